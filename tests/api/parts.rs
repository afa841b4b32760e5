//! Several parts in one scan: each has its pose, verdict, profiles and pictures, and the recipe may set values for each.

use crate::api::bodies::{exact_csv, two_parts_csv};
use crate::api::harness::{Folder, Running, start, start_on};
use insta::{assert_json_snapshot, rounded_redaction};
use serde_json::{Value, json};

/// Digits that an exact scan determines; the rest is rounding.
const DIGITS: usize = 6;

/// A window for each of the two parts; that of the first excludes its last profile.
fn windows() -> Value {
    json!({"windows": [
        {"name": "fixed", "x_min_mm": 150, "x_max_mm": 400, "nominal_radius_mm": 150},
        {"name": "moving", "x_min_mm": 0, "x_max_mm": 105, "nominal_radius_mm": 200}
    ]})
}

fn measured(service: &Running, name: &str, parts: &Value) -> Value {
    let recipe = json!({"method": "cylinder", "parts": parts});
    service.put(&format!("/v1/recipes/{name}"), &[], &recipe).expect(201);
    service.post(&format!("/v1/measurements?recipe={name}"), &two_parts_csv()).expect(201)
}

fn address(measurement: &Value) -> String {
    format!("/v1/measurements/{}", measurement["id"].as_str().expect("an id"))
}

#[test]
fn both_parts_of_a_scan_have_their_poses_in_the_answer() {
    let (service, _folder) = start();
    let measurement = measured(&service, "two", &windows());
    assert_eq!(service.get(&address(&measurement)).expect(200), measurement);
    assert_eq!((&measurement["verdict"], &measurement["parts_count"]), (&json!("accepted"), &json!(2)));
    for single in ["pose", "uncertainty", "conditioning", "residuals", "refusal"] {
        assert_eq!(measurement[single], Value::Null, "there are two of {single}");
    }
    // Truth: the values with which the parts were simulated.
    for (index, name, p, q, y0, z0, radius) in
        [(0, "moving", 0.01_f64, -0.02_f64, 1.5, -2.5, 200.0), (1, "fixed", -0.02, 0.01, 7.0, -45.0, 150.0)]
    {
        let part = &measurement["parts"][index];
        assert_eq!(part["name"], name);
        let near = |field: &str, truth: f64| {
            let value = part["pose"][field].as_f64().expect(field);
            assert!((value - truth).abs() < 1e-5, "{field} of {name}: {value} where {truth} is true");
        };
        near("deflection_deg", p.atan().to_degrees());
        near("pitch_deg", q.atan().to_degrees());
        near("y_c0_mm", y0);
        near("z_c0_mm", z0);
        near("radius_mm", radius);
    }
    let mut parts = measurement["parts"].clone();
    for part in parts.as_array_mut().expect("a list") {
        assert!(part["uncertainty"]["budget"].is_array());
        part["uncertainty"] = json!("[uncertainty]");
        part["pose"]
            .as_object_mut()
            .expect("a pose")
            .retain(|field, _| field.starts_with("y_") || field == "radius_mm");
    }
    assert_json_snapshot!("parts", parts, {
        "[].pose.*" => rounded_redaction(DIGITS), "[].residuals.*" => rounded_redaction(DIGITS),
        "[].conditioning.*" => rounded_redaction(DIGITS),
    });
    assert_eq!(
        measurement["profiles"],
        json!({"total_count": 24, "valid_count": 23, "rejected": {"outside_parts": 1}}),
        "the window ends before the profile at x = 110 mm"
    );
}

#[test]
fn parts_are_found_by_their_gap_and_their_number_is_checked() {
    let (service, _folder) = start();
    let found = measured(&service, "gap", &json!({"by_gap": {}}));
    let of_parts = |field: &str| [&found["parts"][0][field], &found["parts"][1][field]].map(Value::clone);
    assert_eq!(of_parts("name"), [json!("part_1"), json!("part_2")]);
    assert_eq!(
        (of_parts("x_min_mm"), of_parts("x_max_mm")),
        ([json!(0.0), json!(200.0)], [json!(110.0), json!(310.0)])
    );
    assert_eq!(found["provenance"]["recipe"]["parts"], json!({"by_gap": {"gap_min_mm": 20.0}}), "nothing is left out");

    let three = measured(&service, "three", &json!({"by_gap": {"gap_min_mm": 30, "count": 3}}));
    assert_eq!((&three["verdict"], &three["parts_count"]), (&json!("refused"), &json!(2)));
    let refusal = &three["refusal"];
    assert_eq!(refusal["code"], "parts_count_differs");
    assert_eq!(
        (&refusal["parts_count"], &refusal["parts_min_count"], &refusal["part"]),
        (&json!(2), &json!(3), &Value::Null)
    );
    assert_eq!(of_parts("verdict"), [json!("accepted"), json!("accepted")]);
    assert!(three["parts"].as_array().expect("a list").iter().all(|part| part["pose"].is_null()));
    let refused = service.get("/v1/measurements?verdict=refused").expect(200);
    assert_eq!(refused["measurements"].as_array().expect("a list").len(), 1);
    let metrics = service.get("/metrics").text();
    let count = |verdict: &str| metrics.lines().any(|line| line.contains(verdict) && line.ends_with(" 1"));
    assert!(count("verdict=\"accepted\"") && count("verdict=\"refused\""), "{metrics}");
    assert_eq!(service.get("/v1/status").expect(200)["last_verdict"], "refused");
}

