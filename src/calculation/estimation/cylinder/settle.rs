//! From a rough cylinder to the nearest robust fit of a sample: iteratively re-weighted least squares whose window shrinks from
//! coarse to fine, so that the surface with most points near the start wins over what lies beside it.

use super::kernel::Curvature;
use super::model::Cylinder;
use super::projection::ANY_DIRECTION;
use super::sample::Sample;
use super::step::{self, Hold};
use super::sums::Sums;
use crate::estimation::robust;

/// A cylinder that the points of a sample agree on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Settled {
    pub(super) cylinder: Cylinder,
    /// Robust standard deviation of the points on it, mm.
    pub(super) sigma: f64,
}

const ROUNDS_MAX: usize = 60;
/// The window never shrinks faster than this in one round, so that the fit can follow.
const SHRINK: f64 = 0.5;
/// A spread below this share of the radius is rounding.
const SPREAD_FLOOR: f64 = 1e-11;

/// Settles from `start`, first looking at points within `window` mm of it.
pub(super) fn settle(sample: &Sample, start: Cylinder, window: f64, hold: Hold) -> Option<Settled> {
    let (mut cylinder, mut window) = (start, window);
    let mut sigma = window / robust::TUKEY_C;
    let (mut squared, mut scratch) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS_MAX {
        let sums = total(sample, &cylinder, window);
        let (normal, gradient) = step::system(&sums, hold, sigma, cylinder.radius);
        let step = step::solve(&normal, &gradient)?;
        cylinder = cylinder.moved(&step)?;
        squared_distances_within(sample, &cylinder, window, &mut squared);
        sigma = robust::sigma(&squared, &mut scratch).max(SPREAD_FLOOR * cylinder.radius).max(sample.resolution());
        let narrowed = (robust::TUKEY_C * sigma).clamp(window * SHRINK, window);
        // The step in units of its own standard deviation.
        let moved = (normal * step).dot(&step).abs().sqrt();
        let settled = moved < 1e-3 * sigma && narrowed > window * 0.999;
        window = narrowed;
        if settled {
            break;
        }
    }
    Some(Settled { cylinder, sigma })
}

/// Sums over the points of a sample within `window` mm of the cylinder.
pub(super) fn total(sample: &Sample, cylinder: &Cylinder, window: f64) -> Sums {
    let view = cylinder.facing(ANY_DIRECTION);
    let mut sums = Sums::zero();
    for station in &sample.stations {
        sums.add(&sample.profile(station).sums(&view, window * window, Curvature::Weight));
    }
    view.unturned(&sums)
}

fn squared_distances_within(sample: &Sample, cylinder: &Cylinder, window: f64, squared: &mut Vec<f64>) {
    squared.clear();
    let view = cylinder.facing(ANY_DIRECTION);
    for station in &sample.stations {
        sample.profile(station).squared_distances(&view, |found| {
            squared.extend(found.iter().filter(|d2| **d2 < window * window));
        });
    }
}
