//! Repeated requests: the same id returns the same resource, a different body with this id is refused, and nothing moves
//! twice.

use super::{FAST, Line, id};
use serde_json::json;

#[test]
fn a_repeated_move_is_one_move() {
    let line = Line::ready(FAST);
    let order = json!({"m1": {"y_mm": 2.0}, "m2": {"y_mm": 2.0}, "request_id": "part-1"});
    let first = line.post("/v1/moves", &order).expect(201);
    line.wait_for(&first);
    let again = line.post("/v1/moves", &order);
    assert_eq!((again.expect(200)["id"].clone(), again.header("idempotency-replayed")), (first["id"].clone(), "true"));
    let other = json!({"m1": {"y_mm": 3.0}, "m2": {"y_mm": 3.0}, "request_id": "part-1"});
    line.post("/v1/moves", &other).problem(422, "request_id_reused");
    assert_eq!(line.service.get("/v1/moves").expect(200)["moves"].as_array().map(Vec::len), Some(1));
    line.post("/v1/measurements", &json!({"source": "sensor", "request_id": "part-1"}))
        .problem(422, "request_id_reused");
    let csv = crate::api::bodies::exact_csv();
    line.service.post("/v1/measurements?format=csv&request_id=part-1", &csv).problem(422, "request_id_reused");
}

#[test]
fn a_request_that_was_refused_may_be_repeated() {
    let line = Line::ready(FAST);
    line.act("/v1/manipulators/m1/disable").expect(200);
    super::until(&line.service, "/v1/manipulators/m1", |one| one["reading"]["state"] == "disabled");
    let order = json!({"m1": {"y_mm": 2.0}, "m2": {"y_mm": 2.0}, "request_id": "part-2"});
    line.post("/v1/moves", &order).problem(409, "not_enabled");
    line.act("/v1/manipulators/m1/enable").expect(200);
    super::until(&line.service, "/v1/cell", |cell| cell["commands_allowed"] == true);
    let begun = line.post("/v1/moves", &order).expect(201);
    assert_eq!(line.wait_for(&begun)["state"], "done");
    let states: Vec<_> = line.service.get("/v1/moves").expect(200)["moves"]
        .as_array()
        .expect("moves")
        .iter()
        .map(|one| one["state"].clone())
        .collect();
    assert_eq!(states, [json!("done"), json!("refused")]);
}

#[test]
fn a_plan_is_executed_once_however_often_it_is_requested() {
    let line = Line::ready(FAST);
    let measured = line.measure();
    let order = json!({"measurement_id": id(&measured), "request_id": "plan-1",
        "target": {"deflection_deg": 0.3, "pitch_deg": 1.0, "y_c0_mm": -7.0, "z_c0_mm": 6.0}});
    let plan = line.service.post_json("/v1/plans", &order).expect(201);
    assert_eq!(line.service.post_json("/v1/plans", &order).expect(200)["id"], plan["id"]);
    let mut other = order;
    other["target"]["z_c0_mm"] = json!(6.5);
    line.service.post_json("/v1/plans", &other).problem(422, "request_id_reused");
    let execute = format!("/v1/plans/{}/execute", id(&plan));
    let first = line.act(&execute).expect(201);
    for _ in 0..2 {
        let again = line.act(&execute);
        assert_eq!(
            (again.expect(200)["id"].clone(), again.header("idempotency-replayed")),
            (first["id"].clone(), "true")
        );
    }
    assert_eq!(line.wait_for(&first)["state"], "done");
    assert_eq!(line.act(&execute).expect(200)["id"], first["id"], "also when it is over");
    assert_eq!(line.service.get(&format!("/v1/plans/{}", id(&plan))).expect(200)["move_id"], first["id"]);
}

#[test]
fn a_repeated_measurement_by_the_sensor_scans_once() {
    let line = Line::ready(FAST);
    let order = json!({"source": "sensor", "request_id": "scan-1"});
    let begun = line.post("/v1/measurements", &order).expect(201);
    let again = line.post("/v1/measurements", &order);
    assert_eq!((again.expect(200)["id"].clone(), again.header("idempotency-replayed")), (begun["id"].clone(), "true"));
    let path = format!("/v1/measurements/{}?wait_s=50", id(&begun));
    assert_eq!(line.service.get(&path).expect(200)["verdict"], "accepted");
    assert_eq!(line.post("/v1/measurements", &order).expect(200)["verdict"], "accepted");
    let plc = line.service.get(&format!("/v1/measurements/{}?view=plc", id(&begun))).expect(200);
    assert_eq!(plc["verdict_code"], 1);
    assert_eq!(line.service.get("/v1/measurements").expect(200)["measurements"].as_array().map(Vec::len), Some(1));
}
