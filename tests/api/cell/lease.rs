//! The lease: one at a time, renewed by use; its expiry stops the motion, and its fencing token never decreases.

use super::{FAST, Line, REAL, id, untouched, untouched_with};
use crate::api::harness::{Folder, start_on};
use serde_json::json;

#[test]
fn a_lease_is_acquired_renewed_shown_and_released() {
    let (service, _folder) = untouched(FAST);
    assert_eq!(service.get("/v1/cell/lease").expect(200)["lease"], json!(null));
    let taken = service.post_json("/v1/cell/lease", &json!({"holder": "line 3", "ttl_s": 30})).expect(201);
    let lease = taken["lease_id"].as_str().expect("an id");
    let seen = service.get("/v1/cell/lease").expect(200);
    assert_eq!((&seen["lease"]["holder"], &seen["lease"]["fence"]), (&json!("line 3"), &taken["fence"]));
    assert!(!seen.to_string().contains(lease), "the id is known only to its holder");
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
fn messages_about_a_lease_state_the_configured_range() {
    let (service, _folder) = untouched_with(FAST, |config| config.cell.lease.ttl_max_ms = 30_000);
    for ttl_s in [json!(0.1), json!(0.999), json!(30.001), json!(600), json!(1e300), json!(-1), json!(0)] {
        let problem = service.post_json("/v1/cell/lease", &json!({ "ttl_s": ttl_s })).problem(422, "option_invalid");
        let detail = problem["detail"].as_str().expect("text");
        assert!(detail.contains("ttl_s must be between 1 and 30"), "{ttl_s}: {detail}");
    }
    let taken = service.post_json("/v1/cell/lease", &json!({"ttl_s": 30})).expect(201);
    assert_eq!(taken["ttl_ms"], 30_000);
}

#[test]
fn the_cell_is_shown_to_a_plc_as_integers_in_less_than_1024_bytes() {
    let line = Line::ready_with(FAST, |config| config.cell.simulated.manipulators.homed = false);
    let answer = line.service.get("/v1/cell?view=plc");
    let view = answer.expect(200);
    assert!(answer.body.len() < 1024, "{}", answer.body.len());
    let object = view.as_object().expect("flat");
    assert!(object.len() > 20 && object.values().all(|value| value.is_i64() || value.is_null()), "{view}");
    assert_eq!((&view["state_code"], &view["lease_held"], &view["reason_code"]), (&json!(1), &json!(1), &json!(11)));
    assert_eq!(
        (&view["m1_state_code"], &view["m1_homed"], &view["m1_quality_code"]),
        (&json!(1), &json!(0), &json!(2))
    );
    for manipulator in ["m1", "m2"] {
        line.act(&format!("/v1/manipulators/{manipulator}/home")).expect(200);
        let homed = format!("{manipulator}_homed");
        super::until(&line.service, "/v1/cell?view=plc", |view| view[&homed] == 1 && view["state_code"] == 1);
    }
    let moved = line.post("/v1/moves", &json!({"m1": {"y_mm": 1.25}, "m2": {"y_mm": 1.25}})).expect(201);
    assert_eq!(line.wait_for(&moved)["state"], "done");
    let view = super::until(&line.service, "/v1/cell?view=plc", |view| view["state_code"] == 1);
    let y_um = view["m1_y_um"].as_i64().expect("known");
    assert!((1150..1350).contains(&y_um) && view["commands_allowed"] == 1 && view["reason_code"] == 0, "{view}");
    let order = json!({"source": "sensor", "lease_id": line.lease});
    let begun = line.service.post_json("/v1/measurements?view=plc", &order).expect(201);
    assert_eq!((&begun["verdict_code"], &begun["progress_permille"]), (&json!(0), &json!(0)));
}

#[test]
fn the_expiry_of_the_lease_stops_its_motion() {
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
fn releasing_the_lease_stops_its_motion() {
    let line = Line::ready(REAL);
    let begun = line.long_move();
    line.service.delete(&format!("/v1/cell/lease?lease_id={}", line.lease)).expect(200);
    let ended = line.service.get(&format!("/v1/moves/{}?wait_s=20", id(&begun))).expect(200);
    assert_eq!((&ended["state"], &ended["ending"]["code"]), (&json!("stopped"), &json!("lease_released")));
}

#[test]
fn fencing_tokens_continue_to_increase_after_a_restart() {
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
