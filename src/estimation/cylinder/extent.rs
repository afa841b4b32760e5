//! How large and how rough a scan is: what bounds the search for a start. Must not know any cylinder.

use super::sample::Sample;
use crate::estimation::conclude::median;
use crate::estimation::robust;
use crate::scan::Scan;

/// Profiles that are looked at for the roughness.
const PROFILES_MAX: usize = 64;
/// Variance of the difference of two neighbouring sagittas, b − ½(a + c), for points with unit noise across the chord:
/// ¼ + 9/4 + 9/4 + ¼.
const SAGITTA_VARIANCE: f64 = 5.0;

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

/// Robust spread of points about the curve through their neighbours in the file's order, mm.
///
/// How far a point lies from the chord of its neighbours is curvature as well as noise; how much that changes to the next
/// point is noise alone. Too large where profiles are shuffled, too small where the noise is correlated: good enough to say
/// what is near.
pub(super) fn roughness(scan: &Scan) -> f64 {
    let (mut y, mut z, mut squared) = (Vec::new(), Vec::new(), Vec::new());
    let stride = scan.stations().len().div_ceil(PROFILES_MAX).max(1);
    for station in scan.stations().iter().step_by(stride) {
        scan.load(*station, &mut y, &mut z);
        let mut last = None;
        for (y, z) in y.windows(3).zip(z.windows(3)) {
            let now = sagitta(y, z);
            squared.extend(last.zip(now).map(|(last, now): (f64, f64)| (now - last).powi(2) / SAGITTA_VARIANCE));
            last = now;
        }
    }
    robust::sigma(&squared, &mut Vec::new())
}

/// How far the middle of three points lies left of the chord of the outer ones; `None` where those are one.
fn sagitta(y: &[f64], z: &[f64]) -> Option<f64> {
    let ([ay, by, cy], [az, bz, cz]) = (y, z) else { return None };
    let (dy, dz) = (cy - ay, cz - az);
    let across = ((by - ay) * dz - (bz - az) * dy) / dy.hypot(dz);
    across.is_finite().then_some(across)
}
