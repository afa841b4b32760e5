//! Stored data are verified: files of scans against their ids, records against their format, the database against the count of its
//! commits. Every fault is reported.

use crate::api::bodies::exact_csv;
use crate::api::harness::{Folder, Running, start, start_on, start_with};
use crate::timed::cell::id;
use coaxis::store::{Precondition, Store};
use serde_json::json;
use std::io::Write;
use std::path::PathBuf;
use std::process::{Command, Output};
use std::time::Duration;

fn doctor(folder: &Folder, flags: &[&str]) -> Output {
    let data = folder.path().display().to_string();
    let mut command = Command::new(env!("CARGO_BIN_EXE_coaxis"));
    let command = command.args(["doctor", "--data", &data]).args(flags).env_remove("COAXIS_CONFIG");
    command.output().expect("it runs")
}

/// The file of a scan.
fn file(folder: &Folder, scan_id: &str) -> PathBuf {
    let digest = scan_id.trim_start_matches("s-");
    folder.path().join("scans").join(&digest[..2]).join(digest)
}

#[test]
fn a_damaged_or_missing_scan_file_is_reported_and_repaired_by_the_same_upload() {
    let (service, folder) = start();
    let measurement = service.post("/v1/measurements", &exact_csv()).expect(201);
    let scan_id = measurement["provenance"]["scan_id"].as_str().expect("an id");
    let file = file(&folder, scan_id);
    let asked = |service: &Running| {
        [
            service.get(&format!("/v1/scans/{scan_id}/content")),
            service.post_json("/v1/measurements", &json!({"scan_id": scan_id})),
            service.get(&format!("/v1/measurements/{}/plots/centres.svg", id(&measurement))),
        ]
    };
    let mut damaged = exact_csv();
    damaged[100] ^= 1;
    std::fs::write(&file, &damaged).expect("written");
    for answer in asked(&service) {
        let problem = answer.problem(500, "scan_file_damaged");
        assert_eq!(problem["scan_id"], scan_id);
        assert!(problem["detail"].as_str().is_some_and(|text| text.contains("POST /v1/scans")), "{problem}");
    }
    let found = doctor(&folder, &["--scrub"]);
    let said = String::from_utf8(found.stdout).expect("text");
    assert!(found.status.code() == Some(1) && said.contains(scan_id) && said.contains("is damaged"), "{said}");
    assert_eq!(doctor(&folder, &[]).status.code(), Some(0), "without --scrub only lengths are compared");
    service.post("/v1/scans", &exact_csv()).expect(200);
    std::fs::remove_file(&file).expect("removed");
    for answer in asked(&service) {
        assert_eq!(answer.problem(500, "scan_file_missing")["scan_id"], scan_id);
    }
    service.post("/v1/measurements", &exact_csv()).expect(201);
    assert_eq!(service.get(&format!("/v1/scans/{scan_id}/content")).body, exact_csv());
    for answer in asked(&service).into_iter().take(2) {
        assert!(answer.status < 300, "{}", answer.text());
    }
    let clean = doctor(&folder, &["--scrub"]);
    assert_eq!(clean.status.code(), Some(0), "{}", String::from_utf8_lossy(&clean.stdout));
}

/// Stores a recipe as written by a later version of the service.
fn put_later_recipe(folder: &Folder) {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("a runtime");
    runtime.block_on(async {
        let store = Store::open(folder.path()).await.expect("a store");
        let later = r#"{"document_version":99,"content":{}}"#;
        store.put_recipe("later", later, jiff::Timestamp::UNIX_EPOCH, Precondition::None).await.expect("put");
        store.close().await;
    });
}

#[test]
fn a_list_shows_a_record_of_a_later_version_as_unreadable_among_the_others() {
    let folder = Folder::new();
    let service = start_on(&folder, |_| {});
    service.put("/v1/recipes/good", &[], &json!({"points_min": 33})).expect(201);
    service.stop();
    put_later_recipe(&folder);
    let service = start_on(&folder, |_| {});
    let list = service.get("/v1/recipes").expect(200);
    assert_eq!((&list["recipes"][0]["id"], &list["recipes"][0]["state"]), (&json!("later"), &json!("unreadable")));
    assert!(list["recipes"][0]["text"].as_str().is_some_and(|text| text.contains("document version 99")), "{list}");
    assert_eq!(list["recipes"][1]["name"], "good");
    let problem = service.get("/v1/recipes/later").problem(500, "record_unreadable");
    assert_eq!((&problem["record"], &problem["record_id"]), (&json!("recipe"), &json!("later")));
    assert_eq!(doctor(&folder, &[]).status.code(), Some(1));
}

#[test]
fn a_database_that_lost_records_makes_the_service_not_ready_until_an_operator_accepts_it() {
    let folder = Folder::new();
    let service = start_on(&folder, |_| {});
    service.post("/v1/scans", &exact_csv()).expect(201);
    service.stop();
    std::fs::remove_file(folder.path().join("coaxis.db")).expect("removed");
    let service = start_on(&folder, |_| {});
    let problem = service.get("/health/ready").problem(503, "not_ready");
    assert_eq!(problem["not_ready"], json!(["store"]));
    let detail = problem["detail"].as_str().expect("text");
    assert!(detail.contains("missing or empty") && detail.contains("doctor --accept-loss"), "{detail}");
    service.post("/v1/measurements", &exact_csv()).problem(503, "not_ready");
    assert_eq!(service.get("/v1/measurements").expect(200)["measurements"], json!([]));
    assert_eq!(doctor(&folder, &["--accept-loss"]).status.code(), Some(1), "a service is running there");
    service.stop();
    assert_eq!(doctor(&folder, &["--accept-loss"]).status.code(), Some(0));
    let service = start_on(&folder, |_| {});
    service.get("/health/ready").expect(200);
    service.post("/v1/measurements", &exact_csv()).expect(201);
}

#[test]
fn the_service_ends_within_its_time_limit_although_a_client_never_finishes_its_body() {
    let (service, _folder) = start_with(|config| config.timeouts.shutdown_ms = 1_200);
    let mut stream = service.connect();
    let head = "POST /v1/scans HTTP/1.1\r\nHost: a\r\nContent-Length: 1000\r\nExpect: 100-continue\r\n\r\n";
    stream.write_all(head.as_bytes()).expect("sent");
    std::io::Read::read_exact(&mut stream, &mut [0; b"HTTP/1.1 100 Continue\r\n\r\n".len()]).expect("asked for");
    stream.write_all(b"1,2,3\n").expect("sent");
    let watch = service.verbs.as_ref().expect("it runs here").start_stopwatch();
    service.stop();
    let took = watch.elapsed();
    assert!(took < Duration::from_millis(2_500), "{took:?}");
    drop(stream);
}
