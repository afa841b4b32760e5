//! Searches the surface of the part: from a scan and the settings to the joint fit, or to the reason why there is none.

use super::candidates::{self, Candidate, Choice, Noise, Settled};
use super::consensus::Bounds;
use super::layers::{self, Verdict};
use super::model::Cylinder;
use super::normal_equations::RadiusConstraint;
use super::patches::Directions;
use super::pieces::{self, Subset};
use super::sample::{self, Sample};
use super::solve::{self, Problem, Solution};
use super::{field, second_surface};
use crate::estimation::checks::unusable;
use crate::estimation::progress::Progress;
use crate::estimation::refusal::{Reason, Refusal};
use crate::estimation::settings::{Method, NOMINAL_REACH, Settings};
use crate::scan::{Scan, Station};

/// Profiles in the sample for the start: enough to distinguish the finest surface from its neighbours.
const SAMPLE_PROFILES_MAX: usize = 128;
const SAMPLE_POINTS_MAX: usize = 96;
/// Steepest slope of the search; parts have at most 10°.
const SLOPE_MAX: f64 = 0.35;
/// Radii of the search, in sizes of a profile: a full section has a third of its diagonal, less with a support beside it; an arc of
/// 10° has six times its size.
const RADIUS_SIZES: [f64; 2] = [0.1, 8.0];
/// Radii of the search relative to a radius that was detected before, which is uncertain on a short arc; and the steepest slope
/// relative to a detected axis.
const EXPECTED_REACH: [f64; 2] = [0.5, 2.0];
const EXPECTED_SLOPE_MAX: f64 = 0.1;
/// Tolerance about a start: this many times the roughness, limited to these shares of the size of a profile.
const TOLERANCE_ROUGHNESS: f64 = 4.0;
const TOLERANCE_SIZES: [f64; 2] = [0.002, 0.02];

/// How often points in other directions are left out before the search ends.
const ROUNDS_MAX: usize = 4;

/// The inputs of every round.
struct Search<'a> {
    settings: &'a Settings,
    constraint: RadiusConstraint,
    /// Radius of a cylinder that was detected before, mm.
    expected_radius: Option<f64>,
    /// Number of profiles of the complete scan.
    profiles_count: usize,
}

/// The result of a round.
enum Round {
    Found(Box<Solution>),
    /// Points elsewhere dominate the fit; only points in these directions from its axis are used.
    Within(Cylinder, Directions),
}

/// The fit to the part.
pub(super) fn search(
    scan: &Scan,
    used: &[bool],
    settings: &Settings,
    expected_radius: Option<f64>,
    progress: &Progress,
) -> Result<Solution, Refusal> {
    if let Some(refusal) = unusable(scan, settings) {
        return Err(refusal);
    }
    let search = Search {
        settings,
        constraint: RadiusConstraint::of(settings),
        expected_radius,
        profiles_count: scan.stations().len(),
    };
    let mut within = match search.round(scan, used, progress)? {
        Round::Found(solution) => return Ok(*solution),
        Round::Within(cylinder, directions) => vec![(cylinder, directions)],
    };
    while within.len() <= ROUNDS_MAX {
        let subset = Subset::of(scan, used, |_, station| {
            let slices: Vec<_> =
                within.iter().map(|(cylinder, directions)| (cylinder.slice(station.x), *directions)).collect();
            move |[x, y, z]| slices.iter().all(|(slice, directions)| directions.contain(&slice.at(x), y, z))
        });
        let subset = subset.ok_or_else(|| search.no_cylinder())?;
        let used = enough(&subset.scan, settings);
        match search.round(&subset.scan, &used, &progress.uncounted())? {
            Round::Found(solution) => return Ok(subset.restore(*solution)),
            Round::Within(cylinder, directions) => within.push((cylinder, directions)),
        }
    }
    Err(search.no_cylinder())
}

