//! One cylinder through all profiles at once. Every profile serves, also one that is half under a clamp: what its other half
//! says about slopes and radius is as good as anybody's.
//!
//! ```text
//! Scan --sample--> Sample --consensus--> starts --settle--> candidates --choose, finer--> one --solve--> Solution
//!                         (five points)         (coarse to fine)      (coverage, nominal radius)  (every point)
//!
//! Solution --layers--> without thin layers --areas--> covariance --known, form--> budget, warnings
//!     '-----judge----> verdicts
//! ```

mod areas;
mod beneath;
mod block;
mod candidates;
mod components;
mod consensus;
mod covariance;
pub(super) mod extent;
mod form;
mod judge;
mod kernel;
mod known;
mod layers;
mod model;
mod narrow;
mod patches;
mod pieces;
mod projection;
mod readings;
mod repeats;
mod rest;
mod sample;
mod scatter;
mod settle;
mod smooth;
mod solve;
mod step;
mod sums;

use super::budget::Line;
use super::robust;
use super::unusable::unusable;
use super::{
    EndFaces, Found, Outcome, Pose, Profile, Progress, RadiusRule, RadiusSource, Reason, Refusal, Settings,
    Uncertainty, Warning,
};
use crate::scan::{Scan, Station};
use candidates::{Candidate, Choice, Noise};
use consensus::Bounds;
use judge::Model;
use layers::Verdict;
use model::Cylinder;
use patches::{Cut, Directions};
use rest::Rest;
use sample::Sample;
use solve::{Problem, Solution};
use step::Hold;

/// Sampled for the start: enough that the finest surface is told from its neighbours.
const SAMPLE_PROFILES_MAX: usize = 128;
const SAMPLE_POINTS_MAX: usize = 96;
/// Steepest slope that is looked for, beyond the 10° that parts are held to.
const SLOPE_MAX: f64 = 0.35;
/// Radii that are looked for, in sizes of a profile: a full section has a third of its diagonal, less with a floor
/// beside it, an arc of 10° six times it.
const RADIUS_SIZES: [f64; 2] = [0.1, 8.0];
/// Radii that are looked for about a nominal one, relative to it.
const NOMINAL_REACH: f64 = 0.02;
/// What is near a start: this many times the roughness, but within these shares of the size of a profile.
const TOLERANCE_ROUGHNESS: f64 = 4.0;
const TOLERANCE_SIZES: [f64; 2] = [0.002, 0.02];

/// So few profiles have to agree by half, and so very few by two thirds,
const FEW: usize = 20;
const VERY_FEW: usize = 8;
/// and one agrees that has this share on the surface of what the fullest has.
const AGREEING: f64 = 0.25;
/// A surface so much rougher than neighbouring points is looked at again,
const SUSPICIOUS: f64 = 2.0;
/// unless they are so smooth, relative to its radius, that this is rounding.
const ROUGHNESS_MIN: f64 = 1e-7;
/// A closer look has found another surface where the scatter is below this share of the first.
const FINER: f64 = 0.7;

/// The pose or why there is none, and what became of every profile.
pub(super) fn find(scan: &Scan, settings: &Settings, progress: &Progress) -> Found {
    let used: Vec<bool> = scan.stations().iter().map(|s| s.end - s.start >= settings.points_min as usize).collect();
    match search(scan, &used, settings, progress) {
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
            let (outcome, warnings) = match weigh(scan, &solution, settings) {
                Ok((pose, warnings)) => (Outcome::Accepted(Box::new(pose)), warnings),
                Err(refusal) => (Outcome::Refused(refusal), Vec::new()),
            };
            Found { outcome, profiles, warnings }
        }
    }
}

