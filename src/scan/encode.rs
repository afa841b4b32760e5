//! From a scan to the bytes of a file. What is written reads back as the same points, profile by profile.
//! Must not know where the bytes go.
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

use super::decode::Format;
use super::{Columns, Scan, Station};
use std::io::{self, Write};

/// Writes a scan.
///
/// # Errors
/// Those of `out`.
pub fn encode(scan: &Scan, format: Format, out: &mut dyn Write) -> io::Result<()> {
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

/// y and z of a profile's points.
fn points<'a>(scan: &'a Scan, station: &Station) -> impl Iterator<Item = [f64; 2]> + use<'a> {
    (station.start..station.end).filter_map(|index| scan.columns().get(index))
}

/// The most points of a profile.
fn longest(scan: &Scan) -> usize {
    scan.stations().iter().map(|station| station.end - station.start).max().unwrap_or(0)
}

/// Whether single precision holds every coordinate.
fn is_single(scan: &Scan) -> bool {
    let exact = |x: f64| f64::from(x as f32) == x;
    matches!(scan.columns(), Columns::F32 { .. }) && scan.stations().iter().all(|station| exact(station.x))
}

#[cfg(test)]
mod tests;
