//! Made scans of a cylindrical part with holes, clamps, drop-outs, spikes and noise on it, and the truth beside them.
//! Seeded: the same part gives the same scan, everywhere. Must not know how a pose is estimated.
//!
//! A feature moves its points along the line of sight from the axis, so that the true section is the ellipse of
//! [`AxisLine::section`].

mod edge;
mod interference;
mod noise;
mod profile;
mod several;
mod surroundings;
mod truth;

pub use edge::{Edge, Edges, Neighbour};
pub use interference::{Bead, ClampShape, Feature, Interference};
pub use profile::make_profile;
pub use several::make_several;
pub use surroundings::Surroundings;
pub use truth::{Bound, Truth};

use super::{Columns, Scan, ScanError, Station};
use crate::geometry::AxisLine;
use edge::Prepared;
use noise::Noise;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A part, and how it is scanned. Lengths in mm, angles in degrees.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Radius of the cylinder.
    pub radius_mm: f64,
    /// The true axis.
    pub axis: AxisLine,
    /// Plane of the first profile.
    pub x_start_mm: f64,
    /// From the first profile to the last.
    pub length_mm: f64,
    /// Number of profiles.
    pub profiles_count: usize,
    /// Points a profile, before drop-outs.
    pub points_count: usize,
    /// Arc seen of each section.
    pub arc_deg: f64,
    /// Direction of the middle of the arc, from +Z towards +Y; 0 is seen from above.
    pub view_deg: f64,
    /// How the points of a profile are spread over its arc.
    pub sampling: Sampling,
    /// How far a profile may lie from its even place, as a share of half the spacing; 1 lets neighbours meet.
    pub spacing_spread: f64,
    /// Standard deviation of the noise, in y and in z.
    pub noise_sigma_mm: f64,
    /// Correlation of a point's noise with its predecessor's, 0 to 1; the standard deviation stays.
    pub noise_correlation: f64,
    /// Standard deviation by which whole profiles are off, in y and in z.
    pub jitter_sigma_mm: f64,
    /// What sits on the part, as shares of the profiles that carry it.
    pub interference: Interference,
    /// What is seen beside the part.
    pub surroundings: Surroundings,
    /// Share of the points that are missing.
    pub drop_out_ratio: f64,
    /// Share of the points that are thrown off by up to [`SPIKE_MM`].
    pub spike_ratio: f64,
    /// Where the part ends; profiles beyond see what is there, or nothing.
    pub edges: Edges,
    /// Decides every random number.
    pub seed: u64,
}

/// How the points of a profile are spread over its arc.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sampling {
    /// By equal angles about the axis.
    #[default]
    EvenAngle,
    /// By equal steps of y, as a sensor above the part does; what lies more than 90° from +Z is not seen.
    EvenAcross,
}

/// Farthest that a spike throws a point.
pub const SPIKE_MM: f64 = 10.0;
/// How often the blocks of features repeat along the part.
const BLOCKS_COUNT: usize = 3;

impl Part {
    /// The published situation of a whole part: screw holes, straight holes and clamps on 60 % of its profiles.
    #[must_use]
    pub fn with_interference(seed: u64) -> Self {
        Self {
            interference: Interference {
                screw_holes: 0.20,
                straight_holes: 0.16,
                clamps: 0.24,
                clamp_arc: 0.5,
                clamp_height_mm: 25.0,
                ..Interference::default()
            },
            ..Self::smooth(seed)
        }
    }

    /// A smooth part of 200 mm radius, 800 mm long, 140° of it seen by 400 profiles of 640 points, tilted by about 1°.
    #[must_use]
    pub fn smooth(seed: u64) -> Self {
        Self {
            radius_mm: 200.0,
            axis: AxisLine {
                p: 0.3575_f64.to_radians().tan(),
                q: 1.1127_f64.to_radians().tan(),
                y0: -8.272,
                z0: 6.514,
            },
            x_start_mm: 0.0,
            length_mm: 800.0,
            profiles_count: 400,
            points_count: 640,
            arc_deg: 140.0,
            view_deg: 0.0,
            sampling: Sampling::EvenAngle,
            spacing_spread: 0.0,
            noise_sigma_mm: 0.05,
            noise_correlation: 0.0,
            jitter_sigma_mm: 0.0,
            interference: Interference::default(),
            surroundings: Surroundings::default(),
            drop_out_ratio: 0.0,
            spike_ratio: 0.0,
            edges: Edges::default(),
            seed,
        }
    }

    fn feature(&self, index: usize) -> Feature {
        self.interference.feature((index * BLOCKS_COUNT) as f64 / self.profiles_count as f64 % 1.0)
    }

    fn station_x(&self, index: usize, chance: &mut ChaCha8Rng) -> f64 {
        let steps = self.profiles_count.saturating_sub(1).max(1);
        let moved = if self.spacing_spread > 0.0 {
            0.5 * self.spacing_spread.min(1.0) * chance.random_range(-1.0..1.0)
        } else {
            0.0
        };
        self.x_start_mm + self.length_mm * (index as f64 + moved) / steps as f64
    }

