//! Simulates a scan of a synthetic part: profile by profile along the rail with the truth of each, a single profile for a simulated
//! sensor that moves along the part, or several parts in a row. Next to the part the sensor sees the ground plane below it and a
//! support.

use super::features::{Feature, Prepared};
use super::noise::Stream;
use super::part::{BLOCKS_COUNT, Part, SPIKE_MM, Surroundings};
use super::sensor::LaserPlane;
use super::travel::{Delivery, Stage};
use super::truth::Truth;
use crate::scan::columns::Columns;
use crate::scan::{Scan, ScanError, Station};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Simulates a scan of the part.
///
/// # Errors
/// [`ScanError`] if no points remain, or the part's numbers are not finite.
pub fn make(part: &Part) -> Result<(Scan, Truth), ScanError> {
    let mut acquisition = Acquisition::start(part);
    let mut delivered = Delivered::new(part);
    for index in 0..part.profiles_count {
        let profile = acquisition.next(index);
        match acquisition.stage.delivery() {
            Delivery::Once => delivered.push(profile),
            Delivery::Twice => {
                let again = profile.again();
                delivered.push(profile);
                delivered.push(again);
            }
            Delivery::Stale => {
                let stale = delivered.last.as_ref().map(|last| last.stale(profile.x));
                delivered.push(stale.unwrap_or(profile));
            }
            Delivery::Lost => {}
        }
    }
    delivered.end()
}

/// A simulated scan in progress.
struct Acquisition<'a> {
    part: &'a Part,
    edges: Prepared,
    chance: ChaCha8Rng,
    sensor_chance: ChaCha8Rng,
    stage: Stage,
}

/// One profile as the sensor recorded it.
struct Taken {
    x: f64,
    points: Vec<[f64; 3]>,
    /// Number of its points on the part.
    on_part_count: usize,
    /// Their true positions; empty if the profile repeats another one, which adds no information about the part.
    on_part: Vec<[f64; 3]>,
}

impl Taken {
    /// A copy of the profile.
    fn again(&self) -> Self {
        Self { points: self.points.clone(), on_part: Vec::new(), ..*self }
    }

    /// The same points under another x, marked as not on the part.
    fn stale(&self, x: f64) -> Self {
        let moved = x - self.x;
        let points = self.points.iter().map(|[x, y, z]| [x + moved, *y, *z]).collect();
        Self { x, points, on_part_count: 0, on_part: Vec::new() }
    }
}

impl<'a> Acquisition<'a> {
    fn start(part: &'a Part) -> Self {
        Self {
            part,
            edges: part.prepared_edges(),
            chance: ChaCha8Rng::seed_from_u64(part.seed),
            sensor_chance: Stream::Sensor.of(part.seed),
            stage: part.travel.start(part.seed),
        }
    }

    fn next(&mut self, index: usize) -> Taken {
        let (part, plane) = (self.part, self.part.laser_plane);
        let x = self.stage.place(part.station_x(index, &mut self.chance));
        let mut noise = part.noise(&mut self.chance);
        let mut taken =
            Taken { x, points: Vec::with_capacity(part.points_count), on_part_count: 0, on_part: Vec::new() };
        let on_part = (0..part.points_count).map(Seen::OnPart);
        let [left, right] = [part.surroundings.left(part, x), part.surroundings.right(part, x, index)];
        for seen in left.into_iter().map(Seen::Beside).chain(on_part).chain(right.into_iter().map(Seen::Beside)) {
            if self.chance.random_bool(part.drop_out_ratio.clamp(0.0, 1.0)) {
                continue;
            }
            let thrown = thrown(part, &mut self.chance) + seen.reflected(part, &mut self.sensor_chance);
            let Some(place) = seen.place(part, &self.edges, (x, plane), part.feature(index), thrown) else { continue };
            let [y, z] = place.measured(part, noise.next(&mut self.chance));
            taken.points.push([self.stage.encoder_x(plane.x_at(x, [y, z])), y, z]);
            if place.is_on_part {
                let [y, z] = place.point;
                taken.on_part.push([plane.x_at(x, place.point), y, z]);
            }
        }
        taken.on_part_count = taken.on_part.len();
        taken
    }
}

/// The profiles that were delivered.
struct Delivered<'a> {
    part: &'a Part,
    has_own_x: bool,
    stations: Vec<Station>,
    own_x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
    blanks: Vec<f64>,
    truth: Truth,
    /// The last delivered profile.
    last: Option<Taken>,
}

impl<'a> Delivered<'a> {
    fn new(part: &'a Part) -> Self {
        Self {
            part,
            has_own_x: !part.laser_plane.is_square() || part.travel.encoder_sigma_mm > 0.0,
            stations: Vec::with_capacity(part.profiles_count),
            own_x: Vec::new(),
            y: Vec::new(),
            z: Vec::new(),
            blanks: Vec::new(),
            truth: Truth::begin(part),
            last: None,
        }
    }

