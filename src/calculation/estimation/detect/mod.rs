//! Finds the cylinders of an unorganised cloud: axes in any direction, among points of other surfaces.
//!
//! ```text
//! cloud --sample--> points --tree--> patches --patch--> surfaces --score, settle--> the best one --report--> Detected
//!                     ^                     (a plane, two cylinders)                     |
//!                     '------------------ search: without the points on it -------------'
//! ```
//!
//! A result is the start of the joint fit, not the measurement: it is accurate to a few standard deviations. The
//! draws come from fixed seeds, and the result does not depend on the number of threads.

mod sample;
mod search;
mod settle;
mod surface;
#[cfg(test)]
mod tests;

use super::settings::NOMINAL_REACH;
use nalgebra::Vector3;
use sample::Sample;
use search::{Found, Search};
use settle::Radii;

/// The request of a detection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Request {
    /// The radius, if it is known; in the unit of the points.
    pub nominal_radius_mm: Option<f64>,
    /// Largest deviation of the radius from the nominal one, relative to it.
    pub nominal_reach: f64,
    /// A direction, and the largest angle between it and an axis, rad.
    pub along: Option<([f64; 3], f64)>,
    /// The largest number of cylinders that are reported.
    pub most: usize,
}

impl Default for Request {
    fn default() -> Self {
        Self { nominal_radius_mm: None, nominal_reach: NOMINAL_REACH, along: None, most: 1 }
    }
}

/// A cylinder that was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detected {
    /// A point of the axis, at the median of the cylinder's points along it.
    pub point: [f64; 3],
    /// Unit vector along the axis; its largest component is positive.
    pub direction: [f64; 3],
    /// The radius.
    pub radius: f64,
    /// Robust standard deviation of the distances of its points.
    pub sigma: f64,
    /// Share of all points that lie within 4.685 sigma.
    pub share: f64,
    /// The interval of its points along the direction, from `point`; 2 % of them may lie outside.
    pub extent: [f64; 2],
    /// The arc of its points, rad.
    pub arc: f64,
    /// −ln of the bound of the probability that its points agree by chance.
    pub evidence: f64,
}

/// The cylinders of a cloud, the best supported first. Planes and bent planes are never reported.
#[must_use]
pub fn detect(points: &[[f64; 3]], request: &Request) -> Vec<Detected> {
    let point = |place: usize| points.get(place).copied();
    let detection = Detection::of(points.len(), point, request.nominal_radius_mm, request.nominal_reach);
    detection.map_or_else(Vec::new, |mut detection| detection.cylinders(request.along, request.most))
}

/// A detection that can be continued for more cylinders.
pub(super) struct Detection {
    search: Search,
    origin: Vector3<f64>,
    size: f64,
    drawn_count: usize,
}

impl Detection {
    /// For a cloud of `count` points, given by their positions; `None` if it has no extent, or no radius is allowed.
    pub(super) fn of(
        count: usize,
        point: impl Fn(usize) -> Option<[f64; 3]>,
        nominal_radius_mm: Option<f64>,
        nominal_reach: f64,
    ) -> Option<Self> {
        let Sample { points, origin, size, drawn_count } = Sample::take(count, point)?;
        let nominal = |radius: f64| [1.0 - nominal_reach, 1.0 + nominal_reach].map(|v| v * radius);
        let [least, most] = nominal_radius_mm.map_or([0.0, f64::INFINITY], nominal).map(|v| v / size);
        let radii = Radii([least.max(0.0), most]);
        let is_range = least <= most && most > 0.0;
        is_range.then(|| Self { search: Search::new(points, radii), origin, size, drawn_count })
    }

    /// At most this many cylinders, the best supported first; with a direction and the largest angle between it and an axis, rad.
    pub(super) fn cylinders(&mut self, along: Option<([f64; 3], f64)>, most: usize) -> Vec<Detected> {
        let along =
            along.and_then(|(direction, angle)| Some((Vector3::from(direction).try_normalize(0.0)?, angle.cos())));
        let is_along =
            |found: &Found| along.is_none_or(|(along, cos_min)| found.cylinder.direction.dot(&along).abs() >= cos_min);
        let found = self.search.cylinders(most, is_along);
        found.iter().map(|found| self.detected(found)).collect()
    }

    fn detected(&self, found: &Found) -> Detected {
        let Found { cylinder, sigma, count, extent: [low, high], arc, evidence } = *found;
        let largest = cylinder.direction.get(cylinder.direction.iamax()).copied().unwrap_or(1.0);
        let sign = largest.signum();
        let extent = if sign < 0.0 { [-high, -low] } else { [low, high] };
        Detected {
            point: (self.origin + cylinder.point * self.size).into(),
            direction: (cylinder.direction * sign).into(),
            radius: cylinder.radius * self.size,
            sigma: sigma * self.size,
            share: count as f64 / self.drawn_count.max(1) as f64,
            extent: extent.map(|along| along * self.size),
            arc,
            evidence,
        }
    }
}
