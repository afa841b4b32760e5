//! One cylinder through all profiles at once: start by consensus, settle on a sample, solve on every point.

pub(super) mod consensus;
mod model;
mod sample;
mod settle;
mod solve;
mod step;
mod sums;

use crate::estimation::robust;
use crate::scan::Scan;
use consensus::Bounds;
pub use explore::explore;
use sample::Sample;
use settle::Settled;
use step::Hold;

mod explore {
    use super::*;
    pub fn explore(scan: &Scan) -> Option<([f64; 6], [f64; 5], f64)> {
        let sample = Sample::take(scan, |s| s.end - s.start >= 6, 128, 96);
        let size = size(&sample);
        let noise = roughness(scan);
        let tolerance = (4.0 * noise).max(0.002 * size).min(0.02 * size);
        let bounds = Bounds { slope_max: 0.27, radius_mm: [0.3 * size, 10.0 * size], tolerance };
        let starts = consensus::hypotheses(&sample, &bounds, 12);
        if std::env::var("DBG").is_ok() { println!("size {size} noise {noise} tol {tolerance} starts {:?}", starts.first()); }
        let mut settled: Vec<(f64, Settled)> = Vec::new();
        for s in &starts {
            if let Some(s) = settle::settle(&sample, s.cylinder, tolerance * 2.0, Hold::Free) {
                settled.push((0.0, s));
            }
        }
        let finest = settled.iter().map(|(_, s)| s.sigma).fold(f64::INFINITY, f64::min).max(noise);
        for (score, s) in &mut settled {
            *score = consensus::score_whole(&sample, &s.cylinder, 4.0 * finest);
        }
        settled.sort_by(|a, b| a.0.total_cmp(&b.0));
        if std::env::var("DBG").is_ok() { println!("settled {} {:?}", settled.len(), settled.first()); }
        let best = settled.first()?.1;
        let solution = solve::solve(scan, &vec![true; scan.stations().len()], &best, Hold::Free)?;
        let mid = solution.cylinder.about((scan.stations().first()?.x + scan.stations().last()?.x) / 2.0);
        Some(([mid.p, mid.q, mid.y_ref, mid.z_ref, mid.radius, mid.x_ref], solution.covariance.diagonal().map(|v| v.sqrt()).into(), solution.sigma))
    }
    fn size(sample: &Sample) -> f64 {
        let mut sizes: Vec<f64> = sample.stations.iter().map(|s| {
            let (y, z) = sample.points(s);
            let e = |v: &[f64]| v.iter().fold(f64::MIN, |a, b| a.max(*b)) - v.iter().fold(f64::MAX, |a, b| a.min(*b));
            e(y).hypot(e(z))
        }).collect();
        sizes.sort_by(f64::total_cmp);
        sizes[sizes.len() / 2]
    }
    fn roughness(scan: &Scan) -> f64 {
        let mut squared = Vec::new();
        let stride = (scan.stations().len() / 64).max(1);
        for s in scan.stations().iter().step_by(stride) {
            let at = |i: usize| scan.columns().get(i).unwrap_or_default();
            for i in s.start + 1..s.end - 1 {
                let (a, b, c) = (at(i - 1), at(i), at(i + 1));
                // distance of b from the chord a-c
                let (dy, dz) = (c[0] - a[0], c[1] - a[1]);
                let d = ((b[0] - a[0]) * dz - (b[1] - a[1]) * dy) / dy.hypot(dz).max(1e-12);
                squared.push(d * d / 1.5);
            }
        }
        robust::sigma(&squared, &mut Vec::new())
    }
}
