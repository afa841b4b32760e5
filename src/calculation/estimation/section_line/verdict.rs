//! Decides which profiles are valid, by their sections, and whether the scan is refused, by its valid profiles.

use super::axis::{Centre, Fit};
use super::bias::Bias;
use crate::estimation::budget::Line;
use crate::estimation::checks::unusable;
use crate::estimation::conclude::axial_length;
use crate::estimation::estimate::{EndFaces, Pose, Profile, RadiusSource, Section, Uncertainty};
use crate::estimation::refusal::{Reason, Refusal};
use crate::estimation::settings::{Method, Settings};
use crate::estimation::statistics::{self, median};
use crate::estimation::type_b::{Found, PatchInfluence};
use crate::geometry::AxisLine;
use crate::scan::{Scan, Station};
use nalgebra::Vector5;

/// Radii of sections do not belong to one cylinder if they scatter by more than this share of their median,
const RADIUS_SPREAD: f64 = 0.03;
/// and by more than this many times the effect of their noise.
const RADIUS_SCATTERS: f64 = 4.0;
/// The axes of a section have the ratio 1 to 1/cos of the tilt; below this, a tilt of 53°, it is not a section of a part on a rail.
const SLENDER: f64 = 0.6;
/// Sections are not round if their axis ratio differs from that of the tilt by more than this share.
const ROUND: f64 = 0.1;

/// Judges a profile by its own section.
pub(super) fn profile(station: &Station, section: Result<Section, Reason>, settings: &Settings) -> Profile {
    let rejected = match &section {
        Err(reason) => Some(*reason),
        Ok(_) if settings.method == Method::SectionLinePlain => None,
        // A nearly flat or otherwise degenerate ellipse is not the section of a cylinder that crosses the planes.
        Ok(section) if section.ellipse.semi_minor < SLENDER * section.ellipse.semi_major => Some(Reason::NotConverged),
        Ok(section) if section.ellipse.semi_minor < settings.radius_resolved_mm() => Some(Reason::NotConverged),
        Ok(section) if section.inlier_ratio < settings.inlier_ratio_min => Some(Reason::LowInlierRatio),
        Ok(section) if section.arc.degrees() < settings.arc_min_deg => Some(Reason::ArcTooShort),
        Ok(_) => None,
    };
    Profile { x: station.x, points_count: station.end - station.start, rejected, section: section.ok(), offset: None }
}

/// The contribution of a valid profile to the axis.
pub(super) fn centre(profile: &Profile) -> Option<Centre> {
    let section = profile.section.filter(|_| profile.rejected.is_none())?;
    let ellipse = section.ellipse;
    Some(Centre { x: profile.x, y: ellipse.centre_y, z: ellipse.centre_z, radius: ellipse.semi_minor })
}

/// Refusals that need no axis, the most specific first.
pub(super) fn before_fitting(scan: &Scan, profiles: &[Profile], settings: &Settings) -> Option<Refusal> {
    unusable(scan, settings).or_else(|| too_few_valid(profiles, settings))
}

/// Refusals that the fitted axis gives rise to.
pub(super) fn after_fitting(profiles: &[Profile], axis: &AxisLine, bias: Bias, settings: &Settings) -> Option<Refusal> {
    too_few_valid(profiles, settings).or_else(|| too_short(profiles, settings)).or_else(|| {
        (settings.method == Method::SectionLine)
            .then(|| disagreement(profiles, bias).or_else(|| not_round(profiles, axis)))
            .flatten()
    })
}

/// Sections are ellipses with the axes R and R·n, n² = 1 + p² + q²; any other ratio does not belong to a cylinder.
fn not_round(profiles: &[Profile], axis: &AxisLine) -> Option<Refusal> {
    let valid = profiles.iter().filter(|p| p.rejected.is_none()).filter_map(|p| p.section);
    let axis_ratio = median(valid.map(|section| section.ellipse.semi_major / section.ellipse.semi_minor))?;
    let expected_ratio = (1.0 + axis.p * axis.p + axis.q * axis.q).sqrt();
    let round = (axis_ratio / expected_ratio - 1.0).abs() <= ROUND;
    (!round).then_some(Refusal::SectionsNotRound { axis_ratio, expected_ratio })
}

