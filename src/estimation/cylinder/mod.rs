//! One cylinder through all profiles at once. Every profile serves, also one that is half under a clamp: what its other half
//! says about slopes and radius is as good as anybody's.
//!
//! ```text
//! Scan --sample--> Sample --consensus--> starts --settle--> candidates --choose--> one --solve--> Solution --judge--> verdicts
//!                         (five points)         (coarse to fine)      (coverage, nominal radius) (every point)
//! ```

mod candidates;
mod consensus;
mod covariance;
mod extent;
mod form;
mod judge;
mod layers;
mod model;
mod narrow;
mod patches;
mod sample;
mod settle;
mod solve;
mod step;
mod sums;

use super::robust;
use super::unusable::unusable;
use super::{
    Component, Outcome, Pose, Profile, Progress, RadiusRule, RadiusSource, Reason, Refusal, Settings, Uncertainty,
};
use crate::scan::{Scan, Station};
use candidates::{Candidate, Choice, Noise};
use consensus::Bounds;
use judge::Model;
use layers::Verdict;
use model::Cylinder;
use nalgebra::{Matrix5, Vector5};
use patches::Cut;
use sample::Sample;
use solve::Solution;
use step::Hold;

/// Sampled for the start: enough that the finest surface is told from its neighbours.
const SAMPLE_PROFILES_MAX: usize = 128;
const SAMPLE_POINTS_MAX: usize = 96;
/// Steepest slope that is looked for, beyond the 10° that parts are held to.
const SLOPE_MAX: f64 = 0.35;
/// Radii that are looked for, in sizes of a profile: a full section has half of its diagonal, an arc of 10° six times it.
const RADIUS_SIZES: [f64; 2] = [0.25, 8.0];
/// Radii that are looked for about a nominal one, relative to it.
const NOMINAL_REACH: f64 = 0.02;
/// What is near a start: this many times the roughness, but within these shares of the size of a profile.
const TOLERANCE_ROUGHNESS: f64 = 4.0;
const TOLERANCE_SIZES: [f64; 2] = [0.002, 0.02];

/// A surface so much rougher than neighbouring points is looked at again,
const SUSPICIOUS: f64 = 2.0;
/// unless they are so smooth, relative to its radius, that this is rounding.
const ROUGHNESS_MIN: f64 = 1e-7;
/// A closer look has found another surface where the scatter is below this share of the first.
const FINER: f64 = 0.7;

/// The pose or why there is none, and what became of every profile.
pub(super) fn find(scan: &Scan, settings: &Settings, progress: &Progress) -> (Outcome, Vec<Profile>) {
    let used: Vec<bool> = scan.stations().iter().map(|s| s.end - s.start >= settings.points_min as usize).collect();
    match search(scan, &used, settings) {
        Err(refusal) => (Outcome::Refused(refusal), unjudged(scan, &used)),
        Ok(solution) => {
            let model = Model {
                cylinder: &solution.cylinder,
                sigma: solution.sigma,
                sums: &solution.profiles,
                passes_count: solution.passes_count,
            };
            let profiles = judge::judge(scan, &used, model, settings);
            profiles.iter().for_each(|_| progress.advance());
            let outcome = match weigh(scan, &solution, settings) {
                Some(refusal) => Outcome::Refused(refusal),
                None => Outcome::Accepted(Box::new(pose(&solution, settings))),
            };
            (outcome, profiles)
        }
    }
}