    fn push(&mut self, profile: Taken) {
        let start = self.y.len();
        for [x, y, z] in &profile.points {
            if self.has_own_x {
                self.own_x.push(*x);
            }
            self.y.push(*y);
            self.z.push(*z);
        }
        if profile.points.is_empty() {
            self.blanks.push(profile.x);
        } else {
            profile.on_part.iter().for_each(|point| self.truth.add_inner_point(self.part, *point));
            self.truth.end_profile(profile.on_part_count, profile.points.len());
            self.stations.push(Station { x: profile.x, start, end: self.y.len() });
        }
        self.last = Some(profile);
    }

    fn end(self) -> Result<(Scan, Truth), ScanError> {
        let scan = Scan::new(self.stations, Columns::F64 { y: self.y, z: self.z }, "synthetic".to_owned())?;
        let scan = scan.with_blanks(self.blanks);
        let scan = if self.has_own_x { scan.with_own_x(self.own_x)? } else { scan };
        Ok((self.part.export.apply(scan, self.part.seed)?, self.truth.end(self.part)))
    }
}

/// An observed point of a profile.
#[derive(Debug, Clone, Copy)]
pub(super) enum Seen {
    /// A point on the part or on a feature: its index in the profile.
    OnPart(usize),
    /// A point next to the part.
    Beside([f64; 2]),
}

/// Position of a point, in (y, z).
pub(super) struct Place {
    /// True position.
    point: [f64; 2],
    /// Position as the sensor sees it, without noise.
    seen: [f64; 2],
    is_on_part: bool,
}

impl Place {
    /// Position as the sensor reports it, with this noise.
    pub(super) fn measured(&self, part: &Part, [off_y, off_z]: [f64; 2]) -> [f64; 2] {
        let [y, z] = self.seen;
        part.sensor.reported([y + off_y, z + off_z])
    }
}

/// Displacement of a point by a spike; usually none.
pub(super) fn thrown(part: &Part, chance: &mut ChaCha8Rng) -> f64 {
    let spike = chance.random_bool(part.spike_ratio.clamp(0.0, 1.0));
    if spike { chance.random_range(-SPIKE_MM..SPIKE_MM) } else { 0.0 }
}

impl Seen {
    /// Displacement of the point by a second reflection.
    pub(super) fn reflected(self, part: &Part, chance: &mut ChaCha8Rng) -> f64 {
        match self {
            Self::OnPart(_) => part.sensor.reflections.offset_mm(chance),
            Self::Beside(_) => 0.0,
        }
    }

    /// Position of the point in the profile at `x`, displaced by `thrown`; `None` if the sensor sees nothing.
    pub(super) fn place(
        self,
        part: &Part,
        edges: &Prepared,
        (x, plane): (f64, LaserPlane),
        feature: Feature,
        thrown: f64,
    ) -> Option<Place> {
        match self {
            Self::Beside([y, z]) => {
                let point = [y, z + thrown];
                Some(Place { point, seen: point, is_on_part: false })
            }
            Self::OnPart(column) => {
                let place = (column as f64 + 0.5) / part.points_count as f64;
                let direction = part.direction(place);
                let angle = direction - part.direction(0.5 + part.interference.shift);
                let raised = part.interference.offset_mm(feature, place, angle, part.radius_mm);
                let sight = plane.sight(&part.axis, x, direction);
                let offset = edges.offset(&sight, column, part.side.sign() * raised + thrown)?;
                let curl = part.sensor.curl.offset_mm(part.facing(), direction);
                let at = |offset| sight.point(&part.axis, part.radius_mm, offset);
                Some(Place { point: at(offset), seen: at(offset + curl), is_on_part: offset == 0.0 })
            }
        }
    }
}

/// The points (y, z) of the section of `part` by the plane at `x`, mm, without drop-outs and without lines of sight that meet
/// nothing. `along` is the position of the plane along the part, 0 at its near end to 1, and determines the feature there. The
/// number of profiles, their planes, the background, the tilt of the laser plane, the travel and the export of the part have no
/// effect.
#[must_use]
pub fn make_profile(part: &Part, x: f64, along: f64, chance: &mut ChaCha8Rng) -> Vec<[f64; 2]> {
    let edges = part.prepared_edges();
    let feature = part.interference.feature((along * BLOCKS_COUNT as f64).rem_euclid(1.0));
    let mut noise = part.noise(chance);
    let mut points = Vec::with_capacity(part.points_count);
    for column in 0..part.points_count {
        if chance.random_bool(part.drop_out_ratio.clamp(0.0, 1.0)) {
            continue;
        }
        let seen = Seen::OnPart(column);
        let thrown = thrown(part, chance) + seen.reflected(part, chance);
        let Some(place) = seen.place(part, &edges, (x, LaserPlane::default()), feature, thrown) else { continue };
        points.push(place.measured(part, noise.next(chance)));
    }
    points
}

