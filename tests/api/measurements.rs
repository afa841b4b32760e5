//! Measuring, repeating requests, reading results.

use crate::api::bodies::{csv, exact_csv};
use crate::api::harness::{Running, start};
use insta::{assert_json_snapshot, assert_snapshot, rounded_redaction};
use serde_json::{Value, json};

/// Digits that an exact scan determines; the rest is rounding.
const DIGITS: usize = 6;

fn measured(service: &Running) -> Value {
    service.post("/v1/measurements?nominal_radius_mm=200", &exact_csv()).expect(201)
}

fn id_of(measurement: &Value) -> &str {
    measurement["id"].as_str().expect("an id")
}

#[test]
fn an_uploaded_scan_is_measured_and_recorded_in_one_request() {
    let (service, _folder) = start();
    let answer = service.post("/v1/measurements?nominal_radius_mm=200", &exact_csv());
    let measurement = answer.expect(201);
    assert_eq!(answer.header("location"), format!("/v1/measurements/{}", id_of(&measurement)));
    assert_eq!(service.get(answer.header("location")).expect(200), measurement);
    // Truth: simulated with p = 0.01, q = −0.02, y0 = 1.5, z0 = −2.5, R = 200.
    let pose = &measurement["pose"];
    let near = |name: &str, truth: f64| assert!((pose[name].as_f64().expect(name) - truth).abs() < 1e-6, "{pose}");
    near("deflection_deg", 0.01_f64.atan().to_degrees());
    near("pitch_deg", (-0.02_f64).atan().to_degrees());
    near("y_c0_mm", 1.5);
    near("z_c0_mm", -2.5);
    near("radius_mm", 200.0);
    assert_json_snapshot!("measurement", measurement, {
        ".id" => "[id]", ".created_at" => "[time]", ".duration_ms" => "[ms]",
        ".pose.*" => rounded_redaction(DIGITS), ".pose.direction.*" => rounded_redaction(DIGITS),
        ".pose.axis.*.*" => rounded_redaction(DIGITS),
        ".uncertainty" => insta::dynamic_redaction(|value, _| { shape_of(&value) }),
        ".residuals.*" => rounded_redaction(DIGITS), ".conditioning.*" => rounded_redaction(DIGITS),
        ".provenance.software" => "[software]",
    });
}

/// The keys without the numbers, which for an exact scan are only rounding.
fn shape_of(value: &insta::internals::Content) -> insta::internals::Content {
    use insta::internals::Content;
    match value {
        Content::Map(pairs) => Content::Map(pairs.iter().map(|(key, value)| (key.clone(), shape_of(value))).collect()),
        Content::Seq(items) => Content::Seq(items.iter().map(shape_of).collect()),
        Content::F64(_) | Content::U64(_) | Content::I64(_) => Content::from("[number]"),
        other => other.clone(),
    }
}

#[test]
fn the_same_bytes_give_the_same_numbers_from_upload_and_from_the_stored_scan() {
    let (service, _folder) = start();
    let first = measured(&service);
    let order = json!({"scan_id": first["provenance"]["scan_id"], "nominal_radius_mm": 200.0});
    let second = service.post_json("/v1/measurements", &order).expect(201);
    assert_ne!(first["id"], second["id"]);
    for part in ["pose", "uncertainty", "conditioning", "profiles", "residuals", "provenance"] {
        assert_eq!(first[part], second[part]);
    }
}

#[test]
fn a_refusal_is_a_record_with_its_reason_and_no_pose() {
    let (service, _folder) = start();
    let scan = crate::api::bodies::csv((0..30).map(|i| (0, [0.0, f64::from(i), (900.0 - f64::from(i * i)).sqrt()])));
    let measurement = service.post("/v1/measurements", &scan).expect(201);
    assert_eq!(measurement["verdict"], "refused");
    assert_eq!(measurement["refusal"]["code"], "too_few_profiles");
    assert_eq!(measurement["refusal"]["profiles_count"], 1);
    assert_eq!((&measurement["pose"], &measurement["uncertainty"]), (&Value::Null, &Value::Null));
    let listed = service.get("/v1/measurements?verdict=refused").expect(200);
    assert_eq!(listed["measurements"], json!([measurement]));
    assert_eq!(service.get("/v1/measurements?verdict=accepted").expect(200)["measurements"], json!([]));
}

