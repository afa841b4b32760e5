//! Another surface about the same axis beneath the one that was fitted: then that may be a clamp or a sleeve that follows the
//! part, and what shows beside it the part. In: the sample and the fit. Out: how deep it lies and on how many profiles.

use super::model::Cylinder;
use super::sample::Sample;
use crate::estimation::robust;
use crate::scan::Station;

/// Points of one surface lie within this many σ.
const THICKNESS: f64 = 4.0;
/// It holds this share of the points at least; the bottoms of holes hold less,
const SUPPORT_MIN: f64 = 0.12;
/// and is on this share of the profiles,
const COVERAGE_MIN: f64 = 0.3;
/// on each with this share of its points, and the fit on half of these.
const SHOWN_SHARE: f64 = 0.08;

/// A surface beneath.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Beneath {
    /// Below the fit, mm.
    pub(super) depth: f64,
    /// Share of the profiles that show it.
    pub(super) coverage: f64,
}

/// The surface about the same axis that holds the most points below the fit; `None` where none is large enough.
pub(super) fn beneath(sample: &Sample, cylinder: &Cylinder, sigma: f64) -> Option<Beneath> {
    let profiles: Vec<Vec<f64>> = sample.stations.iter().map(|station| depths(sample, station, cylinder)).collect();
    let reach = robust::TUKEY_C * sigma;
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
    // Parts of different radii, one after the other, share no profile.
    let both_count = lower.iter().filter(|profile| shows(profile, [-reach, reach])).count();
    let coverage = lower.len() as f64 / profiles.len() as f64;
    let enough = count as f64 >= SUPPORT_MIN * sample.len() as f64 && coverage >= COVERAGE_MIN;
    (enough && 2 * both_count >= lower.len()).then_some(Beneath { depth: first + 0.5 * thickness, coverage })
}

/// How far the sampled points of a profile lie below the fit, mm.
fn depths(sample: &Sample, station: &Station, cylinder: &Cylinder) -> Vec<f64> {
    let slice = cylinder.slice(station.x);
    sample.points(station).map(|[x, y, z]| -slice.at(x).distance(y, z)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const CYLINDER: Cylinder = Cylinder { x_ref: 0.0, p: 0.0, q: 0.0, y_ref: 0.0, z_ref: 0.0, radius: 10.0 };

    /// Ten profiles of twenty points, each as far below the cylinder as said.
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
    fn a_surface_beside_the_fit_and_below_it_is_told_from_parts_in_a_row_and_from_holes() {
        let sleeve = beneath(&sample(|_, point| if point < 6 { 1.0 } else { 0.0 }), &CYLINDER, 0.01);
        let Beneath { depth, coverage } = sleeve.expect("a surface beneath");
        assert!((depth - 1.0).abs() < 0.03 && coverage == 1.0, "{sleeve:?}");
        assert_eq!(beneath(&sample(|profile, _| if profile < 5 { 1.0 } else { 0.0 }), &CYLINDER, 0.01), None);
        assert_eq!(beneath(&sample(|_, point| if point < 6 { point as f64 } else { 0.0 }), &CYLINDER, 0.01), None);
        assert_eq!(beneath(&sample(|_, _| 0.0), &CYLINDER, 0.01), None);
    }
}
