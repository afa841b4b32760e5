//! Times of decoding a scan in each format and of estimating with each method, relative to the time of one summation of
//! the same coordinates on one thread. Prints a table; `cargo bench` runs it, `cargo bench --bench scan_to_pose --
//! cylinder` only the rows whose name contains the word.
//!
//! All times are measured in turns in one run and printed as the median ratio to the sum of the same round, because machines are
//! shared and noisy.

#![expect(clippy::print_stdout, reason = "a benchmark prints")]

mod yardstick;

use coaxis::estimation::{EndFaceRule, Method, Orientation, Progress, Settings, estimate};
use coaxis::scan::Scan;
use coaxis::scan::decode::{Format, Limits, Request, decode};
use coaxis::scan::encode::encode;
use coaxis::scan::slice::{SliceRequest, slice};
use coaxis::scan::synthetic::{Edge, Edges, LaserPlane, Part, make, placed, random_frame};
use std::error::Error;
use std::hint::black_box;
use yardstick::{POINTS_COUNT, PROFILES_COUNT, large_part, large_scan, median, narrowed, sum, timed};

const ROUNDS_COUNT: usize = 7;
/// Rounds for a scan that takes a twenty-fifth of the time.
const SHORT_ROUNDS_COUNT: usize = 101;

fn main() -> Result<(), Box<dyn Error>> {
    let double = large_scan()?;
    let single = narrowed(&double)?;
    println!("{PROFILES_COUNT} profiles x {POINTS_COUNT} points, {} threads", rayon::current_num_threads());
    println!("{:<34} {:>9} {:>9} {:>9} {:>9}", "", "MB", "ms", "sum ms", "ratio");
    for (format, scan, name) in [
        (Format::Ply, &single, "decode ply, binary f32"),
        (Format::Npy, &single, "decode npy, (P,M,3) f32"),
        (Format::Npy, &double, "decode npy, (P,M,3) f64"),
        (Format::Pcd, &single, "decode pcd, binary f32"),
        (Format::Npz, &single, "decode npz, deflated f32"),
        (Format::Csv, &single, "decode csv"),
        (Format::GocatorCsv, &single, "decode gocator_csv"),
        (Format::Json, &single, "decode json"),
    ] {
        if !asked_for(name) {
            continue;
        }
        let mut bytes = Vec::new();
        encode(scan, format, &mut bytes)?;
        let limits = Limits::default();
        report(name, bytes.len(), scan, ROUNDS_COUNT, || {
            let request = Request::new(&limits);
            let cloud = decode(format, &mut bytes.as_slice(), &request).ok();
            cloud
                .and_then(|cloud| slice(cloud, &SliceRequest::default(), &limits).ok())
                .map(|scan| scan.columns().len())
        });
    }
    for method in Method::ALL {
        let settings = Settings { method, ..Settings::default() };
        let name = format!("estimate {}", method.name());
        report(&name, 0, &single, ROUNDS_COUNT, || estimate(&single, &settings, &Progress::default()).profiles.len());
    }
    drop((single, double));
    // Every point has its own x; in the cloud no two successive points are neighbours.
    let tilted = Part { laser_plane: LaserPlane { about_y_deg: 3.0, about_z_deg: 0.0 }, ..large_part() };
    let million = Part { profiles_count: 1250, points_count: 800, spike_ratio: 0.005, ..Part::with_interference(1) };
    for (part, frame, name) in [
        (tilted, None, "estimate cylinder, tilted laser"),
        (million, Some(random_frame(1, 1000.0)), "estimate cylinder, shuffled cloud"),
    ] {
        if !asked_for(name) {
            continue;
        }
        let scan = make(&part)?.0;
        let scan = frame.map_or_else(|| narrowed(&scan), |frame| Ok(placed(&scan, &frame, Some(1))?))?;
        let orientation = frame.map_or(Orientation::Auto, |_| Orientation::Any);
        let settings = Settings { method: Method::Cylinder, orientation, ..Settings::default() };
        report(name, 0, &scan, ROUNDS_COUNT, || estimate(&scan, &settings, &Progress::default()).profiles.len());
    }
    // A short scan shows the time that does not depend on the size of the scan.
    let short = Part { spike_ratio: 0.005, ..Part::with_interference(1) };
    let edge = |x_mm| Some(Edge { x_mm, chamfer_mm: 0.0, ragged_ratio: 0.0, ragged_mm: 0.0, beyond: None });
    let ending = Part { edges: Edges { near: edge(41.0), far: edge(759.7) }, ..short };
    for (part, end_face, name) in [
        (short, EndFaceRule::None, "estimate cylinder, 400 x 640"),
        (ending, EndFaceRule::Both, "estimate cylinder and both ends"),
    ] {
        let scan = narrowed(&make(&part)?.0)?;
        let settings = Settings { method: Method::Cylinder, end_face, ..Settings::default() };
        report(name, 0, &scan, SHORT_ROUNDS_COUNT, || estimate(&scan, &settings, &Progress::default()).profiles.len());
    }
    Ok(())
}

/// Whether the command line names this row, or no row.
fn asked_for(name: &str) -> bool {
    let mut words = std::env::args().skip(1).filter(|word| !word.starts_with('-')).peekable();
    words.peek().is_none() || words.any(|word| name.contains(&word))
}

fn report<T>(name: &str, bytes_count: usize, scan: &Scan, rounds_count: usize, mut work: impl FnMut() -> T) {
    if !asked_for(name) {
        return;
    }
    let (mut works, mut sums, mut ratios) = (Vec::new(), Vec::new(), Vec::new());
    black_box(work());
    for _ in 0..rounds_count {
        let work_ms = timed(&mut work);
        let sum_ms = timed(|| sum(scan));
        works.push(work_ms);
        sums.push(sum_ms);
        ratios.push(work_ms / sum_ms);
    }
    let megabytes = bytes_count as f64 / 1e6;
    println!("{name:<34} {megabytes:>9.1} {:>9.2} {:>9.2} {:>9.2}", median(works), median(sums), median(ratios));
}