fn search(scan: &Scan, used: &[bool], settings: &Settings) -> Result<Solution, Refusal> {
    if let Some(refusal) = unusable(scan, settings) {
        return Err(refusal);
    }
    let profiles_count = scan.stations().len();
    let valid_count = used.iter().filter(|used| **used).count();
    let profiles_min = settings.profiles_min;
    if valid_count < profiles_min as usize {
        let most_common = Reason::TooFewPoints;
        let (sigma_mm, epsilon_mm) = (None, settings.epsilon_mm);
        return Err(Refusal::TooFewValidProfiles {
            valid_count,
            profiles_count,
            profiles_min,
            most_common,
            sigma_mm,
            epsilon_mm,
        });
    }
    too_short(scan.stations().iter().zip(used).filter(|(_, used)| **used).map(|(s, _)| s), settings)?;
    let sample = Sample::take(scan, used, SAMPLE_PROFILES_MAX, SAMPLE_POINTS_MAX);
    let hold = hold(settings);
    let bounds = bounds(scan, &sample, settings);
    let found = candidates::candidates(&sample, &bounds, Noise::Unknown, hold);
    let chosen = match candidates::choose(&found, settings.nominal_radius_mm, &sample) {
        Choice::One(candidate) => finer(scan, used, &sample, &bounds, hold, candidate, settings)?,
        Choice::Two(a, b) => return Err(two_cylinders(&a, &b)),
        Choice::None => return Err(Refusal::NoCylinder { nominal_radius_mm: settings.nominal_radius_mm }),
    };
    let resolved = |solution: &Solution| {
        let [least, most] = bounds.radius_mm;
        let radius = solution.cylinder.radius;
        // At the end of what was looked for lies a plane or a line, not a part.
        radius >= least && radius <= most && radius >= settings.radius_resolved_mm()
    };
    let no_cylinder = Refusal::NoCylinder { nominal_radius_mm: settings.nominal_radius_mm };
    let mut solution = solve::solve(scan, used, &chosen.settled, hold).filter(resolved).ok_or(no_cylinder)?;
    match layers::mend(scan, used, &solution, &bounds, hold, settings.nominal_radius_mm) {
        Verdict::Clean => {
            form::widen(scan, used, &mut solution, hold);
            Ok(solution)
        }
        Verdict::Mended(mended) => Some(mended).filter(resolved).ok_or(no_cylinder),
        Verdict::Two(a, b) => Err(two_cylinders(&a, &b)),
        Verdict::Undecided { layer_ratio, reach_mm } => Err(Refusal::LayersUndecided { layer_ratio, reach_mm }),
    }
}

/// The candidate looked at as closely as the points' own roughness allows: where a coarse look took a low layer and the part
/// for one rough surface, a fine one tells them apart.
fn finer(
    scan: &Scan,
    used: &[bool],
    sample: &Sample,
    bounds: &Bounds,
    hold: Hold,
    coarse: Candidate,
    settings: &Settings,
) -> Result<Candidate, Refusal> {
    let reach = robust::TUKEY_C * coarse.settled.sigma;
    let averages = patches::average(scan, used, &coarse.settled.cylinder, reach, Cut::Profiles);
    // Whole profiles may be off, which is no layer.
    let roughness = averages.as_ref().map_or(0.0, layers::own_scatter).max(extent::roughness(scan));
    if coarse.settled.sigma < SUSPICIOUS * roughness || roughness < ROUGHNESS_MIN * coarse.settled.cylinder.radius {
        return Ok(coarse);
    }
    let bounds = Bounds { tolerance: TOLERANCE_ROUGHNESS * roughness, ..*bounds };
    let found = candidates::candidates(sample, &bounds, Noise::Known(roughness), hold);
    match candidates::choose(&found, settings.nominal_radius_mm, sample) {
        Choice::Two(a, b) => Err(two_cylinders(&a, &b)),
        Choice::One(fine) if fine.coverage >= candidates::COVERAGE_MIN => {
            // Neighbours may share their noise: what one point scatters by is seen only now.
            let settled = candidates::grown(sample, fine.settled.cylinder, robust::TUKEY_C * roughness, hold);
            let finer = settled.filter(|settled| settled.sigma < FINER * coarse.settled.sigma);
            Ok(finer.map_or(coarse, |settled| Candidate { settled, ..fine }))
        }
        Choice::One(_) | Choice::None => Ok(coarse),
    }
}

