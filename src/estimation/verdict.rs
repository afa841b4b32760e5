//! What is accepted and what is refused: each profile by its section, the scan by its valid profiles. Decides from
//! numbers that others calculated; must not fit anything itself.

use super::axis::{Centre, Fit};
use super::{
    Component, Conditioning, Estimate, Method, Outcome, Pose, Profile, RadiusSource, Reason, Refusal, Residuals,
    Section, Settings, Uncertainty, Warning, robust,
};
use crate::geometry::Angle;
use crate::scan::{Scan, Station};

/// Below this arc a free ellipse is biased by more than its scatter, whatever the radius.
const ARC_OF_BIAS_DEG: f64 = 120.0;
/// A section whose arc stays below this is a straight line for every purpose.
const STRAIGHT_DEG: f64 = 0.5;
/// Radii of sections that scatter by more than this share of their median do not belong to one cylinder: on the shortest
/// arc that is accepted by default, 60°, noise makes them scatter by a few hundredths.
const RADIUS_SPREAD: f64 = 0.1;
/// A fitted radius this far from the nominal one, relative to it, is warned of.
const RADIUS_TOLERANCE: f64 = 0.02;

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
    let profiles_count = profiles.len();
    if identical(scan) {
        return Some(Refusal::PointsIdentical { points_count: scan.columns().len() });
    }
    if profiles_count < settings.profiles_min as usize {
        return Some(Refusal::TooFewProfiles { profiles_count, profiles_min: settings.profiles_min });
    }
    if collinear(scan) {
        return Some(Refusal::PointsCollinear { profiles_count });
    }
    too_few_valid(profiles, settings)
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

fn identical(scan: &Scan) -> bool {
    let first = scan.columns().get(0);
    (1..scan.columns().len()).all(|index| scan.columns().get(index) == first)
}

/// Whether every profile of the scan is straight to within rounding of its own size.
fn collinear(scan: &Scan) -> bool {
    let (mut y, mut z) = (Vec::new(), Vec::new());
    scan.stations().iter().all(|station| {
        scan.load(*station, &mut y, &mut z);
        straight(&y, &z)
    })
}

fn straight(y: &[f64], z: &[f64]) -> bool {
    let count = y.len() as f64;
    let (mean_y, mean_z) = (y.iter().sum::<f64>() / count, z.iter().sum::<f64>() / count);
    let (mut yy, mut yz, mut zz) = (0.0, 0.0, 0.0);
    for (y, z) in y.iter().zip(z) {
        let (y, z) = (y - mean_y, z - mean_z);
        (yy, yz, zz) = (yy + y * y, yz + y * z, zz + z * z);
    }
    let (mean, spread) = (0.5 * (yy + zz), 0.5 * (yy - zz).hypot(2.0 * yz));
    // Along the chord an arc of angle φ has the variance R²φ²/12, across it R²φ⁴/720: their ratio is φ²/60.
    mean - spread <= (mean + spread) * STRAIGHT_DEG.to_radians().powi(2) / 60.0
}

fn axial_length(profiles: &[Profile]) -> f64 {
    let mut used = profiles.iter().filter(|p| p.rejected.is_none()).map(|p| p.x);
    let first = used.next();
    first.zip(used.next_back()).map_or(0.0, |(first, last)| last - first)
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

/// Puts the estimate together.
pub(super) fn conclude(settings: &Settings, outcome: Outcome, profiles: Vec<Profile>) -> Estimate {
    let valid: Vec<(&Profile, &Section)> =
        profiles.iter().filter(|p| p.rejected.is_none()).filter_map(|p| Some((p, p.section.as_ref()?))).collect();
    let seen: Vec<&Section> = if valid.is_empty() {
        profiles.iter().filter_map(|p| p.section.as_ref()).collect()
    } else {
        valid.iter().map(|(_, section)| *section).collect()
    };
    let arc = median(seen.iter().map(|section| section.arc.radians()));
    let points_count: usize = valid.iter().map(|(profile, _)| profile.points_count).sum();
    let inner: f64 = valid.iter().map(|(profile, section)| section.inlier_ratio * profile.points_count as f64).sum();
    let residuals = median(valid.iter().map(|(_, section)| section.sigma))
        .map(|sigma| Residuals { sigma, inlier_ratio: inner / points_count as f64 });
    let conditioning = Conditioning {
        arc: arc.map(Angle::from_radians),
        axial_length: axial_length(&profiles),
        warnings: warnings(settings, &outcome, arc.map(f64::to_degrees)),
    };
    Estimate { method: settings.method, outcome, profiles, conditioning, residuals }
}

fn warnings(settings: &Settings, outcome: &Outcome, arc_deg: Option<f64>) -> Vec<Warning> {
    let Outcome::Accepted(pose) = outcome else { return Vec::new() };
    let radius_mm = pose.radius;
    let differs = |nominal: &f64| (radius_mm - nominal).abs() > RADIUS_TOLERANCE * nominal;
    [
        (settings.method == Method::SectionLinePlain).then_some(Warning::NotRobust),
        arc_deg.filter(|arc| *arc < ARC_OF_BIAS_DEG).map(|arc_deg| Warning::ShortArc { arc_deg }),
        settings
            .nominal_radius_mm
            .filter(differs)
            .map(|nominal_radius_mm| Warning::RadiusDiffers { radius_mm, nominal_radius_mm }),
    ]
    .into_iter()
    .flatten()
    .collect()
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}
