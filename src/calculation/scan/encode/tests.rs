//! What every format owes its readers: the same points back.

use super::*;
use crate::scan::decode::{FormatClaims, Limits, Request, decode, find_format};
use crate::scan::slice::{SliceRequest, slice};
use proptest::prelude::*;

fn written(scan: &Scan, format: Format) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode(scan, format, &mut bytes).expect("memory takes everything");
    bytes
}

/// Reads as an upload is read: its format is found from its bytes, its rule is chosen.
fn read(bytes: &[u8]) -> Scan {
    let limits = Limits::default();
    let format = find_format(&FormatClaims::default(), bytes).expect("known");
    let request = Request::new(&limits);
    let cloud = decode(format, &mut &*bytes, &request).expect("reads");
    slice(cloud, &SliceRequest::default(), &limits).expect("slices")
}

/// Profiles of eight to twelve points at rising x, so that x alone tells them apart, too.
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
        Scan::new(stations, columns, "made".to_owned()).expect("a valid scan")
    })
}

fn all_points(scan: &Scan) -> Vec<(u64, Vec<[u64; 3]>)> {
    let bits = |station: &Station| scan.points_of(station).map(|point| point.map(f64::to_bits)).collect();
    scan.stations().iter().map(|station| (station.x.to_bits(), bits(station))).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_format_gives_the_same_points_back(scan in any_scan()) {
        for format in Format::ALL {
            let back = read(&written(&scan, format));
            prop_assert_eq!(all_points(&back), all_points(&scan), "{}", format);
        }
    }
}

#[test]
fn single_precision_stays_single_where_nothing_is_lost() {
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