fn bounds(scan: &Scan, sample: &Sample, settings: &Settings) -> Bounds {
    let size = extent::size(sample);
    let [least, most] = TOLERANCE_SIZES;
    let tolerance = (TOLERANCE_ROUGHNESS * extent::roughness(scan)).clamp(least * size, most * size);
    let radius_mm = match settings.nominal_radius_mm {
        Some(nominal) => [nominal * (1.0 - NOMINAL_REACH), nominal * (1.0 + NOMINAL_REACH)],
        None => RADIUS_SIZES.map(|sizes| sizes * size),
    };
    Bounds { slope_max: SLOPE_MAX, radius_mm, tolerance }
}

fn hold(settings: &Settings) -> Hold {
    match (settings.radius, settings.nominal_radius_mm) {
        (RadiusRule::Fixed, Some(radius)) => Hold::Fixed { radius },
        (RadiusRule::Prior, Some(radius)) => Hold::Prior { radius, sigma: settings.radius_sigma_mm.unwrap_or(0.0) },
        _ => Hold::Free,
    }
}

fn too_short<'a>(stations: impl Iterator<Item = &'a Station>, settings: &Settings) -> Result<(), Refusal> {
    let (low, high) = stations.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), s| (low.min(s.x), high.max(s.x)));
    let (axial_length_mm, axial_length_min_mm) = (high - low, settings.axial_length_min_mm);
    if axial_length_mm < axial_length_min_mm {
        return Err(Refusal::AxialLengthTooShort { axial_length_mm, axial_length_min_mm });
    }
    Ok(())
}

fn two_cylinders(a: &Candidate, b: &Candidate) -> Refusal {
    Refusal::TwoCylinders {
        radius_a_mm: a.settled.cylinder.radius,
        coverage_a: a.coverage,
        radius_b_mm: b.settled.cylinder.radius,
        coverage_b: b.coverage,
    }
}

/// Refusals that the solution gives rise to.
fn weigh(scan: &Scan, solution: &Solution, settings: &Settings) -> Option<Refusal> {
    let shown = |(_, sums): &(&Station, &sums::Sums)| sums.weight >= 3.0;
    let stations = scan.stations().iter().zip(&solution.profiles).filter(shown).map(|(station, _)| station);
    if let Err(refusal) = too_short(stations, settings) {
        return Some(refusal);
    }
    let [[p, ..], [_, q, ..], [_, _, y, ..], [_, _, _, z, _], _] = covariance(solution).into();
    let (angle_deg, position_mm) = (p.max(q).sqrt().to_degrees(), y.max(z).sqrt());
    let (angle_max_deg, position_max_mm) = (settings.angle_uncertainty_max_deg, settings.position_uncertainty_max_mm);
    let known = angle_deg <= angle_max_deg && position_mm <= position_max_mm;
    (!known).then_some(Refusal::PoseUndetermined { angle_deg, angle_max_deg, position_mm, position_max_mm })
}

/// Of (deflection, pitch, y_ref, z_ref, radius).
fn covariance(solution: &Solution) -> Matrix5<f64> {
    let Cylinder { p, q, .. } = solution.cylinder;
    let slopes = Vector5::new(1.0 / (1.0 + p * p), 1.0 / (1.0 + q * q), 1.0, 1.0, 1.0);
    let to_angles = Matrix5::from_diagonal(&slopes);
    to_angles * solution.covariance * to_angles
}

fn pose(solution: &Solution, settings: &Settings) -> Pose {
    let covariance = covariance(solution);
    let standard = covariance.diagonal().map(|variance| variance.max(0.0).sqrt()).into();
    Pose {
        axis: solution.cylinder.axis(),
        x_ref: solution.cylinder.x_ref,
        radius: solution.cylinder.radius,
        radius_source: match settings.radius {
            RadiusRule::Free => RadiusSource::Fitted,
            RadiusRule::Fixed => RadiusSource::Nominal,
            RadiusRule::Prior => RadiusSource::Prior,
        },
        uncertainty: Uncertainty {
            covariance: covariance.into(),
            budget: vec![Component { source: "repeatability".to_owned(), standard }],
        },
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
