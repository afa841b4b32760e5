//! The directions in which the axis is searched: along the rail, or any.
//!
//! ```text
//! profiles along X --method--> accepted near X, or refused because there is no axis along X
//!                                                        |
//! points --detect--> cylinders in any direction --choose--> one --cut--> sections perpendicular to it --method--> Estimate
//! ```
//!
//! The methods work in a frame whose X lies near the axis. The profiles of a scanner on its rail are in such a frame already;
//! for a cloud, or an axis in another direction, the frame is built from the detected axis.

use super::conclude::conclude;
use super::detect::{Detected, Detection};
use super::estimate::{Conditioning, Estimate, Outcome, Pose, Profile};
use super::progress::Progress;
use super::refusal::{FoundCylinder, Reason, Refusal};
use super::section_cut::SectionCut;
use super::settings::{Method, NOMINAL_REACH, Orientation, Settings};
use super::warning::Warning;
use super::{checks, cylinder, end_face, least_squares, section_line, statistics};
use crate::geometry::Axis;
use crate::scan::{Grouping, Scan};
use std::ops::Range;

/// Number of surfaces to search for in a cloud: two show whether there is a choice; if so, more are listed.
const SURFACES: usize = 2;
const LISTED_MAX: usize = 8;
/// A second surface with this share of the points of the first could also be the part.
const RIVAL: f64 = 0.5;
/// If profiles are given along the rail, an axis in another direction has to explain most of the points.
const MAJORITY: f64 = 0.5;
/// The sections are cut again if the axis lies farther from their X than this, radians (1°).
const CUT_AGAIN: f64 = 0.017;

/// The complete measurement in the orientation that the settings request.
pub(super) fn measure(scan: &Scan, settings: &Settings, progress: &Progress) -> Estimate {
    if settings.method == Method::LeastSquares {
        return with_tilt(least_squares::measure(scan, settings, progress), settings);
    }
    let mut estimate = in_orientation(scan, settings, progress);
    let reach = estimate.residuals.map_or(0.0, |residuals| statistics::TUKEY_C * residuals.sigma);
    if let Outcome::Accepted(pose) = &estimate.outcome
        && pose.cut.is_none()
        && checks::is_concave(scan, pose, reach)
    {
        estimate.conditioning.warnings.push(Warning::ConcaveTowardsSensor);
    }
    estimate
}

fn in_orientation(scan: &Scan, settings: &Settings, progress: &Progress) -> Estimate {
    if settings.orientation == Orientation::Any || scan.grouping() == Grouping::Chosen {
        return anywhere(scan, settings, progress);
    }
    let estimate = in_frame(scan, settings, None, progress);
    match &estimate.outcome {
        Outcome::Accepted(_) => with_tilt(estimate, settings),
        Outcome::Refused(refusal) if no_axis_along_x(refusal) && scan.grouping() == Grouping::SharedX => {
            let found = anywhere(scan, settings, &progress.uncounted());
            if matches!(found.outcome, Outcome::Refused(Refusal::NoCylinder { .. })) { estimate } else { found }
        }
        Outcome::Refused(refusal) if no_axis_along_x(refusal) => elsewhere(scan, estimate, settings, progress),
        Outcome::Refused(_) => estimate,
    }
}

/// The estimate, refused or with a warning if its axis lies farther from the rail than allowed.
fn with_tilt(mut estimate: Estimate, settings: &Settings) -> Estimate {
    let Outcome::Accepted(pose) = &estimate.outcome else { return estimate };
    let (angle_deg, tilt_max_deg) = (pose.axis_in_scan().tilt().degrees(), settings.tilt_max_deg);
    if angle_deg <= tilt_max_deg {
        return estimate;
    }
    match settings.orientation {
        Orientation::Rail => {
            estimate.outcome = Outcome::Refused(Refusal::AxisNotAlongRail { angle_deg, tilt_max_deg });
            estimate.conditioning.warnings.clear();
        }
        Orientation::Auto => {
            estimate.conditioning.warnings.push(Warning::AxisNotAlongRail { angle_deg, tilt_max_deg });
        }
        Orientation::Any => {}
    }
    estimate
}

