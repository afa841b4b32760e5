//! From a scan to the bytes of a file, which decode to the same points, profile by profile.
//!
//! | format | layout |
//! |---|---|
//! | csv | `profile,x_mm,y_mm,z_mm`, shortest decimals that read back as the same number |
//! | gocator_csv | version 2, section RawProfile |
//! | json | `{"profiles": [{"x_mm": …, "points": [[y, z], …]}]}` |
//! | ply | binary little-endian, x y z |
//! | pcd | binary, a row per profile, padded with NaN |
//! | npy | (P, M, 3), padded with NaN |
//! | npz | x, y and z as (P, M), padded with NaN |
//!
//! Profiles without a point are written last, and only by the text formats: the others cannot store their x.
//!
//! The binary formats are written in single precision if the scan has it and its x are represented exactly. Those with a row per
//! profile grow with the longest one: a scan of very uneven profiles is better written as csv or ply.
//!
//! [`encode_cloud`] writes a cloud as binary PLY that reads back as the same cloud.

use super::cloud::{Cloud, Labels};
use super::columns::Columns;
use super::decode::Format;
use super::{Scan, Station};
use std::io::{self, Cursor, Write};
use zip::write::SimpleFileOptions;

/// Writes a scan.
///
/// # Errors
/// Those of `out`; of kind `InvalidInput` if the format has one x for all points of a profile and the scan does not.
pub fn encode(scan: &Scan, format: Format, out: &mut dyn Write) -> io::Result<()> {
    if matches!(format, Format::GocatorCsv | Format::Json) && !scan.is_planar() {
        let reason = "this format has one x for all points of a profile, and the points of this scan have an x of their own: write csv, ply, pcd, npy or npz";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
    }
    match format {
        Format::Csv => write_csv(scan, out),
        Format::GocatorCsv => write_gocator_csv(scan, out),
        Format::Json => write_json(scan, out),
        Format::Ply => write_ply(scan, out),
        Format::Pcd => write_pcd(scan, out),
        Format::Npy => write_npy(scan, out),
        Format::Npz => write_npz(scan, out),
    }
}

/// The most points of a profile.
fn longest(scan: &Scan) -> usize {
    scan.stations().iter().map(|station| station.end - station.start).max().unwrap_or(0)
}

/// Whether single precision represents every coordinate exactly.
fn is_single(scan: &Scan) -> bool {
    let exact = |x: f64| f64::from(x as f32) == x;
    let are_exact = |station: &Station| match scan.own_x(station) {
        Some(own_x) => own_x.iter().all(|x| exact(*x)),
        None => exact(station.x),
    };
    matches!(scan.columns(), Columns::F32 { .. }) && scan.stations().iter().all(are_exact)
}

/// One row per point.
pub(super) fn write_csv(scan: &Scan, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "profile,x_mm,y_mm,z_mm")?;
    for (profile, station) in scan.stations().iter().enumerate() {
        for [x, y, z] in scan.points_of(station) {
            writeln!(out, "{profile},{x:?},{y:?},{z:?}")?;
        }
    }
    let stations_count = scan.stations().len();
    scan.blanks().iter().enumerate().try_for_each(|(blank, x)| writeln!(out, "{},{x:?},,", stations_count + blank))
}

/// One object per profile.
pub(super) fn write_json(scan: &Scan, out: &mut dyn Write) -> io::Result<()> {
    write!(out, "{{\"profiles\":[")?;
    for (profile, station) in scan.stations().iter().enumerate() {
        let comma = if profile == 0 { "" } else { "," };
        write!(out, "{comma}\n{{\"x_mm\":{:?},\"points\":[", station.x)?;
        for (point, [_, y, z]) in scan.points_of(station).enumerate() {
            let comma = if point == 0 { "" } else { "," };
            write!(out, "{comma}[{y:?},{z:?}]")?;
        }
        write!(out, "]}}")?;
    }
    for x in scan.blanks() {
        write!(out, ",\n{{\"x_mm\":{x:?},\"points\":[]}}")?;
    }
    writeln!(out, "]}}")
}

