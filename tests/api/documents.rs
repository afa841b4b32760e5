//! The OpenAPI document, its examples and the page that shows it.

use crate::api::harness::start;
use crate::timed::cell::{FAST, Line};
use coaxis::http::{COMMITTED, Code, openapi_json};
use serde_json::Value;
use std::io::Read;

/// If set, the test writes the document instead of comparing it.
const UPDATE: &str = "UPDATE_OPENAPI";

#[test]
fn the_committed_document_equals_that_of_the_code() {
    let generated = openapi_json().expect("a document");
    if std::env::var_os(UPDATE).is_some() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi/coaxis.json");
        std::fs::write(path, generated).expect("written");
        return;
    }
    assert!(
        generated == COMMITTED,
        "openapi/coaxis.json is out of date; run the tests with {UPDATE}=1 once and read its diff"
    );
}

#[test]
fn the_page_of_problems_contains_the_table_of_problem_codes() {
    let page = include_str!("../../docs/problems.md");
    assert!(page.contains(&Code::table()), "write what `coaxis openapi --problems` prints into docs/problems.md");
}

#[test]
fn the_document_is_served_as_it_is_committed() {
    let (service, _folder) = start();
    let answer = service.get("/openapi.json");
    assert_eq!(
        (answer.status, answer.header("content-type"), answer.text().as_str()),
        (200, "application/json", COMMITTED)
    );
}

#[test]
fn the_page_loads_nothing_from_other_hosts() {
    let (service, _folder) = start();
    let page = service.get("/docs");
    assert_eq!((page.status, page.header("content-type")), (200, "text/html; charset=utf-8"));
    assert!(page.header("content-security-policy").contains("script-src 'self'"));
    let text = page.text();
    let addresses = text.split(['"']).filter(|part| part.starts_with('/') || part.contains("://"));
    for address in addresses {
        assert!(address.starts_with("/docs/"), "{address}");
        let file = service.get(address);
        assert_eq!((file.status, file.header("x-content-type-options")), (200, "nosniff"), "{address}");
    }
    service.get("/docs/nothing.js").problem(404, "route_unknown");
}

#[test]
fn the_scripts_of_the_page_are_sent_compressed_and_declare_it() {
    let (service, _folder) = start();
    let script = service.get("/docs/swagger-ui-bundle.js");
    assert_eq!((script.status, script.header("content-encoding")), (200, "gzip"));
    let mut text = String::new();
    flate2::read::GzDecoder::new(script.body.as_slice()).read_to_string(&mut text).expect("gzip of text");
    assert!(text.contains("SwaggerUIBundle") && script.body.len() * 2 < text.len(), "{}", script.body.len());
}

fn operations(document: &Value) -> impl Iterator<Item = (&str, &str, &Value)> {
    let paths = document["paths"].as_object().expect("paths").iter();
    paths.flat_map(|(path, item)| {
        let methods = item.as_object().expect("an item").iter();
        methods.map(move |(method, operation)| (path.as_str(), method.as_str(), operation))
    })
}

#[test]
fn every_operation_has_a_name_a_summary_and_its_refusals() {
    let document: Value = serde_json::from_str(COMMITTED).expect("JSON");
    for (path, method, operation) in operations(&document) {
        let id = operation["operationId"].as_str().expect("a name");
        let verb = id.split('_').next().expect("a verb");
        let verbs = [
            "create", "list", "get", "put", "take", "release", "stop", "reset", "enable", "disable", "home", "execute",
        ];
        assert!(verbs.contains(&verb), "{id}");
        assert!(!operation["summary"].as_str().expect("a summary").is_empty(), "{method} {path}");
        let responses = operation["responses"].as_object().expect("responses");
        assert!(responses.keys().any(|status| status.starts_with('2')), "{id}");
        for (status, response) in responses.iter().filter(|(status, _)| status.as_str() >= "400") {
            let schema = &response["content"]["application/problem+json"]["schema"]["$ref"];
            assert_eq!(schema, "#/components/schemas/Problem", "{id} {status}");
        }
    }
}

#[test]
fn every_example_of_a_body_works() {
    let line = Line::ready(FAST);
    let document: Value = serde_json::from_str(COMMITTED).expect("JSON");
    for (name, send) in EXAMPLES {
        let example = &document["components"]["schemas"][name]["example"];
        assert!(example.is_object(), "{name} has no example");
        send(&line, example);
    }
}

type Send = fn(&Line, &Value);

/// Bodies of requests, and their addresses.
const EXAMPLES: [(&str, Send); 8] = [
    ("JsonScan", |line, example| {
        line.service.post_json("/v1/measurements", example).expect(201);
    }),
    ("Recipe", |line, example| {
        line.service.put("/v1/recipes/example", &[], example).expect(201);
    }),
    ("MeasurementOrder", |line, example| {
        let service = &line.service;
        // The scan of the example does not exist; it is replaced by one that does.
        service.post_json("/v1/measurements", example).problem(404, "scan_unknown");
        let scan = service.post("/v1/scans", &crate::api::bodies::exact_csv()).expect(201);
        let mut order = example.clone();
        order["scan_id"] = scan["id"].clone();
        service.post_json("/v1/measurements", &order).expect(201);
    }),
    ("SensorOrder", |line, example| {
        let begun = line.post("/v1/measurements", example).expect(201);
        line.service.get(&format!("/v1/measurements/{}?wait_s=30", begun["id"].as_str().expect("an id"))).expect(200);
    }),
    ("PlanRequest", |line, example| {
        line.service.post_json("/v1/plans", example).problem(404, "measurement_unknown");
        let mut order = example.clone();
        order["measurement_id"] = line.measure()["id"].clone();
        line.service.post_json("/v1/plans", &order).expect(201);
    }),
    ("MoveRequest", |line, example| {
        let begun = line.post("/v1/moves", example).expect(201);
        assert_eq!(line.wait_for(&begun)["state"], "done");
    }),
    ("LeaseRequest", |line, example| {
        line.service.post_json("/v1/cell/lease", example).problem(423, "lease_held");
        line.service.delete(&format!("/v1/cell/lease?lease_id={}", line.lease)).expect(200);
        line.service.post_json("/v1/cell/lease", example).expect(201);
    }),
    ("LeaseReference", |line, example| {
        line.service.post_json("/v1/cell/reset", example).problem(423, "lease_held");
    }),
];
