//! The profile sensor of the simulated cell. When it is armed, it takes a profile each time that the stage has advanced by one
//! pitch. Input: the position of the stage and the place of the part. Output: profiles in the rail frame.

use super::rail::Rail;
use std::collections::VecDeque;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::device::sensor::Profile;
use crate::scan::synthetic::{Edge, Edges, Interference, Part, make_profile};

use super::part::Place;
use super::settings::{SensorSettings, Settings};

/// Greatest number of profiles in one scan, which limits the memory.
pub(super) const PROFILES_MAX: u64 = 100_000;
/// Streams of random numbers below this one are not used for profiles.
const FIRST_STREAM: u64 = 16;

/// A profile that was triggered and has not been fetched yet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Trigger {
    scan: u64,
    index: u64,
    x: f64,
    place: Place,
}

/// The state of the sensor.
#[derive(Debug, Clone, Default)]
pub(super) struct Scanning {
    scans_count: u64,
    armed: Option<Armed>,
    waiting: VecDeque<Trigger>,
}

#[derive(Debug, Clone, Copy)]
struct Armed {
    from_mm: f64,
    pitch_mm: f64,
    next: u64,
    profiles_count: u64,
}

impl Scanning {
    /// Prepares for `profiles_count` profiles from the position of the stage, and drops those of an earlier scan.
    pub(super) fn arm(&mut self, from_mm: f64, pitch_mm: f64, profiles_count: u64) {
        self.scans_count += 1;
        self.waiting.clear();
        self.armed = Some(Armed { from_mm, pitch_mm, next: 0, profiles_count: profiles_count.min(PROFILES_MAX) });
    }

    pub(super) fn disarm(&mut self) {
        self.armed = None;
        self.waiting.clear();
    }

    pub(super) const fn is_armed(&self) -> bool {
        self.armed.is_some()
    }

    /// The plane of the next profile, if the stage at `position` has reached it.
    pub(super) fn due(&self, position: f64) -> Option<f64> {
        let armed = self.armed.filter(|armed| armed.next < armed.profiles_count)?;
        let (travel, way) = (position - armed.from_mm, armed.next as f64 * armed.pitch_mm);
        (travel.abs() + 1e-6 >= way).then(|| armed.from_mm + way.copysign(travel))
    }

    /// Takes the next profile of the part at its present place.
    pub(super) fn trigger(&mut self, x: f64, place: Place) {
        if let Some(armed) = &mut self.armed {
            self.waiting.push_back(Trigger { scan: self.scans_count, index: armed.next, x, place });
            armed.next += 1;
        }
    }

    /// Fetches the oldest profiles, at most `count_max`.
    pub(super) fn fetch(&mut self, count_max: usize) -> Vec<Trigger> {
        let count = count_max.min(self.waiting.len());
        self.waiting.drain(..count).collect()
    }
}

/// Generates the profiles of the sensor.
#[derive(Debug, Clone)]
pub(super) struct ProfileMaker {
    seed: u64,
    sensor: SensorSettings,
    rail: Rail,
    part: Part,
}

impl ProfileMaker {
    pub(super) fn new(settings: &Settings) -> Self {
        let Settings { seed, sensor, stage, part, .. } = settings;
        let made = if part.interference { Part::with_interference(*seed) } else { Part::smooth(*seed) };
        let (rail_mm, bound_mm) = (stage.upper_mm - stage.lower_mm, stage.straightness_mm);
        Self {
            seed: *seed,
            sensor: sensor.clone(),
            rail: Rail::new(bound_mm, stage.lower_mm, rail_mm, *seed),
            part: Part {
                radius_mm: part.radius_mm,
                points_count: sensor.points_count as usize,
                arc_deg: sensor.arc_deg,
                noise_sigma_mm: sensor.noise_sigma_mm,
                noise_correlation: sensor.noise_correlation,
                drop_out_ratio: sensor.drop_out_ratio,
                spike_ratio: sensor.spike_ratio,
                ..made
            },
        }
    }

    /// The profile of a trigger. Its random numbers depend only on the seed, the scan and the index.
    pub(super) fn profile(&self, trigger: &Trigger) -> Profile {
        let Trigger { scan, index, x, place } = *trigger;
        let mut chance = ChaCha8Rng::seed_from_u64(self.seed);
        chance.set_stream(FIRST_STREAM + scan * PROFILES_MAX + index);
        let seen = make_profile(&self.part_at(&place), x, place.along(x), &mut chance);
        let [off_y, off_z] = self.rail.off(x);
        // A sensor that is displaced to one side sees the part displaced to the other side.
        let inside = seen.into_iter().map(|[y, z]| [y - off_y, z - off_z]).filter(|point| self.in_field(*point));
        let (y, z): (Vec<f32>, Vec<f32>) = inside.map(|[y, z]| (y as f32, z as f32)).unzip();
        let ticks = (x / self.sensor.encoder_mm).round();
        let missing_count = (self.part.points_count - y.len()) as u64;
        Profile { index, travel_mm: ticks * self.sensor.encoder_mm, x: Vec::new(), y, z, missing_count }
    }

    fn in_field(&self, [y, z]: [f64; 2]) -> bool {
        let SensorSettings { field_half_width_mm, field_z_lower_mm, field_z_upper_mm, .. } = self.sensor;
        y.abs() <= field_half_width_mm && (field_z_lower_mm..=field_z_upper_mm).contains(&z)
    }

    /// The part at its place. Objects on its surface rotate with it: along the arc from +Z towards +Y, opposite to the roll.
    fn part_at(&self, place: &Place) -> Part {
        let interference = self.part.interference;
        let shift = interference.shift - place.roll / self.part.arc_deg.to_radians();
        let end = |x_mm: f64| Some(Edge { x_mm, ..Edge::default() });
        Part {
            axis: place.axis(),
            interference: Interference { shift, ..interference },
            edges: Edges { near: end(place.near.x), far: end(place.far.x) },
            ..self.part.clone()
        }
    }
}