#[test]
fn a_repeated_request_gets_the_first_answer_again() {
    let (service, _folder) = start();
    let path = "/v1/measurements?request_id=order-7";
    let first = service.post(path, &exact_csv()).expect(201);
    let again = service.post(path, &exact_csv());
    assert_eq!(again.expect(200), first);
    assert_eq!(again.header("idempotency-replayed"), "true");
    let by_header = service.post_with("/v1/measurements", &[("idempotency-key", "order-7")], &exact_csv());
    assert_eq!(by_header.expect(200), first);
    let other = service.post("/v1/measurements?request_id=order-7&method=section_line_plain", &exact_csv());
    assert_eq!(other.problem(422, "request_id_reused")["reused_request_id"], "order-7");
    let twice = service.post_with(path, &[("idempotency-key", "order-8")], &exact_csv());
    twice.problem(422, "option_invalid");
    assert_eq!(service.get("/v1/measurements").expect(200)["measurements"].as_array().expect("list").len(), 1);
}

#[test]
fn two_simultaneous_requests_of_the_same_id_create_one_record() {
    let (service, _folder) = start();
    let answers: Vec<_> = std::thread::scope(|scope| {
        let ask = || service.post("/v1/measurements?request_id=at-once", &exact_csv());
        let both = [scope.spawn(ask), scope.spawn(ask)];
        both.map(|thread| thread.join().expect("answered")).into_iter().collect()
    });
    assert_eq!(answers[0].json()["id"], answers[1].json()["id"]);
    let mut statuses = [answers[0].status, answers[1].status];
    statuses.sort_unstable();
    assert_eq!(statuses, [200, 201]);
}

#[test]
fn the_list_is_paged_newest_first() {
    let (service, _folder) = start();
    let ids: Vec<_> = (0..5).map(|_| measured(&service)["id"].clone()).collect();
    let mut path = "/v1/measurements?limit=2".to_owned();
    let mut seen = Vec::new();
    loop {
        let answer = service.get(&path);
        let page = answer.expect(200);
        seen.extend(page["measurements"].as_array().expect("list").iter().map(|m| m["id"].clone()));
        let link = answer.header("link");
        assert_eq!(link.is_empty(), page["next_cursor"].is_null());
        if link.is_empty() {
            break;
        }
        path = link.strip_prefix('<').and_then(|l| l.strip_suffix(">; rel=\"next\"")).expect("a link").to_owned();
    }
    assert!(seen.iter().eq(ids.iter().rev()));
    service.get("/v1/measurements?cursor=00").problem(400, "cursor_malformed");
    assert_eq!(service.get("/v1/measurements?limit=0").problem(400, "query_invalid")["limit_max"], 1000);
}

/// Every member except the id is an integer or null.
fn assert_integers(view: &Value) {
    for (key, value) in view.as_object().expect("flat").iter().filter(|(key, _)| *key != "id") {
        assert!(value.is_i64() || value.is_null(), "{key}: {value}");
    }
}

#[test]
fn a_plc_gets_integers_in_less_than_1024_bytes() {
    let (service, _folder) = start();
    let measurement = measured(&service);
    let answer = service.get(&format!("/v1/measurements/{}?view=plc&wait_s=20", id_of(&measurement)));
    let view = answer.expect(200);
    assert!(answer.body.len() < 1024, "{}", answer.body.len());
    assert_integers(&view);
    assert!(view["end_face_x_um"].is_null() && view["far_end_face_z_um"].is_null(), "not requested");
    assert_eq!(
        (&view["y_c0_um"], &view["pitch_udeg"], &view["radius_um"]),
        (&json!(1500), &json!(-1_145_763), &json!(200_000))
    );
    for (expanded, up) in [("y_c0_mm", "u_y_c0_um"), ("z_c0_mm", "u_z_c0_um"), ("radius_mm", "u_radius_um")] {
        let um = measurement["uncertainty"][expanded].as_f64().expect("known") * 1e3;
        assert_eq!(view[up].as_f64(), Some(um.ceil()), "{up} is rounded up from {um}");
    }
    assert_eq!((&view["warnings_count"], &view["warnings_mask"]), (&json!(1), &json!(1024)), "calibration_not_stated");
    assert_json_snapshot!("plc_view", view, { ".id" => "[id]" });
}

#[test]
fn every_kind_of_measurement_request_can_answer_with_the_plc_view() {
    let (service, _folder) = start();
    let answer = service.post("/v1/measurements?view=plc&request_id=plc", &exact_csv());
    let view = answer.expect(201);
    assert!(answer.header("location").ends_with(view["id"].as_str().expect("an id")));
    assert_eq!(service.get(&format!("{}?view=plc", answer.header("location"))).expect(200), view);
    assert_eq!(service.post("/v1/measurements?view=plc&request_id=plc", &exact_csv()).expect(200), view);
    let whole = service.get(answer.header("location")).expect(200);
    let order = json!({"scan_id": whole["provenance"]["scan_id"]});
    let kept = service.post_json("/v1/measurements?view=plc", &order).expect(201);
    assert_eq!((&kept["y_c0_um"], &kept["verdict_code"]), (&view["y_c0_um"], &json!(1)));
    assert_eq!(service.post("/v1/measurements?view=full", &exact_csv()).expect(201)["verdict"], "accepted");
}