fn search(scan: &Scan, used: &[bool], settings: &Settings, progress: &Progress) -> Result<Solution, Refusal> {
    if let Some(refusal) = unusable(scan, settings) {
        return Err(refusal);
    }
    let valid_count = used.iter().filter(|used| **used).count();
    if valid_count < settings.profiles_min as usize {
        return Err(too_few(scan, valid_count, Reason::TooFewPoints, None, settings));
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
    let epsilon = judge::epsilon(settings, chosen.settled.sigma);
    let problem = Problem { scan, used, hold, epsilon, progress };
    let mut solution = solve::solve(&problem, &chosen.settled).filter(resolved).ok_or(no_cylinder)?;
    let surface = layers::look(&problem, &solution);
    if let Some(directions) = surface.as_ref().and_then(|surface| pieces::held(surface, solution.sigma)) {
        return within(scan, used, settings, &solution.cylinder, directions);
    }
    if let Some(refusal) = sleeve(&sample, &chosen, &solution, settings) {
        return Err(refusal);
    }
    match layers::mend(&problem, &solution, surface, &bounds, settings.nominal_radius_mm) {
        Verdict::Clean => {}
        Verdict::Open { rivals } => solution.rivals = rivals,
        Verdict::Mended(mended) => return Some(mended).filter(resolved).ok_or(no_cylinder),
        Verdict::Two(a, b) => return Err(two_cylinders(&a, &b)),
        Verdict::Undecided { layer_ratio, reach_mm } => return Err(Refusal::LayersUndecided { layer_ratio, reach_mm }),
    }
    areas::widen(scan, used, &mut solution, hold);
    Ok(solution)
}

/// The search among the points that lie in these directions from the axis of a first fit. Each round leaves points out, so
/// there is a last one.
fn within(
    scan: &Scan,
    used: &[bool],
    settings: &Settings,
    cylinder: &Cylinder,
    directions: Directions,
) -> Result<Solution, Refusal> {
    let rest = Rest::of(scan, used, |_, station| {
        let slice = cylinder.slice(station.x);
        move |y, z| directions.hold(&slice, y, z)
    });
    let rest = rest.ok_or(Refusal::NoCylinder { nominal_radius_mm: settings.nominal_radius_mm })?;
    let solution = search(&rest.scan, &rest.used, settings, &Progress::default())?;
    Ok(rest.restore(solution))
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
    let surface = patches::look(scan, used, &coarse.settled.cylinder, reach);
    let averages = surface.and_then(|surface| surface.average(Cut::Profiles));
    // Whole profiles may be off, which is no layer.
    let roughness = averages.as_ref().map_or(0.0, layers::own_scatter).max(extent::roughness(scan));
    if coarse.settled.sigma < SUSPICIOUS * roughness || roughness < ROUGHNESS_MIN * coarse.settled.cylinder.radius {
        return Ok(coarse);
    }
    let bounds = Bounds { tolerance: TOLERANCE_ROUGHNESS * roughness, ..*bounds };
    let found = candidates::candidates(sample, &bounds, Noise::Known(roughness), hold);
    match candidates::choose(&found, settings.nominal_radius_mm, sample) {
        Choice::Two(..) if averages.as_ref().is_some_and(layers::smooth) => Ok(coarse),
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

/// Where another surface about the same axis lies beneath, the fit may be a jaw; a nominal radius says which is the part.
fn sleeve(sample: &Sample, chosen: &Candidate, solution: &Solution, settings: &Settings) -> Option<Refusal> {
    let beneath = beneath::beneath(sample, &solution.cylinder, solution.sigma)?;
    let (radius_a_mm, radius_b_mm) = (solution.cylinder.radius, solution.cylinder.radius - beneath.depth);
    let off = |radius: f64| settings.nominal_radius_mm.map_or(0.0, |nominal| (radius - nominal).abs());
    let (coverage_a, coverage_b) = (chosen.coverage, beneath.coverage);
    // A radius that is held at the nominal one says nothing of which of them has it.
    let told = settings.nominal_radius_mm.is_some() && settings.radius == RadiusRule::Free;
    let open = !told || off(radius_b_mm) < off(radius_a_mm);
    open.then_some(Refusal::TwoCylinders { radius_a_mm, coverage_a, radius_b_mm, coverage_b })
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

fn too_few(
    scan: &Scan,
    valid_count: usize,
    most_common: Reason,
    sigma_mm: Option<f64>,
    settings: &Settings,
) -> Refusal {
    let (profiles_count, profiles_min, epsilon_mm) =
        (scan.stations().len(), settings.profiles_min, settings.epsilon_mm);
    Refusal::TooFewValidProfiles { valid_count, profiles_count, profiles_min, most_common, sigma_mm, epsilon_mm }
}

/// Where there are few profiles, half or two thirds of them have to lie on the surface. A cylinder can be tilted until it meets some that
/// vibration has shifted, and then says nothing of the others.
fn agreed(scan: &Scan, solution: &Solution, settings: &Settings) -> Result<(), Refusal> {
    let share = |(station, sums): (&Station, &sums::Sums)| sums.weight / (station.end - station.start).max(1) as f64;
    let shares: Vec<f64> = scan.stations().iter().zip(&solution.profiles).map(share).collect();
    let fullest = shares.iter().copied().fold(0.0, f64::max);
    let agreeing_count = shares.iter().filter(|share| **share >= AGREEING * fullest).count();
    let needed_count = match shares.len() {
        count if count <= VERY_FEW => (2 * count).div_ceil(3),
        count => count.div_ceil(2),
    };
    if shares.len() > FEW || agreeing_count >= needed_count {
        return Ok(());
    }
    let profiles_min = needed_count.try_into().unwrap_or(u32::MAX);
    let settings = Settings { profiles_min, ..*settings };
    Err(too_few(scan, agreeing_count, Reason::NotConverged, Some(solution.sigma), &settings))
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

/// The pose and what should be known of it, unless the solution gives rise to a refusal.
fn weigh(scan: &Scan, solution: &Solution, settings: &Settings) -> Result<(Pose, Vec<Warning>), Refusal> {
    let shown = |(_, sums): &(&Station, &sums::Sums)| sums.weight >= 3.0;
    let valid_count = scan.stations().iter().zip(&solution.profiles).filter(shown).count();
    if valid_count < settings.profiles_min as usize {
        return Err(too_few(scan, valid_count, Reason::NotConverged, Some(solution.sigma), settings));
    }
    agreed(scan, solution, settings)?;
    let stations = scan.stations().iter().zip(&solution.profiles).filter(shown).map(|(station, _)| station);
    too_short(stations, settings)?;
    let hold = hold(settings);
    let mut lines = known::from_data(solution, hold, settings);
    left_open(&Uncertainty::of(&lines), settings)?;
    lines.extend(known::from_layers(solution));
    if settings.nominal_radius_mm.is_none() {
        // With one the drawing vouches for the part: layers widen the answer and do not refuse it.
        left_open(&Uncertainty::of(&lines), settings)?;
    }
    let form = form::form(scan, solution, hold);
    lines.extend(form.iter().map(|form| Line::of_shift(Line::FORM, &form.shift, &solution.cylinder.axis())));
    lines.extend(known::from_calibration(scan, solution, hold, settings));
    let warnings = form.map_or_else(Vec::new, |form| form.warnings);
    Ok((pose(solution, settings, Uncertainty::of(&lines)), warnings))
}

fn left_open(uncertainty: &Uncertainty, settings: &Settings) -> Result<(), Refusal> {
    let [[deflection, ..], [_, pitch, ..], [_, _, y, ..], [_, _, _, z, _], _] = uncertainty.covariance;
    let (angle_deg, position_mm) = (deflection.max(pitch).sqrt().to_degrees(), y.max(z).sqrt());
    let (angle_max_deg, position_max_mm) = (settings.angle_uncertainty_max_deg, settings.position_uncertainty_max_mm);
    let known = angle_deg <= angle_max_deg && position_mm <= position_max_mm;
    if known {
        return Ok(());
    }
    Err(Refusal::PoseUndetermined { angle_deg, angle_max_deg, position_mm, position_max_mm })
}

fn pose(solution: &Solution, settings: &Settings, uncertainty: Uncertainty) -> Pose {
    Pose {
        axis: solution.cylinder.axis(),
        x_ref: solution.cylinder.x_ref,
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
