//! The profiles of a simulated sensor: in sensor coordinates at the times when they are due, and as messages of one of three forms:
//! point clouds, uniform profiles, or one uniform surface at the end.

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use tokio::time::{Instant, sleep_until};

use crate::device::clock::now;
use crate::device::error::Pending;
use crate::device::gocator::codec::{Generation, INVALID, Profiles, Scale, Stamp, Stamps, Surface, kind};
use crate::scan::Scan;

use super::super::extrinsic::Placement;

/// Ticks of the sensor's clock per second.
const CLOCK_HZ: f64 = 1.024e6;

/// One profile in sensor coordinates.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Taken {
    /// Ticks of the encoder.
    pub encoder: i64,
    /// Ticks of the sensor's clock.
    pub timestamp: u64,
    /// (x, z) in sensor coordinates along the laser line, mm; `None` for a point without a measurement.
    pub points: Vec<Option<[f64; 2]>>,
}

/// A source of profiles.
pub trait Source: Send {
    /// Begins a scan with its first profile.
    fn begin(&mut self);

    /// Waits for the next profile; `None` if there are no more.
    fn next(&mut self) -> Pending<'_, Option<Arc<Taken>>>;
}

/// The profiles of a scan, repeated at every start.
#[derive(Debug)]
pub struct ScanSource {
    profiles: Vec<Arc<Taken>>,
    next: usize,
    rate_hz: Option<f64>,
    began_at: Option<Instant>,
}

impl ScanSource {
    /// `rate_hz` is the number of profiles per second; without it, every profile is due at once.
    #[must_use]
    pub fn new(profiles: Vec<Taken>, rate_hz: Option<f64>) -> Self {
        let rate_hz = rate_hz.filter(|rate| rate.is_finite() && *rate > 0.0);
        Self { profiles: profiles.into_iter().map(Arc::new).collect(), next: 0, rate_hz, began_at: None }
    }

    /// The time when the next profile is due.
    fn due(&mut self) -> Option<Instant> {
        let rate_hz = self.rate_hz?;
        let began_at = *self.began_at.get_or_insert_with(now);
        began_at.checked_add(Duration::try_from_secs_f64(self.next as f64 / rate_hz).ok()?)
    }
}

impl Source for ScanSource {
    fn begin(&mut self) {
        (self.next, self.began_at) = (0, None);
    }

    fn next(&mut self) -> Pending<'_, Option<Arc<Taken>>> {
        Box::pin(async {
            let taken = Arc::clone(self.profiles.get(self.next)?);
            if let Some(due) = self.due() {
                sleep_until(due).await;
            }
            self.next += 1;
            Some(taken)
        })
    }
}

/// A scan in the rail frame as a sensor with this mounting takes it, with its encoder at 0 at the first profile; `None` if the
/// mounting does not keep profiles in planes x = const.
#[must_use]
pub fn taken_from(scan: &Scan, placement: &Placement, mm_per_tick: f64, rate_hz: f64) -> Option<Vec<Taken>> {
    let first_x = scan.stations().first().map_or(0.0, |station| station.x);
    let (mut y, mut z) = (Vec::new(), Vec::new());
    let taken = scan.stations().iter().enumerate().map(|(index, station)| {
        scan.load(*station, &mut y, &mut z);
        let points = y.iter().zip(&z).map(|(y, z)| placement.to_sensor([*y, *z]).map(Some));
        Some(Taken {
            encoder: ((station.x - first_x) / mm_per_tick).round() as i64,
            timestamp: (index as f64 * CLOCK_HZ / rate_hz).round() as u64,
            points: points.collect::<Option<Vec<_>>>()?,
        })
    });
    taken.collect()
}

/// Camera exposure in the messages, without influence on the data.
const EXPOSURE_NS: u32 = 120_000;
/// Greatest number of steps of the uniform form between two neighbouring points that are interpolated.
const GAP_STEPS_MAX: f64 = 4.0;
/// Distance from a step of the uniform form within which a point counts as being at that step.
const STEP_TOLERANCE: f64 = 1e-3;

/// The simulated outputs of the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Form {
    /// Profiles with x and z of every point.
    #[default]
    PointCloud,
    /// Profiles with z at equal steps of x.
    Uniform,
    /// One surface at the end of the scan, with z at equal steps of x and y.
    Surface,
}

/// The form in which the sensor sends its profiles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// The output.
    pub form: Form,
    /// The generation of its messages.
    pub generation: Generation,
    /// Scale along the laser line.
    pub x: Scale,
    /// Scale of the rows of a surface.
    pub y: Scale,
    /// Scale towards the sensor.
    pub z: Scale,
    /// Points of a uniform profile or row.
    pub width: u32,
    /// Serial number in the stamps.
    pub serial: u32,
}