/// Whether a refusal may mean that the axis does not lie along X.
fn no_axis_along_x(refusal: &Refusal) -> bool {
    matches!(
        refusal,
        Refusal::NoCylinder { .. }
            | Refusal::TooFewProfiles { .. }
            | Refusal::TooFewValidProfiles { .. }
            | Refusal::AxialLengthTooShort { .. }
            | Refusal::PointsCollinear { .. }
            | Refusal::SectionsDisagree { .. }
            | Refusal::SectionsNotRound { .. }
            | Refusal::ProfilesNotPlanar { .. }
    )
}

/// Searches other directions if no axis was found along the rail.
fn elsewhere(scan: &Scan, along_rail: Estimate, settings: &Settings, progress: &Progress) -> Estimate {
    let found = detection(scan, settings).map_or_else(Vec::new, |mut detection| detection.cylinders(None, 1));
    let explains_most = |found: &&Detected| found.share >= MAJORITY && tilt_deg(found) > settings.tilt_max_deg;
    let Some(found) = found.first().filter(explains_most) else { return along_rail };
    match settings.orientation {
        Orientation::Rail => {
            let (angle_deg, tilt_max_deg) = (tilt_deg(found), settings.tilt_max_deg);
            let outcome = Outcome::Refused(Refusal::AxisNotAlongRail { angle_deg, tilt_max_deg });
            Estimate { outcome, ..along_rail }
        }
        Orientation::Auto | Orientation::Any => {
            let estimate = about(scan, found, settings, &progress.uncounted());
            if matches!(estimate.outcome, Outcome::Accepted(_)) { estimate } else { along_rail }
        }
    }
}

/// Searches every direction that the settings allow.
fn anywhere(scan: &Scan, settings: &Settings, progress: &Progress) -> Estimate {
    let along_x = ([1.0, 0.0, 0.0], settings.tilt_max_deg.to_radians());
    let is_rail = settings.orientation == Orientation::Rail;
    let along = is_rail.then_some(along_x);
    let mut detection = detection(scan, settings);
    let mut detected = |along, most| detection.as_mut().map_or_else(Vec::new, |it| it.cylinders(along, most));
    let mut found = detected(along, 1);
    // The remaining points may contain a second candidate.
    if found.first().is_some_and(|first| 1.0 - first.share >= RIVAL * first.share) {
        found = detected(along, SURFACES);
        if rivals(&found).len() > 1 {
            found = detected(along, LISTED_MAX);
        }
    }
    match choose(&found, settings) {
        Ok(chosen) => about(scan, chosen, settings, progress),
        Err(refusal) => {
            let beside = if is_rail { detected(None, 1) } else { Vec::new() };
            let beside = beside.first().filter(|found| found.share >= MAJORITY);
            let refusal = match (beside, refusal) {
                (Some(beside), Refusal::NoCylinder { .. }) => {
                    Refusal::AxisNotAlongRail { angle_deg: tilt_deg(beside), tilt_max_deg: settings.tilt_max_deg }
                }
                (_, refusal) => refusal,
            };
            // A refused scan is shown in its original frame.
            Estimate { outcome: Outcome::Refused(refusal), ..in_frame_refused(scan, settings, progress) }
        }
    }
}

/// The verdicts on the profiles of a cloud that shows no part.
fn in_frame_refused(scan: &Scan, settings: &Settings, progress: &Progress) -> Estimate {
    let profiles = scan.stations().iter().map(|station| {
        progress.advance();
        Profile {
            x: station.x,
            points_count: station.end - station.start,
            rejected: Some(Reason::NotConverged),
            section: None,
            offset: None,
        }
    });
    Estimate {
        method: settings.method,
        outcome: Outcome::Refused(Refusal::NoCylinder { nominal_radius_mm: settings.nominal_radius_mm }),
        profiles: profiles.collect(),
        conditioning: Conditioning::default(),
        residuals: None,
    }
}

