//! Refusals of the cell, after which nothing was sent: every reason has its code and its numbers.

use super::{FAST, Line, REAL, id, untouched};
use crate::api::harness::start;
use serde_json::{Value, json};

#[test]
fn without_a_cell_commands_are_refused_and_files_are_measured() {
    let (service, _folder) = start();
    for path in ["/v1/cell", "/v1/cell/lease", "/v1/manipulators"] {
        service.get(path).problem(409, "cell_absent");
    }
    for path in
        ["/v1/cell/stop", "/v1/cell/lease", "/v1/cell/reset", "/v1/manipulators/m1/home", "/v1/plans/p-1/execute"]
    {
        service.post(path, &[]).problem(409, "cell_absent");
    }
    service.delete("/v1/cell/lease").problem(409, "cell_absent");
    service.post_json("/v1/moves", &json!({"m1": {"y_mm": 1.0}})).problem(409, "cell_absent");
    service.post_json("/v1/measurements", &json!({"source": "sensor"})).problem(409, "cell_absent");
    assert_eq!(service.get("/v1/status").expect(200)["cell_state"], json!(null));
    service.get("/v1/moves").expect(200);
}

#[test]
fn a_client_without_the_lease_moves_nothing() {
    let (service, _folder) = untouched(FAST);
    let targets = json!({"m1": {"y_mm": 1.0}, "m2": {"y_mm": 1.0}});
    service.post_json("/v1/moves", &targets).problem(409, "lease_required");
    let mut with_lease = targets;
    with_lease["lease_id"] = json!("l-never");
    service.post_json("/v1/moves", &with_lease).problem(409, "lease_required");
    let taken = service.post_json("/v1/cell/lease", &json!({"holder": "line 3"})).expect(201);
    let held = service.post_json("/v1/moves", &with_lease).problem(423, "lease_held");
    assert_eq!((&held["holder"], held["remaining_ms"].as_u64().is_some_and(|ms| ms <= 5000)), (&json!("line 3"), true));
    let says_which =
        |problem: &Value| problem["detail"].as_str().is_some_and(|text| text.contains("lease_id that was given"));
    let renewed = service.post_json("/v1/cell/lease", &json!({"lease_id": "l-never"})).problem(423, "lease_held");
    assert!(says_which(&held) && says_which(&renewed), "{held} {renewed}");
    assert!(!says_which(&service.post("/v1/cell/lease", &[]).problem(423, "lease_held")), "none was given");
    let path = format!("/v1/cell/lease?lease_id={}", taken["lease_id"].as_str().expect("an id"));
    service.delete(&path).expect(200);
    with_lease["lease_id"] = taken["lease_id"].clone();
    service.post_json("/v1/moves", &with_lease).problem(409, "lease_over");
    service.delete(&path).problem(409, "lease_over");
    service.post_json("/v1/cell/reset", &json!({"lease_id": "a"})).problem(409, "lease_required");
}

#[test]
fn a_manipulator_that_is_not_enabled_does_not_move() {
    let (service, _folder) = untouched(FAST);
    let lease = service.post("/v1/cell/lease", &[]).expect(201);
    assert_eq!(lease["holder"], "anonymous");
    let order = json!({"m1": {"y_mm": 1.0}, "m2": {"y_mm": 1.0}, "lease_id": lease["lease_id"]});
    assert_eq!(service.post_json("/v1/moves", &order).problem(409, "not_enabled")["manipulator"], "m1");
    let cell = service.get("/v1/cell").expect(200);
    assert_eq!((&cell["commands_allowed"], &cell["reasons"][0]["code"]), (&json!(false), &json!("not_enabled")));
    let kept = &service.get("/v1/moves").expect(200)["moves"][0];
    assert_eq!((&kept["state"], &kept["waypoints_count"]), (&json!("refused"), &json!(null)), "nothing was sent");
    assert!(kept["ending"]["text"].as_str().is_some_and(|text| text.contains("enable it first")), "{kept}");
}