impl View {
    /// Scales that cover every point of these profiles, not finer than 9 µm across and 8 µm towards the sensor; the uniform forms
    /// have as many steps as the widest profile has points. `step_mm` is the distance between the rows of a surface.
    #[must_use]
    pub fn reaching(profiles: &[Taken], form: Form, step_mm: f64) -> Self {
        let mut bounds = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        for point in profiles.iter().flat_map(|taken| &taken.points).flatten() {
            for ([least, most], value) in bounds.iter_mut().zip(point) {
                (*least, *most) = (least.min(*value), most.max(*value));
            }
        }
        let [[x_least, x_most], [z_least, z_most]] =
            bounds.map(|bound| if bound[0] <= bound[1] { bound } else { [0.0; 2] });
        let width = profiles.iter().map(|taken| taken.points.len()).max().unwrap_or(0).clamp(1, 65_535) as u32;
        let x = match form {
            Form::PointCloud => Scale::covering(x_least, x_most, 9_000),
            Form::Uniform | Form::Surface => {
                let step_nm = (x_most - x_least) * 1e6 / f64::from(width.max(2) - 1);
                Scale { scale_nm: (step_nm.ceil() as u32).max(1), offset_um: (x_least * 1e3).floor() as i32 }
            }
        };
        let y = Scale { scale_nm: ((step_mm.abs() * 1e6).round() as u32).max(1), offset_um: 0 };
        let z = Scale::covering(z_least, z_most, 8_000);
        Self { form, generation: Generation::default(), x, y, z, width, serial: 0 }
    }

    pub(super) fn stamp(&self, taken: &Taken, frame_index: u64, out: &mut Vec<u8>) {
        let stamp = Stamp {
            frame_index,
            timestamp: taken.timestamp,
            encoder: taken.encoder,
            serial: self.serial,
            ..Stamp::default()
        };
        Stamps::encode(0, &[stamp], false, out);
    }

    /// Appends the message group of one profile.
    pub(super) fn profile(&self, taken: &Taken, frame_index: u64, out: &mut Vec<u8>) {
        self.stamp(taken, frame_index, out);
        let (kind, width, values) = match self.form {
            Form::PointCloud => (kind::PROFILE_POINT_CLOUD, taken.points.len() as u32, self.point_cloud(taken)),
            Form::Uniform | Form::Surface => (kind::UNIFORM_PROFILE, self.width, bytes(&self.row(taken))),
        };
        let (x, z) = (self.x, self.z);
        let profiles =
            Profiles { count: 1, width, x, z, source: 0, exposure_ns: EXPOSURE_NS, camera: 0, values: &values };
        profiles.encode(kind, self.generation, true, out);
    }

    /// Appends the message group of a surface with these rows.
    pub(super) fn surface(&self, first: &Taken, rows: &[Vec<i16>], out: &mut Vec<u8>) {
        self.stamp(first, 1, out);
        let values = bytes(&rows.concat());
        let surface = Surface {
            rows_count: rows.len() as u32,
            width: self.width,
            x: self.x,
            y: self.y,
            z: self.z,
            source: 0,
            exposure_ns: EXPOSURE_NS,
            values: &values,
        };
        surface.encode(self.generation, true, out);
    }

    fn point_cloud(&self, taken: &Taken) -> Vec<u8> {
        let numbers = |point: &Option<[f64; 2]>| {
            let numbers = point.map(|[x, z]| [self.x.raw(x), self.z.raw(z)]);
            // A point that is out of range in either coordinate is missing.
            numbers.filter(|numbers| !numbers.contains(&INVALID)).unwrap_or([INVALID; 2])
        };
        let mut values = Vec::with_capacity(4 * taken.points.len());
        for [x, z] in taken.points.iter().map(numbers) {
            values.extend_from_slice(&x.to_le_bytes());
            values.extend_from_slice(&z.to_le_bytes());
        }
        values
    }

    /// z at the equal steps of x: that of the point at the step, or interpolated between two close neighbours.
    pub(super) fn row(&self, taken: &Taken) -> Vec<i16> {
        let mut row = vec![INVALID; self.width as usize];
        let mut set = |at: f64, z: f64| {
            if let Some(place) = (at >= 0.0).then_some(at as usize).and_then(|at| row.get_mut(at)) {
                *place = self.z.raw(z);
            }
        };
        let mut before = None;
        for point in &taken.points {
            let here = point.map(|[x, z]| ((x - self.x.offset_mm()) / self.x.step_mm(), z));
            if let (Some((from, from_z)), Some((to, to_z))) = (before, here) {
                join([from, from_z], [to, to_z], &mut set);
            }
            if let Some((at, z)) = here.filter(|(at, _)| (at - at.round()).abs() <= STEP_TOLERANCE) {
                set(at.round(), z);
            }
            before = here;
        }
        row
    }
}

/// Interpolates every step between two neighbours.
fn join(from: [f64; 2], to: [f64; 2], set: &mut impl FnMut(f64, f64)) {
    let [[low, low_z], [high, high_z]] = if from[0] <= to[0] { [from, to] } else { [to, from] };
    let width = high - low;
    if !(0.0..=GAP_STEPS_MAX).contains(&width) {
        return;
    }
    let mut at = low.ceil();
    while at <= high {
        set(at, if width > 0.0 { low_z + (high_z - low_z) * (at - low) / width } else { low_z });
        at += 1.0;
    }
}

fn bytes(numbers: &[i16]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}
