//! From a scan to the bytes of a file. What is written reads back as the same points, profile by profile.
//!
//! | format | layout |
//! |---|---|
//! | csv | `profile,x_mm,y_mm,z_mm`, shortest decimals that read back as the same number |
//! | gocator_csv | version 2, section RawProfile |
//! | json | `{"profiles": [{"x_mm": …, "points": [[y, z], …]}]}` |
//! | ply | binary little-endian, x y z |
//! | pcd | binary, a row per profile, filled up with NaN |
//! | npy | (P, M, 3), filled up with NaN |
//! | npz | x, y and z as (P, M), filled up with NaN |
//!
//! Profiles without a point are written last, by the text formats alone: the others have no place for their x.
//!
//! The binary formats hold single precision where the scan does and its x lose nothing by it. Those with a row per
//! profile grow with the longest one: a scan of very uneven profiles is better written as csv or ply.

mod binary;
mod cloud;
mod text;

pub use cloud::encode_cloud;

use super::columns::Columns;
use super::decode::Format;
use super::{Scan, Station};
use std::io::{self, Write};

/// Writes a scan.
///
/// # Errors
/// Those of `out`; of kind `InvalidInput` where the format has one x for all points of a profile and the scan has not.
pub fn encode(scan: &Scan, format: Format, out: &mut dyn Write) -> io::Result<()> {
    if matches!(format, Format::GocatorCsv | Format::Json) && !scan.is_planar() {
        let reason = "this format has one x for all points of a profile, and the points of this scan have an x of their own: write csv, ply, pcd, npy or npz";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
    }
    match format {
        Format::Csv => text::write_csv(scan, out),
        Format::GocatorCsv => text::write_gocator_csv(scan, out),
        Format::Json => text::write_json(scan, out),
        Format::Ply => binary::write_ply(scan, out),
        Format::Pcd => binary::write_pcd(scan, out),
        Format::Npy => binary::write_npy(scan, out),
        Format::Npz => binary::write_npz(scan, out),
    }
}

/// The most points of a profile.
fn longest(scan: &Scan) -> usize {
    scan.stations().iter().map(|station| station.end - station.start).max().unwrap_or(0)
}

/// Whether single precision holds every coordinate.
fn is_single(scan: &Scan) -> bool {
    let exact = |x: f64| f64::from(x as f32) == x;
    let are_exact = |station: &Station| match scan.own_x(station) {
        Some(own_x) => own_x.iter().all(|x| exact(*x)),
        None => exact(station.x),
    };
    matches!(scan.columns(), Columns::F32 { .. }) && scan.stations().iter().all(are_exact)
}

#[cfg(test)]
mod tests;
