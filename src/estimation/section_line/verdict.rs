//! What is accepted and what is refused: each profile by its section, the scan by its valid profiles. Decides from
//! numbers that others calculated; must not fit anything itself.

use super::axis::{Centre, Fit};
use crate::estimation::conclude::{axial_length, median};
use crate::estimation::unusable::unusable;
use crate::estimation::{
    Component, Method, Pose, Profile, RadiusSource, Reason, Refusal, Section, Settings, Uncertainty, robust,
};
use crate::scan::{Scan, Station};

/// Radii of sections that scatter by more than this share of their median do not belong to one cylinder: on the shortest
/// arc that is accepted by default, 60°, noise makes them scatter by a few hundredths.
const RADIUS_SPREAD: f64 = 0.1;

/// Judges a profile by its own section.
pub(super) fn profile(station: &Station, section: Result<Section, Reason>, settings: &Settings) -> Profile {
    let rejected = match &section {
        Err(reason) => Some(*reason),
        Ok(_) if settings.method == Method::SectionLinePlain => None,
        Ok(section) if section.inlier_ratio < settings.inlier_ratio_min => Some(Reason::LowInlierRatio),
        Ok(section) if section.arc.degrees() < settings.arc_min_deg => Some(Reason::ArcTooShort),
        Ok(_) => None,
    };
    Profile { x: station.x, points_count: station.end - station.start, rejected, section: section.ok(), offset: None }
}

/// A valid profile's say in the axis.
pub(super) fn centre(profile: &Profile) -> Option<Centre> {
    let section = profile.section.filter(|_| profile.rejected.is_none())?;
    let ellipse = section.ellipse;
    Some(Centre { x: profile.x, y: ellipse.centre_y, z: ellipse.centre_z, radius: ellipse.semi_minor })
}

/// Refusals that need no axis, the most telling first.
pub(super) fn before_fitting(scan: &Scan, profiles: &[Profile], settings: &Settings) -> Option<Refusal> {
    unusable(scan, settings).or_else(|| too_few_valid(profiles, settings))
}

/// Refusals that the finished axis gives rise to.
pub(super) fn after_fitting(profiles: &[Profile], settings: &Settings) -> Option<Refusal> {
    too_few_valid(profiles, settings)
        .or_else(|| too_short(profiles, settings))
        .or_else(|| (settings.method == Method::SectionLine).then(|| disagreement(profiles)).flatten())
}

fn too_short(profiles: &[Profile], settings: &Settings) -> Option<Refusal> {
    let (axial_length_mm, axial_length_min_mm) = (axial_length(profiles), settings.axial_length_min_mm);
    (axial_length_mm < axial_length_min_mm)
        .then_some(Refusal::AxialLengthTooShort { axial_length_mm, axial_length_min_mm })
}

fn disagreement(profiles: &[Profile]) -> Option<Refusal> {
    let radii = || profiles.iter().filter_map(centre).map(|centre| centre.radius);
    let radius_mm = median(radii())?;
    let squared: Vec<f64> = radii().map(|radius| (radius - radius_mm).powi(2)).collect();
    let radius_spread_mm = robust::sigma(&squared, &mut Vec::new());
    (radius_spread_mm > RADIUS_SPREAD * radius_mm).then_some(Refusal::SectionsDisagree { radius_mm, radius_spread_mm })
}

/// The refusal where the valid centres allow no line at all.
pub(super) fn no_axis(profiles: &[Profile], settings: &Settings) -> Refusal {
    after_fitting(profiles, settings).unwrap_or(Refusal::AxialLengthTooShort {
        axial_length_mm: axial_length(profiles),
        axial_length_min_mm: settings.axial_length_min_mm,
    })
}

fn too_few_valid(profiles: &[Profile], settings: &Settings) -> Option<Refusal> {
    let (profiles_min, profiles_count) = (settings.profiles_min, profiles.len());
    let valid_count = profiles.iter().filter(|p| p.rejected.is_none()).count();
    let counted = |reason: &Reason| profiles.iter().filter(|p| p.rejected == Some(*reason)).count();
    // The earlier of two equally common reasons names the plainer cause.
    let most_common = Reason::ALL.into_iter().rev().max_by_key(counted).unwrap_or(Reason::NotConverged);
    (valid_count < profiles_min as usize).then_some(Refusal::TooFewValidProfiles {
        valid_count,
        profiles_count,
        profiles_min,
        most_common,
    })
}

/// Notes every centre's distance from the axis and rejects those that the line gave no weight.
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

/// The pose with what its repeatability over the profiles says.
pub(super) fn pose(fit: &Fit) -> Pose {
    let [[a, ..], [_, b, ..], [_, _, c, ..], [_, _, _, d, _], [_, _, _, _, e]] = fit.covariance;
    let standard = [a, b, c, d, e].map(|variance| variance.max(0.0).sqrt());
    Pose {
        axis: fit.axis,
        x_ref: fit.x_ref,
        radius: fit.radius,
        radius_source: RadiusSource::Fitted,
        uncertainty: Uncertainty {
            covariance: fit.covariance,
            budget: vec![Component { source: "repeatability".to_owned(), standard }],
        },
    }
}
