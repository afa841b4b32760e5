//! Scenes drawn from everything that can be simulated, measured like an uploaded file: missing values and repeated profiles
//! are removed, points are grouped into profiles, and the axis may have any direction.

use super::{Chance, Fate, scene, wrong_or_right};
use crate::made::uploaded::Upload;
use coaxis::estimation::{Orientation, Settings};
use coaxis::geometry::Frame;
use coaxis::scan::synthetic::{
    Bend, Coordinates, Curl, Export, LaserPlane, Part, Reflections, RepeatedX, Ripple, Sampling, SensorErrors,
    Sentinel, SentinelPlace, Side, Steps, Surroundings, Travel, random_frame,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// The number of the first of these scenes.
pub(super) const FIRST: u64 = 1_000_000;

/// A scene, and the kinds of faults that it was drawn from in addition to the narrower mix.
#[derive(Debug, Clone)]
pub(super) struct Wide {
    pub(super) part: Part,
    pub(super) settings: Settings,
    /// The rail frame in the scan; `None` for profiles along the rail.
    frame: Option<Frame>,
    is_shuffled: bool,
    export: Export,
    pub(super) kinds: Vec<&'static str>,
}

/// Systematic errors common to all profiles: a scan does not show them, and without `type_b` no uncertainty that
/// is calculated from the points can contain them.
pub(super) const SYSTEMATIC: [&str; 3] = ["bend", "ripple", "curl"];

/// The scene with this number.
pub(super) fn scene_wide(seed: u64) -> Wide {
    let (part, settings) = scene(seed);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(100);
    let mut chance = Chance(random);
    let mut wide =
        Wide { part, settings, frame: None, is_shuffled: false, export: Export::default(), kinds: Vec::new() };
    wide.draw_view(&mut chance);
    wide.draw_sensor(&mut chance);
    wide.draw_travel(&mut chance);
    wide.draw_placement(&mut chance, seed);
    wide.draw_export(&mut chance);
    wide
}

impl Wide {
    /// Whether the scene is of this kind in this share of all scenes.
    fn is(&mut self, kind: &'static str, share: f64, chance: &mut Chance) -> bool {
        let is_drawn = chance.happens(share);
        if is_drawn {
            self.kinds.push(kind);
        }
        is_drawn
    }

    /// Whether it has an error that the points do not show.
    pub(super) fn is_systematic(&self) -> bool {
        self.kinds.iter().any(|kind| SYSTEMATIC.contains(kind))
    }

    /// Its kinds without which the result is correct or refused.
    pub(super) fn decisive_kinds(&self) -> Vec<&'static str> {
        let is_decisive = |kind: &&'static str| !matches!(self.without(kind).fate(), Fate::Wrong(_));
        self.kinds.iter().copied().filter(is_decisive).collect()
    }

    /// The same scene without one of its kinds.
    fn without(&self, kind: &str) -> Self {
        let mut less = self.clone();
        let Self { part, .. } = &mut less;
        match kind {
            "inside" => part.side = Side::Outside,
            "wide arc" => part.arc_deg = part.arc_deg.min(170.0),
            "tilted plane" => part.laser_plane = LaserPlane::default(),
            "heavy tails" => part.noise_freedom = None,
            "bend" => part.sensor.bend = Bend::default(),
            "ripple" => part.sensor.ripple = Ripple::default(),
            "curl" => part.sensor.curl = Curl::default(),
            "reflections" => part.sensor.reflections = Reflections::default(),
            "encoder noise" => part.travel.encoder_sigma_mm = 0.0,
            "stick-slip" => part.travel.stick_mm = 0.0,
            "repeated twice" | "repeated stale" => part.travel.repeated_ratio = 0.0,
            "lost" => part.travel.lost_ratio = 0.0,
            "sentinel" => less.export.sentinel = None,
            "lattice" => less.export.steps = Steps::default(),
            _ => less.frame = None,
        }
        less
    }

    fn draw_view(&mut self, chance: &mut Chance) {
        if self.is("inside", 0.15, chance) {
            self.part.side = Side::Inside;
            self.part.surroundings = Surroundings::default();
        }
        if self.is("wide arc", 0.15, chance) {
            self.part.arc_deg = if chance.happens(0.5) { 360.0 } else { chance.between(170.0, 360.0) };
            self.part.sampling = Sampling::EvenAngle;
            self.part.surroundings = Surroundings::default();
        }
        if self.is("tilted plane", 0.3, chance) {
            let mut tilt = || if chance.happens(0.6) { chance.between(-15.0, 15.0) } else { 0.0 };
            self.part.laser_plane = LaserPlane { about_y_deg: tilt(), about_z_deg: tilt() };
        }
    }

    fn draw_sensor(&mut self, chance: &mut Chance) {
        let sigma = self.part.noise_sigma_mm;
        if self.is("heavy tails", 0.2, chance) {
            self.part.noise_freedom = Some(chance.scaled(2.3, 10.0));
        }
        let mut sensor = SensorErrors::default();
        if self.is("bend", 0.08, chance) {
            // The range just covers the part.
            let middle_mm = self.part.axis.at(self.part.x_start_mm + 0.5 * self.part.length_mm)[1];
            sensor.bend = Bend { size_mm: sigma * chance.between(-3.0, 3.0), middle_mm, range_mm: self.part.radius_mm };
        }
        if self.is("ripple", 0.08, chance) {
            let period_mm = self.part.radius_mm * chance.scaled(0.01, 0.3);
            sensor.ripple = Ripple { amplitude_mm: sigma * chance.scaled(0.1, 3.0), period_mm };
        }
        if self.is("curl", 0.08, chance) {
            sensor.curl =
                Curl { mm_per_rad: sigma * chance.between(-10.0, 10.0), from_deg: chance.between(30.0, 60.0) };
        }
        if self.is("reflections", 0.15, chance) {
            let side = if chance.happens(0.5) { 1.0 } else { -1.0 };
            let offset_mm = side * sigma * chance.scaled(2.0, 200.0);
            sensor.reflections = Reflections { ratio: chance.between(0.0, 0.15), offset_mm };
        }
        self.part.sensor = sensor;
    }

    fn draw_travel(&mut self, chance: &mut Chance) {
        let spacing = self.part.length_mm / self.part.profiles_count as f64;
        let mut travel = Travel::default();
        if self.is("encoder noise", 0.2, chance) {
            travel.encoder_sigma_mm = self.part.noise_sigma_mm * chance.scaled(0.2, 10.0);
        }
        if self.is("stick-slip", 0.15, chance) {
            travel.stick_mm = spacing * chance.scaled(0.3, 3.0);
        }
        if self.is("repeated twice", 0.08, chance) {
            travel.repeated_ratio = chance.between(0.0, 1.0);
        } else if self.is("repeated stale", 0.08, chance) {
            (travel.repeated_ratio, travel.repeated_x) = (chance.between(0.0, 0.3), RepeatedX::New);
        }
        if self.is("lost", 0.15, chance) {
            travel.lost_ratio = chance.between(0.0, 0.5);
        }
        self.part.travel = travel;
    }

    fn draw_placement(&mut self, chance: &mut Chance, seed: u64) {
        if self.is("any direction", 0.25, chance) {
            self.frame = Some(random_frame(seed, 1000.0));
            self.is_shuffled = chance.happens(0.5);
            self.settings.orientation = if chance.happens(0.5) { Orientation::Any } else { Orientation::Auto };
        }
    }

    fn draw_export(&mut self, chance: &mut Chance) {
        if self.is("sentinel", 0.2, chance) {
            let values = [0.0, -9999.0, 9999.0, -99_999.0, 999.0, -32.768];
            let value_mm = values[chance.between(0.0, 6.0) as usize];
            let at_edges = chance.happens(0.5) && self.frame.is_none();
            let place = if at_edges { SentinelPlace::Edges } else { SentinelPlace::Random };
            let coordinates = match chance.between(0.0, 3.0) {
                kind if kind < 1.0 => Coordinates::Z,
                kind if kind < 2.0 => Coordinates::YZ,
                _ => Coordinates::XYZ,
            };
            let ratio = chance.scaled(0.003, 0.3);
            self.export.sentinel = Some(Sentinel { value_mm, ratio, place, coordinates });
        }
        if self.is("lattice", 0.25, chance) {
            let sigma = self.part.noise_sigma_mm;
            let mut step = || if chance.happens(0.7) { sigma * chance.scaled(0.1, 10.0) } else { 0.0 };
            self.export.steps = Steps { x_mm: step(), y_mm: step(), z_mm: step() };
        }
    }

    /// The result of the scene.
    pub(super) fn fate(&self) -> Fate {
        let upload =
            Upload { placed_at: self.frame, is_shuffled: self.is_shuffled, export: self.export, declared: None };
        match upload.measured(&self.part, &self.settings) {
            Err(code) => Fate::Refused(code),
            Ok((errors, standard)) => wrong_or_right(errors, standard),
        }
    }
}