/// Simulates a scan of parts in a row; returns the truth of each, in their order. A part's profiles are bit for bit those that
/// [`make`] gives for it alone.
///
/// # Errors
/// [`ScanError`] if a part cannot be simulated, or does not lie after the previous one.
pub fn make_several(parts: &[Part]) -> Result<(Scan, Vec<Truth>), ScanError> {
    let (mut y, mut z, mut stations, mut truths) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut blanks, mut own_x, mut is_planar) = (Vec::new(), Vec::new(), true);
    for part in parts {
        let (scan, truth) = make(part)?;
        let before = y.len();
        stations.extend(scan.stations().iter().map(|station| Station {
            start: station.start + before,
            end: station.end + before,
            ..*station
        }));
        let (mut part_y, mut part_z) = (Vec::new(), Vec::new());
        scan.columns().load(scan.points(), &mut part_y, &mut part_z);
        own_x.extend(scan.stations().iter().flat_map(|station| scan.points_of(station)).map(|[x, ..]| x));
        is_planar &= scan.is_planar();
        y.append(&mut part_y);
        z.append(&mut part_z);
        blanks.extend_from_slice(scan.blanks());
        truths.push(truth);
    }
    let scan = Scan::new(stations, Columns::F64 { y, z }, "synthetic".to_owned())?;
    let scan = scan.with_blanks(blanks);
    Ok((if is_planar { scan } else { scan.with_own_x(own_x)? }, truths))
}

/// Gap between the part and adjacent objects, in radii.
const GAP: f64 = 0.05;
/// Width of the ground plane on either side, in radii.
const FLOOR_WIDTH: f64 = 0.75;
/// Width of a flat support, in radii,
const SUPPORT_WIDTH: f64 = 0.4;
/// and depth of its face below the axis.
const SUPPORT_DEPTH: f64 = 0.3;
/// Half of the angle over which a round support is visible.
const SUPPORT_HALF_RAD: f64 = 1.0;

impl Surroundings {
    /// The points left of the part (towards −Y) in the plane of the profile `index` at `x`, in order of y.
    pub(super) fn left(&self, part: &Part, x: f64) -> Vec<[f64; 2]> {
        let start = part.axis.at(x)[0] - part.radius_mm * (1.0 + GAP + FLOOR_WIDTH);
        self.floor(part, start)
    }

    /// The points right of the part, in order of y except for the end of a support that overhangs the ground plane.
    pub(super) fn right(&self, part: &Part, x: f64, index: usize) -> Vec<[f64; 2]> {
        let [axis_y, axis_z] = part.axis.at(x);
        let edge = axis_y + part.radius_mm * (1.0 + GAP);
        let shown = (index as f64 + 0.5) / part.profiles_count as f64 % 0.25 < 0.25 * self.supports;
        let count = if shown { (self.support * part.points_count as f64).round() as usize } else { 0 };
        let support = (0..count).map(|i| (i as f64 + 0.5) / count as f64).map(|share| {
            let own = self.support_radius_mm;
            if own > 0.0 {
                let (sin, cos) = ((2.0 * share - 1.0) * SUPPORT_HALF_RAD).sin_cos();
                [edge + own * (1.0 + sin), axis_z + own * cos]
            } else {
                [edge + share * part.radius_mm * SUPPORT_WIDTH, axis_z - part.radius_mm * SUPPORT_DEPTH]
            }
        });
        support.chain(self.floor(part, edge)).collect()
    }

    fn floor(&self, part: &Part, start: f64) -> Vec<[f64; 2]> {
        let [_, middle_z] = part.axis.at(part.x_start_mm + part.length_mm / 2.0);
        let count = (0.5 * self.floor * part.points_count as f64).round() as usize;
        let step = part.radius_mm * FLOOR_WIDTH / count.max(1) as f64;
        (0..count).map(|i| [start + (i as f64 + 0.5) * step, middle_z - self.floor_depth_mm]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::synthetic::make;
    use rand::SeedableRng;

    #[test]
    fn without_noise_it_equals_the_profile_of_the_complete_scan() {
        let part = Part { noise_sigma_mm: 0.0, ..Part::with_interference(3) };
        let (scan, _) = make(&part).expect("a scan");
        let (mut y, mut z) = (Vec::new(), Vec::new());
        for index in [0, 60, 100, 133, 250, 399] {
            let station = scan.stations()[index];
            scan.load(station, &mut y, &mut z);
            let along = index as f64 / part.profiles_count as f64;
            let points = make_profile(&part, station.x, along, &mut ChaCha8Rng::seed_from_u64(1));
            assert_eq!(points, y.iter().zip(&z).map(|(y, z)| [*y, *z]).collect::<Vec<_>>(), "{index}");
        }
    }

    #[test]
    fn beyond_the_end_there_are_no_points() {
        let far = Some(crate::scan::synthetic::Edge { x_mm: 800.0, ..Default::default() });
        let mut part = Part::smooth(3);
        part.edges.far = far;
        let seen = |x: f64| make_profile(&part, x, 0.99, &mut ChaCha8Rng::seed_from_u64(1)).len();
        // With a tilt of about a degree, the end plane spreads over 800 ± 4 mm.
        assert_eq!((seen(795.0), seen(805.0)), (640, 0));
    }
}