/// Out-of-range values of a faulty client are never clamped, and the message is short whatever their size.
#[test]
fn a_number_out_of_range_is_refused_with_the_range_and_never_printed_in_full() {
    let line = Line::ready(FAST);
    let refused = |path: &str, body: Value, field: &str| {
        let problem = line.post(path, &body).problem(422, "option_invalid");
        assert_eq!(problem["field"], field, "{problem}");
        assert!(problem["detail"].as_str().is_some_and(|text| text.len() < 120), "{problem}");
        problem
    };
    for size in [45.1, 135.0, 1e300] {
        let target = json!({"deflection_deg": 0.0, "pitch_deg": -size, "y_c0_mm": 0.0, "z_c0_mm": 0.0});
        let order = json!({"measurement_id": "m-1", "target": target});
        let problem = refused("/v1/plans", order, "target.pitch_deg");
        assert_eq!((&problem["least"], &problem["most"]), (&json!(-45.0), &json!(45.0)));
    }
    refused("/v1/moves", json!({"m1": {"c_deg": 1e300}}), "m1.c_deg");
    refused("/v1/moves", json!({"m2": {"z_mm": -1e300}}), "m2.z_mm");
    refused("/v1/moves", json!({"m1": {"y_mm": 1.0}, "m2": {"y_mm": 1.0}, "speed_ratio": 1e300}), "speed_ratio");
    refused("/v1/measurements", json!({"source": "sensor", "x_from_mm": 1e300}), "x_from_mm");
    refused("/v1/measurements", json!({"source": "sensor", "speed_mm_s": 1e300}), "speed_mm_s");
    refused("/v1/cell/lease", json!({"ttl_s": 1e300}), "ttl_s");
    let recipe =
        line.service.put("/v1/recipes/a", &[], &json!({"nominal_radius_mm": 1e300})).problem(422, "recipe_invalid");
    assert!(recipe["detail"].as_str().is_some_and(|text| text.ends_with("got 1e300")), "{recipe}");
}

#[test]
fn the_refusal_of_a_move_without_a_target_gives_an_example() {
    let line = Line::ready(FAST);
    for nothing in [json!({}), json!({"m1": {}}), json!({"m1": {}, "m2": {"x_mm": null}})] {
        let problem = line.post("/v1/moves", &nothing).problem(422, "nothing_to_move");
        assert_eq!(problem["field"], "m1");
        assert!(problem["detail"].as_str().is_some_and(|text| text.contains("y_mm")), "{problem}");
    }
}

#[test]
fn unknown_parameters_are_not_ignored() {
    let (service, _folder) = untouched(FAST);
    for path in [
        "/v1/cell",
        "/v1/cell/lease",
        "/v1/manipulators",
        "/v1/manipulators/m1",
        "/v1/plans/p-1",
        "/v1/scans/s-1",
        "/v1/recipes/a",
    ] {
        service.get(&format!("{path}?wait=1")).problem(400, "query_invalid");
    }
    for wait in ["61", "300", "-1", "1.5", "soon", ""] {
        let problem = service.get(&format!("/v1/moves/v-1?wait_s={wait}")).problem(400, "query_invalid");
        assert!(problem["detail"].as_str().is_some_and(|text| text.contains("from 0 to 60")), "{problem}");
    }
    let packed = [("content-type", "application/json"), ("content-encoding", "gzip")];
    service.post_with("/v1/cell/lease", &packed, b"{}").problem(415, "encoding_unsupported");
    service.post_with("/v1/cell/reset", &packed, b"{}").problem(415, "encoding_unsupported");
}

/// Decimals of the longest number of a document.
fn decimals(text: &str) -> usize {
    let numbers = text.split(|c: char| !c.is_ascii_digit() && c != '.');
    numbers.filter_map(|number| number.split_once('.')).map(|(_, decimals)| decimals.len()).max().unwrap_or(0)
}

