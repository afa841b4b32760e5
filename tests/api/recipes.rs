//! Recipes: storing, replacing under a precondition, measuring with them.

use crate::api::bodies::{encoded, exact_csv};
use crate::api::harness::start;
use coaxis::geometry::AxisLine;
use coaxis::scan::decode::Format;
use coaxis::scan::synthetic::{Edge, Edges, Part};
use insta::assert_json_snapshot;
use serde_json::{Value, json};

#[test]
fn a_recipe_is_stored_read_listed_and_replaced_by_a_client_that_has_read_it() {
    let (service, _folder) = start();
    let path = "/v1/recipes/shaft-200";
    let first = service.put(path, &[], &json!({"nominal_radius_mm": 200.0, "points_min": 30}));
    assert_json_snapshot!("recipe", first.expect(201), { ".created_at" => "[time]", ".updated_at" => "[time]" });
    assert_eq!(service.get(path).header("etag"), first.header("etag"));
    assert_eq!(service.get("/v1/recipes").expect(200)["recipes"], json!([first.json()]));

    let blind = service.put(path, &[], &json!({})).problem(428, "precondition_required");
    assert_eq!(format!("\"{}\"", blind["current_etag"].as_str().expect("a tag")), first.header("etag"));
    let seen = service.put(path, &[("if-match", first.header("etag"))], &json!({"points_min": 40}));
    assert_eq!(seen.expect(200)["revision"], 2);
    let outdated = service.put(path, &[("if-match", first.header("etag"))], &json!({"points_min": 50}));
    assert_eq!(outdated.problem(412, "recipe_changed")["current_etag"], seen.json()["etag"]);
    service.put(path, &[("if-none-match", "*")], &json!({})).problem(412, "recipe_changed");
    assert_eq!(service.put(path, &[("if-match", "*")], &json!({})).expect(200)["revision"], 3);
    let absent = service.put("/v1/recipes/new", &[("if-match", "*")], &json!({})).problem(412, "recipe_changed");
    assert!(absent["detail"].as_str().expect("text").contains("there is no recipe new"), "{absent}");
    service.put(path, &[("if-match", "r1")], &json!({})).problem(400, "request_header_invalid");
}

#[test]
fn an_invalid_value_is_refused_when_the_recipe_is_stored() {
    let (service, _folder) = start();
    let refused = |body: Value, code: &str| service.put("/v1/recipes/a", &[], &body).problem(422, code);
    assert_eq!(refused(json!({"iterations_max": 51}), "recipe_invalid")["field"], "iterations_max");
    assert_eq!(refused(json!({"epsilon_noise_multiple": 3}), "recipe_invalid")["field"], "noise_sigma_mm");
    assert_eq!(refused(json!({"profile_by": "gap"}), "recipe_invalid")["field"], "profile_by");
    assert_eq!(refused(json!({"region": {"x_mm": [2, 1]}}), "recipe_invalid")["field"], "region.x_mm");
    let parallel = json!({"frame": {"origin_mm": [0, 0, 0], "x_axis": [1, 0, 0], "z_axis": [1, 0, 0]}});
    assert_eq!(refused(parallel, "recipe_invalid")["field"], "frame");
    let type_b = refused(json!({"type_b": {"temperature_sigma_k": -1.0}}), "recipe_invalid");
    assert!(type_b["detail"].as_str().expect("text").contains("type_b.temperature_sigma_k"), "{type_b}");
    let unknown = refused(json!({"epsilon": 0.1}), "json_invalid");
    assert!(unknown["detail"].as_str().expect("text").contains("epsilon"), "{unknown}");
    service.put("/v1/recipes/A", &[], &json!({})).problem(422, "option_invalid");
    let text = service.post_with("/v1/recipes/a", &[], b"");
    text.problem(405, "method_not_allowed");
    service.get("/v1/recipes/a").problem(404, "recipe_unknown");
}