#[test]
fn an_empty_window_is_refused_by_name_and_the_other_part_is_measured() {
    let (service, _folder) = start();
    let parts = json!({"windows": [
        {"name": "moving", "x_min_mm": 0, "x_max_mm": 120}, {"name": "nobody", "x_min_mm": 120, "x_max_mm": 190}
    ]});
    let measurement = measured(&service, "empty", &parts);
    assert_eq!((&measurement["verdict"], &measurement["parts"][0]["verdict"]), (&json!("refused"), &json!("accepted")));
    let refusal = &measurement["refusal"];
    assert_eq!((&refusal["code"], &refusal["part"]), (&json!("window_empty"), &json!("nobody")));
    assert!(refusal["detail"].as_str().expect("text").starts_with("part nobody: no profile lies"), "{refusal}");
    let own = &measurement["parts"][1];
    assert_eq!((&own["refusal"]["code"], &own["profiles"]["total_count"]), (&json!("window_empty"), &json!(0)));
    for picture in ["centres", "residual_map", "section", "end_view"] {
        assert_eq!(service.get(&format!("{}/plots/{picture}.svg?part=nobody", address(&measurement))).status, 200);
    }
    let view = service.get(&format!("{}?view=plc&part=2", address(&measurement))).expect(200);
    assert_eq!(
        (&view["verdict_code"], &view["refusal_code"], &view["pitch_udeg"]),
        (&json!(2), &json!(12), &Value::Null)
    );
}

#[test]
fn a_plc_reads_one_part_at_a_time() {
    let (service, _folder) = start();
    let measurement = measured(&service, "two", &windows());
    let address = address(&measurement);
    let view = |part: &str| service.get(&format!("{address}?view=plc{part}"));
    let (first, second) = (view("").expect(200), view("&part=2").expect(200));
    assert!(view("&part=2").body.len() < 1024);
    assert_eq!([&first["radius_um"], &second["radius_um"]], [&json!(200_000), &json!(150_000)]);
    assert_eq!([&first["part"], &second["part"]], [&json!(1), &json!(2)]);
    assert_eq!([&first["parts_count"], &first["profiles_total_count"]], [&json!(2), &json!(11)]);
    assert_eq!((view("&part=moving").expect(200), view("&part=fixed").expect(200)), (first, second));
    let unknown = view("&part=3").problem(404, "part_unknown");
    assert_eq!((&unknown["part"], &unknown["parts"]), (&json!("3"), &json!(["moving", "fixed"])));
    service.get(&format!("{address}?part=1")).problem(400, "query_invalid");
    let whole = service.post("/v1/measurements", &exact_csv()).expect(201);
    let address = self::address(&whole);
    let view = service.get(&format!("{address}?view=plc&part=1")).expect(200);
    assert_eq!((&view["part"], &view["parts_count"]), (&json!(1), &json!(1)));
    service.get(&format!("{address}?view=plc&part=2")).problem(404, "part_unknown");
    assert_eq!((&whole["parts"], &whole["parts_count"]), (&Value::Null, &Value::Null));
}

#[test]
fn every_profile_names_its_part_and_can_be_selected_by_it() {
    let (service, _folder) = start();
    let address = address(&measured(&service, "two", &windows()));
    let all = service.get(&format!("{address}/profiles")).expect(200)["profiles"].clone();
    let names: Vec<&Value> = all.as_array().expect("a list").iter().map(|profile| &profile["part"]).collect();
    let expected = [vec!["moving"; 11], vec![""], vec!["fixed"; 12]].concat();
    assert!(
        names.iter().zip(expected).all(|(name, expected)| name.as_str().unwrap_or_default() == expected),
        "{names:?}"
    );
    assert_eq!((&all[11]["reason"], &all[11]["verdict"]), (&json!("outside_parts"), &json!("rejected")));
    let second = service.get(&format!("{address}/profiles?part=fixed&limit=5")).expect(200);
    assert_eq!((&second["total_count"], &second["profiles"][0]), (&json!(12), &all[12]));
    let csv = service.get(&format!("{address}/profiles?part=2&format=csv")).text();
    assert_eq!(csv.lines().count(), 13);
    assert!(csv.lines().skip(1).all(|line| line.ends_with(",fixed")), "{csv}");
    service.get(&format!("{address}/profiles?part=3")).problem(404, "part_unknown");
}

