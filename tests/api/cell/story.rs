//! The complete sequence on simulated devices: measure by the sensor, plan, execute, measure again, and the part has its target
//! pose. The truth is that of the simulated part.

use super::{FAST, Line, id, number};
use serde_json::{Value, json};

const FIELDS: [&str; 4] = ["deflection_deg", "pitch_deg", "y_c0_mm", "z_c0_mm"];

fn target() -> Value {
    json!({"deflection_deg": 0.1, "pitch_deg": -0.2, "y_c0_mm": 2.0, "z_c0_mm": 8.0})
}

/// Difference between a pose and a target, by field.
fn off(measured: &Value, target: &Value) -> [f64; 4] {
    FIELDS.map(|field| number(measured, &format!("/pose/{field}")) - number(target, &format!("/{field}")))
}

/// Allowed remaining error of the devices: an error e of each clamp (backlash 0.05 mm, and 2 % of the travel of the two other axes)
/// rotates the part by 2e/500 mm and shifts its axis at x = 0 by at most 1.6 e (clamps at 150 and 650 mm), and the uncertainty of
/// the measurement (k = 2).
fn allowed(measured: &Value, plan: &Value) -> [f64; 4] {
    let way = |carrier: &str, axis: &str| number(plan, &format!("/axes/{carrier}/{axis}/travel_mm")).abs();
    let ways = ["m1", "m2"].map(|carrier| way(carrier, "x") + way(carrier, "y") + way(carrier, "z"));
    let error = 0.05 + 0.02 * ways[0].max(ways[1]);
    let by_devices =
        [(2.0 * error / 500.0_f64).to_degrees(), (2.0 * error / 500.0_f64).to_degrees(), 1.6 * error, 1.6 * error];
    let mut known = FIELDS.map(|field| number(measured, &format!("/uncertainty/{field}")));
    for (known, by_devices) in known.iter_mut().zip(by_devices) {
        *known += by_devices;
    }
    known
}

fn assert_true(line: &Line, measured: &Value) {
    let truth = line.truth();
    let truth = [truth.deflection().degrees(), truth.pitch().degrees(), truth.y0, truth.z0];
    // The stage is straight within 0.005 mm; over a scan of 400 mm that is 0.0015° and, at x = 0, some 0.015 mm.
    let stage = [0.0015, 0.0015, 0.02, 0.02];
    for ((field, truth), stage) in FIELDS.iter().zip(truth).zip(stage) {
        let (value, known) =
            (number(measured, &format!("/pose/{field}")), number(measured, &format!("/uncertainty/{field}")));
        assert!((value - truth).abs() <= 2.0 * known + stage, "{field}: {value} is not {truth}, ±{known}");
    }
}

#[test]
fn a_measured_part_is_moved_to_its_target_by_a_plan() {
    let line = Line::ready(FAST);
    let mut measured = line.measure();
    assert_true(&line, &measured);
    // Once from a large distance, once from a small one.
    for _ in 0..2 {
        let order = json!({"measurement_id": id(&measured), "target": target()});
        let plan = line.service.post_json("/v1/plans", &order).expect(201);
        assert!(number(&plan, "/strain_mm") <= 0.5 && number(&plan, "/duration_s") > 0.0, "{plan}");
        let begun = line.act(&format!("/v1/plans/{}/execute", id(&plan))).expect(201);
        assert_eq!((&begun["state"], &begun["plan_id"]), (&json!("moving"), &plan["id"]));
        let ended = line.wait_for(&begun);
        assert_eq!(
            (&ended["state"], &ended["progress"], &ended["ending"]),
            (&json!("done"), &json!(1.0), &Value::Null)
        );
        measured = line.measure();
        assert_true(&line, &measured);
        for ((field, off), allowed) in FIELDS.iter().zip(off(&measured, &target())).zip(allowed(&measured, &plan)) {
            assert!(off.abs() <= allowed, "{field} is off by {off}, allowed are {allowed}");
        }
    }
    let moves = line.service.get("/v1/moves").expect(200);
    assert_eq!(moves["moves"].as_array().map(Vec::len), Some(2));
    let world = line.service.world.as_ref().expect("a world");
    for carrier in coaxis::motion::Carrier::ALL {
        assert!(world.record(carrier).all_out_of_limits().len() == 0, "no target was ever outside the limits");
    }
}

#[test]
fn the_stored_scan_measured_again_gives_the_same_pose_to_the_last_bit() {
    let line = Line::ready(FAST);
    let measured = line.measure();
    let scan = format!("s-{}", measured["provenance"]["scan_sha256"].as_str().expect("a digest"));
    let again = line.service.post_json("/v1/measurements", &json!({"scan_id": scan})).expect(201);
    for part in ["pose", "uncertainty", "profiles", "residuals", "conditioning"] {
        assert_eq!(again[part], measured[part], "{part}");
    }
    // The simulated stage is not quite straight, which no scan shows; for an uploaded file this is unknown.
    assert_eq!(measured["uncertainty"]["scope"], "combined");
    assert_eq!(measured["uncertainty"]["budget"][1]["source"], "stage_straightness");
    let kept = line.service.get(&format!("/v1/scans/{scan}")).expect(200);
    assert_eq!(kept["format"], "ply");
    let content = line.service.get(&format!("/v1/scans/{scan}/content"));
    let uploaded = line.service.post("/v1/measurements?format=ply", &content.body).expect(201);
    assert_eq!(uploaded["pose"], measured["pose"]);
    assert_eq!(uploaded["uncertainty"]["scope"], "repeatability");
}

#[test]
fn homing_is_executed_and_reported() {
    let line = Line::ready_with(FAST, |config| config.cell.simulated.manipulators.homed = false);
    for manipulator in ["m1", "m2"] {
        let home = format!("/v1/manipulators/{manipulator}/home");
        assert_eq!(line.act(&home).expect(200)["result"], "accepted");
        super::until(&line.service, "/v1/cell", |cell| cell["state"] == "idle");
        assert_eq!(line.act(&home).expect(200)["result"], "already_so", "a known reference is not looked for again");
    }
    let cell =
        super::until(&line.service, "/v1/cell", |cell| cell["state"] == "idle" && cell["commands_allowed"] == true);
    assert_eq!(cell["faults"], json!([]));
    assert_eq!(line.act("/v1/manipulators/m2/enable").expect(200)["result"], "already_so");
    let one = line.service.get("/v1/manipulators/m1").expect(200);
    assert_eq!((&one["quality"], &one["reading"]["x"]["homed"]), (&json!("good"), &json!(true)));
    assert_eq!(line.act("/v1/manipulators/m1/disable").expect(200)["result"], "accepted");
    super::until(&line.service, "/v1/manipulators/m1", |one| one["reading"]["state"] == "disabled");
}