#[test]
fn an_unknown_view_is_400_everywhere() {
    let (service, _folder) = start();
    let id = id_of(&measured(&service)).to_owned();
    service.post("/v1/measurements?view=plcs", &exact_csv()).problem(400, "query_invalid");
    service.post("/v1/scans?view=plcs", &exact_csv()).problem(400, "query_invalid");
    for path in [
        "/v1/measurements",
        &format!("/v1/measurements/{id}"),
        &format!("/v1/measurements/{id}/profiles"),
        &format!("/v1/measurements/{id}/plots/section.svg"),
        "/v1/scans",
        "/v1/recipes",
        "/v1/status",
        "/v1/events",
        "/v1/cell",
        "/v1/cell/lease",
        "/v1/manipulators",
        "/v1/manipulators/m1",
        "/v1/moves",
        "/v1/moves/v-1",
        "/v1/plans",
        "/v1/plans/p-1",
    ] {
        service.get(&format!("{path}?view=plcs")).problem(400, "query_invalid");
    }
}

#[test]
fn times_have_six_decimals_of_the_second_in_every_document() {
    fn check(value: &Value) -> usize {
        match value {
            Value::Object(object) => object
                .iter()
                .map(|(key, value)| match value.as_str().filter(|_| key.ends_with("_at") || key == "at") {
                    Some(time) => {
                        assert!(
                            time.len() == 27 && time.as_bytes()[19] == b'.' && time.ends_with('Z'),
                            "{key}: {time}"
                        );
                        1
                    }
                    None => check(value),
                })
                .sum(),
            Value::Array(array) => array.iter().map(check).sum(),
            _ => 0,
        }
    }
    let (service, _folder) = start();
    service.put("/v1/recipes/a", &[], &json!({"points_min": 33})).expect(201);
    let documents = [
        measured(&service),
        service.get("/v1/measurements").expect(200),
        service.get("/v1/scans").expect(200),
        service.get("/v1/recipes/a").expect(200),
        service.get("/v1/status").expect(200),
    ];
    assert!(documents.iter().all(|document| check(document) > 0));
}

#[test]
fn profiles_are_available_as_json_csv_or_ndjson() {
    let (service, _folder) = start();
    let path = format!("/v1/measurements/{}/profiles", id_of(&measured(&service)));
    let page = service.get(&format!("{path}?limit=5&cursor=10"));
    let document = page.expect(200);
    assert_eq!(document["total_count"], 12);
    assert_eq!(document["profiles"].as_array().expect("list").len(), 2);
    assert_eq!(document["profiles"][0]["index"], 10);
    let first = service.get(&format!("{path}?limit=5"));
    assert!(first.header("link").contains("cursor=5"), "{}", first.header("link"));

    let csv = service.get_with(&path, &[("accept", "text/csv")]);
    assert_eq!(csv.header("content-type"), "text/csv; charset=utf-8; header=present");
    let text = csv.text();
    assert_eq!(text.matches("\r\n").count(), 13);
    assert_snapshot!("profiles_csv_header", text.lines().next().expect("a header"));
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    assert!(rows.iter().all(|row| row.len() == rows[0].len()));

    let lines = service.get_with(&path, &[("accept", "application/x-ndjson")]).text();
    let documents: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    assert_eq!(documents[10], document["profiles"][0]);
    assert_eq!(service.get(&format!("{path}?format=csv")).text(), text);
    let refused = service.get_with(&path, &[("accept", "image/png")]).problem(406, "not_acceptable");
    assert_eq!(refused["offered"], json!(["application/json", "text/csv", "application/x-ndjson"]));
}

#[test]
fn pictures_are_drawn_from_the_stored_scan() {
    let (service, _folder) = start();
    let id = id_of(&measured(&service)).to_owned();
    for picture in ["centres", "residual_map", "section", "end_view"] {
        let answer = service.get(&format!("/v1/measurements/{id}/plots/{picture}.svg"));
        assert_eq!((answer.status, answer.header("content-type")), (200, "image/svg+xml"));
        assert!(answer.text().starts_with("<svg") && answer.text().contains(&id));
    }
    assert_eq!(service.get(&format!("/v1/measurements/{id}/plots/section.svg?profile=11")).status, 200);
    let beyond = service.get(&format!("/v1/measurements/{id}/plots/section.svg?profile=12"));
    assert_eq!(beyond.problem(404, "profile_unknown")["profiles_count"], 12);
    service.get(&format!("/v1/measurements/{id}/plots/nothing.svg")).problem(404, "route_unknown");
}