#[test]
fn pictures_show_one_part() {
    let (service, _folder) = start();
    let address = address(&measured(&service, "two", &windows()));
    let picture = |name: &str| service.get(&format!("{address}/plots/{name}"));
    for (query, part) in [("", "moving"), ("?part=1", "moving"), ("?part=fixed", "fixed")] {
        for name in ["centres", "residual_map", "section", "end_view"] {
            let svg = picture(&format!("{name}.svg{query}")).text();
            assert!(svg.starts_with("<svg") && svg.contains(&format!(", part {part}")), "{name}{query}");
        }
    }
    assert!(picture("residual_map.svg?part=2").text().contains("radius 150.0000"));
    let section = picture("section.svg?profile=20").text();
    assert!(section.contains(", part fixed") && section.contains("profile 20 (12 to 23)"), "{section}");
    let outside = picture("section.svg?profile=11").text();
    assert!(outside.contains("profile 11 (0 to 23)") && outside.contains("outside_parts"), "{outside}");
    picture("section.svg?profile=24").problem(404, "profile_unknown");
    picture("section.svg?part=3").problem(404, "part_unknown");
    picture("section.svg?part=1&profile=3").problem(400, "query_invalid");
}

#[test]
fn an_invalid_value_is_refused_by_its_field() {
    let (service, _folder) = start();
    let refused =
        |parts: Value, code: &str| service.put("/v1/recipes/a", &[], &json!({ "parts": parts })).problem(422, code);
    let field = |parts: Value| refused(parts, "recipe_invalid")["field"].clone();
    assert_eq!(field(json!({"by_gap": {"gap_min_mm": 0}})), "parts.by_gap.gap_min_mm");
    assert_eq!(field(json!({"by_gap": {"count": 17}})), "parts.by_gap.count");
    assert_eq!(field(json!({"windows": []})), "parts.windows");
    let window = |name: &str, least: f64, most: f64| json!({"name": name, "x_min_mm": least, "x_max_mm": most});
    assert_eq!(field(json!({"windows": [window("a", 0.0, 2.0), window("b", 1.0, 3.0)]})), "parts.windows[1].x_min_mm");
    assert_eq!(field(json!({"windows": [window("a", 0.0, 2.0), window("a", 2.0, 3.0)]})), "parts.windows[1].name");
    for strange in
        [json!({"by_gap": {"gap": 3}}), json!({"windows": [{"name": "gap"}]}), json!({"gap": 1}), json!("two")]
    {
        let detail = refused(strange, "json_invalid")["detail"].clone();
        assert!(
            ["gap", "x_min_mm", "by_gap"].iter().any(|word| detail.as_str().expect("text").contains(word)),
            "{detail}"
        );
    }
    service.put("/v1/recipes/a", &[], &json!({"parts": "one"})).expect(201);
}

#[test]
fn the_command_gives_the_same_document_and_a_picture_of_every_part() {
    let folder = Folder::new();
    let service = start_on(&folder, |_| {});
    let online = measured(&service, "two", &windows());
    let own = Folder::new();
    let place = |name: &str| own.path().join(name).display().to_string();
    let (scan, recipe, plots, profiles) = (place("two.csv"), place("two.json"), place("plots"), place("profiles.csv"));
    std::fs::write(&scan, two_parts_csv()).expect("written");
    let text = json!({"method": "cylinder", "parts": windows()}).to_string();
    std::fs::write(&recipe, text).expect("written");
    let measure = |more: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_coaxis"));
        command.args(["measure", &scan, "--recipe", &recipe, "--json"]).args(more).output().expect("it runs")
    };
    let output = measure(&["--plots", &plots, "--profiles", &profiles]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let offline: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    for same in ["verdict", "parts_count", "parts", "profiles", "pose", "refusal", "conditioning"] {
        assert_eq!(offline[same], online[same], "{same}");
    }
    for part in ["moving", "fixed"] {
        for picture in ["centres", "residual_map", "section", "end_view"] {
            assert!(
                own.path().join("plots").join(part).join(picture).with_extension("svg").exists(),
                "{picture} of {part}"
            );
        }
    }
    let csv = service.get(&format!("{}/profiles?format=csv", address(&online))).text();
    assert_eq!(std::fs::read_to_string(&profiles).expect("written"), csv);
    std::fs::write(&recipe, json!({"parts": {"by_gap": {"count": 3}}}).to_string()).expect("written");
    assert_eq!(measure(&[]).status.code(), Some(2), "one refusal refuses the complete scan");
}
