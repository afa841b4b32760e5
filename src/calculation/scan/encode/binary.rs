//! The binary formats that a scan is written in.

use super::{is_single, longest};
use crate::scan::{Scan, Station};
use std::io::{self, Cursor, Write};
use zip::write::SimpleFileOptions;

/// The precision of a file: the names that the formats have for it, and its bytes.
#[derive(Clone, Copy)]
enum Float {
    Single,
    Double,
}

impl Float {
    fn of(scan: &Scan) -> Self {
        if is_single(scan) { Self::Single } else { Self::Double }
    }

    fn write(self, value: f64, out: &mut dyn Write) -> io::Result<()> {
        match self {
            Self::Single => out.write_all(&(value as f32).to_le_bytes()),
            Self::Double => out.write_all(&value.to_le_bytes()),
        }
    }

    fn size(self) -> usize {
        match self {
            Self::Single => 4,
            Self::Double => 8,
        }
    }
}

/// Vertices without more; where two profiles share an x, their border is lost.
pub(super) fn write_ply(scan: &Scan, out: &mut dyn Write) -> io::Result<()> {
    let float = Float::of(scan);
    let kind = match float {
        Float::Single => "float",
        Float::Double => "double",
    };
    write!(out, "ply\nformat binary_little_endian 1.0\ncomment unit: mm\nelement vertex {}\n", scan.points().len())?;
    ["x", "y", "z"].iter().try_for_each(|axis| writeln!(out, "property {kind} {axis}"))?;
    writeln!(out, "end_header")?;
    for station in scan.stations() {
        for point in scan.points_of(station) {
            point.iter().try_for_each(|value| float.write(*value, out))?;
        }
    }
    Ok(())
}

/// The points of a profile, filled up with NaN to `width`.
fn row(scan: &Scan, station: &Station, width: usize) -> impl Iterator<Item = [f64; 3]> {
    scan.points_of(station).chain(std::iter::repeat([f64::NAN; 3])).take(width)
}

fn write_rows(scan: &Scan, float: Float, out: &mut dyn Write) -> io::Result<()> {
    let width = longest(scan);
    for station in scan.stations() {
        for point in row(scan, station, width) {
            point.iter().try_for_each(|value| float.write(*value, out))?;
        }
    }
    Ok(())
}

/// An organised cloud.
pub(super) fn write_pcd(scan: &Scan, out: &mut dyn Write) -> io::Result<()> {
    let (float, width, height) = (Float::of(scan), longest(scan), scan.stations().len());
    let size = float.size();
    write!(out, "# .PCD v0.7 - Point Cloud Data file format\n# unit: mm\nVERSION 0.7\nFIELDS x y z\n")?;
    write!(out, "SIZE {size} {size} {size}\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {width}\nHEIGHT {height}\n")?;
    write!(out, "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {}\nDATA binary\n", width * height)?;
    write_rows(scan, float, out)
}

/// The header of an array, filled up with blanks to a multiple of 64 bytes.
fn write_npy_header(shape: &str, float: Float, out: &mut dyn Write) -> io::Result<()> {
    let size = float.size();
    let mut header = format!("{{'descr': '<f{size}', 'fortran_order': False, 'shape': {shape}, }}");
    // Magic, version and length take ten bytes, the line's end one.
    let blanks = 63 - (header.len() + 10) % 64;
    header.push_str(&" ".repeat(blanks));
    header.push('\n');
    let length = u16::try_from(header.len()).map_err(io::Error::other)?;
    out.write_all(b"\x93NUMPY\x01\x00")?;
    out.write_all(&length.to_le_bytes())?;
    out.write_all(header.as_bytes())
}

/// One array.
pub(super) fn write_npy(scan: &Scan, out: &mut dyn Write) -> io::Result<()> {
    let float = Float::of(scan);
    write_npy_header(&format!("({}, {}, 3)", scan.stations().len(), longest(scan)), float, out)?;
    write_rows(scan, float, out)
}

/// One array per axis.
pub(super) fn write_npz(scan: &Scan, out: &mut dyn Write) -> io::Result<()> {
    let (float, width) = (Float::of(scan), longest(scan));
    let shape = format!("({}, {width})", scan.stations().len());
    // The archive's directory points back into it, so it is put together in memory.
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (axis, name) in ["x.npy", "y.npy", "z.npy"].into_iter().enumerate() {
        archive.start_file(name, SimpleFileOptions::default().large_file(true))?;
        write_npy_header(&shape, float, &mut archive)?;
        for station in scan.stations() {
            for point in row(scan, station, width) {
                float.write(point.get(axis).copied().unwrap_or(f64::NAN), &mut archive)?;
            }
        }
    }
    out.write_all(archive.finish()?.get_ref())
}
