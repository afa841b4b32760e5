//! Synthetic scans for requests, exact or large.

use coaxis::geometry::AxisLine;
use coaxis::scan::decode::Format;
use coaxis::scan::encode::encode;
use coaxis::scan::synthetic::{Part, make, make_several};
use std::fmt::Write as _;
use std::io::Write as _;

/// Twelve profiles of sixty points on a cylinder of 200 mm radius, without noise, as CSV.
pub(crate) fn exact_csv() -> Vec<u8> {
    let axis = AxisLine { p: 0.01, q: -0.02, y0: 1.5, z0: -2.5 };
    encoded(
        &Part { axis, length_mm: 110.0, profiles_count: 12, points_count: 60, noise_sigma_mm: 0.0, ..Part::smooth(1) },
        Format::Csv,
    )
}

/// The same part from x = 0 to 110 mm and, from 200 to 310 mm, one of 150 mm radius with p = −0.02, q = 0.01, y0 = 7, z0 = −45.
pub(crate) fn two_parts_csv() -> Vec<u8> {
    let exact = Part { length_mm: 110.0, profiles_count: 12, points_count: 60, noise_sigma_mm: 0.0, ..Part::smooth(1) };
    let first = Part { axis: AxisLine { p: 0.01, q: -0.02, y0: 1.5, z0: -2.5 }, ..exact };
    let axis = AxisLine { p: -0.02, q: 0.01, y0: 7.0, z0: -45.0 };
    let second = Part { axis, radius_mm: 150.0, x_start_mm: 200.0, ..exact };
    let mut bytes = Vec::new();
    encode(&make_several(&[first, second]).expect("a scan").0, Format::Csv, &mut bytes).expect("written");
    bytes
}

/// A scan whose measurement takes a while: 400 profiles of 640 points, with interference.
pub(crate) fn large_npy() -> Vec<u8> {
    encoded(&Part::with_interference(3), Format::Npy)
}

/// The same bytes, compressed.
pub(crate) fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    packer.write_all(bytes).expect("packed");
    packer.finish().expect("packed")
}

/// A scan in this format.
pub(crate) fn encoded(part: &Part, format: Format) -> Vec<u8> {
    let (scan, _) = make(part).expect("a scan");
    let mut bytes = Vec::new();
    encode(&scan, format, &mut bytes).expect("written");
    bytes
}

/// A table of points with a profile column.
pub(crate) fn csv(points: impl IntoIterator<Item = (usize, [f64; 3])>) -> Vec<u8> {
    let mut text = "profile,x_mm,y_mm,z_mm\n".to_owned();
    for (profile, [x, y, z]) in points {
        writeln!(text, "{profile},{x},{y},{z}").expect("written");
    }
    text.into_bytes()
}
