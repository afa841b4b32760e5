//! Scans a part: profile after profile along the rail, and the truth of each.

use super::edge::Prepared;
use super::interference::Feature;
use super::laser_plane::LaserPlane;
use super::noise::Noise;
use super::travel::{Delivery, Stage};
use super::truth::Truth;
use super::{Part, SPIKE_MM, Stream};
use crate::scan::columns::Columns;
use crate::scan::{Scan, ScanError, Station};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Scans the part.
///
/// # Errors
/// [`ScanError`] where no point is left, or the part's numbers are not finite.
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

/// One scan under way.
struct Acquisition<'a> {
    part: &'a Part,
    edges: Prepared,
    chance: ChaCha8Rng,
    sensor_chance: ChaCha8Rng,
    stage: Stage,
}

/// One profile as the sensor took it.
struct Taken {
    x: f64,
    points: Vec<[f64; 3]>,
    /// How many of its points lie on the part.
    on_part_count: usize,
    /// Their true places; none where the profile repeats another one, which says nothing new about the part.
    on_part: Vec<[f64; 3]>,
}

impl Taken {
    /// The same once more.
    fn again(&self) -> Self {
        Self { points: self.points.clone(), on_part: Vec::new(), ..*self }
    }

    /// The same points under another x, where they do not lie on the part.
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
            edges: part.edges.prepare(part),
            chance: ChaCha8Rng::seed_from_u64(part.seed),
            sensor_chance: Stream::Sensor.of(part.seed),
            stage: part.travel.start(part.seed),
        }
    }

    fn next(&mut self, index: usize) -> Taken {
        let (part, plane) = (self.part, self.part.laser_plane);
        let x = self.stage.place(part.station_x(index, &mut self.chance));
        let mut noise = Noise::begin(part, &mut self.chance);
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

/// The profiles that arrived.
struct Delivered<'a> {
    part: &'a Part,
    has_own_x: bool,
    stations: Vec<Station>,
    own_x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
    blanks: Vec<f64>,
    truth: Truth,
    /// The last profile that arrived.
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

/// Something in a profile.
#[derive(Debug, Clone, Copy)]
pub(super) enum Seen {
    /// On the part or what sits on it: the position in the profile.
    OnPart(usize),
    /// Beside it.
    Beside([f64; 2]),
}

/// Where a point lies, in (y, z).
pub(super) struct Place {
    /// Truly.
    point: [f64; 2],
    /// As the sensor sees it, without noise.
    seen: [f64; 2],
    is_on_part: bool,
}

impl Place {
    /// As the sensor reports it, with this noise.
    pub(super) fn measured(&self, part: &Part, [off_y, off_z]: [f64; 2]) -> [f64; 2] {
        let [y, z] = self.seen;
        part.sensor.reported([y + off_y, z + off_z])
    }
}

/// How far a point is thrown off; mostly not at all.
pub(super) fn thrown(part: &Part, chance: &mut ChaCha8Rng) -> f64 {
    let spike = chance.random_bool(part.spike_ratio.clamp(0.0, 1.0));
    if spike { chance.random_range(-SPIKE_MM..SPIKE_MM) } else { 0.0 }
}

impl Seen {
    /// How far a second reflection displaces the point.
    pub(super) fn reflected(self, part: &Part, chance: &mut ChaCha8Rng) -> f64 {
        match self {
            Self::OnPart(_) => part.sensor.reflections.offset_mm(chance),
            Self::Beside(_) => 0.0,
        }
    }

    /// Where the point lies in the profile at `x`, thrown off by `thrown`; `None` where nothing is seen.
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
                let curl = part.sensor.curl.offset_mm(part, direction);
                let at = |offset| sight.point(part, offset);
                Some(Place { point: at(offset), seen: at(offset + curl), is_on_part: offset == 0.0 })
            }
        }
    }
}