/// Which profiles have at least the number of points that the settings require.
pub(super) fn enough(scan: &Scan, settings: &Settings) -> Vec<bool> {
    scan.stations().iter().map(|station| station.end - station.start >= settings.points_min as usize).collect()
}

pub(super) fn too_few(
    profiles_count: usize,
    valid_count: usize,
    most_common: Reason,
    sigma_mm: Option<f64>,
    settings: &Settings,
) -> Refusal {
    let (profiles_min, epsilon_mm) = (settings.profiles_min, settings.epsilon_mm);
    Refusal::TooFewValidProfiles { valid_count, profiles_count, profiles_min, most_common, sigma_mm, epsilon_mm }
}

pub(super) fn too_short<'a>(stations: impl Iterator<Item = &'a Station>, settings: &Settings) -> Result<(), Refusal> {
    let (low, high) = stations.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), s| (low.min(s.x), high.max(s.x)));
    let (axial_length_mm, axial_length_min_mm) = (high - low, settings.axial_length_min_mm.unwrap_or(0.0));
    if axial_length_mm < axial_length_min_mm {
        return Err(Refusal::AxialLengthTooShort { axial_length_mm, axial_length_min_mm });
    }
    Ok(())
}

impl Search<'_> {
    fn no_cylinder(&self) -> Refusal {
        Refusal::NoCylinder { nominal_radius_mm: self.settings.nominal_radius_mm }
    }

    fn round(&self, scan: &Scan, used: &[bool], progress: &Progress) -> Result<Round, Refusal> {
        let (settings, constraint) = (self.settings, self.constraint);
        let valid_count = used.iter().filter(|used| **used).count();
        if valid_count < settings.profiles_min as usize {
            return Err(too_few(self.profiles_count, valid_count, Reason::TooFewPoints, None, settings));
        }
        too_short(scan.stations().iter().zip(used).filter(|(_, used)| **used).map(|(s, _)| s), settings)?;
        let sample = Sample::take(scan, used, SAMPLE_PROFILES_MAX, SAMPLE_POINTS_MAX);
        let roughness = sample::roughness(scan);
        let bounds = self.bounds(&sample, roughness);
        let chosen = match self.choose(&sample, &bounds, Noise::Unknown) {
            Choice::One(candidate) => candidate,
            Choice::Two(a, b) => return Err(two_cylinders(&a, &b)),
            Choice::None => return Err(self.no_cylinder()),
        };
        let resolved = |solution: &Solution| {
            let [least, most] = bounds.radius_mm;
            let radius = solution.cylinder.radius;
            // A radius at the end of the range means a plane or a line, not a part.
            radius >= least && radius <= most && radius >= settings.radius_resolved_mm()
        };
        let epsilon = Method::Cylinder.inlier_limit_mm(settings.epsilon_mm, chosen.settled.sigma);
        let problem = Problem { scan, used, constraint, epsilon, progress };
        let mut solution =
            solve::solve(&problem, &chosen.settled).filter(resolved).ok_or_else(|| self.no_cylinder())?;
        let surface = layers::look(&problem, &solution);
        if let Some(directions) = surface.as_ref().and_then(|surface| pieces::part_directions(surface, solution.sigma))
        {
            return Ok(Round::Within(solution.cylinder, directions));
        }
        if let Some(refusal) = self.sleeve(&problem, &sample, &chosen, &solution) {
            return Err(refusal);
        }
        let mend = |surface| layers::mend(&problem, &solution, &bounds, settings.nominal_radius_mm, surface);
        match surface.as_ref().map_or(Verdict::Unchanged, mend) {
            Verdict::Unchanged => {}
            Verdict::Mended(mended) => {
                return Some(mended)
                    .filter(|mended| resolved(mended))
                    .map(Round::Found)
                    .ok_or_else(|| self.no_cylinder());
            }
            Verdict::Two(a, b) => return Err(two_cylinders(&a, &b)),
            Verdict::Undecided { layer_ratio, reach_mm } => {
                return Err(Refusal::LayersUndecided { layer_ratio, reach_mm });
            }
        }
        solution.field = surface.as_ref().and_then(|surface| field::covariance(surface, &solution, constraint));
        Ok(Round::Found(Box::new(solution)))
    }

    fn bounds(&self, sample: &Sample, roughness: f64) -> Bounds {
        let size = sample::size(sample);
        let [least, most] = TOLERANCE_SIZES;
        let tolerance = (TOLERANCE_ROUGHNESS * roughness).clamp(least * size, most * size);
        let radius_mm = match (self.settings.nominal_radius_mm, self.expected_radius) {
            (Some(nominal), _) => [nominal * (1.0 - NOMINAL_REACH), nominal * (1.0 + NOMINAL_REACH)],
            (None, Some(expected)) => EXPECTED_REACH.map(|share| share * expected),
            (None, None) => RADIUS_SIZES.map(|sizes| sizes * size),
        };
        let slope_max = match self.expected_radius {
            Some(_) => EXPECTED_SLOPE_MAX,
            None => SLOPE_MAX.max(self.settings.tilt_max_deg.to_radians().tan()),
        };
        Bounds { slope_max, radius_mm, tolerance }
    }

    /// The candidate that is the part. A constrained radius fits every surface; if two candidates remain, their freely fitted radii
    /// show which of them has the nominal one.
    fn choose(&self, sample: &Sample, bounds: &Bounds, noise: Noise) -> Choice {
        let choice = |constraint: RadiusConstraint| {
            let found = candidates::candidates(sample, bounds, noise, constraint);
            candidates::choose(&found, self.settings.nominal_radius_mm, sample)
        };
        match choice(self.constraint) {
            Choice::Two(..) if !matches!(self.constraint, RadiusConstraint::Free) => choice(RadiusConstraint::Free),
            choice => choice,
        }
    }

    /// If another surface about the same axis lies below, the fit may be a clamp; a nominal radius decides which is the part.
    fn sleeve(
        &self,
        problem: &Problem<'_>,
        sample: &Sample,
        chosen: &Candidate,
        solution: &Solution,
    ) -> Option<Refusal> {
        let least = self.settings.radius_resolved_mm();
        let beneath = second_surface::beneath(sample, &solution.cylinder, solution.sigma)?;
        let free = free_radius(problem, solution);
        let radius_a_mm = free.unwrap_or(solution.cylinder.radius);
        let radius_b_mm = radius_a_mm - beneath.depth;
        let off = |radius: f64| self.settings.nominal_radius_mm.map(|nominal| (radius - nominal).abs());
        let is_nominal = free.is_some() && off(radius_a_mm).zip(off(radius_b_mm)).is_some_and(|(a, b)| a <= b);
        let (coverage_a, coverage_b) = (chosen.coverage, beneath.coverage);
        let is_undecided = !is_nominal && radius_b_mm >= least;
        is_undecided.then_some(Refusal::TwoCylinders { radius_a_mm, coverage_a, radius_b_mm, coverage_b })
    }
}

/// The radius from the points alone: a constrained radius does not distinguish the surfaces.
fn free_radius(problem: &Problem<'_>, solution: &Solution) -> Option<f64> {
    if matches!(problem.constraint, RadiusConstraint::Free) {
        return Some(solution.cylinder.radius);
    }
    let start = Settled { cylinder: solution.cylinder, sigma: solution.sigma };
    let uncounted = problem.progress.uncounted();
    let free = solve::solve(&Problem { constraint: RadiusConstraint::Free, progress: &uncounted, ..*problem }, &start)?;
    Some(free.cylinder.radius)
}

fn two_cylinders(a: &Candidate, b: &Candidate) -> Refusal {
    Refusal::TwoCylinders {
        radius_a_mm: a.settled.cylinder.radius,
        coverage_a: a.coverage,
        radius_b_mm: b.settled.cylinder.radius,
        coverage_b: b.coverage,
    }
}
