//! Moves a cloud into the rail frame and cuts it to a region.

use super::error::SliceError;
use crate::geometry::Frame;
use crate::scan::cloud::{Cloud, Stripe};
use crate::scan::columns::Columns;
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

/// The region of a cloud that is retained, bounds included, in the rail frame; an omitted bound does not restrict.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Region {
    /// Lower and upper x, mm.
    pub x_mm: Option<[f64; 2]>,
    /// Lower and upper y, mm.
    pub y_mm: Option<[f64; 2]>,
    /// Lower and upper z, mm.
    pub z_mm: Option<[f64; 2]>,
}

/// An invalid bound: not finite, or the lower above the upper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{axis} must be [lower, upper], both finite, the lower not above the upper")]
pub struct RegionError {
    /// Name of the bound.
    pub axis: &'static str,
}

impl Region {
    /// Checks every bound; a region with an invalid one contains no point.
    ///
    /// # Errors
    /// [`RegionError`] names the first invalid bound.
    pub fn check(&self) -> Result<(), RegionError> {
        for (axis, bound) in [("x_mm", self.x_mm), ("y_mm", self.y_mm), ("z_mm", self.z_mm)] {
            if bound.is_some_and(|[lower, upper]| !(lower.is_finite() && upper.is_finite() && lower <= upper)) {
                return Err(RegionError { axis });
            }
        }
        Ok(())
    }
}

/// The points of a cloud, each with its stripe.
fn each_point(cloud: &Cloud) -> impl Iterator<Item = (&Stripe, [f64; 2])> {
    let mut start = 0;
    cloud.stripes.iter().flat_map(move |stripe| {
        let range = std::mem::replace(&mut start, stripe.end)..stripe.end;
        range.filter_map(move |index| Some((stripe, cloud.columns.get(index)?)))
    })
}

/// A cloud of the given points, with the labels and missing points of `like`. Planes without points are left out, since a rotation
/// may not leave them at one x.
fn collect(like: &Cloud, points: impl Iterator<Item = (f64, [f64; 3])>) -> Cloud {
    let (mut stripes, mut ys, mut zs): (Vec<Stripe>, Vec<f64>, Vec<f64>) = Default::default();
    for (label, [x, y, z]) in points {
        ys.push(y);
        zs.push(z);
        match stripes.last_mut() {
            Some(last) if last.label == label && last.x == x => last.end = ys.len(),
            _ => stripes.push(Stripe { label, x, end: ys.len() }),
        }
    }
    let columns = Columns::F64 { y: ys, z: zs };
    let (labels, unit, missing_count) = (like.labels.clone(), like.unit, like.missing_count);
    Cloud { stripes, columns, labels, unit, blanks: Vec::new(), missing_count }
}

/// The cloud in the rail frame that `frame` declares, with no coordinate beyond `coordinate_max_mm`.
pub(super) fn move_into(cloud: &Cloud, frame: &Frame, coordinate_max_mm: f64) -> Result<Cloud, SliceError> {
    let rotation = frame.rotation()?;
    let origin = Vector3::from(frame.origin_mm);
    let moved = |x: f64, [y, z]: [f64; 2]| rotation * (Point3::new(x, y, z) - origin);
    let beyond = |value: &f64| !(0.0..=coordinate_max_mm).contains(&value.abs());
    for (index, (stripe, point)) in each_point(cloud).enumerate() {
        if let Some(&value) = moved(stripe.x, point).iter().find(|value| beyond(value)) {
            return Err(SliceError::CoordinateOutOfRange { index, value, limit: coordinate_max_mm });
        }
    }
    let points = each_point(cloud).map(|(stripe, point)| (stripe.label, moved(stripe.x, point).into()));
    let mut placed = collect(cloud, points);
    // If the file's x is parallel to the rail, planes remain planes of one x, including those without points.
    if rotation.m12 == 0.0 && rotation.m13 == 0.0 {
        placed.blanks = cloud.blanks.iter().map(|x| rotation.m11 * (x - origin.x)).collect();
    }
    Ok(placed)
}

/// The points of the cloud in a region.
pub(super) fn cut_to(cloud: &Cloud, region: &Region) -> Result<Cloud, SliceError> {
    let holds =
        |bound: Option<[f64; 2]>, value: f64| bound.is_none_or(|[lower, upper]| (lower..=upper).contains(&value));
    let inside = |x: f64, [y, z]: [f64; 2]| holds(region.x_mm, x) && holds(region.y_mm, y) && holds(region.z_mm, z);
    let kept = each_point(cloud).filter(|(stripe, point)| inside(stripe.x, *point));
    let mut cut = collect(cloud, kept.map(|(stripe, [y, z])| (stripe.label, [stripe.x, y, z])));
    if cut.columns.is_empty() {
        return Err(SliceError::RegionEmpty { points: cloud.columns.len() });
    }
    cut.blanks = cloud.blanks.iter().copied().filter(|x| holds(region.x_mm, *x)).collect();
    Ok(cut)
}
