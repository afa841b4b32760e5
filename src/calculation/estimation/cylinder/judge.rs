//! Judges each profile by the joint model: how many of its points are inliers, over which arc, and where its own centre lies with
//! the shape of the section fixed.

use super::kernel::Inner;
use super::model::Cylinder;
use super::normal_equations::Sums;
use crate::estimation::estimate::{Profile, Section};
use crate::estimation::refusal::Reason;
use crate::estimation::settings::{Method, Settings};
use crate::estimation::statistics::median;
use crate::geometry::{Angle, SectionEllipse};
use crate::scan::{Scan, Station};
use nalgebra::{Matrix2, Vector2};
use std::f64::consts::{PI, TAU};

/// The inlier distance in units of the joint spread, if the noise is larger than ε allows for: it contains 97.4 % of normal noise.
const EPSILON_SIGMAS: f64 = 2.22;
/// A centre is off the axis if it is farther from it than this many robust spreads of all centres,
const OFF_AXIS_SPREADS: f64 = 6.0;
/// and farther than this many spreads of the points.
const OFF_AXIS_SIGMAS: f64 = 1.0;

/// Shortest arc of a section with a known shape; a free ellipse needs more.
const ARC_MIN_DEG: f64 = 15.0;

/// The model, its spread and the results of the last pass over the points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Model<'a> {
    pub(super) cylinder: &'a Cylinder,
    pub(super) sigma: f64,
    /// One entry a station.
    pub(super) sums: &'a [Sums],
    /// The points within [`Method::inlier_limit_mm`] of the model, one entry a station.
    pub(super) inner: &'a [Inner],
    pub(super) passes_count: u32,
}

impl Method {
    /// Distance from the surface below which a point is an inlier, mm, if the points on the part scatter by `sigma_mm`.
    ///
    /// `least_squares` uses every point.
    #[must_use]
    pub const fn inlier_limit_mm(self, epsilon_mm: f64, sigma_mm: f64) -> f64 {
        match self {
            Self::Cylinder => epsilon_mm.max(EPSILON_SIGMAS * sigma_mm),
            Self::SectionLine | Self::SectionLinePlain => epsilon_mm,
            Self::LeastSquares => f64::INFINITY,
        }
    }
}

/// Judges every profile.
pub(super) fn judge(scan: &Scan, used: &[bool], model: Model<'_>, settings: &Settings) -> Vec<Profile> {
    let axis = model.cylinder.axis();
    let section = axis.section(model.cylinder.radius, model.cylinder.x_ref);
    let work = |(((station, used), sums), inner): (((&Station, &bool), &Sums), &Inner)| {
        if !*used {
            return rejected(station, Reason::TooFewPoints);
        }
        let [centre_y, centre_z] = axis.at(station.x);
        let here = SectionEllipse { centre_y, centre_z, ..section };
        match moved(here, sums) {
            Some(own) => profile(station, inner, own, &model, settings),
            None => rejected(station, Reason::NotConverged),
        }
    };
    let stations = scan.stations().iter().zip(used).zip(model.sums).zip(model.inner);
    let mut profiles: Vec<Profile> = stations.map(work).collect();
    mark_off_axis(&mut profiles, model.sigma);
    profiles
}

fn rejected(station: &Station, reason: Reason) -> Profile {
    let points_count = station.end - station.start;
    Profile { x: station.x, points_count, rejected: Some(reason), section: None, offset: None }
}

/// The verdict on a profile, with the model's section at `own`, the centre that the profile's own points give.
fn profile(station: &Station, inner: &Inner, own: SectionEllipse, model: &Model<'_>, settings: &Settings) -> Profile {
    let points_count = station.end - station.start;
    let inlier_ratio = inner.count / points_count as f64;
    let arc = if inner.count > 0.0 { angle(inner.high) - angle(inner.low) } else { 0.0 };
    let rejected = if inlier_ratio < settings.inlier_ratio_min {
        Some(Reason::LowInlierRatio)
    } else if arc.to_degrees() < settings.arc_min_deg.min(ARC_MIN_DEG) {
        Some(Reason::ArcTooShort)
    } else {
        None
    };
    let section = Section {
        ellipse: own,
        sigma: model.sigma,
        inlier_ratio,
        rms: (inner.squared / inner.count.max(1.0)).sqrt(),
        arc: Angle::from_radians(arc.clamp(0.0, TAU)),
        iterations_count: model.passes_count,
    };
    let offset = model.cylinder.axis().distance([station.x, own.centre_y, own.centre_z]);
    Profile { x: station.x, points_count, rejected, section: Some(section), offset: Some(offset) }
}

/// The angle of a position on the scale of [`Inner`], −π to π.
fn angle(place: f64) -> f64 {
    if place > 1.0 {
        PI - (2.0 - place).asin()
    } else if place < -1.0 {
        -PI - (-2.0 - place).asin()
    } else {
        place.asin()
    }
}

/// The model's section at the centre that the profile's own points give: one step with radius and slopes fixed.
fn moved(section: SectionEllipse, sums: &Sums) -> Option<SectionEllipse> {
    let normal: Matrix2<f64> = sums.normal.fixed_view::<2, 2>(2, 2).into_owned();
    let gradient: Vector2<f64> = sums.gradient.fixed_rows::<2>(2).into_owned();
    let step = normal.try_inverse()? * -gradient;
    let moved = SectionEllipse { centre_y: section.centre_y + step.x, centre_z: section.centre_z + step.y, ..section };
    (moved.centre_y.is_finite() && moved.centre_z.is_finite()).then_some(moved)
}

/// Rejects valid profiles whose centre lies far from the others.
fn mark_off_axis(profiles: &mut [Profile], sigma: f64) {
    let valid = |profile: &Profile| profile.rejected.is_none();
    let offsets = profiles.iter().filter(|p| valid(p)).filter_map(|p| p.offset);
    let Some(middle) = median(offsets) else { return };
    let limit = (OFF_AXIS_SPREADS * middle).max(OFF_AXIS_SIGMAS * sigma);
    for profile in profiles.iter_mut().filter(|p| valid(p) && p.offset.is_some_and(|offset| offset > limit)) {
        profile.rejected = Some(Reason::OffAxis);
    }
}
