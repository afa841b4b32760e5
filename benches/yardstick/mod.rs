//! Shared by the benchmarks: the large scan, the time of one summation of its coordinates as a reference, and medians.

#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]

use coaxis::scan::synthetic::{Part, make};
use coaxis::scan::{Columns, Scan};
use std::error::Error;
use std::hint::black_box;
use std::time::Instant;

pub(crate) const PROFILES_COUNT: usize = 5000;
pub(crate) const POINTS_COUNT: usize = 1280;

/// A part with screw holes, straight holes, clamps and spikes.
pub(crate) fn large_part() -> Part {
    Part {
        profiles_count: PROFILES_COUNT,
        points_count: POINTS_COUNT,
        // Stations an eighth of a millimetre apart, so that single precision represents them exactly.
        length_mm: (PROFILES_COUNT - 1) as f64 / 8.0,
        spike_ratio: 0.005,
        ..Part::with_interference(1)
    }
}

/// Its scan, in double precision.
pub(crate) fn large_scan() -> Result<Scan, Box<dyn Error>> {
    Ok(make(&large_part())?.0)
}

/// The scan as a sensor would store it: single precision.
pub(crate) fn narrowed(scan: &Scan) -> Result<Scan, Box<dyn Error>> {
    let narrow = |v: &Vec<f64>| v.iter().map(|&v| v as f32).collect();
    let columns = match scan.columns() {
        Columns::F64 { y, z } => Columns::F32 { y: narrow(y), z: narrow(z) },
        single => single.clone(),
    };
    let narrowed = Scan::new(scan.stations().to_vec(), columns, scan.rule().to_owned())?;
    let own_x = scan.stations().iter().filter_map(|station| scan.own_x(station)).flatten().copied();
    Ok(if scan.is_planar() { narrowed } else { narrowed.with_own_x(own_x.collect())? })
}

/// The reference: a simple loop that sums y and z in double precision, in their order, once.
pub(crate) fn sum(scan: &Scan) -> [f64; 2] {
    fn of<T: Copy + Into<f64>>(y: &[T], z: &[T]) -> [f64; 2] {
        y.iter().zip(z).fold([0.0; 2], |[sum_y, sum_z], (&y, &z)| [sum_y + y.into(), sum_z + z.into()])
    }
    match scan.columns() {
        Columns::F32 { y, z } => of(y, z),
        Columns::F64 { y, z } => of(y, z),
    }
}

/// Duration of some work in milliseconds.
pub(crate) fn timed<T>(work: impl FnOnce() -> T) -> f64 {
    let start = Instant::now();
    black_box(work());
    start.elapsed().as_secs_f64() * 1e3
}

/// The median.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}