fn too_short(profiles: &[Profile], settings: &Settings) -> Option<Refusal> {
    let (axial_length_mm, axial_length_min_mm) = (axial_length(profiles), settings.axial_length_min_mm.unwrap_or(0.0));
    (axial_length_mm < axial_length_min_mm)
        .then_some(Refusal::AxialLengthTooShort { axial_length_mm, axial_length_min_mm })
}

fn disagreement(profiles: &[Profile], bias: Bias) -> Option<Refusal> {
    let radii = || profiles.iter().filter_map(centre).map(|centre| centre.radius);
    let radius_mm = median(radii())?;
    let squared: Vec<f64> = radii().map(|radius| (radius - radius_mm).powi(2)).collect();
    let radius_spread_mm = statistics::sigma(&squared, &mut Vec::new());
    let limit = (RADIUS_SPREAD * radius_mm).max(RADIUS_SCATTERS * bias.radius_scatter);
    (radius_spread_mm > limit).then_some(Refusal::SectionsDisagree { radius_mm, radius_spread_mm })
}

/// The refusal if the valid centres determine no line.
pub(super) fn no_axis(profiles: &[Profile], settings: &Settings) -> Refusal {
    too_few_valid(profiles, settings).unwrap_or(Refusal::AxialLengthTooShort {
        axial_length_mm: axial_length(profiles),
        axial_length_min_mm: settings.axial_length_min_mm.unwrap_or(0.0),
    })
}

fn too_few_valid(profiles: &[Profile], settings: &Settings) -> Option<Refusal> {
    let (profiles_min, profiles_count) = (settings.profiles_min, profiles.len());
    let valid_count = profiles.iter().filter(|p| p.rejected.is_none()).count();
    let counted = |reason: &Reason| profiles.iter().filter(|p| p.rejected == Some(*reason)).count();
    // The earlier of two equally common reasons names the simpler cause.
    let most_common = Reason::ALL.into_iter().rev().max_by_key(counted).unwrap_or(Reason::NotConverged);
    let sigma_mm = median(profiles.iter().filter_map(|p| p.section).map(|section| section.sigma));
    let epsilon_mm = settings.epsilon_mm;
    let few = valid_count < profiles_min as usize;
    few.then_some(Refusal::TooFewValidProfiles {
        valid_count,
        profiles_count,
        profiles_min,
        most_common,
        sigma_mm,
        epsilon_mm,
    })
}

/// Stores every centre's distance from the axis and rejects those without weight in the line.
pub(super) fn mark_off_axis(profiles: &mut [Profile], fit: &Fit) {
    let mut weights = fit.weights.iter();
    for profile in profiles {
        let off = profile.rejected.is_none() && profile.section.is_some() && weights.next() == Some(&0.0);
        if off {
            profile.rejected = Some(Reason::OffAxis);
        }
        profile.offset =
            profile.section.map(|s| fit.axis.distance([profile.x, s.ellipse.centre_y, s.ellipse.centre_z]));
    }
}

/// The pose with its uncertainty: the scatter of the profiles, the bias common to all of them, and the errors that no scan shows.
pub(super) fn pose(fit: &Fit, bias: Bias, patches: &[PatchInfluence], origin: [f64; 3], settings: &Settings) -> Pose {
    let Fit { axis, x_ref, radius, .. } = *fit;
    // The errors of position and radius are correlated: the ellipse shrinks away from the observed arc.
    let shared = Vector5::new(0.0, 0.0, bias.y, bias.z, bias.radius);
    let mut lines = vec![
        Line::of_slopes(Line::REPEATABILITY, &fit.covariance, &axis).with_freedom(Vector5::repeat(fit.freedom)),
        Line::of_shift(Line::FIT_BIAS, &shared, &axis),
    ];
    lines.extend(settings.type_b.lines(&Found { axis, x_ref, radius, origin }, &fit.influences, patches));
    let (uncertainty, end_faces) = (Uncertainty::of(&lines, &axis, x_ref), EndFaces::default());
    Pose { axis, x_ref, cut: None, radius, radius_source: RadiusSource::Fitted, uncertainty, end_faces }
}
