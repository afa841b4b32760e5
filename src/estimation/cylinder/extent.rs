//! How large and how rough a scan is: what bounds the search for a start. Must not know any cylinder.

use super::sample::Sample;
use crate::estimation::conclude::median;
use crate::estimation::robust;
use crate::scan::Scan;

/// Profiles that are looked at for the roughness.
const PROFILES_MAX: usize = 64;
/// Squared distance of a point from the chord of its neighbours, for points with unit noise across the chord: 1 + ¼ + ¼.
const CHORD_VARIANCE: f64 = 1.5;

/// Median over the profiles of the diagonal of their bounding boxes, mm.
pub(super) fn size(sample: &Sample) -> f64 {
    let span = |values: &[f64]| {
        let (low, high) =
            values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(*v), high.max(*v)));
        (high - low).max(0.0)
    };
    let diagonal = |station| {
        let (y, z) = sample.points(station);
        span(y).hypot(span(z))
    };
    median(sample.stations.iter().map(diagonal)).unwrap_or(0.0)
}

/// Robust spread of points about the chord of their neighbours in the file's order, mm.
///
/// The noise where profiles are in order; too large where they are shuffled, too small where the noise is correlated: good
/// enough to say what is near.
pub(in crate::estimation) fn roughness(scan: &Scan) -> f64 {
    let (mut y, mut z, mut squared) = (Vec::new(), Vec::new(), Vec::new());
    let stride = scan.stations().len().div_ceil(PROFILES_MAX).max(1);
    for station in scan.stations().iter().step_by(stride) {
        scan.load(*station, &mut y, &mut z);
        for (y, z) in y.windows(3).zip(z.windows(3)) {
            if let ([ay, by, cy], [az, bz, cz]) = (y, z) {
                let (dy, dz) = (cy - ay, cz - az);
                let across = ((by - ay) * dz - (bz - az) * dy) / dy.hypot(dz);
                squared.push(if across.is_finite() { across * across / CHORD_VARIANCE } else { 0.0 });
            }
        }
    }
    robust::sigma(&squared, &mut Vec::new())
}
