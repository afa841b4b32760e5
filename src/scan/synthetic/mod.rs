//! Made scans of a cylindrical part with holes, clamps, drop-outs, spikes and noise on it, and the truth beside them.
//! Seeded: the same part gives the same scan, everywhere. Must not know how a pose is estimated.
//!
//! Every profile is seen from above (+Z): its directions are spread evenly over the arc, and a feature moves its points
//! along the line of sight from the axis, so that the true section is the ellipse of [`AxisLine::section`].

mod edge;
mod several;
mod truth;

pub use edge::{Edge, Edges, Neighbour};
pub use several::make_several;
pub use truth::{Bound, Truth};

use super::{Columns, Scan, ScanError, Station};
use crate::geometry::AxisLine;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

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
    /// Arc seen of each section, centred on +Z.
    pub arc_deg: f64,
    /// Standard deviation of the noise, in y and in z.
    pub noise_sigma_mm: f64,
    /// What sits on the part, as shares of the profiles that carry it.
    pub interference: Interference,
    /// Share of the points that are missing.
    pub drop_out_ratio: f64,
    /// Share of the points that are thrown off by up to [`SPIKE_MM`].
    pub spike_ratio: f64,
    /// Where the part ends; profiles beyond see what is there, or nothing.
    pub edges: Edges,
    /// Decides every random number.
    pub seed: u64,
}

/// Shares of the profiles that carry each kind of feature; the rest is smooth. They stand in blocks along x.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Interference {
    /// Profiles with two screw holes: two groups of 2 % of the points sunk by 10 and 20 mm.
    pub screw_holes: f64,
    /// Profiles through a straight hole: 15 % of the points sunk by 30 mm.
    pub straight_holes: f64,
    /// Profiles under a clamp.
    pub clamps: f64,
    /// Share of the arc that a clamp covers, in its middle.
    pub clamp_arc: f64,
    /// Height of a clamp above the surface.
    pub clamp_height_mm: f64,
}

/// Farthest that a spike throws a point.
pub const SPIKE_MM: f64 = 10.0;
/// How often the blocks of features repeat along the part.
const BLOCKS_COUNT: usize = 3;

/// What one profile carries.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Feature {
    /// Nothing.
    Smooth,
    /// Two groups of 2 % of the points, sunk by 10 and 20 mm.
    ScrewHoles,
    /// 15 % of the points, sunk by 30 mm.
    StraightHole,
    /// The middle of the arc, raised.
    Clamp {
        /// Share of the arc.
        arc: f64,
        /// Above the surface.
        height_mm: f64,
    },
}

impl Feature {
    /// How far the feature moves the point at `place` (0 to 1 along the arc) away from the axis, mm.
    #[must_use]
    pub fn offset_mm(self, place: f64) -> f64 {
        let within = |start: f64, width: f64| place >= start && place < start + width;
        match self {
            Self::ScrewHoles if within(0.41, 0.02) => -10.0,
            Self::ScrewHoles if within(0.61, 0.02) => -20.0,
            Self::StraightHole if within(0.55, 0.15) => -30.0,
            Self::Clamp { arc, height_mm } if within(0.5 - arc / 2.0, arc) => height_mm,
            _ => 0.0,
        }
    }
}

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
            noise_sigma_mm: 0.05,
            interference: Interference::default(),
            drop_out_ratio: 0.0,
            spike_ratio: 0.0,
            edges: Edges::default(),
            seed,
        }
    }

    fn feature(&self, index: usize) -> Feature {
        let Interference { screw_holes, straight_holes, clamps, clamp_arc, clamp_height_mm } = self.interference;
        let phase = (index * BLOCKS_COUNT) as f64 / self.profiles_count as f64 % 1.0;
        let smooth = 1.0 - screw_holes - straight_holes - clamps;
        match phase {
            phase if phase < smooth => Feature::Smooth,
            phase if phase < smooth + screw_holes => Feature::ScrewHoles,
            phase if phase < smooth + screw_holes + straight_holes => Feature::StraightHole,
            _ => Feature::Clamp { arc: clamp_arc, height_mm: clamp_height_mm },
        }
    }

    fn station_x(&self, index: usize) -> f64 {
        let steps = self.profiles_count.saturating_sub(1).max(1);
        self.x_start_mm + self.length_mm * index as f64 / steps as f64
    }
}

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
        let (x, feature, start) = (part.station_x(index), part.feature(index), y.len());
        let mut inner_count = 0;
        for point in 0..part.points_count {
            if chance.random_bool(part.drop_out_ratio.clamp(0.0, 1.0)) {
                continue;
            }
            let place = (point as f64 + 0.5) / part.points_count as f64;
            let spike = chance.random_bool(part.spike_ratio.clamp(0.0, 1.0));
            let thrown = if spike { chance.random_range(-SPIKE_MM..SPIKE_MM) } else { 0.0 };
            let direction = (0.5 - place) * part.arc_deg.to_radians();
            let offset = feature.offset_mm(place) + thrown;
            let Some(offset) = edges.offset(x, point, [-direction.sin(), direction.cos()], offset) else { continue };
            let [true_y, true_z] = on_surface(part, x, direction, offset);
            let mut noise =
                || part.noise_sigma_mm * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut chance);
            y.push(true_y + noise());
            z.push(true_z + noise());
            if offset == 0.0 {
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
