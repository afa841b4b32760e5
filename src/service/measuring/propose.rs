//! Proposes recipes for a scan file without a recipe: one for each cylinder that is detected in its points, in any direction.
//!
//! ```text
//! file --read, clean--> Cloud --detect--> cylinders --in_frame--> Proposal: the cylinder and its recipe
//! ```

use std::io::{BufReader, Read};

use super::copying_reader::READ_BLOCK_BYTES;
use super::offline::unpacked;
use super::order::Origin;
use crate::estimation::{DetectRequest, Detected, FoundCylinder, Orientation, detect};
use crate::geometry::{Axis, Frame};
use crate::scan::Cloud;
use crate::scan::decode::{DecodeError, Limits};
use crate::scan::missing::clean;
use crate::scan::slice::Region;

use super::pipeline::read;
use super::recipe::{Recipe, Resolved};

/// Maximum number of proposals: a longer list is not useful, and the search for each cylinder takes time.
pub const PROPOSALS_MAX: usize = 8;
/// A cylinder with a smaller share of the points than this fraction of the first one's is clutter.
const SHARE_MIN: f64 = 0.05;
/// Maximum number of points for the search. It draws a random sample of some thousand; more points only use memory.
const SEARCHED_MAX: usize = 200_000;
/// The region extends beyond each end of the cylinder by this fraction of its length, like the sections of the estimation: the
/// search reports the extent of 98 % of the points.
const BEYOND_ENDS: f64 = 0.05;
/// Half the width of the region in radii: the distance from the axis within which the estimation keeps points.
const HALF_WIDTH: f64 = 1.5;
/// Decimals of a direction; over the length of a part, the rounding is a millionth of the length.
const DIRECTION_DECIMALS: usize = 6;

/// A cylinder of a scan and a recipe that measures it.
#[derive(Debug, Clone, PartialEq)]
pub struct Proposal {
    /// The detected cylinder in the coordinates of the scan, its axis rounded as in the recipe. It is the initial value of
    /// a measurement, not its result.
    pub cylinder: FoundCylinder,
    /// The recipe, which can be used without changes.
    pub recipe: Recipe,
}

/// Reads the points of a scan file like a measurement: gzip and zstd are decompressed, missing points and repeated profiles
/// removed.
///
/// # Errors
/// [`DecodeError`] with the cause in the file.
pub fn read_cloud(
    source: Box<dyn Read + '_>,
    origin: &Origin,
    resolved: &Resolved,
    limits: &Limits,
) -> Result<Cloud, DecodeError> {
    let (source, sent) = unpacked(source, limits)?;
    let mut reader = BufReader::with_capacity(READ_BLOCK_BYTES, source);
    let decoded = read(&mut reader, &origin.claims(), resolved, limits, sent.as_ref())?;
    let (cloud, _) = clean(decoded.cloud, resolved.missing_values.as_deref());
    match cloud.columns.is_empty() {
        true => Err(DecodeError::NoPoints { missing_count: cloud.missing_count }),
        false => Ok(cloud),
    }
}

/// A recipe for each cylinder of a cloud, the one with most points first. Each recipe contains all values of `asked`;
/// `nominal_radius_mm` restricts the search to cylinders within 2 % of it.
#[must_use]
pub fn propose(cloud: &Cloud, asked: &Recipe, nominal_radius_mm: Option<f64>) -> Vec<Proposal> {
    let request = DetectRequest { nominal_radius_mm, most: PROPOSALS_MAX, ..DetectRequest::default() };
    let mut found = detect(&searched(cloud), &request);
    let share_min = SHARE_MIN * found.first().map_or(0.0, |first| first.share);
    found.retain(|found| found.share >= share_min);
    let count = found.len();
    let numbered = found.iter().enumerate();
    numbered.filter_map(|(index, found)| proposal(found, asked, &format!("{} of {count}", index + 1))).collect()
}

/// The points of a cloud, or every n-th of a large one. n is odd, so that the selection does not alias with rows of an even number
/// of points.
fn searched(cloud: &Cloud) -> Vec<[f64; 3]> {
    let step = cloud.columns.len().div_ceil(SEARCHED_MAX) | 1;
    cloud.points().step_by(step).collect()
}

