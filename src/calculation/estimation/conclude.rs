//! Assembles the estimate from the result of a method: conditioning, residuals, warnings.

use super::estimate::{Conditioning, Estimate, Outcome, Profile, Residuals, Section};
use super::refusal::Reason;
use super::settings::{Method, Settings};
use super::statistics::median;
use super::warning::Warning;
use crate::geometry::Angle;

/// The result of a method.
pub(super) struct Found {
    pub(super) outcome: Outcome,
    /// One entry a profile, in station order.
    pub(super) profiles: Vec<Profile>,
    /// Warnings of the method itself.
    pub(super) warnings: Vec<Warning>,
}

/// Below this arc the bias of a free ellipse exceeds its scatter, whatever the radius.
const ARC_OF_BIAS_DEG: f64 = 120.0;
/// A fitted radius that differs from the nominal one by more than this share gives a warning.
const RADIUS_TOLERANCE: f64 = 0.02;

/// A larger share of profiles without the part gives a warning.
const ELSEWHERE_SHARE: f64 = 0.25;

/// Puts the estimate together.
pub(super) fn conclude(settings: &Settings, found: Found) -> Estimate {
    let Found { outcome, profiles, warnings } = found;
    let fitted: Vec<(&Profile, &Section)> = profiles.iter().filter_map(|p| Some((p, p.section.as_ref()?))).collect();
    let valid: Vec<(&Profile, &Section)> = fitted.iter().copied().filter(|(p, _)| p.rejected.is_none()).collect();
    let seen: Vec<&Section> = if valid.is_empty() {
        profiles.iter().filter_map(|p| p.section.as_ref()).collect()
    } else {
        valid.iter().map(|(_, section)| *section).collect()
    };
    let arc = median(seen.iter().map(|section| section.arc.radians()));
    // `cylinder` can give a pose from profiles of which none is valid by itself.
    let accepted = matches!(outcome, Outcome::Accepted(_));
    let served = if valid.is_empty() && accepted { &fitted } else { &valid };
    let points_count: usize = served.iter().map(|(profile, _)| profile.points_count).sum();
    let inner: f64 = served.iter().map(|(profile, section)| section.inlier_ratio * profile.points_count as f64).sum();
    let residuals = median(served.iter().map(|(_, section)| section.sigma))
        .map(|sigma| Residuals { sigma, inlier_ratio: inner / points_count as f64 });
    let conditioning = Conditioning {
        arc: arc.map(Angle::from_radians),
        axial_length: if valid.is_empty() { span(fitted.iter().map(|(p, _)| p.x)) } else { axial_length(&profiles) },
        warnings: [warnings, general_warnings(settings, &outcome, &profiles, arc.map(f64::to_degrees))].concat(),
    };
    Estimate { method: settings.method, outcome, profiles, conditioning, residuals }
}

fn general_warnings(
    settings: &Settings,
    outcome: &Outcome,
    profiles: &[Profile],
    arc_deg: Option<f64>,
) -> Vec<Warning> {
    let Outcome::Accepted(pose) = outcome else { return Vec::new() };
    let radius_mm = pose.radius;
    let elsewhere_count = profiles.iter().filter(|p| p.rejected == Some(Reason::NotConverged)).count();
    let profiles_count = profiles.len();
    let elsewhere = elsewhere_count as f64 > ELSEWHERE_SHARE * profiles_count as f64;
    let differs = |nominal: &f64| (radius_mm - nominal).abs() > RADIUS_TOLERANCE * nominal;
    [
        (settings.method == Method::SectionLinePlain).then_some(Warning::NotRobust),
        (settings.method == Method::Cylinder && elsewhere)
            .then_some(Warning::OnSomeProfiles { elsewhere_count, profiles_count }),
        arc_deg
            .filter(|arc| settings.method != Method::Cylinder && *arc < ARC_OF_BIAS_DEG)
            .map(|arc_deg| Warning::ShortArc { arc_deg }),
        settings
            .nominal_radius_mm
            .filter(differs)
            .map(|nominal_radius_mm| Warning::RadiusDiffers { radius_mm, nominal_radius_mm }),
        (!settings.type_b.is_stated()).then_some(Warning::CalibrationNotStated),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// From the first valid profile to the last, mm.
pub(super) fn axial_length(profiles: &[Profile]) -> f64 {
    span(profiles.iter().filter(|p| p.rejected.is_none()).map(|p| p.x))
}

fn span(mut stations: impl DoubleEndedIterator<Item = f64>) -> f64 {
    let first = stations.next();
    first.zip(stations.next_back()).map_or(0.0, |(first, last)| last - first)
}
