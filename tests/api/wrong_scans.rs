//! Every kind of invalid upload gets its own problem and is deleted, and the service continues.

use crate::api::bodies::{csv, encoded, exact_csv};
use crate::api::harness::{Answer, start};
use coaxis::scan::decode::Format;
use coaxis::scan::synthetic::Part;
use serde_json::json;
use std::io::Write;

fn small() -> Part {
    Part { profiles_count: 5, points_count: 50, length_mm: 40.0, ..Part::smooth(2) }
}

#[test]
fn wrong_bytes_have_their_own_problem_and_leave_nothing_behind() {
    let (service, folder) = start();
    let ply = encoded(&small(), Format::Ply);
    let pcd = String::from_utf8_lossy(&encoded(&small(), Format::Pcd)).into_owned();
    let lying = pcd.replacen("POINTS 250", "POINTS 4000000000", 1);
    assert_ne!(lying, pcd, "the header states its points");
    let nan = csv((0..50).map(|i| (i % 5, [f64::from(u32::try_from(i).expect("small") % 5), f64::NAN, f64::NAN])));
    let huge = csv((0..50).map(|i| (i % 5, [0.0, 1e308, 1.0])));
    let post = |body: &[u8]| service.post("/v1/measurements", body);
    let detail = |answer: &Answer| answer.json()["detail"].as_str().expect("text").to_owned();

    post(b"").problem(422, "file_empty");
    post(b"Dear Sir or Madam,\nplease find attached the scan.\n").problem(422, "not_a_table");
    let truncated = post(&ply[..ply.len() / 2]);
    assert_eq!(truncated.problem(422, "file_truncated")["points_expected_count"], 250);
    assert!(detail(&truncated).contains("whole file"));
    post(lying.as_bytes()).problem(422, "size_mismatch");
    assert_eq!(post(&nan).problem(422, "no_points")["missing_count"], 50);
    post(&huge).problem(422, "coordinate_out_of_range");
    post(b"solid part\nfacet normal 0 0 1\n").problem(422, "not_a_table");
    service.post("/v1/measurements?format=pcd", &ply).problem(415, "format_conflict");
    service
        .post_with("/v1/measurements", &[("content-type", "application/x-npy")], &ply)
        .problem(415, "format_conflict");
    service.post("/v1/measurements?profile_by=column%3Dframe", &exact_csv()).problem(422, "column_unknown");
    service.post("/v1/measurements?profile_by=gap", &exact_csv()).problem(422, "option_invalid");
    for radius in ["NaN", "-1"] {
        let path = format!("/v1/measurements?nominal_radius_mm={radius}");
        assert_eq!(service.post(&path, &exact_csv()).problem(422, "option_invalid")["field"], "nominal_radius_mm");
    }
    service.post("/v1/measurements?nominal_radius=1", &exact_csv()).problem(400, "query_invalid");

    assert_eq!(folder.scan_files_count(), 0, "nothing is left behind");
    assert_eq!(service.get("/v1/measurements").expect(200)["measurements"], json!([]));
    post(&exact_csv()).expect(201);
}

#[test]
fn points_that_define_no_axis_are_refused_with_their_reason() {
    let (service, _folder) = start();
    let profiles = |point: fn(f64) -> [f64; 2]| {
        csv((0..200_u32).map(|i| {
            let [y, z] = point(f64::from(i / 5));
            (usize::try_from(i % 5).expect("small"), [f64::from(i % 5) * 10.0, y, z])
        }))
    };
    let refusal = |body: &[u8]| service.post("/v1/measurements", body).expect(201)["refusal"].clone();
    assert_eq!(refusal(&profiles(|i| [i, 2.0 * i + 1.0]))["code"], "points_collinear");
    // A sensor without a signal writes the same point repeatedly, unless the recipe declares otherwise.
    let same = profiles(|_| [3.0, 4.0]);
    assert_eq!(service.post("/v1/measurements", &same).problem(422, "no_points")["missing_count"], 200);
    service.put("/v1/recipes/all", &[], &json!({"missing_values": []})).expect(201);
    let refused = service.post("/v1/measurements?recipe=all", &same).expect(201);
    assert_eq!(refused["refusal"]["code"], "points_identical");
    let one = csv((0..50).map(|i| {
        let a = 0.5 + 0.04 * f64::from(i);
        (0, [0.0, 50.0 * a.cos(), 50.0 * a.sin()])
    }));
    assert_eq!(refusal(&one)["code"], "too_few_profiles");
}

#[test]
fn a_decompression_bomb_is_refused() {
    let (service, folder) = start();
    let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    let line = b"1,2,3\n".repeat(1 << 16);
    for _ in 0..64 {
        packer.write_all(&line).expect("packed");
    }
    let bomb = packer.finish().expect("packed");
    let answer = service.post_with("/v1/measurements", &[("content-encoding", "gzip")], &bomb);
    assert_eq!(answer.problem(413, "inflate_ratio")["ratio_max"], 100);
    let damaged = service.post_with("/v1/measurements", &[("content-encoding", "gzip")], &exact_csv());
    damaged.problem(422, "compression_invalid");
    let cut = service.post_with("/v1/measurements", &[("content-encoding", "zstd")], &bomb[..4]);
    cut.problem(422, "compression_invalid");
    assert_eq!(folder.scan_files_count(), 0);
}
