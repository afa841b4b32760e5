//! Storing scans and returning them.

use crate::api::bodies::{exact_csv, gzip};
use crate::api::harness::start;
use insta::assert_json_snapshot;

#[test]
fn a_scan_is_stored_once_under_its_hash_and_returned_byte_for_byte() {
    let (service, folder) = start();
    let answer = service.post("/v1/scans", &exact_csv());
    let scan = answer.expect(201);
    assert_eq!(answer.header("location"), format!("/v1/scans/{}", scan["id"].as_str().expect("an id")));
    assert_json_snapshot!("scan", scan, { ".created_at" => "[time]" });
    assert_eq!(service.post("/v1/scans", &exact_csv()).expect(200), scan);
    assert_eq!(service.get(answer.header("location")).expect(200), scan);
    assert_eq!(service.get("/v1/scans").expect(200)["scans"], serde_json::json!([scan]));
    let content = service.get(&format!("{}/content", answer.header("location")));
    assert_eq!((content.status, content.body), (200, exact_csv()));
    assert_eq!(folder.scan_files_count(), 1);
}

#[test]
fn a_compressed_scan_is_the_same_scan() {
    let (service, _folder) = start();
    let plain = service.post("/v1/scans", &exact_csv()).expect(201);
    let gzip = gzip(&exact_csv());
    let zstd = zstd::encode_all(exact_csv().as_slice(), 3).expect("packed");
    for (encoding, body) in [("gzip", &gzip), ("zstd", &zstd), ("identity", &exact_csv())] {
        let answer = service.post_with("/v1/scans", &[("content-encoding", encoding)], body);
        assert_eq!(answer.expect(200)["id"], plain["id"], "{encoding}");
    }
    for body in [&gzip, &zstd] {
        assert_eq!(service.post("/v1/scans", body).expect(200)["id"], plain["id"], "known by its first bytes");
        let measurement = service.post_with("/v1/measurements", &[("content-type", "application/json")], body);
        measurement.problem(422, "json_syntax");
    }
    service.post_with("/v1/scans", &[("content-encoding", "br")], b"x").problem(415, "encoding_unsupported");
}

#[test]
fn an_unknown_scan_is_404() {
    let (service, _folder) = start();
    for id in [format!("s-{}", "0".repeat(64)), "..%2f..%2fcoaxis.db".to_owned(), "%ff".to_owned()] {
        let answer = service.get(&format!("/v1/scans/{id}"));
        answer.problem(404, if id == "%ff" { "route_unknown" } else { "scan_unknown" });
        assert_eq!(service.get(&format!("/v1/scans/{id}/content")).status, 404);
    }
}

#[test]
fn the_error_for_a_form_asks_for_the_bytes_of_the_scan() {
    let (service, folder) = start();
    let form = [("content-type", "multipart/form-data; boundary=x")];
    for path in ["/v1/scans", "/v1/measurements"] {
        let problem = service.post_with(path, &form, b"--x\r\n").problem(415, "content_type_unsupported");
        assert!(problem["detail"].as_str().expect("text").contains("--data-binary"), "{problem}");
    }
    assert_eq!(folder.scan_files_count(), 0);
}