/// Two rows per profile: the sensor's X is y, its Z is z, the frame's Y is x.
pub(super) fn write_gocator_csv(scan: &Scan, out: &mut dyn Write) -> io::Result<()> {
    let columns = longest(scan);
    writeln!(out, "Info\nCSV Version,Sensor Count\n2,1\nEnd\n")?;
    writeln!(out, "RawProfile\nFrame Count,Column Count\n{},{columns}\n", scan.stations().len() + scan.blanks().len())?;
    write!(out, "Frame,Source,Time,Encoder,Z Encoder,Inputs,Exposure,Y,Axis")?;
    (0..columns).try_for_each(|column| write!(out, ",{column}"))?;
    writeln!(out)?;
    for (frame, station) in scan.stations().iter().enumerate() {
        for (axis, name) in ["X", "Z"].into_iter().enumerate() {
            write!(out, "{frame},0,0,0,0,0,0,{:?},{name}", station.x)?;
            for [_, y, z] in scan.points_of(station) {
                write!(out, ",{:?}", if axis == 0 { y } else { z })?;
            }
            let filled = station.end - station.start;
            writeln!(out, "{}", ",".repeat(columns - filled))?;
        }
    }
    for (blank, x) in scan.blanks().iter().enumerate() {
        let frame = scan.stations().len() + blank;
        for name in ["X", "Z"] {
            writeln!(out, "{frame},0,0,0,0,0,0,{x:?},{name}{}", ",".repeat(columns))?;
        }
    }
    writeln!(out, "End")
}

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

/// Only vertices; if two profiles share an x, the boundary between them is lost.
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

/// The points of a profile, padded with NaN to `width`.
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

/// The header of an array, padded with blanks to a multiple of 64 bytes.
fn write_npy_header(shape: &str, float: Float, out: &mut dyn Write) -> io::Result<()> {
    let size = float.size();
    let mut header = format!("{{'descr': '<f{size}', 'fortran_order': False, 'shape': {shape}, }}");
    // Magic, version and length take ten bytes, the line end one.
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
    // The archive's directory refers back to the entries, so the archive is built in memory.
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

/// Writes a cloud in the order of its points. A reader gets the same points and the same profiles, and therefore the same
/// measurement; missing points are not written.
///
/// # Errors
/// Those of `out`.
pub fn encode_cloud(cloud: &Cloud, out: &mut dyn Write) -> io::Result<()> {
    let exact = |value: f64| f64::from(value as f32) == value;
    let single = matches!(cloud.columns, Columns::F32 { .. }) && cloud.stripes.iter().all(|stripe| exact(stripe.x));
    let kind = if single { "float" } else { "double" };
    let points_count = cloud.columns.len();
    write!(out, "ply\nformat binary_little_endian 1.0\ncomment unit: mm\nelement vertex {points_count}\n")?;
    ["x", "y", "z"].iter().try_for_each(|axis| writeln!(out, "property {kind} {axis}"))?;
    let labelled = match &cloud.labels {
        Labels::Column(name) => {
            writeln!(out, "property double {name}")?;
            true
        }
        Labels::None | Labels::Row => false,
    };
    writeln!(out, "end_header")?;
    let mut start = 0;
    for stripe in &cloud.stripes {
        for index in start..stripe.end {
            let Some([y, z]) = cloud.columns.get(index) else { return Ok(()) };
            match single {
                true => [stripe.x, y, z].iter().try_for_each(|value| out.write_all(&(*value as f32).to_le_bytes()))?,
                false => [stripe.x, y, z].iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))?,
            }
            if labelled {
                out.write_all(&stripe.label.to_le_bytes())?;
            }
        }
        start = stripe.end;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::{FormatClaims, Limits, Request, decode, find_format};
    use crate::scan::slice::{SliceRequest, slice};
    use proptest::prelude::*;

    fn written(scan: &Scan, format: Format) -> Vec<u8> {
        let mut bytes = Vec::new();
        encode(scan, format, &mut bytes).expect("writes to memory");
        bytes
    }

    /// Reads the bytes like an upload: the format is found from the bytes, and the rule is chosen.
    fn read(bytes: &[u8]) -> Scan {
        let limits = Limits::default();
        let format = find_format(&FormatClaims::default(), bytes).expect("known");
        let request = Request::new(&limits);
        let cloud = decode(format, &mut &*bytes, &request).expect("reads");
        slice(cloud, &SliceRequest::default(), &limits).expect("slices")
    }

    /// Profiles of eight to twelve points at increasing x, so that x alone separates them.
    fn any_scan() -> impl Strategy<Value = Scan> {
        let profile = |coordinate: BoxedStrategy<f64>| {
            (0.001..50.0f64, proptest::collection::vec([coordinate.clone(), coordinate], 8..12))
        };
        let coordinate = prop_oneof![(-1e6..1e6f64), Just(0.0), Just(-0.0), Just(1e-300), (-1.0..1.0f64)].boxed();
        (any::<bool>(), proptest::collection::vec(profile(coordinate), 1..8)).prop_map(|(single, profiles)| {
            let (mut stations, mut ys, mut zs): (Vec<Station>, Vec<f64>, Vec<f64>) = Default::default();
            for (step, points) in profiles {
                let start = ys.len();
                points.iter().for_each(|[y, z]| {
                    ys.push(*y);
                    zs.push(*z);
                });
                let x = stations.last().map_or(-100.0, |last| last.x) + step;
                stations.push(Station { x, start, end: ys.len() });
            }
            let narrow = |values: &[f64]| values.iter().map(|v| *v as f32).collect();
            let columns =
                if single { Columns::F32 { y: narrow(&ys), z: narrow(&zs) } } else { Columns::F64 { y: ys, z: zs } };
            Scan::new(stations, columns, "simulated".to_owned()).expect("a valid scan")
        })
    }

    fn all_points(scan: &Scan) -> Vec<(u64, Vec<[u64; 3]>)> {
        let bits = |station: &Station| scan.points_of(station).map(|point| point.map(f64::to_bits)).collect();
        scan.stations().iter().map(|station| (station.x.to_bits(), bits(station))).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn every_format_preserves_the_points(scan in any_scan()) {
            for format in Format::ALL {
                let back = read(&written(&scan, format));
                prop_assert_eq!(all_points(&back), all_points(&scan), "{}", format);
            }
        }
    }

    #[test]
    fn single_precision_is_kept_if_it_is_exact() {
        let columns = Columns::F32 { y: vec![0.1; 8], z: vec![0.2; 8] };
        let station = |x| vec![Station { x, start: 0, end: 8 }];
        let exact = Scan::new(station(0.5), columns.clone(), String::new()).expect("valid");
        let inexact = Scan::new(station(0.1), columns, String::new()).expect("valid");
        for format in [Format::Ply, Format::Pcd, Format::Npy, Format::Npz] {
            assert!(matches!(read(&written(&exact, format)).columns(), Columns::F32 { .. }), "{format}");
            assert!(matches!(read(&written(&inexact, format)).columns(), Columns::F64 { .. }), "{format}");
        }
    }

    #[test]
    fn the_text_formats_keep_profiles_without_a_point() {
        let columns = Columns::F64 { y: vec![0.1; 16], z: vec![0.2; 16] };
        let stations = vec![Station { x: 1.0, start: 0, end: 8 }, Station { x: 2.0, start: 8, end: 16 }];
        let scan = Scan::new(stations, columns, String::new()).expect("valid").with_blanks(vec![3.5, -1.0]);
        for format in [Format::Csv, Format::GocatorCsv, Format::Json] {
            let back = read(&written(&scan, format));
            assert_eq!((back.blanks(), all_points(&back)), (&[-1.0, 3.5][..], all_points(&scan)), "{format}");
        }
    }
}

