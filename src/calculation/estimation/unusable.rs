//! Scans that no method can make anything of, told by their points alone.

use super::refusal::Refusal;
use super::settings::Settings;
use crate::scan::Scan;

/// A section whose arc stays below this is a straight line for every purpose.
const STRAIGHT_DEG: f64 = 0.5;

/// The refusal, the most telling first.
pub(super) fn unusable(scan: &Scan, settings: &Settings) -> Option<Refusal> {
    let profiles_count = scan.stations().len();
    if identical(scan) {
        return Some(Refusal::PointsIdentical { points_count: scan.points().len() });
    }
    if profiles_count < settings.profiles_min as usize {
        return Some(Refusal::TooFewProfiles { profiles_count, profiles_min: settings.profiles_min });
    }
    if scan.is_planar() && scan.stations().first().map(|s| s.x) == scan.stations().last().map(|s| s.x) {
        return Some(Refusal::TravelMissing { profiles_count });
    }
    collinear(scan).then_some(Refusal::PointsCollinear { profiles_count })
}

fn identical(scan: &Scan) -> bool {
    let first = scan.columns().get(scan.points().start);
    scan.is_planar() && scan.points().all(|index| scan.columns().get(index) == first)
}

/// Whether every profile of the scan is straight to within rounding of its own size.
fn collinear(scan: &Scan) -> bool {
    let (mut y, mut z) = (Vec::new(), Vec::new());
    scan.stations().iter().all(|station| {
        scan.load(*station, &mut y, &mut z);
        // Two points are always on a line, which says nothing.
        y.len() > 2 && straight(&y, &z)
    })
}

fn straight(y: &[f64], z: &[f64]) -> bool {
    let count = y.len() as f64;
    let (mean_y, mean_z) = (y.iter().sum::<f64>() / count, z.iter().sum::<f64>() / count);
    let (mut yy, mut yz, mut zz) = (0.0, 0.0, 0.0);
    for (y, z) in y.iter().zip(z) {
        let (y, z) = (y - mean_y, z - mean_z);
        (yy, yz, zz) = (yy + y * y, yz + y * z, zz + z * z);
    }
    let (mean, spread) = (0.5 * (yy + zz), 0.5 * (yy - zz).hypot(2.0 * yz));
    // Along the chord an arc of angle φ has the variance R²φ²/12, across it R²φ⁴/720: their ratio is φ²/60.
    mean - spread <= (mean + spread) * STRAIGHT_DEG.to_radians().powi(2) / 60.0
}
