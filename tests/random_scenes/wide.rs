//! Scenes drawn from everything that can be simulated, measured as an uploaded file is: missing values and repeated profiles
//! are removed, points are grouped into profiles, and the axis may lie in any direction.

use super::{Chance, Fate, scene, wrong_or_right};
use coaxis::estimation::{Orientation, Outcome, Pose, Progress, Settings, estimate};
use coaxis::geometry::{Axis, Frame};
use coaxis::scan::decode::{Limits, Unit};
use coaxis::scan::missing::clean;
use coaxis::scan::slice::{SliceRequest, slice};
use coaxis::scan::synthetic::{
    Bend, Coordinates, Curl, Export, LaserPlane, Part, Reflections, RepeatedX, Ripple, Sampling, SensorErrors,
    Sentinel, SentinelPlace, Side, Steps, Surroundings, Travel, make, placed, random_frame,
};
use coaxis::scan::{Cloud, Columns, Labels, Scan, Stripe};
use nalgebra::{Matrix5, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::FRAC_PI_2;

/// The number of the first of these scenes.
pub(super) const FIRST: u64 = 1_000_000;

/// A scene, and what it was drawn from beyond the narrower mix.
#[derive(Debug, Clone)]
pub(super) struct Wide {
    pub(super) part: Part,
    pub(super) settings: Settings,
    /// Where the rail frame lies in the scan; `None` for profiles along the rail.
    frame: Option<Frame>,
    is_shuffled: bool,
    export: Export,
    pub(super) kinds: Vec<&'static str>,
}

/// Kinds of errors that repeat from profile to profile: a scan does not show them, and without `type_b` no uncertainty that
/// comes from the points can cover them.
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

    /// Its kinds without any one of which the answer is right or refused.
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
            // The range just holds the part.
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

    /// What becomes of the scene.
    pub(super) fn fate(&self) -> Fate {
        // Every profile can be lost.
        let Ok((scan, truth)) = make(&self.part) else { return Fate::Refused("nothing_scanned") };
        let (scan, axis) = match &self.frame {
            None => (scan, truth_axis(&truth.axis(), truth.x_ref_mm)),
            Some(frame) => {
                let shuffle_seed = self.is_shuffled.then_some(self.part.seed);
                let placed_truth = truth.placed(frame).expect("a frame");
                (placed(&scan, frame, shuffle_seed).expect("a frame"), placed_truth.axis)
            }
        };
        let written = self.export.apply(scan, self.part.seed).expect("finite");
        let (cloud, _) = clean(cloud(&written, self.frame.is_none()), None);
        let limits = Limits { points_per_profile_max: usize::MAX, ..Limits::default() };
        let Ok(scan) = slice(cloud, &SliceRequest::default(), &limits) else { return Fate::Refused("not_sliced") };
        match estimate(&scan, &self.settings, &Progress::default()).outcome {
            Outcome::Refused(refusal) => Fate::Refused(refusal.code()),
            Outcome::Accepted(pose) => {
                let (errors, standard) = compared(&pose, &axis, self.part.radius_mm);
                wrong_or_right(errors, standard)
            }
        }
    }
}

fn truth_axis(line: &coaxis::geometry::AxisLine, x_ref: f64) -> Axis {
    let [y, z] = line.at(x_ref);
    Axis { point_mm: [x_ref, y, z], direction: line.direction() }
}

/// The scan as a decoded file: with a profile column, or without any grouping.
fn cloud(scan: &Scan, has_profiles: bool) -> Cloud {
    let (mut stripes, mut y, mut z): (Vec<Stripe>, _, _) = (Vec::new(), Vec::new(), Vec::new());
    for (index, station) in scan.stations().iter().enumerate() {
        let label = if has_profiles { index as f64 } else { 0.0 };
        for [own_x, own_y, own_z] in scan.points_of(station) {
            y.push(own_y);
            z.push(own_z);
            match stripes.last_mut() {
                Some(last) if last.label == label && last.x == own_x => last.end = y.len(),
                _ => stripes.push(Stripe { label, x: own_x, end: y.len() }),
            }
        }
    }
    let labels = if has_profiles { Labels::Column("profile".to_owned()) } else { Labels::None };
    let blanks = scan.blanks().to_vec();
    Cloud { stripes, columns: Columns::F64 { y, z }, labels, unit: Unit::Millimetre, blanks, missing_count: 0 }
}

/// Errors of (deflection, pitch, y_ref, z_ref, radius) and their standard uncertainties, in the coordinates of the scan where
/// the axis lies near X there, else in the frame of the pose, radians and mm.
fn compared(pose: &Pose, truth: &Axis, radius_mm: f64) -> ([f64; 5], [f64; 5]) {
    // It is symmetric: the order of rows and columns does not matter.
    let own = Matrix5::from(pose.uncertainty.covariance);
    let (line, x_ref, covariance, true_line) = match pose.on_rail() {
        Some(rail) => (rail.axis, rail.x_ref, Matrix5::from(rail.uncertainty.covariance), truth.line()),
        None => (pose.axis, pose.x_ref, own, in_frame_of(pose, truth).line()),
    };
    let standard = covariance.diagonal().map(|variance| variance.max(0.0).sqrt()).into();
    let [y, z] = line.at(x_ref);
    // An axis far from that of the pose has no slopes there, and the angle between them is at least 90° − 60°.
    let Some(true_line) = true_line else { return ([FRAC_PI_2; 5], standard) };
    let [true_y, true_z] = true_line.at(x_ref);
    let angles = [line.deflection().radians(), line.pitch().radians()];
    let true_angles = [true_line.deflection().radians(), true_line.pitch().radians()];
    let errors =
        [angles[0] - true_angles[0], angles[1] - true_angles[1], y - true_y, z - true_z, pose.radius - radius_mm];
    (errors, standard)
}

fn in_frame_of(pose: &Pose, axis: &Axis) -> Axis {
    let Some(cut) = &pose.cut else { return *axis };
    let rotation = cut.frame.rotation().expect("a frame of sections");
    let point = rotation * (Vector3::from(axis.point_mm) - Vector3::from(cut.frame.origin_mm));
    Axis { point_mm: point.into(), direction: (rotation * Vector3::from(axis.direction)).into() }
}