#[test]
fn the_request_overrides_the_recipe_and_the_recipe_the_configuration() {
    let folder = crate::api::harness::Folder::new();
    let service = crate::api::harness::start_on(&folder, |config| {
        config.estimation.points_min = 25;
        config.estimation.arc_min_deg = 50.0;
    });
    let recipe = json!({
        "arc_min_deg": 55.0, "method": "section_line_plain", "region": {"x_mm": [0.0, 60.0]},
        "type_b": {"extrinsics_position_mm": 0.02}
    });
    service.put("/v1/recipes/part", &[], &recipe).expect(201);
    let measurement = service.post("/v1/measurements?recipe=part&method=section_line", &exact_csv()).expect(201);
    let used = &measurement["provenance"]["recipe"];
    assert_eq!(
        (&used["method"], &used["arc_min_deg"], &used["points_min"]),
        (&json!("section_line"), &json!(55.0), &json!(25))
    );
    assert_eq!(used["type_b"]["extrinsics_position_mm"], 0.02);
    let budget = measurement["uncertainty"]["budget"].as_array().expect("a list");
    let extrinsics = budget.iter().find(|line| line["source"] == "sensor_extrinsics").expect("a line of the budget");
    // Slightly more than 0.02 mm, because the part is tilted and a shift along the rail moves its axis at x_ref.
    assert!((extrinsics["y_ref_mm"].as_f64().expect("a number") - 0.02).abs() < 1e-4, "{extrinsics}");
    assert_eq!(measurement["provenance"]["recipe_name"], "part");
    assert_eq!(measurement["profiles"]["total_count"], 7, "x = 0, 10, … 60");
    let listed = service.get("/v1/measurements?recipe=part").expect(200);
    assert_eq!(listed["measurements"][0]["id"], measurement["id"]);
    assert_eq!(service.get("/v1/measurements?recipe=other").expect(200)["measurements"], json!([]));
}

#[test]
fn a_recipe_requests_end_faces_and_an_end_that_is_not_seen_is_null_with_a_warning() {
    let (service, _folder) = start();
    let axis = AxisLine { p: 0.02, q: 0.0, y0: 1.0, z0: 2.0 };
    let far = Some(Edge { x_mm: 80.25, ..Edge::default() });
    let part = Part {
        axis,
        length_mm: 100.0,
        profiles_count: 101,
        points_count: 100,
        edges: Edges { near: None, far },
        ..Part::smooth(1)
    };
    let scan = encoded(&part, Format::Json);
    for (asked, keys) in [("far", ["end_face", "far_end_face"]), ("both", ["far_end_face", "end_face"])] {
        service
            .put(&format!("/v1/recipes/{asked}"), &[], &json!({ "end_face": asked, "method": "cylinder" }))
            .expect(201);
        let measurement = service.post(&format!("/v1/measurements?format=json&recipe={asked}"), &scan).expect(201);
        let [seen, unseen] = keys;
        assert!(measurement["pose"][unseen].is_null(), "{measurement}");
        let error = measurement["pose"][seen]["x_mm"].as_f64().expect("a length") - 80.25;
        // Profiles 1 mm apart, columns 0.15 mm apart along the axis.
        assert!(error.abs() < 0.1, "{error} mm");
        let half_width = measurement["uncertainty"][format!("{seen}_x_mm")].as_f64().expect("a length");
        assert!(half_width > 0.0 && half_width < 0.3, "{half_width} mm");
        let ends: Vec<&Value> = measurement["conditioning"]["warnings"]
            .as_array()
            .expect("a list")
            .iter()
            .filter(|warning| warning["code"] == "end_face_not_seen")
            .map(|warning| &warning["end"])
            .collect();
        assert_eq!(ends, if asked == "both" { vec!["near"] } else { vec![] });
        let id = measurement["id"].as_str().expect("an id");
        assert_eq!(service.get(&format!("/v1/measurements/{id}")).expect(200), measurement, "as it was kept");
    }
    service.put("/v1/recipes/wrong", &[], &json!({ "end_face": "left" })).problem(422, "json_invalid");
}

#[test]
fn a_precondition_that_fails_does_not_advance_the_sequence() {
    let (service, _folder) = start();
    service.put("/v1/recipes/a", &[], &json!({"points_min": 33})).expect(201);
    let sequence = || service.get("/v1/status").expect(200)["sequence"].as_u64();
    let before = sequence();
    service.put("/v1/recipes/a", &[("if-match", "\"r7\"")], &json!({"points_min": 34})).problem(412, "recipe_changed");
    service.put("/v1/recipes/a", &[("if-none-match", "*")], &json!({"points_min": 34})).problem(412, "recipe_changed");
    assert_eq!(sequence(), before);
    service.put("/v1/recipes/a", &[("if-match", "\"r1\"")], &json!({"points_min": 34})).expect(200);
    assert!(sequence() > before);
}