#[test]
fn lengths_and_angles_of_answers_have_at_most_six_decimals() {
    let line = Line::ready(FAST);
    let measured = line.measure();
    let target = json!({"deflection_deg": 0.3, "pitch_deg": 0.7, "y_c0_mm": 1.1, "z_c0_mm": 2.2, "roll_deg": 0.1});
    let plan =
        line.service.post_json("/v1/plans", &json!({"measurement_id": id(&measured), "target": target})).expect(201);
    assert_eq!(plan["target"]["deflection_deg"], 0.3, "it is what was asked for");
    let begun = line.act(&format!("/v1/plans/{}/execute", id(&plan))).expect(201);
    assert_eq!(line.wait_for(&begun)["state"], "done");
    let one = format!("/v1/moves/{}", id(&begun));
    for path in ["/v1/manipulators", "/v1/manipulators/m1", "/v1/plans", "/v1/moves", &one] {
        let text = line.service.get(path).text();
        // Times of day have decimals, too.
        let text: Vec<_> = text.split(',').filter(|field| !field.contains("_at\"")).collect();
        assert!((1..=6).contains(&decimals(&text.join(","))), "{path}: {text:?}");
    }
}

#[test]
fn an_invalid_target_is_refused_with_its_numbers_before_anything_is_sent() {
    let line = Line::ready_with(FAST, |config| config.cell.manipulators.m1.limits.z.step_mm = 5.0);
    let refused = |body, code| line.post("/v1/moves", &body).problem(422, code);
    let both = |x: f64, y: f64, z: f64| json!({"m1": {"x_mm": x, "y_mm": y, "z_mm": z}, "m2": {"x_mm": x, "y_mm": y, "z_mm": z}});
    let out = refused(both(0.0, 30.0, 0.0), "out_of_limits");
    assert_eq!(
        (&out["axis"], &out["value"], &out["upper"], &out["unit"]),
        (&json!("y"), &json!(30.0), &json!(25.0), &json!("mm"))
    );
    assert_eq!(refused(both(0.0, 0.0, 6.0), "step_too_large")["max"], 5.0);
    assert!(refused(json!({"m1": {"x_mm": 3.0}}), "strain_too_large")["strain_mm"].as_f64().is_some_and(|mm| mm > 2.9));
    assert_eq!(
        refused(json!({"m1": {"c_deg": 2.0}}), "twist_too_large")["max_deg"].as_f64().map(f64::round),
        Some(1.0)
    );
    assert_eq!(refused(json!({"m1": {"y_mm": 1.0}, "speed_ratio": 1.5}), "option_invalid")["field"], "speed_ratio");
    refused(json!({"m1": {"y": 1.0}}), "json_invalid");
    let world = line.service.world.as_ref().expect("a world");
    for carrier in coaxis::motion::Carrier::ALL {
        assert!(world.record(carrier).all_out_of_limits().len() == 0);
    }
    assert_eq!(line.service.get("/v1/moves").expect(200)["moves"], json!([]), "nothing was written down either");
}

#[test]
fn an_unknown_resource_is_not_found() {
    let line = Line::ready(FAST);
    line.service.get("/v1/moves/v-1").problem(404, "move_unknown");
    line.service.get("/v1/plans/p-1").problem(404, "plan_unknown");
    line.act("/v1/plans/p-1/execute").problem(404, "plan_unknown");
    line.service.get("/v1/manipulators/m3").problem(404, "manipulator_unknown");
    line.act("/v1/manipulators/m3/enable").problem(404, "manipulator_unknown");
    let order =
        json!({"measurement_id": "m-1", "target": {"deflection_deg": 0, "pitch_deg": 0, "y_c0_mm": 0, "z_c0_mm": 0}});
    line.service.post_json("/v1/plans", &order).problem(404, "measurement_unknown");
    line.service.get("/v1/moves/v-1?wait_s=61").problem(400, "query_invalid");
    line.service.get("/v1/measurements/m-1?wait_s=61").problem(400, "query_invalid");
}