/// The recipe of a cylinder. `None` if its axis has no direction, which the search does not report.
fn proposal(found: &Detected, asked: &Recipe, number: &str) -> Option<Proposal> {
    let FoundCylinder { point_mm, direction, radius_mm, length_mm, share } = FoundCylinder::from(found);
    let decimals = cylinder_decimals(radius_mm);
    let length = |value: f64| rounded(value, decimals);
    let axis = Axis {
        point_mm: point_mm.map(length),
        direction: direction.map(|component| rounded(component, DIRECTION_DECIMALS)),
    };
    // `Frame::along` normalises the direction again, to full precision.
    let frame = Frame { x_axis: axis.direction, ..Frame::along(&axis).ok()? };
    let about_axis = |half: f64| Some([-length(half), length(half)]);
    let across = about_axis(HALF_WIDTH * radius_mm);
    let region = Region { x_mm: about_axis((0.5 + BEYOND_ENDS) * length_mm), y_mm: across, z_mm: across };
    let description = format!(
        "cylinder {number}: radius {} mm, length {} mm, {:.0} % of the points",
        three_digits(radius_mm),
        three_digits(length_mm),
        100.0 * share
    );
    let recipe = Recipe {
        description: Some(description),
        // X of the frame lies along this cylinder, so a cylinder that crosses it is excluded.
        orientation: Some(Orientation::Rail),
        frame: Some(frame),
        region: Some(region),
        ..asked.clone()
    };
    let cylinder = FoundCylinder { point_mm: axis.point_mm, direction: axis.direction, radius_mm, length_mm, share };
    Some(Proposal { cylinder, recipe })
}

/// Decimals that represent a length of a cylinder to a ten-thousandth of its radius or better: people read recipes, and the
/// detection is not more accurate.
#[must_use]
pub fn cylinder_decimals(radius_mm: f64) -> usize {
    let decade = (1e-4 * radius_mm).log10().floor();
    // A radius that is not finite, which the search does not report, gets no decimals.
    if decade.is_finite() { (-decade).clamp(0.0, 12.0) as usize } else { 0 }
}

/// A value rounded to `decimals` decimals.
fn rounded(value: f64, decimals: usize) -> f64 {
    // Adding zero converts −0 to 0.
    format!("{value:.decimals$}").parse().unwrap_or(value) + 0.0
}

/// A positive length for people, with three digits.
fn three_digits(value: f64) -> String {
    crate::service::wording::plain(format!("{value:.2e}").parse().unwrap_or(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_rounded_to_a_ten_thousandth_of_the_radius() {
        for (radius, decimals) in [(94.1, 3), (200.0, 2), (0.3, 5), (1e6, 0), (f64::NAN, 0), (0.0, 0)] {
            assert_eq!(cylinder_decimals(radius), decimals, "{radius}");
        }
        assert_eq!(rounded(-12.345_678, 3), -12.346);
        assert!(rounded(-0.000_1, 3).is_sign_positive());
        assert_eq!([94.123, 310.4, 1234.0].map(three_digits), ["94.1", "310", "1230"]);
    }

    #[test]
    fn a_recipe_encloses_its_cylinder_and_contains_the_requested_values() {
        let found = Detected {
            point: [1.0, 2.0, 3.0],
            direction: [0.0, 0.6, 0.8],
            radius: 20.0,
            sigma: 0.01,
            share: 0.42,
            extent: [-40.0, 60.0],
            arc: 3.0,
            evidence: 1000.0,
        };
        let asked = Recipe { nominal_radius_mm: Some(20.1), ..Recipe::default() };
        let Proposal { cylinder, recipe } = proposal(&found, &asked, "2 of 3").expect("a direction");
        assert_eq!(cylinder.length_mm, 100.0);
        let frame = recipe.frame.expect("a frame");
        // The middle of the extent lies 10 mm from the point.
        assert_eq!((frame.origin_mm, frame.x_axis), ([1.0, 8.0, 11.0], [0.0, 0.6, 0.8]));
        let region = recipe.region.expect("a region");
        assert_eq!(
            (region.x_mm, region.y_mm, region.z_mm),
            (Some([-55.0, 55.0]), Some([-30.0, 30.0]), Some([-30.0, 30.0]))
        );
        assert_eq!((recipe.nominal_radius_mm, recipe.orientation), (Some(20.1), Some(Orientation::Rail)));
        let description = "cylinder 2 of 3: radius 20 mm, length 100 mm, 42 % of the points";
        assert_eq!(recipe.description.as_deref(), Some(description));
        assert!(recipe.check().is_ok());
    }
}