#[cfg(test)]
mod cloud_tests {
    use super::*;
    use crate::scan::Stripe;
    use crate::scan::decode::Request;
    use crate::scan::decode::{Format, Limits, Unit, decode};

    #[test]
    fn a_cloud_is_decoded_unchanged() {
        let stripe = |label, x, end| Stripe { label, x, end };
        let mut cloud = Cloud {
            stripes: vec![stripe(3.0, 0.5, 2), stripe(4.0, 0.25, 3)],
            columns: Columns::F32 { y: vec![1.5, -2.25, 3.0], z: vec![0.1, 200.0, -7.0] },
            labels: Labels::Column("profile".to_owned()),
            unit: Unit::Millimetre,
            blanks: Vec::new(),
            missing_count: 0,
        };
        for x in [0.25, 0.1] {
            cloud.stripes[1].x = x;
            let mut bytes = Vec::new();
            encode_cloud(&cloud, &mut bytes).expect("writes to memory");
            let limits = Limits::default();
            let request = Request::new(&limits);
            let read = decode(Format::Ply, &mut &*bytes, &request).expect("it reads");
            assert_eq!((&read.stripes, &read.labels), (&cloud.stripes, &cloud.labels));
            let points = |cloud: &Cloud| (0..3).map(|index| cloud.columns.get(index)).collect::<Vec<_>>();
            assert_eq!(points(&read), points(&cloud));
        }
    }
}