/// The search for the surfaces of a scan, the one with most points first.
fn detection(scan: &Scan, settings: &Settings) -> Option<Detection> {
    let Range { start, end } = scan.points();
    let point = |place: usize| {
        let index = start + place;
        let station = scan.stations().get(scan.stations().partition_point(|station| station.end <= index))?;
        scan.point(station, index)
    };
    Detection::of(end - start, point, settings.nominal_radius_mm, NOMINAL_REACH)
}

/// The surfaces that could be the part by their number of points.
fn rivals(found: &[Detected]) -> Vec<&Detected> {
    let most = found.iter().map(|found| found.share).fold(0.0, f64::max);
    found.iter().filter(|found| found.share >= RIVAL * most).collect()
}

/// The cylinder that is the part, if there is only one candidate.
fn choose<'a>(found: &'a [Detected], settings: &Settings) -> Result<&'a Detected, Refusal> {
    let no_cylinder = Refusal::NoCylinder { nominal_radius_mm: settings.nominal_radius_mm };
    let along_rail = |found: &&Detected| tilt_deg(found) <= settings.tilt_max_deg;
    let mut possible = rivals(found);
    // Among several cylinders, only those along the rail are candidates.
    if settings.orientation != Orientation::Any && possible.iter().any(along_rail) {
        possible.retain(along_rail);
    }
    match possible.as_slice() {
        [] => Err(no_cylinder),
        [only] => Ok(only),
        [..] => Err(Refusal::SeveralCylinders { cylinders: found.iter().map(FoundCylinder::from).collect() }),
    }
}

/// Measures in a frame along a cylinder that was detected.
fn about(scan: &Scan, detected: &Detected, settings: &Settings, progress: &Progress) -> Estimate {
    let mut axis = Axis { point_mm: detected.point, direction: detected.direction };
    let mut cut = SectionCut::about(&axis, detected.radius, detected.extent);
    for again in [true, false] {
        let Some((sections, of_cut)) = cut.and_then(|cut| Some((cut.apply(scan)?, cut))) else { break };
        let estimate = in_frame(&sections, settings, Some(detected.radius), progress);
        let Outcome::Accepted(pose) = &estimate.outcome else { return estimate };
        let (radius, x_ref, slope) = (pose.radius, pose.x_ref, pose.axis.p.hypot(pose.axis.q));
        let pose = Pose { cut: Some(of_cut), ..(**pose).clone() };
        axis = pose.axis_in_scan();
        let placed = Estimate { outcome: Outcome::Accepted(Box::new(pose)), ..estimate };
        if !again || slope <= CUT_AGAIN {
            return with_tilt(placed, settings);
        }
        // The ends of the part along the axis, relative to the new point of the axis.
        let [first, last] = of_cut.x_mm.map(|x| x - x_ref);
        cut = SectionCut::about(&axis, radius, [first, last]);
    }
    in_frame_refused(scan, settings, progress)
}

fn tilt_deg(found: &Detected) -> f64 {
    Axis { point_mm: found.point, direction: found.direction }.tilt().degrees()
}

impl From<&Detected> for FoundCylinder {
    fn from(found: &Detected) -> Self {
        let [first, last] = found.extent;
        let middle = 0.5 * (first + last);
        let axis = std::array::from_fn(|i| {
            found.point.get(i).copied().unwrap_or(0.0) + middle * found.direction.get(i).copied().unwrap_or(0.0)
        });
        Self {
            point_mm: axis,
            direction: found.direction,
            radius_mm: found.radius,
            length_mm: last - first,
            share: found.share,
        }
    }
}

/// A measurement in a frame whose X lies near the axis. `expected_radius` is the detected one, mm.
fn in_frame(scan: &Scan, settings: &Settings, expected_radius: Option<f64>, progress: &Progress) -> Estimate {
    let found = match settings.method {
        Method::Cylinder | Method::LeastSquares => cylinder::find(scan, settings, expected_radius, progress),
        Method::SectionLine | Method::SectionLinePlain => section_line::find(scan, settings, progress),
    };
    let mut estimate = conclude(settings, found);
    if !progress.is_stopped() {
        end_face::complete(scan, settings, &mut estimate);
    }
    estimate
}