#[test]
fn the_cell_executes_one_job_at_a_time() {
    let line = Line::ready(REAL);
    let begun = line.long_move();
    let busy = line.post("/v1/moves", &json!({"m1": {"y_mm": 1.0}, "m2": {"y_mm": 1.0}})).problem(409, "cell_busy");
    assert_eq!((&busy["job_id"], &busy["state"]), (&begun["id"], &json!("moving")));
    line.post("/v1/measurements", &json!({"source": "sensor"})).problem(409, "cell_busy");
    assert_eq!(line.service.get("/v1/status").expect(200)["cell_state"], "moving");
    line.service.post("/v1/cell/stop", &[]).expect(200);
    assert_eq!(line.wait_for(&begun)["state"], "stopped");
}

#[test]
fn a_plan_is_stale_after_a_motion() {
    let line = Line::ready(FAST);
    let measured = line.measure();
    let order = json!({"measurement_id": id(&measured),
        "target": {"deflection_deg": 0.3, "pitch_deg": 1.0, "y_c0_mm": -7.0, "z_c0_mm": 6.0}});
    let plan = line.service.post_json("/v1/plans", &order).expect(201);
    let begun = line.post("/v1/moves", &json!({"m1": {"y_mm": 1.0}, "m2": {"y_mm": 1.0}})).expect(201);
    assert_eq!(line.wait_for(&begun)["state"], "done");
    line.act(&format!("/v1/plans/{}/execute", id(&plan))).problem(409, "plan_stale");
    line.service.post_json("/v1/plans", &order).problem(409, "plan_stale");
    assert_eq!(line.service.get(&format!("/v1/plans/{}", id(&plan))).expect(200)["move_id"], json!(null));
}

#[test]
fn homing_a_referenced_axis_makes_no_plan_stale() {
    let line = Line::ready(FAST);
    let measured = line.measure();
    let order = json!({"measurement_id": id(&measured),
        "target": {"deflection_deg": 0.3, "pitch_deg": 1.0, "y_c0_mm": -7.0, "z_c0_mm": 6.0}});
    let plan = line.service.post_json("/v1/plans", &order).expect(201);
    let homed = line.act("/v1/manipulators/m1/home").expect(200);
    assert_eq!(homed["result"], "already_so", "{homed}");
    let begun = line.act(&format!("/v1/plans/{}/execute", id(&plan))).expect(201);
    assert_eq!(line.wait_for(&begun)["state"], "done");
    let stale = line.service.post_json("/v1/plans", &order).problem(409, "plan_stale");
    assert!(stale["detail"].as_str().is_some_and(|text| text.contains("moved since")), "{stale}");
}

#[test]
fn the_age_of_repeated_bytes_counts_from_their_last_upload() {
    let folder = crate::api::harness::Folder::new();
    let with_cell = |config: &mut coaxis::config::Config| {
        config.cell.enabled = true;
        config.cell.simulated.time_factor = FAST;
    };
    let csv = crate::api::bodies::exact_csv();
    let order = |measured: &Value| {
        json!({"measurement_id": id(measured),
            "target": {"deflection_deg": 0.3, "pitch_deg": 1.0, "y_c0_mm": -7.0, "z_c0_mm": 6.0}})
    };
    let service = crate::api::harness::start_on(&folder, with_cell);
    let before = service.post("/v1/measurements", &csv).expect(201);
    service.stop();
    let service = crate::api::harness::start_on(&folder, with_cell);
    super::until(&service, "/v1/cell", |cell| cell["state"] == "idle");
    let again = |service: &crate::api::harness::Running| {
        service.post_json("/v1/measurements", &json!({"scan_id": before["provenance"]["scan_id"]})).expect(201)
    };
    for old in [&before, &again(&service)] {
        let stale = service.post_json("/v1/plans", &order(old)).problem(409, "plan_stale");
        assert!(stale["detail"].as_str().is_some_and(|text| text.contains("was restarted")), "{stale}");
    }
    let uploaded = service.post("/v1/measurements", &csv).expect(201);
    for fresh in [&uploaded, &again(&service)] {
        let answer = service.post_json("/v1/plans", &order(fresh));
        assert!(!answer.text().contains("plan_stale"), "{}", answer.text());
    }
}

