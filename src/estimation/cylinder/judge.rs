//! Each profile against the joint model: how many of its points lie on it, over which arc, and where its own centre would
//! be with the section's shape held. Must not change the model.

use super::model::Cylinder;
use super::sums::Sums;
use crate::estimation::conclude::median;
use crate::estimation::{Profile, Reason, Section, Settings};
use crate::geometry::{Angle, SectionEllipse};
use crate::scan::{Scan, Station};
use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// ε in units of the joint spread, where the noise is larger than ε was made for: 97.4 % of normal noise.
const EPSILON_SIGMAS: f64 = 2.22;
/// A centre farther from the axis than this many robust spreads of all centres is off it,
const OFF_AXIS_SPREADS: f64 = 6.0;
/// but never one nearer than this many spreads of the points.
const OFF_AXIS_SIGMAS: f64 = 1.0;

/// A section whose shape is known needs less of an arc than a free ellipse.
const ARC_MIN_DEG: f64 = 15.0;

/// The model, its spread and what the last pass over the points left.
#[derive(Debug, Clone, Copy)]
pub(super) struct Model<'a> {
    pub(super) cylinder: &'a Cylinder,
    pub(super) sigma: f64,
    /// One a station.
    pub(super) sums: &'a [Sums],
    pub(super) passes_count: u32,
}

/// Judges every profile.
pub(super) fn judge(scan: &Scan, used: &[bool], model: Model<'_>, settings: &Settings) -> Vec<Profile> {
    let epsilon = settings.epsilon_mm.max(EPSILON_SIGMAS * model.sigma);
    let work = |((station, used), sums): ((&Station, &bool), &Sums)| {
        if !*used {
            return rejected(station, Reason::TooFewPoints);
        }
        let counts = count(scan, station, model.cylinder, epsilon);
        profile(station, &counts, sums, &model, settings)
    };
    let mut profiles: Vec<Profile> = scan.stations().par_iter().zip(used).zip(model.sums).map(work).collect();
    mark_off_axis(&mut profiles, model.sigma);
    profiles
}

fn rejected(station: &Station, reason: Reason) -> Profile {
    let points_count = station.end - station.start;
    Profile { x: station.x, points_count, rejected: Some(reason), section: None, offset: None }
}

/// What lies within ε of the model.
#[derive(Debug, Clone, Copy, Default)]
struct Counts {
    points_count: usize,
    inner_count: usize,
    squared_sum: f64,
    /// Tangents of half the outermost angles, from the mean direction.
    low: f64,
    high: f64,
}

fn count(scan: &Scan, station: &Station, cylinder: &Cylinder, epsilon: f64) -> Counts {
    let slice = cylinder.slice(station.x);
    let (mut y, mut z) = (Vec::new(), Vec::new());
    scan.load(*station, &mut y, &mut z);
    let (mut mean_u, mut mean_w) = (0.0, 0.0);
    for (y, z) in y.iter().zip(&z) {
        (mean_u, mean_w) = (mean_u + y - slice.y, mean_w + z - slice.z);
    }
    let length = mean_u.hypot(mean_w).max(f64::MIN_POSITIVE);
    let (mean_u, mean_w) = (mean_u / length, mean_w / length);
    let mut counts = Counts { points_count: y.len(), low: f64::INFINITY, high: f64::NEG_INFINITY, ..Counts::default() };
    for (&y, &z) in y.iter().zip(&z) {
        let d = slice.distance(y, z);
        let inner = d.abs() < epsilon;
        let (u, w) = (y - slice.y, z - slice.z);
        let (along, across) = (u * mean_u + w * mean_w, w * mean_u - u * mean_w);
        // tan(θ/2) = sin/(1 + cos) orders angles over the whole turn.
        let half = across / (along.hypot(across) + along).max(f64::MIN_POSITIVE);
        counts.inner_count += usize::from(inner);
        counts.squared_sum += if inner { d * d } else { 0.0 };
        counts.low = if inner { counts.low.min(half) } else { counts.low };
        counts.high = if inner { counts.high.max(half) } else { counts.high };
    }
    counts
}

fn profile(station: &Station, counts: &Counts, sums: &Sums, model: &Model<'_>, settings: &Settings) -> Profile {
    let inlier_ratio = counts.inner_count as f64 / counts.points_count.max(1) as f64;
    let arc = if counts.inner_count == 0 { 0.0 } else { 2.0 * (counts.high.atan() - counts.low.atan()) };
    let Some(ellipse) = own_section(station, sums, model.cylinder) else {
        return rejected(station, Reason::NotConverged);
    };
    let rejected = if inlier_ratio < settings.inlier_ratio_min {
        Some(Reason::LowInlierRatio)
    } else if arc.to_degrees() < settings.arc_min_deg.min(ARC_MIN_DEG) {
        Some(Reason::ArcTooShort)
    } else {
        None
    };
    let rms = (counts.squared_sum / counts.inner_count.max(1) as f64).sqrt();
    let section = Section {
        ellipse,
        sigma: model.sigma,
        inlier_ratio,
        rms,
        arc: Angle::from_radians(arc.clamp(0.0, TAU)),
        iterations_count: model.passes_count,
    };
    let offset = model.cylinder.axis().distance([station.x, ellipse.centre_y, ellipse.centre_z]);
    Profile { x: station.x, points_count: counts.points_count, rejected, section: Some(section), offset: Some(offset) }
}

/// The model's section, moved to where the profile's own points put it: one step with radius and slopes held.
fn own_section(station: &Station, sums: &Sums, cylinder: &Cylinder) -> Option<SectionEllipse> {
    let normal: Matrix2<f64> = sums.normal.fixed_view::<2, 2>(2, 2).into_owned();
    let gradient: Vector2<f64> = sums.gradient.fixed_rows::<2>(2).into_owned();
    let step = normal.lu().solve(&-gradient)?;
    let section = cylinder.axis().section(cylinder.radius, station.x);
    let moved = SectionEllipse { centre_y: section.centre_y + step.x, centre_z: section.centre_z + step.y, ..section };
    (moved.centre_y.is_finite() && moved.centre_z.is_finite()).then_some(moved)
}

/// Rejects valid profiles whose centre lies far from where the others' lie.
fn mark_off_axis(profiles: &mut [Profile], sigma: f64) {
    let valid = |profile: &Profile| profile.rejected.is_none();
    let offsets = profiles.iter().filter(|p| valid(p)).filter_map(|p| p.offset);
    let Some(middle) = median(offsets) else { return };
    let limit = (OFF_AXIS_SPREADS * middle).max(OFF_AXIS_SIGMAS * sigma);
    for profile in profiles.iter_mut().filter(|p| valid(p) && p.offset.is_some_and(|offset| offset > limit)) {
        profile.rejected = Some(Reason::OffAxis);
    }
}
