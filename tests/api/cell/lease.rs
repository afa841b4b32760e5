//! The lease: one at a time, renewed by use, its running out stops what it moves, and its fence never goes back.

use super::{FAST, Line, REAL, id, untouched};
use crate::harness::{Folder, start_on};
use serde_json::json;

#[test]
fn a_lease_is_taken_renewed_seen_and_given_back() {
    let (service, _folder) = untouched(FAST);
    assert_eq!(service.get("/v1/cell/lease").expect(200)["lease"], json!(null));
    let taken = service.post_json("/v1/cell/lease", &json!({"holder": "line 3", "ttl_s": 30})).expect(201);
    let lease = taken["lease_id"].as_str().expect("an id");
    let seen = service.get("/v1/cell/lease").expect(200);
    assert_eq!((&seen["lease"]["holder"], &seen["lease"]["fence"]), (&json!("line 3"), &taken["fence"]));
    assert!(!seen.to_string().contains(lease), "the id is its holder's alone");
    assert!(!service.get("/v1/cell").text().contains(lease));
    let renewed = service.post_json("/v1/cell/lease", &json!({"lease_id": lease})).expect(200);
    assert_eq!(renewed["fence"], taken["fence"]);
    service.post_json("/v1/cell/lease", &json!({"holder": "line 4"})).problem(423, "lease_held");
    service.delete(&format!("/v1/cell/lease?lease_id={lease}")).expect(200);
    let next = service.post_json("/v1/cell/lease", &json!({"holder": "line 4"})).expect(201);
    assert!(next["fence"].as_u64() > taken["fence"].as_u64());
    for bad in [json!({"ttl_s": 0.001}), json!({"ttl_s": 1e9}), json!({"ttl_s": -1}), json!({"holder": ""})] {
        service.post_json("/v1/cell/lease", &bad).problem(422, "option_invalid");
    }
}

#[test]
fn the_running_out_of_the_lease_stops_what_it_moved() {
    let line = Line::ready(REAL);
    line.service.delete(&format!("/v1/cell/lease?lease_id={}", line.lease)).expect(200);
    let taken = line.service.post_json("/v1/cell/lease", &json!({"holder": "brief", "ttl_s": 1})).expect(201);
    let order = json!({"m1": {"y_mm": 20.0}, "m2": {"y_mm": 20.0}, "speed_ratio": 0.1, "lease_id": taken["lease_id"]});
    let begun = line.service.post_json("/v1/moves", &order).expect(201);
    let ended = line.wait_for(&begun);
    assert_eq!((&ended["state"], &ended["ending"]["code"]), (&json!("stopped"), &json!("lease_over")));
    assert_eq!(ended["holder"], "brief");
    line.service.post_json("/v1/moves", &order).problem(409, "lease_over");
}

#[test]
fn giving_the_lease_back_stops_what_it_moved() {
    let line = Line::ready(REAL);
    let begun = line.long_move();
    line.service.delete(&format!("/v1/cell/lease?lease_id={}", line.lease)).expect(200);
    let ended = line.service.get(&format!("/v1/moves/{}?wait_s=20", id(&begun))).expect(200);
    assert_eq!((&ended["state"], &ended["ending"]["code"]), (&json!("stopped"), &json!("lease_released")));
}

#[test]
fn fences_go_on_growing_after_a_restart() {
    let folder = Folder::new();
    let mut last = 0;
    for _ in 0..2 {
        let service = start_on(&folder, |config| config.cell.enabled = true);
        for _ in 0..2 {
            let taken = service.post("/v1/cell/lease", &[]).expect(201);
            let fence = taken["fence"].as_u64().expect("a number");
            assert!(fence > last, "{fence} after {last}");
            last = fence;
            service
                .delete(&format!("/v1/cell/lease?lease_id={}", taken["lease_id"].as_str().expect("an id")))
                .expect(200);
        }
        service.stop();
    }
}
