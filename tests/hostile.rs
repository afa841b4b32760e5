//! Arbitrary bytes: seeded mutations of valid files never cause a panic or an abort between format detection and profiles. With
//! `COAXIS_MUTATIONS=80000`, as in `tests/run long`, there are a million of them. Each decoder runs in a child process with little
//! address space, because running out of memory aborts, which no test can catch within its own process.

#![expect(
    clippy::expect_used,
    clippy::indexing_slicing,
    clippy::print_stdout,
    reason = "a panic fails the test as intended"
)]

use crate::made::count;
use coaxis::scan::decode::{Encoding, Format, FormatClaims, Limits, Request, Sent, decode, find_format, inflate};
use coaxis::scan::encode::encode;
use coaxis::scan::slice::{SliceRequest, slice};
use coaxis::scan::{Columns, Scan, Station};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::io::{BufRead, Write};
use std::process::Command;

/// Mutations per file in continuous integration.
const MUTATIONS: u64 = 10_000;
/// Most mutations change bytes before this offset: headers.
const HEAD: usize = 700;
const ADDRESS_SPACE_KIB: u64 = 768 * 1024;
/// Set in the child; the test then does the work instead of starting a child.
const CHILD: &str = "COAXIS_HOSTILE_CHILD";

fn small_limits() -> Limits {
    Limits { points_max: 1_000_000, inflated_bytes_max: 64 << 20, ..Limits::default() }
}

/// Ten profiles of 24 points, in single precision.
fn small_scan() -> Scan {
    let station = |i: usize| Station { x: i as f64 * 0.5, start: i * 24, end: (i + 1) * 24 };
    let value = |i: usize| i as f32 * 0.25 - 30.0;
    let columns = Columns::F32 { y: (0..240).map(value).collect(), z: (0..240).map(|i| value(i % 24)).collect() };
    Scan::new((0..10).map(station).collect(), columns, "made".to_owned()).expect("valid")
}

fn encoded(format: Format) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode(&small_scan(), format, &mut bytes).expect("memory takes everything");
    bytes
}

/// x, y, z of every point of the small scan.
fn points() -> Vec<[f32; 3]> {
    let scan = small_scan();
    let of = |station: &Station| {
        let x = station.x;
        let range = station.start..station.end;
        range.map(|i| scan.columns().get(i).map(|[y, z]| [x as f32, y as f32, z as f32])).collect::<Option<Vec<_>>>()
    };
    scan.stations().iter().map(of).collect::<Option<Vec<_>>>().expect("all there").concat()
}

/// The small scan as a table without a header whose first column contains point names, some of them only numbers.
fn csv_named() -> Vec<u8> {
    let name = |i: usize| if i.is_multiple_of(3) { format!("{i}") } else { format!("p{i}") };
    let rows = points().into_iter().enumerate();
    rows.map(|(i, [x, y, z])| format!("{},{x},{y},{z},\n", name(i + 1))).collect::<String>().into_bytes()
}

fn ply(encoding: &str, body: &[u8]) -> Vec<u8> {
    let header = format!(
        "ply\nformat {encoding} 1.0\ncomment unit: mm\nelement camera 1\nproperty list uchar short pixels\n\
         element vertex 240\nproperty float x\nproperty uchar red\nproperty float y\nproperty float z\nend_header\n"
    );
    [header.as_bytes(), body].concat()
}

fn ply_ascii() -> Vec<u8> {
    let rows: String = points().iter().map(|[x, y, z]| format!("{x} 7 {y} {z}\n")).collect();
    ply("ascii", format!("2 1 1\n{rows}").as_bytes())
}

fn ply_big_endian() -> Vec<u8> {
    let mut body = vec![2, 0, 1, 0, 1];
    for [x, y, z] in points() {
        body.extend(x.to_be_bytes());
        body.push(7);
        body.extend(y.to_be_bytes());
        body.extend(z.to_be_bytes());
    }
    ply("binary_big_endian", &body)
}

