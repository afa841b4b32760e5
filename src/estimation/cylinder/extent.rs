//! How large and how rough a scan is: what bounds the search for a start. Must not know any cylinder.

use super::sample::{Sample, spread};
use crate::estimation::conclude::median;
use crate::estimation::robust;
use crate::scan::Scan;

/// Profiles that are looked at for the roughness.
const PROFILES_MAX: usize = 64;
/// Chords of a profile that are looked at.
const CHORDS_MAX: usize = 64;
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
pub(super) fn roughness(scan: &Scan) -> f64 {
    let columns = scan.columns();
    let mut squared = Vec::with_capacity(PROFILES_MAX * CHORDS_MAX);
    for station in spread(scan.stations().len(), PROFILES_MAX).filter_map(|index| scan.stations().get(index)) {
        let chords_count = (station.end - station.start).saturating_sub(2);
        for first in spread(chords_count, CHORDS_MAX).map(|place| station.start + place) {
            if let [Some([ay, az]), Some([by, bz]), Some([cy, cz])] = [0, 1, 2].map(|next| columns.get(first + next)) {
                let (dy, dz) = (cy - ay, cz - az);
                let area = (by - ay) * dz - (bz - az) * dy;
                let across2 = area * area / (dy * dy + dz * dz);
                squared.push(if across2.is_finite() { across2 / CHORD_VARIANCE } else { 0.0 });
            }
        }
    }
    robust::sigma(&squared, &mut Vec::new())
}