#[test]
fn measuring_a_scan_again_does_not_make_its_pose_newer() {
    let line = Line::ready(FAST);
    let measured = line.measure();
    let order = |measured: &serde_json::Value| {
        json!({"measurement_id": id(measured),
            "target": {"deflection_deg": 0.3, "pitch_deg": 1.0, "y_c0_mm": -7.0, "z_c0_mm": 6.0}})
    };
    let again = || {
        let order = json!({"scan_id": measured["provenance"]["scan_id"]});
        line.service.post_json("/v1/measurements", &order).expect(201)
    };
    let plan = line.service.post_json("/v1/plans", &order(&again())).expect(201);
    let begun = line.act(&format!("/v1/plans/{}/execute", id(&plan))).expect(201);
    assert_eq!(line.wait_for(&begun)["state"], "done");
    line.service.post_json("/v1/plans", &order(&again())).problem(409, "plan_stale");
    // A new upload states that the scan shows the part as it is now.
    line.service.post_json("/v1/plans", &order(&line.measure())).problem(422, "nothing_to_move");
}

#[test]
fn a_client_without_the_lease_does_not_affect_its_holder() {
    let line = Line::ready(FAST);
    let measured = line.measure();
    let order = json!({"measurement_id": id(&measured),
        "target": {"deflection_deg": 0.3, "pitch_deg": 1.0, "y_c0_mm": -7.0, "z_c0_mm": 6.0}});
    let plan = line.service.post_json("/v1/plans", &order).expect(201);
    let other = json!({"m1": {"y_mm": 1.0}, "m2": {"y_mm": 1.0}, "lease_id": "l-other"});
    line.service.post_json("/v1/moves", &other).problem(423, "lease_held");
    let other = json!({"lease_id": "l-other"});
    line.service.post_json("/v1/manipulators/m1/home", &other).problem(423, "lease_held");
    assert_eq!(line.service.get("/v1/moves").expect(200)["moves"], json!([]), "nothing was written down");
    line.act(&format!("/v1/plans/{}/execute", id(&plan))).expect(201);
}

#[test]
fn a_pose_that_is_too_old_is_refused_for_motion() {
    let line = Line::ready_with(FAST, |config| config.cell.plan_age_max_s = 1);
    let measured = line.measure();
    let order = json!({"measurement_id": id(&measured),
        "target": {"deflection_deg": 0.3, "pitch_deg": 1.0, "y_c0_mm": -7.0, "z_c0_mm": 6.0}});
    let plan = line.service.post_json("/v1/plans", &order).expect(201);
    // Only time has to pass, and no event marks this, so the test waits for an event that does not occur.
    let newest = line.service.get("/v1/events?after=0").expect(200)["newest"].as_u64().expect("a number");
    line.service.get(&format!("/v1/events?after={newest}&wait_s=2")).expect(200);
    let stale = line.act(&format!("/v1/plans/{}/execute", id(&plan))).problem(409, "plan_stale");
    assert_eq!(stale["max_s"], 1);
}

#[test]
fn an_invalid_scan_is_refused_and_not_recorded() {
    let line = Line::ready(FAST);
    let refused = |body| line.post("/v1/measurements", &body);
    let problem = refused(json!({"source": "sensor", "profiles_count": 1})).problem(422, "option_invalid");
    assert_eq!(problem["field"], "profiles_count");
    for (field, value) in [("x_from_mm", -4000.0), ("x_to_mm", 4000.0), ("speed_mm_s", 50000.0)] {
        let problem = refused(json!({"source": "sensor", field: value})).problem(422, "scan_out_of_range");
        assert_eq!((&problem["field"], &problem["value"]), (&json!(field), &json!(value)), "{problem}");
        assert!(problem["detail"].as_str().is_some_and(|text| text.len() < 120), "{problem}");
    }
    refused(json!({"source": "camera"})).problem(422, "json_invalid");
    refused(json!({"source": "sensor", "recipe": "none"})).problem(404, "recipe_unknown");
    let scan = line.service.post_json("/v1/measurements", &json!({"source": "sensor"}));
    scan.problem(409, "lease_required");
    assert_eq!(line.service.get("/v1/measurements").expect(200)["measurements"], json!([]));
}