#[test]
fn pictures_state_when_and_with_which_recipe_it_was_measured_and_the_result_with_its_uncertainty() {
    let (service, _folder) = start();
    service.put("/v1/recipes/shaft", &[], &json!({"nominal_radius_mm": 200})).expect(201);
    let measurement = service.post("/v1/measurements?recipe=shaft", &exact_csv()).expect(201);
    let created_at = measurement["created_at"].as_str().expect("a time").replace('T', " ");
    let measured_at = format!("measured {} UTC", &created_at[..19]);
    for picture in ["centres", "residual_map", "section", "end_view"] {
        let svg = service.get(&format!("/v1/measurements/{}/plots/{picture}.svg", id_of(&measurement))).text();
        for words in [measured_at.as_str(), "recipe shaft", "method cylinder", "deflection", "k = 2", "coaxis "] {
            assert!(svg.contains(words), "{picture}: {words}");
        }
    }
}

#[test]
fn pictures_of_a_refused_scan_show_its_points_and_the_reason() {
    let (service, _folder) = start();
    // A level plane, so there is no cylinder.
    let place = |index: usize| [(index / 60) as f64 * 5.0, (index % 60) as f64 - 30.0, (index * 7 % 13) as f64 * 0.01];
    let level = csv((0..12 * 60).map(|index| (index / 60, place(index))));
    let measurement = service.post("/v1/measurements", &level).expect(201);
    assert_eq!(measurement["verdict"], "refused");
    let code = measurement["refusal"]["code"].as_str().expect("a code");
    for (picture, mark) in [("centres", "h0"), ("residual_map", "v1h-"), ("section", "h0"), ("end_view", "h0")] {
        let svg = service.get(&format!("/v1/measurements/{}/plots/{picture}.svg", id_of(&measurement))).text();
        assert!(svg.contains(&format!("Refused ({code})")), "{picture}");
        assert!(svg.matches(mark).count() >= 60, "{picture}: {}", svg.matches(mark).count());
    }
}

#[test]
fn an_unknown_resource_is_404_with_the_id() {
    let (service, _folder) = start();
    let id = "m-0199f0c8-0000-7000-8000-000000000000";
    for path in ["", "/profiles", "/plots/centres.svg"] {
        let problem = service.get(&format!("/v1/measurements/{id}{path}")).problem(404, "measurement_unknown");
        assert_eq!(problem["measurement_id"], id);
    }
    let scan = format!("s-{}", "0".repeat(64));
    service.post_json("/v1/measurements", &json!({"scan_id": scan})).problem(404, "scan_unknown");
    service.post("/v1/measurements?recipe=nobody", &exact_csv()).problem(404, "recipe_unknown");
}

#[test]
fn an_order_in_json_and_a_scan_in_json_are_distinguished() {
    let (service, _folder) = start();
    let points: Vec<_> = (0..40)
        .map(|i| {
            let a = 0.5 + f64::from(i) * 0.05;
            json!([50.0 * a.cos(), 50.0 * a.sin()])
        })
        .collect();
    let profiles: Vec<_> = (0..4).map(|i| json!({"x_mm": f64::from(i) * 10.0, "points": points})).collect();
    let scan = json!({ "profiles": profiles });
    let uploaded = service.post_json("/v1/measurements", &scan).expect(201);
    assert_eq!((&uploaded["provenance"]["format"], &uploaded["verdict"]), (&json!("json"), &json!("accepted")));
    let mixed = json!({"scan_id": "s-1", "profiles": []});
    service.post_json("/v1/measurements", &mixed).problem(422, "json_invalid");
    service.post_json("/v1/measurements", &json!({"method": "section_line"})).problem(422, "json_invalid");
    let mistyped = json!({"scan_id": uploaded["provenance"]["scan_id"], "nominal_radius": 50});
    let problem = service.post_json("/v1/measurements", &mistyped).problem(422, "json_invalid");
    assert!(problem["detail"].as_str().expect("text").contains("nominal_radius"), "{problem}");
    service
        .post_with("/v1/measurements", &[("content-type", "application/json")], b"{\"scan_id\": ")
        .problem(400, "json_malformed");
}
