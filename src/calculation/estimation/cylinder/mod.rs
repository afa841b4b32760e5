//! One cylinder through all profiles at once. Every profile serves, also one that is half under a clamp: what its other half
//! says about slopes and radius is as good as anybody's.
//!
//! ```text
//! Scan --sample--> Sample --consensus--> starts --settle--> candidates --choose--> one --solve--> Solution
//!   A                     (five points)         (coarse to fine)      (coverage, nominal radius)  (every point)
//!   '---------------------------- rest: without points that lie far about the axis ---------------- pieces --'
//!
//! Solution --beneath, layers--> without thin layers --field--> covariance --known, form--> budget, warnings
//!     |--------hollow---------> refused where the fit lies between two surfaces
//!     '--------judge----------> verdicts
//! ```

mod beneath;
mod block;
mod candidates;
mod cells;
mod components;
mod consensus;
mod covariance;
pub(super) mod extent;
mod field;
mod form;
mod hollow;
mod judge;
mod kernel;
mod known;
mod layers;
mod linearity;
mod model;
mod moments;
mod narrow;
mod patches;
mod pieces;
mod profile;
mod projection;
mod resolution;
mod rest;
mod sample;
mod scatter;
mod search;
mod settle;
mod smooth;
mod solve;
mod step;
mod sums;

use super::budget::Line;
use super::estimate::{EndFaces, Outcome, Pose, Profile, RadiusSource, Reason, Uncertainty};
use super::progress::Progress;
use super::refusal::Refusal;
use super::settings::{RadiusRule, Settings};
use super::warning::Warning;
use super::{Found, limits};
use crate::scan::{Scan, Station};
use judge::Model;
use solve::Solution;
use step::Hold;

/// A pose rests on this share of the profiles at least. So few profiles have to agree by half, and so very few by two thirds,
const SHARE_MIN: f64 = 0.1;
const FEW: usize = 20;
const VERY_FEW: usize = 8;
/// and one agrees that has this share on the surface of what the fullest has.
const AGREEING: f64 = 0.25;

/// The pose or why there is none, and what became of every profile.
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

fn hold(settings: &Settings) -> Hold {
    match (settings.radius, settings.nominal_radius_mm) {
        (RadiusRule::Fixed, Some(radius)) => Hold::Fixed { radius },
        (RadiusRule::Prior, Some(radius)) => Hold::Prior { radius, sigma: settings.radius_sigma_mm.unwrap_or(0.0) },
        _ => Hold::Free,
    }
}

fn too_few(
    profiles_count: usize,
    valid_count: usize,
    most_common: Reason,
    sigma_mm: Option<f64>,
    settings: &Settings,
) -> Refusal {
    let (profiles_min, epsilon_mm) = (settings.profiles_min, settings.epsilon_mm);
    Refusal::TooFewValidProfiles { valid_count, profiles_count, profiles_min, most_common, sigma_mm, epsilon_mm }
}

/// Why most of the profiles were rejected.
fn most_common(profiles: &[Profile]) -> Reason {
    let count = |reason: Reason| profiles.iter().filter(|profile| profile.rejected == Some(reason)).count();
    profiles
        .iter()
        .filter_map(|profile| profile.rejected)
        .max_by_key(|reason| count(*reason))
        .unwrap_or(Reason::NotConverged)
}

/// A tenth of the profiles have to lie on the surface, and where there are few, half or two thirds of them: a cylinder can be
/// tilted until it meets some that vibration has shifted, and then says nothing of the others.
fn agreed(scan: &Scan, solution: &Solution, most_common: Reason, settings: &Settings) -> Result<(), Refusal> {
    let share = |(station, sums): (&Station, &sums::Sums)| sums.weight / (station.end - station.start).max(1) as f64;
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

fn too_short<'a>(stations: impl Iterator<Item = &'a Station>, settings: &Settings) -> Result<(), Refusal> {
    let (low, high) = stations.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), s| (low.min(s.x), high.max(s.x)));
    let (axial_length_mm, axial_length_min_mm) = (high - low, settings.axial_length_min_mm.unwrap_or(0.0));
    if axial_length_mm < axial_length_min_mm {
        return Err(Refusal::AxialLengthTooShort { axial_length_mm, axial_length_min_mm });
    }
    Ok(())
}

/// The pose and what should be known of it, unless the solution gives rise to a refusal.
fn weigh(
    scan: &Scan,
    solution: &Solution,
    most_common: Reason,
    settings: &Settings,
) -> Result<(Pose, Vec<Warning>), Refusal> {
    let shown = |(_, sums): &(&Station, &sums::Sums)| sums.weight >= 3.0;
    let valid_count = scan.stations().iter().zip(&solution.profiles).filter(shown).count();
    if valid_count < settings.profiles_min as usize {
        return Err(too_few(scan.stations().len(), valid_count, most_common, Some(solution.sigma), settings));
    }
    agreed(scan, solution, most_common, settings)?;
    if let Some(layer_ratio) = hollow::share(scan, solution) {
        return Err(Refusal::LayersUndecided { layer_ratio, reach_mm: hollow::WITHIN * solution.sigma });
    }
    let stations = scan.stations().iter().zip(&solution.profiles).filter(shown).map(|(station, _)| station);
    too_short(stations, settings)?;
    let hold = hold(settings);
    let mut lines = known::from_data(solution, hold, settings);
    lines.extend(known::from_curvature(solution, hold));
    lines.extend(known::from_layers(solution));
    lines.extend(known::from_resolution(scan, solution, hold));
    let form = form::form(scan, solution, hold);
    lines.extend(form.iter().map(|form| Line::of_shift(Line::FORM, &form.shift, &solution.cylinder.axis())));
    lines.extend(known::from_calibration(scan, solution, hold, settings));
    let uncertainty = Uncertainty::of(&lines, &solution.cylinder.axis(), solution.cylinder.x_ref);
    if let Some(refusal) = limits::undetermined(&uncertainty, solution.cylinder.radius, settings) {
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

/// The profiles of a scan that no cylinder was found in.
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
