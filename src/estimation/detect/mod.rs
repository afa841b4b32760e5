//! Finds the cylinders of an unorganised cloud: axes in any direction, among points of other surfaces.
//!
//! ```text
//! cloud --sample--> points --tree--> patches --patch--> surfaces --score, settle--> the best one --report--> Detected
//!                     ^                     (a plane, two cylinders)                     |
//!                     '------------------ search: without the points on it -------------'
//! ```
//!
//! A result is the start of the joint fit, not the measurement: it lies within a few standard deviations of the noise. The
//! draws come from fixed seeds, and the result does not depend on the number of threads.

mod patch;
mod sample;
mod score;
mod search;
mod settle;
mod surface;
#[cfg(test)]
mod tests;
mod tree;

use nalgebra::Vector3;
use sample::Sample;
use search::{Found, Wanted};
use settle::Radii;

/// What is looked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Request {
    /// The radius, where it is known; in the unit of the points.
    pub nominal_radius_mm: Option<f64>,
    /// How far the radius may be from the nominal one, relative to it.
    pub nominal_reach: f64,
    /// A direction, and the largest angle of an axis to it, rad.
    pub along: Option<([f64; 3], f64)>,
    /// The number of cylinders that are reported at most.
    pub most: usize,
}

impl Default for Request {
    fn default() -> Self {
        Self { nominal_radius_mm: None, nominal_reach: 0.02, along: None, most: 1 }
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
    /// Where its points begin and end along the direction, from `point`; 2 % of them may lie beyond.
    pub extent: [f64; 2],
    /// The arc that its points cover, rad.
    pub arc: f64,
    /// −ln of the bound of the probability that its points agree by chance.
    pub evidence: f64,
}

/// The cylinders of a cloud, the best supported first. Planes and bent planes are never among them.
#[must_use]
pub fn detect(points: &[[f64; 3]], request: &Request) -> Vec<Detected> {
    let Some(sample) = Sample::take(points) else { return Vec::new() };
    let nominal = |radius: f64| [1.0 - request.nominal_reach, 1.0 + request.nominal_reach].map(|v| v * radius);
    let [least, most] = request.nominal_radius_mm.map_or([0.0, f64::INFINITY], nominal).map(|v| v / sample.size);
    if !(least <= most && most > 0.0) {
        return Vec::new();
    }
    let along =
        request.along.and_then(|(direction, angle)| Some((Vector3::from(direction).try_normalize(0.0)?, angle.cos())));
    let wanted = Wanted { radii: Radii([least.max(0.0), most]), along, most: request.most };
    search::cylinders(&sample.points, &wanted).iter().map(|found| detected(found, &sample)).collect()
}

fn detected(found: &Found, sample: &Sample) -> Detected {
    let Found { cylinder, sigma, count, extent: [low, high], arc, evidence } = *found;
    let largest = cylinder.direction.get(cylinder.direction.iamax()).copied().unwrap_or(1.0);
    let sign = largest.signum();
    let extent = if sign < 0.0 { [-high, -low] } else { [low, high] };
    Detected {
        point: (sample.origin + cylinder.point * sample.size).into(),
        direction: (cylinder.direction * sign).into(),
        radius: cylinder.radius * sample.size,
        sigma: sigma * sample.size,
        share: count as f64 / sample.drawn_count.max(1) as f64,
        extent: extent.map(|along| along * sample.size),
        arc,
        evidence,
    }
}