fn pcd(data: &str, body: &[u8]) -> Vec<u8> {
    let header = format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z normal\nSIZE 4 4 4 2\nTYPE F F F I\n\
         COUNT 1 1 1 2\nWIDTH 24\nHEIGHT 10\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 240\nDATA {data}\n"
    );
    [header.as_bytes(), body].concat()
}

fn pcd_ascii() -> Vec<u8> {
    let rows: String = points().iter().map(|[x, y, z]| format!("{x} {y} {z} 1 2\n")).collect();
    pcd("ascii", rows.as_bytes())
}

/// Each field after the other; literals of up to 32 bytes, and copies where four bytes repeat.
fn pcd_compressed() -> Vec<u8> {
    let points = points();
    let mut plain: Vec<u8> = (0..3).flat_map(|axis| points.iter().flat_map(move |p| p[axis].to_le_bytes())).collect();
    plain.extend([1, 0, 2, 0].repeat(points.len()));
    let mut packed = Vec::new();
    let mut at = 0;
    while at < plain.len() {
        let repeats = (at >= 4).then(|| (at..plain.len()).take_while(|i| plain[*i] == plain[*i - 4]).count().min(264));
        match repeats {
            Some(length @ 9..) => {
                packed.extend([7 << 5, u8::try_from(length - 9).expect("at most 255"), 3]);
                at += length;
            }
            _ => {
                let length = (plain.len() - at).min(4);
                packed.push(u8::try_from(length - 1).expect("at most 3"));
                packed.extend(&plain[at..at + length]);
                at += length;
            }
        }
    }
    let size = |bytes: &[u8]| u32::try_from(bytes.len()).expect("small").to_le_bytes();
    pcd("binary_compressed", &[&size(&packed)[..], &size(&plain), &packed].concat())
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(bytes).expect("memory takes everything");
    encoder.finish().expect("memory takes everything")
}

/// The complete processing of an upload; the result is the number of profiles or a reason.
fn take_in(bytes: &[u8], declared: Option<Format>) -> Result<usize, String> {
    let limits = small_limits();
    let claims = FormatClaims { parameter: declared, ..FormatClaims::default() };
    let mut reader: Box<dyn BufRead + '_> = match Encoding::sniff(bytes) {
        Some(encoding) => {
            Box::new(inflate(encoding, bytes, &limits, &Sent::default()).map_err(|error| error.to_string())?)
        }
        None => Box::new(bytes),
    };
    let format = {
        let head = reader.fill_buf().map_err(|error| error.to_string())?;
        find_format(&claims, head.get(..512).unwrap_or(head)).map_err(|error| error.to_string())?
    };
    let request = Request::new(&limits);
    let cloud = decode(format, &mut *reader, &request).map_err(|error| error.to_string())?;
    let scan = slice(cloud, &SliceRequest::default(), &limits).map_err(|error| error.to_string())?;
    Ok(scan.stations().len())
}

/// Damages a file in one to three positions.
fn mutate(bytes: &mut Vec<u8>, rng: &mut ChaCha8Rng) {
    const NUMBERS: [&str; 10] = [
        "0",
        "-1",
        "1e308",
        "nan",
        "4294967295",
        "4294967296",
        "99999999999",
        "18446744073709551615",
        "2147483648",
        "",
    ];
    const WORDS: [u64; 6] = [0, u64::MAX, 0x7fff_ffff, 0xffff_ffff, 0x7ff0_0000_0000_0000, 1 << 40];
    for _ in 0..rng.random_range(1..=3) {
        if bytes.is_empty() {
            return;
        }
        let within = if rng.random_bool(0.7) { HEAD.min(bytes.len()) } else { bytes.len() };
        let at = rng.random_range(0..within);
        let end = (at + rng.random_range(1..64)).min(bytes.len());
        match rng.random_range(0..7) {
            0 => bytes[at] ^= 1 << rng.random_range(0..8),
            1 => bytes[at] = rng.random(),
            2 => bytes.truncate(at),
            3 => {
                let piece = bytes[at..end].to_vec();
                bytes.splice(at..at, piece);
            }
            4 => drop(bytes.drain(at..end)),
            5 => {
                let word = WORDS[rng.random_range(0..WORDS.len())].to_le_bytes();
                let size = [2, 4, 8][rng.random_range(0..3)].min(bytes.len() - at);
                bytes[at..at + size].copy_from_slice(&word[..size]);
            }
            _ => {
                // The next number in the text is replaced.
                let is_part = |byte: &u8| byte.is_ascii_digit() || matches!(byte, b'.' | b'-');
                let Some(start) = bytes[at..].iter().position(is_part).map(|start| at + start) else { continue };
                let length = bytes[start..].iter().take_while(|byte| is_part(byte)).count();
                let number = NUMBERS[rng.random_range(0..NUMBERS.len())];
                bytes.splice(start..start + length, number.bytes());
            }
        }
    }
}

