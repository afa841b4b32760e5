//! How large and how rough a scan is: what bounds the search for a start.

use super::sample::{Sample, spread};
use crate::estimation::conclude::median;
use crate::estimation::robust;
use crate::scan::Scan;

/// Profiles that are looked at for the roughness.
const PROFILES_MAX: usize = 64;
/// Runs of four neighbouring points of a profile that are looked at.
const RUNS_MAX: usize = 64;
/// Variance of the difference of two neighbouring sagittas, b − ½(a + c), for points with unit noise across the chord:
/// ¼ + 9/4 + 9/4 + ¼.
const SAGITTA_VARIANCE: f64 = 5.0;

/// Median over the profiles of the diagonal of their bounding boxes, mm.
pub(super) fn size(sample: &Sample) -> f64 {
    let span = |values: &mut dyn Iterator<Item = f64>| {
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        (high - low).max(0.0)
    };
    let diagonal = |station| {
        let points = || sample.points(station);
        span(&mut points().map(|[_, y, _]| y)).hypot(span(&mut points().map(|[_, _, z]| z)))
    };
    median(sample.stations.iter().map(diagonal)).unwrap_or(0.0)
}

/// Robust spread of points about the curve through their neighbours in the file's order, mm.
///
/// How far a point lies from the chord of its neighbours is curvature as well as noise; how much that changes to the next
/// point is noise alone. Too large where profiles are shuffled, too small where the noise is correlated: good enough to say
/// what is near.
pub(in crate::estimation) fn roughness(scan: &Scan) -> f64 {
    let columns = scan.columns();
    let mut squared = Vec::with_capacity(PROFILES_MAX * RUNS_MAX);
    for station in spread(scan.stations().len(), PROFILES_MAX).filter_map(|index| scan.stations().get(index)) {
        let runs_count = (station.end - station.start).saturating_sub(3);
        for first in spread(runs_count, RUNS_MAX).map(|place| station.start + place) {
            if let [Some(a), Some(b), Some(c), Some(d)] = [0, 1, 2, 3].map(|next| columns.get(first + next)) {
                let change = sagitta(b, c, d) - sagitta(a, b, c);
                squared.push(if change.is_finite() { change * change / SAGITTA_VARIANCE } else { 0.0 });
            }
        }
    }
    robust::sigma(&squared, &mut Vec::new())
}

/// How far the middle of three points lies left of the chord of the outer ones, mm.
fn sagitta([ay, az]: [f64; 2], [by, bz]: [f64; 2], [cy, cz]: [f64; 2]) -> f64 {
    let (dy, dz) = (cy - ay, cz - az);
    ((by - ay) * dz - (bz - az) * dy) / (dy * dy + dz * dz).sqrt()
}