    /// The direction of the point at `place` (0 to 1 along the profile): radians from +Z towards −Y.
    fn direction(&self, place: f64) -> f64 {
        let half = 0.5 * self.arc_deg.to_radians();
        match self.sampling {
            Sampling::EvenAngle => (1.0 - 2.0 * place) * half - self.view_deg.to_radians(),
            Sampling::EvenAcross => {
                let seen = |angle: f64| angle.clamp(-HORIZON_RAD, HORIZON_RAD).sin();
                let view = self.view_deg.to_radians();
                let (low, high) = (seen(view - half), seen(view + half));
                -(low + (high - low) * place).asin()
            }
        }
    }
}

/// A sensor above does not look round the part.
const HORIZON_RAD: f64 = 1.55;

/// Scans the part.
///
/// # Errors
/// [`ScanError`] where no point is left, or the part's numbers are not finite.
pub fn make(part: &Part) -> Result<(Scan, Truth), ScanError> {
    let mut chance = ChaCha8Rng::seed_from_u64(part.seed);
    let (mut y, mut z, mut stations) = (Vec::new(), Vec::new(), Vec::new());
    let mut truth = Truth::begin(part);
    let (edges, mut blanks) = (part.edges.prepare(part), Vec::new());
    for index in 0..part.profiles_count {
        let (x, start) = (part.station_x(index, &mut chance), y.len());
        let mut noise = Noise::begin(part, &mut chance);
        let mut inner_count = 0;
        let on_part = (0..part.points_count).map(Seen::OnPart);
        let [left, right] = [part.surroundings.left(part, x), part.surroundings.right(part, x, index)];
        for seen in left.into_iter().map(Seen::Beside).chain(on_part).chain(right.into_iter().map(Seen::Beside)) {
            if chance.random_bool(part.drop_out_ratio.clamp(0.0, 1.0)) {
                continue;
            }
            let thrown = thrown(part, &mut chance);
            let Some((true_point, inner)) = place(part, &edges, x, part.feature(index), seen, thrown) else { continue };
            let ([true_y, true_z], [off_y, off_z]) = (true_point, noise.next(&mut chance));
            y.push(true_y + off_y);
            z.push(true_z + off_z);
            if inner {
                inner_count += 1;
                truth.add_inner_point(part, [x, true_y, true_z]);
            }
        }
        if y.len() == start {
            blanks.push(x);
            continue;
        }
        truth.end_profile(inner_count, y.len() - start);
        stations.push(Station { x, start, end: y.len() });
    }
    let scan = Scan::new(stations, Columns::F64 { y, z }, "synthetic".to_owned())?;
    Ok((scan.with_blanks(blanks), truth.end(part)))
}

/// Something in a profile.
#[derive(Debug, Clone, Copy)]
enum Seen {
    /// On the part or what sits on it: the position in the profile.
    OnPart(usize),
    /// Beside it.
    Beside([f64; 2]),
}

/// How far a point is thrown off; mostly not at all.
fn thrown(part: &Part, chance: &mut ChaCha8Rng) -> f64 {
    let spike = chance.random_bool(part.spike_ratio.clamp(0.0, 1.0));
    if spike { chance.random_range(-SPIKE_MM..SPIKE_MM) } else { 0.0 }
}

/// Where the point lies but for its noise, and whether that is on the part; `None` where nothing is seen.
fn place(part: &Part, edges: &Prepared, x: f64, feature: Feature, seen: Seen, thrown: f64) -> Option<([f64; 2], bool)> {
    match seen {
        Seen::Beside([y, z]) => Some(([y, z + thrown], false)),
        Seen::OnPart(column) => {
            let place = (column as f64 + 0.5) / part.points_count as f64;
            let direction = part.direction(place);
            let angle = direction - part.direction(0.5 + part.interference.shift);
            let offset = part.interference.offset_mm(feature, place, angle, part.radius_mm) + thrown;
            let offset = edges.offset(x, column, [-direction.sin(), direction.cos()], offset)?;
            Some((on_surface(part, x, direction, offset), offset == 0.0))
        }
    }
}

/// The point that is seen from the axis in `direction` (radians from +Z towards −Y), `offset` beyond the surface.
///
/// ρ² (1 − (p·sin + q·cos)²/n²) = R² in the plane x = const, with n² = 1 + p² + q².
fn on_surface(part: &Part, x: f64, direction: f64, offset: f64) -> [f64; 2] {
    let AxisLine { p, q, .. } = part.axis;
    let (unit_y, unit_z) = (-direction.sin(), direction.cos());
    let along = (p * unit_y + q * unit_z).powi(2) / (1.0 + p * p + q * q);
    let reach = part.radius_mm / (1.0 - along).sqrt() + offset;
    let [centre_y, centre_z] = part.axis.at(x);
    [centre_y + reach * unit_y, centre_z + reach * unit_z]
}
