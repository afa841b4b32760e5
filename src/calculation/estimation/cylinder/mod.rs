//! One cylinder through all profiles at once. Every profile contributes, even one that is half covered by a clamp: its other half
//! determines slopes and radius equally well.
//!
//! ```text
//! Scan --sample--> Sample --consensus--> starts --settle--> candidates --choose--> one --solve--> Solution
//!   A                     (five points)         (coarse to fine)      (coverage, nominal radius)  (every point)
//!   '------ Subset: without points in other directions about the axis ------------------------- pieces --'
//!
//! Solution --second_surface, layers--> without thin layers --field--> covariance --budget_lines--> budget, warnings
//!     '--------judge----------> verdicts
//! ```

mod block;
mod budget_lines;
mod candidates;
mod consensus;
mod covariance;
mod field;
mod judge;
mod kernel;
mod layers;
mod model;
mod normal_equations;
mod patches;
mod pieces;
pub(super) mod sample;
mod search;
mod second_surface;
mod solve;

use super::budget::Line;
use super::checks;
use super::conclude::Found;
use super::estimate::{EndFaces, Outcome, Pose, Profile, RadiusSource, Uncertainty};
use super::progress::Progress;
use super::refusal::{Reason, Refusal};
use super::settings::{RadiusRule, Settings};
use super::warning::Warning;
use crate::scan::{Scan, Station};
use judge::Model;
use normal_equations::RadiusConstraint;
use search::{too_few, too_short};
use solve::Solution;

/// A pose is based on at least this share of the profiles. With few profiles half of them have to agree, with very few two thirds.
const SHARE_MIN: f64 = 0.1;
const FEW: usize = 20;
const VERY_FEW: usize = 8;
/// A profile agrees if it has at least this share of the largest number of inliers of any profile.
const AGREEING: f64 = 0.25;

/// The pose or the reason why there is none, and the verdict on every profile.
pub(super) fn find(scan: &Scan, settings: &Settings, expected_radius: Option<f64>, progress: &Progress) -> Found {
    let used = search::enough(scan, settings);
    match search::search(scan, &used, settings, expected_radius, progress) {
        Err(refusal) => {
            Found { outcome: Outcome::Refused(refusal), profiles: unjudged(scan, &used), warnings: Vec::new() }
        }
        Ok(solution) => {
            let model = Model {
                cylinder: &solution.cylinder,
                sigma: solution.sigma,
                sums: &solution.profiles,
                inner: &solution.inner,
                passes_count: solution.passes_count,
            };
            let profiles = judge::judge(scan, &used, model, settings);
            let (outcome, warnings) = match weigh(scan, &solution, most_common(&profiles), settings) {
                Ok((pose, warnings)) => (Outcome::Accepted(Box::new(pose)), warnings),
                Err(refusal) => (Outcome::Refused(refusal), Vec::new()),
            };
            Found { outcome, profiles, warnings }
        }
    }
}

/// The most frequent reason for which profiles were rejected.
fn most_common(profiles: &[Profile]) -> Reason {
    let count = |reason: Reason| profiles.iter().filter(|profile| profile.rejected == Some(reason)).count();
    profiles
        .iter()
        .filter_map(|profile| profile.rejected)
        .max_by_key(|reason| count(*reason))
        .unwrap_or(Reason::NotConverged)
}

/// A tenth of the profiles have to lie on the surface, and half or two thirds of few profiles: a cylinder can be tilted until it
/// passes through some profiles that vibration has shifted, and then does not describe the others.
fn agreed(scan: &Scan, solution: &Solution, most_common: Reason, settings: &Settings) -> Result<(), Refusal> {
    let share = |(station, sums): (&Station, &normal_equations::Sums)| {
        sums.weight / (station.end - station.start).max(1) as f64
    };
    let shares: Vec<f64> = scan.stations().iter().zip(&solution.profiles).map(share).collect();
    let fullest = shares.iter().copied().fold(0.0, f64::max);
    let agreeing_count = shares.iter().filter(|share| **share >= AGREEING * fullest).count();
    let needed_count = match shares.len() {
        count if count <= VERY_FEW => (2 * count).div_ceil(3),
        count if count <= FEW => count.div_ceil(2),
        count => (SHARE_MIN * count as f64).ceil() as usize,
    };
    if agreeing_count >= needed_count {
        return Ok(());
    }
    let profiles_min = needed_count.try_into().unwrap_or(u32::MAX);
    let settings = Settings { profiles_min, ..*settings };
    Err(too_few(shares.len(), agreeing_count, most_common, Some(solution.sigma), &settings))
}

/// The pose with its uncertainty and warnings, or the refusal that the solution gives rise to.
fn weigh(
    scan: &Scan,
    solution: &Solution,
    most_common: Reason,
    settings: &Settings,
) -> Result<(Pose, Vec<Warning>), Refusal> {
    let shown = |(_, sums): &(&Station, &normal_equations::Sums)| sums.weight >= 3.0;
    let valid_count = scan.stations().iter().zip(&solution.profiles).filter(shown).count();
    if valid_count < settings.profiles_min as usize {
        return Err(too_few(scan.stations().len(), valid_count, most_common, Some(solution.sigma), settings));
    }
    agreed(scan, solution, most_common, settings)?;
    if let Some(layer_ratio) = second_surface::share(scan, solution) {
        return Err(Refusal::LayersUndecided { layer_ratio, reach_mm: second_surface::WITHIN * solution.sigma });
    }
    let stations = scan.stations().iter().zip(&solution.profiles).filter(shown).map(|(station, _)| station);
    too_short(stations, settings)?;
    let constraint = RadiusConstraint::of(settings);
    let mut lines = budget_lines::from_data(solution, constraint, settings);
    lines.extend(budget_lines::from_curvature(solution, constraint));
    lines.extend(budget_lines::from_layers(solution));
    lines.extend(budget_lines::from_resolution(scan, solution, constraint));
    let form = budget_lines::form(scan, solution, constraint);
    lines.extend(form.iter().map(|form| Line::of_shift(Line::FORM, &form.shift, &solution.cylinder.axis())));
    lines.extend(budget_lines::from_calibration(scan, solution, constraint, settings));
    let uncertainty = Uncertainty::of(&lines, &solution.cylinder.axis(), solution.cylinder.x_ref);
    if let Some(refusal) = checks::undetermined(&uncertainty, solution.cylinder.radius, settings) {
        return Err(refusal);
    }
    Ok((pose(solution, settings, uncertainty), form.map_or_else(Vec::new, |form| form.warnings)))
}

fn pose(solution: &Solution, settings: &Settings, uncertainty: Uncertainty) -> Pose {
    Pose {
        axis: solution.cylinder.axis(),
        x_ref: solution.cylinder.x_ref,
        cut: None,
        radius: solution.cylinder.radius,
        radius_source: match settings.radius {
            RadiusRule::Free => RadiusSource::Fitted,
            RadiusRule::Fixed => RadiusSource::Nominal,
            RadiusRule::Prior => RadiusSource::Prior,
        },
        uncertainty,
        end_faces: EndFaces::default(),
    }
}

/// The profiles of a scan in which no cylinder was found.
fn unjudged(scan: &Scan, used: &[bool]) -> Vec<Profile> {
    let reason = |used: &bool| if *used { Reason::NotConverged } else { Reason::TooFewPoints };
    let profile = |(station, used): (&Station, &bool)| Profile {
        x: station.x,
        points_count: station.end - station.start,
        rejected: Some(reason(used)),
        section: None,
        offset: None,
    };
    scan.stations().iter().zip(used).map(profile).collect()
}