/// Runs the mutations of one file in a child process.
fn survives(test: &str, declared: Option<Format>, valid: &[u8]) {
    if std::env::var_os(CHILD).is_some() {
        assert_eq!(take_in(valid, declared), Ok(10), "the unmodified file is valid");
        let is_read = |seed: &u64| {
            let mut bytes = valid.to_vec();
            mutate(&mut bytes, &mut ChaCha8Rng::seed_from_u64(*seed));
            take_in(&bytes, declared).is_ok()
        };
        let mutations = count("COAXIS_MUTATIONS", MUTATIONS);
        let read = (0..mutations).filter(is_read).count() as u64;
        // Both profiles and a reason are accepted, but mutations that always cause the same one test little.
        println!("{read} of {mutations} still read");
        assert!(read > mutations / 1000 && read < mutations - mutations / 10, "{read}");
        return;
    }
    // The test binary expects the path of a test without the name of the binary.
    let (_, test) = test.split_once("::").expect("a path");
    let child = Command::new("bash")
        .args(["-c", "ulimit -v $0 && exec \"$@\"", &ADDRESS_SPACE_KIB.to_string()])
        .arg(std::env::current_exe().expect("the test has a path"))
        .args(["--exact", test, "--test-threads", "1", "--nocapture"])
        .env(CHILD, "1")
        .output()
        .expect("bash runs");
    let said = String::from_utf8_lossy(&child.stdout);
    assert!(child.status.success(), "{}\n{said}\n{}", child.status, String::from_utf8_lossy(&child.stderr));
    assert!(said.contains("1 passed"), "the child ran its test: {said}");
    println!("{said}");
}

/// One test per decoder; the second word is the declared format.
macro_rules! readers {
    ($($name:ident: $declared:expr, $valid:expr;)*) => {$(
        #[test]
        fn $name() {
            survives(concat!(module_path!(), "::", stringify!($name)), $declared, &$valid);
        }
    )*};
}

readers! {
    csv_survives: Some(Format::Csv), encoded(Format::Csv);
    csv_named_survives: Some(Format::Csv), csv_named();
    gocator_csv_survives: Some(Format::GocatorCsv), encoded(Format::GocatorCsv);
    ply_little_endian_survives: Some(Format::Ply), encoded(Format::Ply);
    ply_big_endian_survives: Some(Format::Ply), ply_big_endian();
    ply_ascii_survives: Some(Format::Ply), ply_ascii();
    pcd_binary_survives: Some(Format::Pcd), encoded(Format::Pcd);
    pcd_ascii_survives: Some(Format::Pcd), pcd_ascii();
    pcd_compressed_survives: Some(Format::Pcd), pcd_compressed();
    npy_survives: Some(Format::Npy), encoded(Format::Npy);
    npz_survives: Some(Format::Npz), encoded(Format::Npz);
    json_survives: Some(Format::Json), encoded(Format::Json);
    gzip_survives: None, gzip(&encoded(Format::Csv));
    zstd_survives: None, zstd::encode_all(&*encoded(Format::Ply), 3).expect("memory takes everything");
}
