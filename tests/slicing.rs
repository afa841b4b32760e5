//! The slicing of a cloud and the order of its points do not matter: clouds sliced at half, one and two times a pitch,
//! and shuffled, give the same verdict and poses within one standard uncertainty of each other.
//!
//! Every second point has a different draw of the noise: its pose differs from that of all points by √(2σ² − σ²), i.e. by 0.71 of
//! its own standard uncertainty, and is compared with the expanded one.

#![expect(clippy::expect_used, clippy::indexing_slicing, clippy::print_stdout, reason = "a test may fail")]

use crate::made::count;
use crate::measured::{apart, pose};
use coaxis::estimation::{Estimate, Orientation, Progress, Settings, estimate};
use coaxis::geometry::AxisLine;
use coaxis::scan::decode::{Limits, Unit};
use coaxis::scan::slice::{SliceRequest, slice};
use coaxis::scan::synthetic::{Interference, Part, make};
use coaxis::scan::{Cloud, Columns, Labels, ProfileRule, Stripe};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Cases in continuous integration.
const CASES: u64 = 20;
/// Share of the cases that have to agree.
const AGREEING: f64 = 0.98;

fn cloud_of(points: &[[f64; 3]]) -> Cloud {
    let columns =
        Columns::F64 { y: points.iter().map(|[_, y, _]| *y).collect(), z: points.iter().map(|[.., z]| *z).collect() };
    let stripes = points.iter().enumerate().map(|(i, [x, ..])| Stripe { label: 0.0, x: *x, end: i + 1 }).collect();
    let (labels, unit) = (Labels::None, Unit::Millimetre);
    Cloud { stripes, columns, labels, unit, blanks: Vec::new(), missing_count: 0 }
}

/// A cloud of a part along X: every point has its own x.
fn points(seed: u64) -> (Vec<[f64; 3]>, f64) {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let radius_mm = chance.random_range(20.0..200.0);
    let slope = |chance: &mut ChaCha8Rng| chance.random_range(-8.0..8.0_f64).to_radians().tan();
    let part = Part {
        radius_mm,
        axis: AxisLine { p: slope(&mut chance), q: slope(&mut chance), y0: 10.0, z0: -20.0 },
        length_mm: radius_mm * chance.random_range(1.0..6.0),
        profiles_count: 120,
        points_count: 80,
        arc_deg: chance.random_range(90.0..170.0),
        noise_sigma_mm: 0.001 * radius_mm,
        interference: if seed.is_multiple_of(2) { Interference::NONE } else { Interference::default() },
        ..Part::smooth(seed)
    };
    let (scan, _) = make(&part).expect("a part");
    let spacing = part.length_mm / 119.0;
    let line = part.axis;
    let mut points = Vec::new();
    for station in scan.stations() {
        for [x, y, z] in scan.points_of(station) {
            // Moved along the axis, because the points of a cloud have arbitrary positions along the part.
            let by = chance.random_range(-0.5..0.5) * spacing;
            points.push([x + by, y + line.p * by, z + line.q * by]);
        }
    }
    (points, spacing)
}

fn estimated(points: &[[f64; 3]], pitch: Option<f64>) -> Estimate {
    let request = SliceRequest { rule: pitch.map(|pitch| ProfileRule::XPitch(Some(pitch))), ..SliceRequest::default() };
    let scan = slice(cloud_of(points), &request, &Limits::default()).expect("profiles");
    let settings = Settings { orientation: Orientation::Rail, ..Settings::default() };
    estimate(&scan, &settings, &Progress::default())
}

fn agrees(seed: u64) -> bool {
    let (points, spacing) = points(seed);
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let mut shuffled = points.clone();
    shuffled.shuffle(&mut chance);
    let thinned: Vec<[f64; 3]> = points.iter().copied().step_by(2).collect();
    let pitch = spacing * chance.random_range(1.0..4.0);
    let estimates = [
        estimated(&points, None),
        estimated(&shuffled, None),
        estimated(&thinned, None),
        estimated(&points, Some(0.5 * pitch)),
        estimated(&points, Some(pitch)),
        estimated(&points, Some(2.0 * pitch)),
        estimated(&shuffled, Some(pitch)),
    ];
    // The third estimate uses every second point.
    let most = [1.0, 1.0, 2.0, 1.0, 1.0, 1.0, 1.0];
    let poses: Vec<_> = estimates.iter().filter_map(pose).collect();
    if poses.is_empty() {
        return true;
    }
    if poses.len() < estimates.len() {
        println!("case {seed}: {} of {} accepted", poses.len(), estimates.len());
        return false;
    }
    let first = poses[0];
    for (other, most) in poses.iter().zip(most) {
        let [angle, distance] = apart(&other.axis_in_scan(), &first.axis_in_scan());
        let [direction, position] = other.axis_standard();
        let radius = (other.radius - first.radius).abs() / other.uncertainty.covariance[4][4].sqrt();
        let off = [angle / direction, distance / position, radius];
        if off.iter().any(|off| *off > most) {
            println!("case {seed}: {off:.2?} standard uncertainties apart");
            return false;
        }
    }
    true
}

#[test]
fn slicing_order_and_thinning_do_not_matter() {
    let cases = count("COAXIS_CASES", CASES);
    let agreeing = (0..cases).into_par_iter().filter(|seed| agrees(*seed)).count();
    println!("{agreeing} of {cases} cases agree");
    assert!(agreeing as f64 >= AGREEING * cases as f64 - 0.5, "{agreeing} of {cases}");
}
