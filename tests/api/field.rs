//! Users' files with typical faults, over HTTP and offline: each is measured correctly, or refused with the reason and the remedy.
//! A result is correct if its error is within 2.5 of the stated standard uncertainties. The detected directions of the axis are
//! tested in `tests/field.rs`.

use crate::api::harness::{Answer, Running, start};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Radius, deflection and pitch in degrees, y_c0 and z_c0.
type Truth = [f64; 5];
const USUAL: Truth = [50.0, 0.8, 1.1, 3.0, -7.0];
/// The part of the file with integer millimetres of x up to 1950.
const LARGE: Truth = [400.0, 0.8, 1.1, 3.0, -7.0];
/// Height maps without positions start at 0, while the part was simulated with y from −38 mm.
const FROM_ZERO: Truth = [50.0, 0.8, 1.1, 41.0, -7.0];
/// Maximum error in standard uncertainties.
const STANDARD_MAX: f64 = 2.5;

/// Expected result of a file.
enum Expected {
    /// A pose with a warning.
    Right(Truth, Option<&'static str>),
    /// A problem: status, code, and words of its text.
    Problem(u16, &'static str, &'static [&'static str]),
    /// A refusal of the estimation.
    Refused(&'static str),
    /// A warning, with any pose.
    Warned(&'static str),
}

use Expected::{Problem, Refused, Right, Warned};

/// Files, the query, and the expected results.
fn table() -> Vec<(&'static str, &'static str, Expected)> {
    let right = || Right(USUAL, None);
    let mut rows: Vec<(&str, &str, Expected)> = [
        "wild_x.csv",
        "tilt_y3.csv",
        "tilt_z3.csv",
        "tilt_z10.csv",
        "csv_count_first.xyz",
        "csv_pts.pts",
        "csv_units_row.csv",
        "csv_units_row_br.csv",
        "json_bom.json",
        "ply_cr.ply",
        "ply_cr_bin.ply",
        "livox_line_all.pcd",
        "ply_prop_line_const.ply",
        "label_tiles_5.csv",
        "csv_nul_tail.csv",
        "csv_footer_total.csv",
        "csv_header_twice.csv",
        "csv_exp_D.csv",
        "csv_long_preamble.csv",
        "csv_preamble_two_numbers.csv",
        "npz_x1d.npz",
        "npy_struct.npy",
        "npy_f16.npy",
        "ply_obj_info_um.ply",
        "ply_comment_um.ply",
        "pcd_v5.pcd",
        "csv_utf16.csv",
        "rotational_label.csv",
    ]
    .into_iter()
    .map(|file| (file, "", right()))
    .collect();
    for file in ["zero3_edge_5.csv", "zero3_edge_20.csv", "zero3_rand_10.csv", "sentinel_9999_1of40.csv"] {
        rows.push((file, "", Right(USUAL, Some("missing_values"))));
    }
    for file in ["sentinel_999_4of40.csv", "sent_-99999_edges20.csv"] {
        rows.push((file, "", Right(USUAL, Some("missing_values"))));
    }
    for file in ["dup_x2_label.csv", "stale_x2.csv"] {
        rows.push((file, "", Right(USUAL, Some("repeated_profiles"))));
    }
    rows.extend([
        ("sent_-99999_edges20.csv", "missing=-99999", right()),
        ("npz_crc_xyz.npz", "", Problem(422, "file_damaged", &["CRC-32"])),
        ("npz_block_damaged.npz", "", Problem(422, "file_damaged", &["CRC-32"])),
        ("npz_lzma.npz", "", Problem(415, "format_unsupported", &["deflate"])),
        ("npz_bzip2.npz", "", Problem(415, "format_unsupported", &["deflate"])),
        ("matrix_z.csv", "", Problem(422, "pitch_needed", &["x_pitch_mm", "y_pitch_mm"])),
        ("matrix_z.csv", "x_pitch_mm=5&y_pitch_mm=0.5", Right(FROM_ZERO, None)),
        ("matrix_keyence.tsv", "", Problem(422, "pitch_needed", &["x_pitch_mm", "first column is taken as y"])),
        ("matrix_keyence.tsv", "x_pitch_mm=5", right()),
        ("csv_units_row.csv", "x_pitch_mm=5", Problem(422, "pitch_unused", &["leave them out"])),
        ("json_nan.json", "", Problem(422, "json_syntax", &["NaN", "write null"])),
        ("csv_thousands_int_um.csv", "", Problem(422, "number_ambiguous", &["decimal=point"])),
        ("csv_thousands_int_um.csv", "decimal=point", right()),
        ("csv_thousands_dot_de.csv", "", Problem(422, "number_ambiguous", &["\"1.000\"", "decimal=comma"])),
        ("csv_thousands_dot_de.csv", "decimal=comma", Right(LARGE, None)),
        ("gocator_profile_y0.csv", "", Refused("travel_missing")),
        ("flip_z.csv", "", Warned("concave_towards_sensor")),
    ]);
    rows
}

fn path(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/field").join(file)
}

/// The largest error of a measurement, in standard uncertainties.
fn worst(document: &Value, [radius, deflection, pitch, y_c0, z_c0]: Truth) -> f64 {
    let (pose, standard) = (&document["pose"], &document["uncertainty"]["standard"]);
    let number = |of: &Value, name: &str| of[name].as_f64().unwrap_or_else(|| panic!("{name}: {document}"));
    let x_ref = number(pose, "x_ref_mm");
    let at_ref = |at_zero: f64, angle: f64| at_zero + x_ref * angle.to_radians().tan();
    [
        ("radius_mm", radius),
        ("deflection_deg", deflection),
        ("pitch_deg", pitch),
        ("y_ref_mm", at_ref(y_c0, deflection)),
        ("z_ref_mm", at_ref(z_c0, pitch)),
    ]
    .into_iter()
    .map(|(name, truth)| (number(pose, name) - truth).abs() / number(standard, name))
    .fold(0.0, f64::max)
}

fn warnings(document: &Value) -> Vec<&str> {
    let warnings = document["conditioning"]["warnings"].as_array().expect("a list");
    warnings
        .iter()
        .filter_map(|warning| warning["code"].as_str())
        .filter(|code| *code != "calibration_not_stated")
        .collect()
}

fn check(document: &Value, expected: &Expected, of: &str) {
    match expected {
        Right(truth, warning) => {
            assert_eq!(document["verdict"], "accepted", "{of}: {document}");
            let worst = worst(document, *truth);
            assert!(worst <= STANDARD_MAX, "{of}: {worst:.2} standard uncertainties");
            assert_eq!(warnings(document), warning.iter().copied().collect::<Vec<_>>(), "{of}");
        }
        Refused(code) => assert_eq!(document["refusal"]["code"], *code, "{of}: {document}"),
        Warned(code) => assert!(warnings(document).contains(code), "{of}: {document}"),
        Problem(..) => panic!("{of} is measured: {document}"),
    }
}

fn over_http(service: &Running, file: &str, query: &str, expected: &Expected) {
    let bytes = std::fs::read(path(file)).expect("the file is there");
    let answer: Answer = service.post(&format!("/v1/measurements?{query}"), &bytes);
    let of = format!("{file}?{query} over HTTP");
    let Problem(status, code, words) = expected else { return check(&answer.expect(201), expected, &of) };
    let problem = answer.problem(*status, code);
    assert_eq!(problem["retryable"], false, "{of}");
    let detail = problem["detail"].as_str().expect("text");
    assert!(words.iter().all(|word| detail.contains(word)), "{of}: {detail}");
}

fn offline(file: &str, query: &str, expected: &Expected) {
    let flags = query.split('&').filter(|part| !part.is_empty()).map(|part| format!("--{}", part.replace('_', "-")));
    let mut command = Command::new(env!("CARGO_BIN_EXE_coaxis"));
    let output = command.arg("measure").arg(path(file)).arg("--json").args(flags).output().expect("it runs");
    let of = format!("{file}?{query} offline");
    let Problem(_, _, words) = expected else {
        return check(&serde_json::from_slice(&output.stdout).expect("a document"), expected, &of);
    };
    let text = String::from_utf8(output.stderr).expect("text");
    assert_eq!(output.status.code(), Some(1), "{of}: {text}");
    assert!(words.iter().all(|word| text.contains(word)), "{of}: {text}");
}

#[test]
fn every_file_of_the_field_is_measured_correctly_or_refused_with_the_remedy() {
    let (service, _folder) = start();
    for (file, query, expected) in table() {
        over_http(&service, file, query, &expected);
        offline(file, query, &expected);
    }
}

#[test]
fn a_stored_matrix_is_measured_by_an_order_that_repeats_its_pitches() {
    let (service, _folder) = start();
    let bytes = std::fs::read(path("matrix_keyence.tsv")).expect("the file is there");
    service.post("/v1/scans", &bytes).problem(422, "pitch_needed");
    let scan = service.post("/v1/scans?x_pitch_mm=5", &bytes).expect(201);
    let order = json!({"scan_id": scan["id"], "x_pitch_mm": 5, "missing_values": []});
    check(&service.post_json("/v1/measurements", &order).expect(201), &Right(USUAL, None), "an order");
    service.put("/v1/recipes/map", &[], &json!({"x_pitch_mm": 5, "decimal": "point"})).expect(201);
    check(&service.post("/v1/measurements?recipe=map", &bytes).expect(201), &Right(USUAL, None), "a recipe");
    service.put("/v1/recipes/none", &[], &json!({"x_pitch_mm": 0})).problem(422, "recipe_invalid");
    service.post("/v1/measurements?y_pitch_mm=-1", &bytes).problem(422, "option_invalid");
}

#[test]
fn orders_and_recipes_may_begin_with_a_byte_order_mark() {
    let (service, _folder) = start();
    let marked = |text: String| [&b"\xef\xbb\xbf"[..], text.as_bytes()].concat();
    let json_header = [("content-type", "application/json")];
    let scan = service.post("/v1/scans", &std::fs::read(path("csv_units_row.csv")).expect("there")).expect(201);
    let order = marked(json!({"scan_id": scan["id"]}).to_string());
    service.post_with("/v1/measurements", &json_header, &order).expect(201);
    let scan = std::fs::read(path("json_bom.json")).expect("there");
    service.post_with("/v1/measurements", &json_header, &scan).expect(201);
}

#[test]
fn the_error_for_a_body_without_line_ends_states_the_correct_curl_option() {
    let (service, _folder) = start();
    let form = [("content-type", "application/x-www-form-urlencoded")];
    for file in ["frame_plain.csv", "ply_comment_um.ply", "csv_pts.pts", "livox_line_all.pcd"] {
        let bytes = std::fs::read(path(file)).expect("there");
        let stripped: Vec<u8> = bytes.into_iter().filter(|byte| !matches!(byte, b'\r' | b'\n' | 0)).collect();
        let problem = service.post_with("/v1/measurements", &form, &stripped).problem(422, "line_ends_missing");
        assert!(problem["detail"].as_str().expect("text").contains("--data-binary"), "{file}: {problem}");
    }
}

#[test]
fn a_body_that_cannot_be_decompressed_is_a_client_error_with_the_supported_formats() {
    let (service, folder) = start();
    let csv = std::fs::read(path("frame_plain.csv")).expect("there");
    for encoding in ["deflate", "br", "gzip, gzip"] {
        let problem = service
            .post_with("/v1/measurements", &[("content-encoding", encoding)], &csv)
            .problem(415, "encoding_unsupported");
        assert!(problem["detail"].as_str().expect("text").contains("gzip"), "{problem}");
    }
    // A damaged checksum at the end of gzip; a table in a zip archive.
    let mut gzip = crate::api::bodies::gzip(&csv);
    let last = gzip.len() - 6;
    gzip[last] ^= 1;
    service.post("/v1/measurements", &gzip).problem(422, "compression_invalid");
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    zip.start_file("scan.csv", zip::write::SimpleFileOptions::default()).expect("starts");
    std::io::Write::write_all(&mut zip, &csv).expect("writes");
    let zip = zip.finish().expect("ends").into_inner();
    let problem = service.post("/v1/measurements", &zip).problem(415, "format_unsupported");
    assert!(problem["detail"].as_str().expect("text").contains("scan.csv"), "{problem}");
    assert_eq!(folder.scan_files_count(), 0);
}

#[test]
fn formats_units_and_methods_have_the_names_of_the_offline_command() {
    let (service, _folder) = start();
    let bytes = std::fs::read(path("csv_count_first.xyz")).expect("there");
    for name in ["csv", "xyz", "XYZ", "txt", "pts", "ds", "asc", "tsv"] {
        service.post(&format!("/v1/measurements?format={name}"), &bytes).expect(201);
    }
    for unit in ["mm", "MM", "millimetre"] {
        service.post(&format!("/v1/measurements?unit={unit}"), &bytes).expect(201);
    }
    let problem = service.post("/v1/measurements?format=stl", &bytes).problem(400, "query_invalid");
    assert!(problem["detail"].as_str().expect("text").contains("csv, gocator_csv, ply"), "{problem}");
}

#[test]
fn no_message_about_a_request_contains_terms_of_rust() {
    let (service, _folder) = start();
    let queries = [
        "format=stl",
        "unit=yard",
        "method=guess",
        "decimal=dot",
        "nominal_radius_mm=wide",
        "color=red",
        "missing=x",
        "unit=mm&unit=mm",
    ];
    // The id of a request is hexadecimal, and may contain "f64".
    let words = |mut problem: serde_json::Value| {
        problem["request_id"] = serde_json::Value::Null;
        problem.to_string()
    };
    let ask =
        |query: &&str| service.post(&format!("/v1/measurements?{query}"), b"1,2,3\n").problem(400, "query_invalid");
    let mut details: Vec<String> = queries.iter().map(|query| words(ask(query))).collect();
    for order in [
        json!({"scan_id": 5}),
        json!({"scan_id": "s-1", "method": "guess"}),
        json!({"scan_id": "s-1", "nominal_radius_mm": "1,5"}),
        json!({"scan_id": "s-1", "color": "red"}),
        json!({"scan_id": "s-1", "missing_values": 5}),
    ] {
        details.push(words(service.post_json("/v1/measurements", &order).problem(422, "json_invalid")));
    }
    for recipe in [
        json!({"radius": "loose"}),
        json!({"points_min": -1}),
        json!({"frame": {"origin_mm": [0, 0]}}),
        json!({"parts": {"by": 5}}),
        json!({"unit": "yard"}),
    ] {
        details.push(words(service.put("/v1/recipes/wrong", &[], &recipe).problem(422, "json_invalid")));
    }
    for detail in details {
        for word in ["variant", "f64", "u32", "struct", "sequence", "expected", "`", "deserialize"] {
            assert!(!detail.contains(word), "{word}: {detail}");
        }
    }
}
