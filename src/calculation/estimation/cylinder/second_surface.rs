//! Signs that the fitted surface may not be the part. Another surface about the same axis lies below it: then the fit may be a
//! clamp or a sleeve around the part. Or the fit lies between two surfaces (a tube that is scanned from both sides, second
//! reflections of half of the points): then most points are off by about the same distance on either side, and few are near the
//! fit.

use super::model::Cylinder;
use super::sample::Sample;
use super::solve::Solution;
use crate::estimation::statistics;
use crate::scan::{Scan, Station};

/// Points of one surface lie within this many σ.
const THICKNESS: f64 = 4.0;
/// It has at least this share of the points (the bottoms of holes have less),
const SUPPORT_MIN: f64 = 0.12;
/// and is on at least this share of the profiles.
const COVERAGE_MIN: f64 = 0.3;
/// On each of them it has at least this share of the points, and the fit at least half of this.
const SHOWN_SHARE: f64 = 0.08;

/// A surface below the fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Beneath {
    /// Below the fit, mm.
    pub(super) depth: f64,
    /// Share of the profiles that show it.
    pub(super) coverage: f64,
}

/// The surface about the same axis that has the most points below the fit; `None` if none is large enough.
pub(super) fn beneath(sample: &Sample, cylinder: &Cylinder, sigma: f64) -> Option<Beneath> {
    let profiles: Vec<Vec<f64>> = sample.stations.iter().map(|station| depths(sample, station, cylinder)).collect();
    let reach = statistics::TUKEY_C * sigma;
    let mut below: Vec<f64> = profiles.iter().flatten().copied().filter(|depth| *depth > reach).collect();
    below.sort_unstable_by(f64::total_cmp);
    let thickness = THICKNESS * sigma;
    let held = |(index, first): (usize, &f64)| {
        (below.partition_point(|depth| *depth <= first + thickness).saturating_sub(index), *first)
    };
    let (count, first) = below.iter().enumerate().map(held).max_by_key(|(count, _)| *count)?;
    let shows = |profile: &[f64], [least, most]: [f64; 2]| {
        let within = profile.iter().filter(|depth| (least..=most).contains(*depth));
        within.count() as f64 >= SHOWN_SHARE * profile.len() as f64
    };
    let lower: Vec<&Vec<f64>> = profiles.iter().filter(|profile| shows(profile, [first, first + thickness])).collect();
    // Parts of different radii in a row share no profile.
    let both_count = lower.iter().filter(|profile| shows(profile, [-reach, reach])).count();
    let coverage = lower.len() as f64 / profiles.len() as f64;
    let enough = count as f64 >= SUPPORT_MIN * sample.len() as f64 && coverage >= COVERAGE_MIN;
    (enough && 2 * both_count >= lower.len()).then_some(Beneath { depth: first + 0.5 * thickness, coverage })
}

/// Depths of the sampled points of a profile below the fit, mm.
fn depths(sample: &Sample, station: &Station, cylinder: &Cylinder) -> Vec<f64> {
    let slice = cylinder.slice(station.x);
    sample.points(station).map(|[x, y, z]| -slice.at(x).distance(y, z)).collect()
}

/// Largest number of points that are examined.
const POINTS_MAX: usize = 32_768;
/// The points nearer than half a σ are compared with those nearer than two σ: a quarter for a uniform distribution and 40 % for a
/// normal one.
const NEAR: f64 = 0.5;
pub(super) const WITHIN: f64 = 2.0;
/// Standard deviations of the binomial count near the fit; chance exceeds them once in 3·10⁶.
const CERTAIN: f64 = 5.0;

/// The share of the points within two σ that are farther than half a σ, if it is larger than in a uniform distribution.
pub(super) fn share(scan: &Scan, solution: &Solution) -> Option<f64> {
    let step = scan.points().len().div_ceil(POINTS_MAX).max(1);
    let distance = |[x, y, z]: [f64; 3]| solution.cylinder.slice(x).distance(y, z).abs() / solution.sigma;
    let within: Vec<f64> = scan.every_nth_point(step).map(distance).filter(|distance| *distance < WITHIN).collect();
    let (count, near) = (within.len() as f64, within.iter().filter(|distance| **distance < NEAR).count() as f64);
    let even = NEAR / WITHIN;
    let is_hollow = near < even * count - CERTAIN * (even * (1.0 - even) * count).sqrt();
    is_hollow.then(|| 1.0 - near / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CYLINDER: Cylinder = Cylinder { x_ref: 0.0, p: 0.0, q: 0.0, y_ref: 0.0, z_ref: 0.0, radius: 10.0 };

    /// Ten profiles of twenty points, each at the depth below the cylinder that `depth` returns.
    fn sample(depth: impl Fn(usize, usize) -> f64) -> Sample {
        let mut sample = Sample::default();
        for profile in 0..10 {
            let place = |point: usize| {
                let (sin, cos) = (0.1 * point as f64 - 1.0).sin_cos();
                let reach = 10.0 - depth(profile, point);
                [profile as f64, reach * sin, reach * cos]
            };
            sample.push(profile as f64, (0..20).map(place));
        }
        sample
    }

    #[test]
    fn a_surface_below_the_fit_is_distinguished_from_parts_in_a_row_and_from_holes() {
        let sleeve = beneath(&sample(|_, point| if point < 6 { 1.0 } else { 0.0 }), &CYLINDER, 0.01);
        let Beneath { depth, coverage } = sleeve.expect("a surface beneath");
        assert!((depth - 1.0).abs() < 0.03 && coverage == 1.0, "{sleeve:?}");
        assert_eq!(beneath(&sample(|profile, _| if profile < 5 { 1.0 } else { 0.0 }), &CYLINDER, 0.01), None);
        assert_eq!(beneath(&sample(|_, point| if point < 6 { point as f64 } else { 0.0 }), &CYLINDER, 0.01), None);
        assert_eq!(beneath(&sample(|_, _| 0.0), &CYLINDER, 0.01), None);
    }
}
