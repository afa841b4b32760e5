//! The API policy of docs/releasing.md: compares `openapi/coaxis.json` with the document of the last release,
//! `openapi/last-release.json`, and fails on a change that can break a client, unless `openapi/changes-since-release.toml` lists it
//! with a reason.
//!
//! A change breaks a client if a request that was valid is refused or has another meaning, or if an answer lacks a member or
//! contains a value that the document excluded. New paths, optional parameters, properties of answers, values of an enumeration and
//! problem codes are compatible, because clients must accept them. Schemas are compared where operations use them, so the name of a
//! schema may change.

#![expect(clippy::expect_used, clippy::indexing_slicing, reason = "a test may fail")]

use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, BTreeSet};

const RELEASED: &str = include_str!("../openapi/last-release.json");
const CURRENT: &str = include_str!("../openapi/coaxis.json");
const LISTED: &str = include_str!("../openapi/changes-since-release.toml");

const METHODS: [&str; 8] = ["get", "put", "post", "delete", "options", "head", "patch", "trace"];
/// Keywords without effect on what a client may send or receive.
const PROSE: [&str; 8] =
    ["description", "title", "summary", "example", "examples", "tags", "externalDocs", "deprecated"];
/// Bounds with +1 if a larger value admits less, -1 if it admits more.
const BOUNDS: [(&str, f64); 8] = [
    ("minimum", 1.0),
    ("exclusiveMinimum", 1.0),
    ("minLength", 1.0),
    ("minItems", 1.0),
    ("maximum", -1.0),
    ("exclusiveMaximum", -1.0),
    ("maxLength", -1.0),
    ("maxItems", -1.0),
];

/// Decides what is compatible: a request may admit more than before, an answer may contain less.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Direction {
    Request,
    Answer,
}

impl Direction {
    fn name(self) -> &'static str {
        match self {
            Self::Request => "request",
            Self::Answer => "answer",
        }
    }
}

/// A schema without references and `allOf`; its alternatives were separated before.
#[derive(Default)]
struct Shape<'a> {
    types: BTreeSet<&'a str>,
    nullable: bool,
    properties: BTreeMap<&'a str, &'a Value>,
    required: BTreeSet<&'a str>,
    /// Every other keyword that has an effect.
    keywords: BTreeMap<&'a str, &'a Value>,
}

impl<'a> Shape<'a> {
    fn of(document: &'a Value, schema: &'a Value) -> Self {
        let mut shape = Self::default();
        shape.add(document, schema);
        shape
    }

    fn add(&mut self, document: &'a Value, schema: &'a Value) {
        for (keyword, value) in entries(schema) {
            match keyword {
                "$ref" => self.add(document, target(document, schema).1),
                "allOf" => elements(value).for_each(|part| self.add(document, part)),
                "type" => {
                    let types = value.as_str().into_iter().chain(elements(value).filter_map(Value::as_str));
                    types.for_each(
                        |name| if name == "null" { self.nullable = true } else { _ = self.types.insert(name) },
                    );
                }
                "properties" => self.properties.extend(entries(value)),
                "required" => self.required.extend(elements(value).filter_map(Value::as_str)),
                _ if PROSE.contains(&keyword) => {}
                _ => _ = self.keywords.insert(keyword, value),
            }
        }
    }
}

fn entries(object: &Value) -> impl Iterator<Item = (&str, &Value)> {
    object.as_object().into_iter().flatten().map(|(key, value)| (key.as_str(), value))
}

fn elements(array: &Value) -> impl Iterator<Item = &Value> {
    array.as_array().into_iter().flatten()
}

/// The target of a reference, with the name of the schema; any other value is its own target.
fn target<'a>(document: &'a Value, schema: &'a Value) -> (Option<&'a str>, &'a Value) {
    let Some(reference) = schema["$ref"].as_str() else { return (None, schema) };
    let name = reference.strip_prefix("#/components/schemas/").expect("references are to schemas of the document");
    let found = document["components"]["schemas"].get(name).expect("every reference has its schema");
    (Some(name), found)
}

/// The schemas that a value may follow, with nested `oneOf` flattened; `null` is not one of them but sets the flag.
fn alternatives<'a>(document: &'a Value, schema: &'a Value, nullable: &mut bool) -> Vec<&'a Value> {
    let (_, found) = target(document, schema);
    let Some(list) = found.get("oneOf").or_else(|| found.get("anyOf")) else {
        *nullable |= Shape::of(document, found).nullable;
        return if found["type"] == "null" { Vec::new() } else { vec![schema] };
    };
    elements(list).flat_map(|one| alternatives(document, one, nullable)).collect()
}

/// Finds the changes between two OpenAPI documents that can break a client. A change is one line of text.
struct Comparison<'a> {
    old: &'a Value,
    new: &'a Value,
    changes: BTreeSet<String>,
    /// Pairs of named schemas that were compared, which also ends recursion.
    compared: BTreeSet<(&'a str, &'a str, Direction)>,
}

fn breaking_changes(old: &Value, new: &Value) -> BTreeSet<String> {
    let mut comparison = Comparison { old, new, changes: BTreeSet::new(), compared: BTreeSet::new() };
    comparison.documents();
    comparison.changes
}

impl<'a> Comparison<'a> {
    fn report(&mut self, place: &str, what: &str) {
        self.changes.insert(format!("{place}: {what}"));
    }

    /// Reports keywords with different values for which there is no rule of compatibility.
    fn other_keywords(&mut self, place: &str, old: &Value, new: &Value, known: &[&str]) {
        let keys: BTreeSet<_> = entries(old).chain(entries(new)).map(|(key, _)| key).collect();
        for key in keys.into_iter().filter(|key| !known.contains(key) && !PROSE.contains(key)) {
            if old.get(key) != new.get(key) {
                self.report(place, &format!("`{key}` is different: {}, before {}", new[key], old[key]));
            }
        }
    }

    fn documents(&mut self) {
        let (old, new) = (self.old, self.new);
        self.other_keywords("document", old, new, &["openapi", "info", "paths", "components"]);
        for (path, old_item) in entries(&old["paths"]) {
            let Some(new_item) = new["paths"].get(path) else {
                self.report(path, "path removed");
                continue;
            };
            self.other_keywords(path, old_item, new_item, &METHODS);
            for (method, old_operation) in entries(old_item).filter(|(key, _)| METHODS.contains(key)) {
                let place = format!("{} {path}", method.to_uppercase());
                match new_item.get(method) {
                    Some(new_operation) => self.operations(&place, old_operation, new_operation),
                    None => self.report(&place, "operation removed"),
                }
            }
        }
    }

    fn operations(&mut self, place: &str, old: &'a Value, new: &'a Value) {
        self.other_keywords(place, old, new, &["parameters", "requestBody", "responses"]);
        self.parameters(place, &old["parameters"], &new["parameters"]);
        self.request_bodies(place, &old["requestBody"], &new["requestBody"]);
        for (status, old_answer) in entries(&old["responses"]) {
            let place = format!("{place}: answer {status}");
            match new["responses"].get(status) {
                Some(new_answer) => self.answers(&place, old_answer, new_answer),
                None => self.report(&place, "removed"),
            }
        }
    }

    fn parameters(&mut self, place: &str, old: &'a Value, new: &'a Value) {
        let key = |parameter: &'a Value| (parameter["in"].as_str(), parameter["name"].as_str());
        let find = |list: &'a Value, wanted: &'a Value| elements(list).find(|one| key(one) == key(wanted));
        let name = |parameter: &Value| {
            let text = |key| parameter[key].as_str().unwrap_or_default();
            format!("{place}: {} parameter {}", text("in"), text("name"))
        };
        for old_parameter in elements(old) {
            let place = name(old_parameter);
            let Some(new_parameter) = find(new, old_parameter) else {
                self.report(&place, "removed");
                continue;
            };
            if old_parameter["required"] != true && new_parameter["required"] == true {
                self.report(&place, "now required");
            }
            self.other_keywords(&place, old_parameter, new_parameter, &["required", "schema"]);
            self.schemas(&place, &old_parameter["schema"], &new_parameter["schema"], Direction::Request);
        }
        for new_parameter in elements(new) {
            if new_parameter["required"] == true && find(old, new_parameter).is_none() {
                self.report(&name(new_parameter), "new and required");
            }
        }
    }

    fn request_bodies(&mut self, place: &str, old: &'a Value, new: &'a Value) {
        let place = format!("{place}: request body");
        if old["required"] != true && new["required"] == true {
            self.report(&place, "now required");
        }
        self.contents(&place, &old["content"], &new["content"], Direction::Request);
    }

    fn answers(&mut self, place: &str, old: &'a Value, new: &'a Value) {
        self.contents(place, &old["content"], &new["content"], Direction::Answer);
        for (name, old_header) in entries(&old["headers"]) {
            let place = format!("{place}: header {name}");
            match new["headers"].get(name) {
                Some(new_header) => {
                    self.schemas(&place, &old_header["schema"], &new_header["schema"], Direction::Answer);
                }
                None => self.report(&place, "removed"),
            }
        }
        // The description of a refusal is the list of its problem codes.
        if old["content"].get("application/problem+json").is_some() {
            let codes = |answer: &'a Value| answer["description"].as_str().unwrap_or_default().split(", ");
            for code in codes(old).filter(|code| codes(new).all(|other| other != *code)) {
                self.report(place, &format!("problem code {code} removed"));
            }
        }
    }

    fn contents(&mut self, place: &str, old: &'a Value, new: &'a Value, direction: Direction) {
        for (media_type, old_content) in entries(old) {
            match new.get(media_type) {
                Some(content) => self.schemas(place, &old_content["schema"], &content["schema"], direction),
                None => self.report(place, &format!("media type {media_type} removed")),
            }
        }
    }

    fn schemas(&mut self, place: &str, old: &'a Value, new: &'a Value, direction: Direction) {
        let (mut old_nullable, mut new_nullable) = (false, false);
        let olds = alternatives(self.old, old, &mut old_nullable);
        let mut news = alternatives(self.new, new, &mut new_nullable);
        match direction {
            Direction::Request if old_nullable && !new_nullable => self.report(place, "null no longer accepted"),
            Direction::Answer if new_nullable && !old_nullable => self.report(place, "can be null"),
            _ => {}
        }
        if direction == Direction::Request && old["default"] != new["default"] {
            self.report(place, &format!("default is {}, before {}", new["default"], old["default"]));
        }
        // Alternatives of the same name are compared first, so that a removed one is not mistaken for another.
        let (named, others): (Vec<_>, Vec<_>) = olds.into_iter().partition(|old| {
            let name = target(self.old, old).0;
            name.is_some() && news.iter().any(|new| target(self.new, new).0 == name)
        });
        for old in named.into_iter().chain(others) {
            let distances = news.iter().map(|&new| self.distance(old, new, direction)).enumerate();
            match distances.min_by_key(|(_, distance)| *distance) {
                Some((index, _)) => self.alternative(place, old, news.remove(index), direction),
                None => {
                    let name = target(self.old, old).0.unwrap_or("an unnamed one");
                    self.report(place, &format!("one of the alternatives removed ({name})"));
                }
            }
        }
        if direction == Direction::Answer {
            for new in news {
                let name = target(self.new, new).0.unwrap_or("an unnamed one");
                self.report(place, &format!("new alternative ({name})"));
            }
        }
    }

    /// The number of differences between two alternatives, to determine which new one corresponds to an old one.
    fn distance(&self, old: &'a Value, new: &'a Value, direction: Direction) -> usize {
        let named = target(self.old, old).0;
        if named.is_some() && named == target(self.new, new).0 {
            return 0;
        }
        // Pairs under comparison are copied as well, because a recursive schema would otherwise be compared without end.
        let compared = self.compared.clone();
        let mut trial = Comparison { old: self.old, new: self.new, changes: BTreeSet::new(), compared };
        trial.alternative("", old, new, direction);
        let other_type = Shape::of(self.old, old).types != Shape::of(self.new, new).types;
        trial.changes.len() + 1 + if other_type { 1000 } else { 0 }
    }

    fn alternative(&mut self, place: &str, old: &'a Value, new: &'a Value, direction: Direction) {
        let (old_name, old) = target(self.old, old);
        let (new_name, new) = target(self.new, new);
        if let (Some(old), Some(new)) = (old_name, new_name)
            && !self.compared.insert((old, new, direction))
        {
            return;
        }
        let named = old_name.map(|name| format!("{} {name}", direction.name()));
        let place = named.as_deref().unwrap_or(place);
        let (old, new) = (Shape::of(self.old, old), Shape::of(self.new, new));
        if old.types != new.types {
            self.report(place, &format!("type is {:?}, before {:?}", new.types, old.types));
            return;
        }
        self.properties(place, &old, &new, direction);
        for keyword in old.keywords.keys().chain(new.keywords.keys()).copied().collect::<BTreeSet<_>>() {
            let values = (old.keywords.get(keyword).copied(), new.keywords.get(keyword).copied());
            self.keyword(place, keyword, values, direction);
        }
    }

    fn properties(&mut self, place: &str, old: &Shape<'a>, new: &Shape<'a>, direction: Direction) {
        for (name, old_property) in &old.properties {
            let place = format!("{place}.{name}");
            let Some(new_property) = new.properties.get(name) else {
                self.report(&place, "removed");
                continue;
            };
            match (direction, old.required.contains(name), new.required.contains(name)) {
                (Direction::Request, false, true) => self.report(&place, "now required"),
                (Direction::Answer, true, false) => self.report(&place, "can be absent"),
                _ => {}
            }
            self.schemas(&place, old_property, new_property, direction);
        }
        if direction == Direction::Request {
            for name in new.required.iter().filter(|name| !old.properties.contains_key(*name)) {
                self.report(&format!("{place}.{name}"), "new and required");
            }
        }
    }

    fn keyword(&mut self, place: &str, keyword: &str, values: (Option<&'a Value>, Option<&'a Value>), way: Direction) {
        let (old, new) = values;
        match (keyword, old, new) {
            // These are compared where both alternatives are known.
            ("default" | "oneOf" | "anyOf", ..) => {}
            ("items", Some(old), Some(new)) => self.schemas(&format!("{place}[]"), old, new, way),
            ("additionalProperties", Some(old @ Value::Object(_)), Some(new @ Value::Object(_))) => {
                self.schemas(&format!("{place}.*"), old, new, way);
            }
            // An answer may always have further properties.
            ("additionalProperties", None | Some(Value::Bool(_)), None | Some(Value::Bool(_)))
                if way == Direction::Answer || new != Some(&Value::Bool(false)) => {}
            ("enum", Some(old), Some(new)) => {
                for value in elements(old).filter(|value| elements(new).all(|other| other != *value)) {
                    self.report(place, &format!("value {value} removed"));
                }
            }
            ("enum", None, Some(_)) if way == Direction::Answer => {}
            ("enum", Some(_), None) if way == Direction::Request => {}
            _ if old == new => {}
            _ => {
                let sign = BOUNDS.iter().find(|(name, _)| *name == keyword).map(|(_, sign)| sign);
                let narrower = sign.map(|sign| {
                    let bound = |value: Option<&Value>| {
                        value.and_then(Value::as_f64).map_or(f64::NEG_INFINITY, |number| number * sign)
                    };
                    bound(new) > bound(old)
                });
                if narrower.is_none_or(|narrower| narrower == (way == Direction::Request)) {
                    let text = |value: Option<&Value>| value.map_or("none".to_owned(), Value::to_string);
                    self.report(place, &format!("`{keyword}` is {}, before {}", text(new), text(old)));
                }
            }
        }
    }
}

/// Compares the detected changes with the listed ones.
///
/// # Errors
/// The action that the developer has to take.
fn judge(found: &BTreeSet<String>, listed: &BTreeMap<String, String>, released: &str) -> Result<(), String> {
    let unlisted: Vec<_> = found.iter().filter(|change| !listed.contains_key(*change)).collect();
    let stale: Vec<_> = listed.keys().filter(|change| !found.contains(*change)).collect();
    let unexplained: Vec<_> =
        listed.iter().filter(|(_, reason)| reason.trim().is_empty()).map(|(change, _)| change).collect();
    let mut message = String::new();
    let lines = |changes: &[&String]| changes.iter().map(|change| format!("  {change:?}\n")).collect::<String>();
    if !unlisted.is_empty() {
        message += &format!(
            "The API has changes since version {released} that can break clients:\n{}Undo them. Where one is intended, add its line \
             with a reason below [changes] in openapi/changes-since-release.toml (\"…\" = \"reason\") and name it in \
             CHANGELOG.md; docs/releasing.md says which version it needs.\n",
            lines(&unlisted)
        );
    }
    if !stale.is_empty() {
        message += &format!(
            "openapi/changes-since-release.toml lists changes that did not happen; remove their lines:\n{}",
            lines(&stale)
        );
    }
    if !unexplained.is_empty() {
        message += &format!("openapi/changes-since-release.toml gives no reason for:\n{}", lines(&unexplained));
    }
    if message.is_empty() { Ok(()) } else { Err(message) }
}

/// Whether a version may break clients of an older one: a new minor version before 1.0, then a new major one.
fn may_break(old: &str, new: &str) -> bool {
    let numbers = |version: &str| version.split('.').map(|part| part.parse().expect("a number")).collect::<Vec<u32>>();
    let leading = |version: &str| numbers(version).into_iter().take(if version.starts_with("0.") { 2 } else { 1 });
    leading(old).lt(leading(new))
}

fn document(text: &str) -> Value {
    serde_json::from_str(text).expect("an OpenAPI document in JSON")
}

fn version(document: &Value) -> &str {
    document["info"]["version"].as_str().expect("a version")
}

fn listed() -> BTreeMap<String, String> {
    let mut file: BTreeMap<String, BTreeMap<String, String>> =
        toml::from_str(LISTED).expect("openapi/changes-since-release.toml is a table of lines with reasons");
    let changes = file.remove("changes").expect("openapi/changes-since-release.toml has [changes]");
    assert!(file.is_empty(), "openapi/changes-since-release.toml has nothing but [changes]");
    changes
}

#[test]
fn the_api_is_compatible_with_the_last_release() {
    let released = document(RELEASED);
    let found = breaking_changes(&released, &document(CURRENT));
    judge(&found, &listed(), version(&released)).unwrap_or_else(|message| panic!("{message}"));
}

#[test]
fn a_version_with_breaking_changes_is_a_new_minor_one() {
    let (released, current) = (document(RELEASED), document(CURRENT));
    let (old, new) = (version(&released), version(&current));
    assert!(
        old == new || listed().is_empty() || may_break(old, new),
        "version {new} has changes that can break clients of {old}; docs/releasing.md says which version it needs"
    );
}

#[test]
fn the_last_release_is_that_of_the_changelog() {
    let changelog = include_str!("../CHANGELOG.md");
    let mut headings = changelog.lines().filter_map(|line| line.strip_prefix("## "));
    assert_eq!(headings.next(), Some("Unreleased"));
    let newest = headings.next().and_then(|heading| heading.split_whitespace().next());
    assert_eq!(
        newest,
        Some(version(&document(RELEASED))),
        "openapi/last-release.json must be the document of the newest release in CHANGELOG.md; docs/releasing.md says how to copy it"
    );
}

/// A document with one operation, whose request and answer have separate schemas.
fn small() -> Value {
    let object =
        |properties: Value, required: Value| json!({"type": "object", "properties": properties, "required": required});
    let reference = |name: &str| json!({"schema": {"$ref": format!("#/components/schemas/{name}")}});
    json!({
        "info": {"version": "0.2.0"},
        "paths": {"/v1/orders": {"post": {
            "operationId": "create_order",
            "parameters": [{"name": "view", "in": "query", "required": false, "schema": {"type": "string", "enum": ["full", "plc"]}}],
            "requestBody": {"required": false, "content": {"application/json": reference("Order")}},
            "responses": {
                "201": {
                    "content": {"application/json": reference("Receipt")},
                    "headers": {"Location": {"schema": {"type": "string"}}},
                },
                "409": {"description": "order_known, order_late", "content": {"application/problem+json": reference("Problem")}},
            },
        }}},
        "components": {"schemas": {
            "Order": object(
                json!({"radius_mm": {"type": ["number", "null"], "minimum": 0, "maximum": 100, "default": null}}),
                json!([]),
            ),
            "Receipt": object(
                json!({
                    "id": {"type": "string", "pattern": "^o-"},
                    "state": {"type": "string", "enum": ["open", "done"]},
                    "count": {"type": "integer", "format": "int32", "maximum": 10},
                    "lines": {"type": "array", "items": {"$ref": "#/components/schemas/Line"}},
                    "ending": {"oneOf": [{"$ref": "#/components/schemas/Ending"}, {"type": "null"}]},
                    "by": {"oneOf": [{"$ref": "#/components/schemas/Person"}, {"$ref": "#/components/schemas/Ending"}]},
                }),
                json!(["id", "state"]),
            ),
            "Line": object(json!({"text": {"type": "string"}, "below": {"$ref": "#/components/schemas/Line"}}), json!(["text"])),
            "Ending": {"allOf": [object(json!({"reason": {"type": "string"}}), json!(["reason"])), {"type": "object"}]},
            "Person": object(json!({"name": {"type": "string"}}), json!(["name"])),
            "Problem": object(json!({"code": {"type": "string"}}), json!(["code"])),
        }},
    })
}

/// The changes that are detected after the value at a JSON pointer was replaced; `null` removes it.
fn changes(pointer: &str, value: Value) -> Vec<String> {
    let mut new = small();
    let (parent, key) = pointer.rsplit_once('/').expect("a pointer");
    let key = key.replace("~1", "/");
    match (new.pointer_mut(parent).expect("the document has the parent"), value) {
        (Value::Object(object), Value::Null) => _ = object.remove(&key).expect("something to remove"),
        (Value::Object(object), value) => _ = object.insert(key, value),
        (Value::Array(array), value) => array.push(value),
        _ => unreachable!("a pointer ends in an object or an array"),
    }
    breaking_changes(&small(), &new).into_iter().collect()
}

const OPERATION: &str = "/paths/~1v1~1orders/post";
const SCHEMAS: &str = "/components/schemas";

/// Asserts that replacing the value causes this change and no other.
fn breaks(pointer: &str, value: Value, expected: &str) {
    assert_eq!(changes(pointer, value), [expected], "{pointer}");
}

fn breaks_nobody(pointer: &str, value: Value) {
    assert_eq!(changes(pointer, value), [""; 0], "{pointer}");
}

#[test]
fn a_removed_path_operation_parameter_or_answer_breaks() {
    breaks("/paths/~1v1~1orders", Value::Null, "/v1/orders: path removed");
    breaks(OPERATION, Value::Null, "POST /v1/orders: operation removed");
    breaks(&format!("{OPERATION}/parameters"), Value::Null, "POST /v1/orders: query parameter view: removed");
    breaks(&format!("{OPERATION}/responses/409"), Value::Null, "POST /v1/orders: answer 409: removed");
    breaks(
        &format!("{OPERATION}/responses/201/headers"),
        Value::Null,
        "POST /v1/orders: answer 201: header Location: removed",
    );
    breaks(
        &format!("{OPERATION}/responses/201/content"),
        Value::Null,
        "POST /v1/orders: answer 201: media type application/json removed",
    );
    breaks(
        &format!("{OPERATION}/operationId"),
        json!("make_order"),
        "POST /v1/orders: `operationId` is different: \"make_order\", before \"create_order\"",
    );
    breaks(
        &format!("{OPERATION}/responses/409/description"),
        json!("order_known, order_early"),
        "POST /v1/orders: answer 409: problem code order_late removed",
    );
}

#[test]
fn a_request_that_was_valid_must_stay_valid() {
    let parameter = |required: bool| json!({"name": "unit", "in": "query", "required": required, "schema": {}});
    let list = format!("{OPERATION}/parameters/1");
    breaks(&list, parameter(true), "POST /v1/orders: query parameter unit: new and required");
    breaks_nobody(&list, parameter(false));
    let view = format!("{OPERATION}/parameters/0");
    breaks(&format!("{view}/required"), json!(true), "POST /v1/orders: query parameter view: now required");
    let values = format!("{view}/schema/enum");
    breaks(&values, json!(["full"]), "POST /v1/orders: query parameter view: value \"plc\" removed");
    breaks_nobody(&values, json!(["full", "plc", "short"]));
    breaks_nobody(&values, Value::Null);
    breaks(&format!("{OPERATION}/requestBody/required"), json!(true), "POST /v1/orders: request body: now required");
    let order = format!("{SCHEMAS}/Order");
    breaks(&format!("{order}/required"), json!(["radius_mm"]), "request Order.radius_mm: now required");
    breaks(&format!("{order}/required"), json!(["unit"]), "request Order.unit: new and required");
    breaks(&format!("{order}/properties/radius_mm"), Value::Null, "request Order.radius_mm: removed");
    breaks_nobody(&format!("{order}/properties/note"), json!({"type": "string"}));
    breaks(
        &format!("{order}/additionalProperties"),
        json!(false),
        "request Order: `additionalProperties` is false, before none",
    );
    let radius = format!("{order}/properties/radius_mm");
    breaks(&format!("{radius}/type"), json!("number"), "request Order.radius_mm: null no longer accepted");
    breaks(
        &format!("{radius}/type"),
        json!(["string", "null"]),
        "request Order.radius_mm: type is {\"string\"}, before {\"number\"}",
    );
    breaks(&format!("{radius}/maximum"), json!(50), "request Order.radius_mm: `maximum` is 50, before 100");
    breaks(&format!("{radius}/minimum"), json!(1), "request Order.radius_mm: `minimum` is 1, before 0");
    breaks(
        &format!("{radius}/exclusiveMinimum"),
        json!(0),
        "request Order.radius_mm: `exclusiveMinimum` is 0, before none",
    );
    breaks_nobody(&format!("{radius}/maximum"), json!(200));
    breaks_nobody(&format!("{radius}/minimum"), Value::Null);
    breaks(&format!("{radius}/default"), json!(10), "request Order.radius_mm: default is 10, before null");
}

#[test]
fn an_answer_must_keep_its_properties_types_and_values() {
    let receipt = format!("{SCHEMAS}/Receipt");
    breaks(&format!("{receipt}/properties/count"), Value::Null, "answer Receipt.count: removed");
    breaks_nobody(&format!("{receipt}/properties/note"), json!({"type": "string"}));
    breaks(&format!("{receipt}/required"), json!(["id"]), "answer Receipt.state: can be absent");
    breaks_nobody(&format!("{receipt}/required"), json!(["id", "state", "count"]));
    let property = |name: &str| format!("{receipt}/properties/{name}");
    breaks(&property("state/enum"), json!(["open", "ended"]), "answer Receipt.state: value \"done\" removed");
    breaks_nobody(&property("state/enum"), json!(["open", "late", "done"]));
    breaks(
        &property("count/type"),
        json!("number"),
        "answer Receipt.count: type is {\"number\"}, before {\"integer\"}",
    );
    breaks(&property("count/type"), json!(["integer", "null"]), "answer Receipt.count: can be null");
    breaks(&property("count/format"), json!("int64"), "answer Receipt.count: `format` is \"int64\", before \"int32\"");
    breaks(&property("count/maximum"), json!(11), "answer Receipt.count: `maximum` is 11, before 10");
    breaks_nobody(&property("count/maximum"), json!(9));
    breaks(&property("id/pattern"), json!("^r-"), "answer Receipt.id: `pattern` is \"^r-\", before \"^o-\"");
    breaks_nobody(&property("id/description"), json!("Names the order."));
    breaks(&format!("{SCHEMAS}/Line/properties/text"), Value::Null, "answer Line.text: removed");
    breaks(&format!("{SCHEMAS}/Ending/allOf/0/properties"), Value::Null, "answer Ending.reason: removed");
}

#[test]
fn alternatives_are_compared_with_those_that_correspond() {
    let by = format!("{SCHEMAS}/Receipt/properties/by/oneOf");
    let reference = |name: &str| json!({"$ref": format!("#/components/schemas/{name}")});
    breaks_nobody(&by, json!([reference("Ending"), reference("Person")]));
    breaks(&by, json!([reference("Person")]), "answer Receipt.by: one of the alternatives removed (Ending)");
    breaks(&by, json!([reference("Ending")]), "answer Receipt.by: one of the alternatives removed (Person)");
    breaks(
        &by,
        json!([reference("Person"), reference("Ending"), reference("Line")]),
        "answer Receipt.by: new alternative (Line)",
    );
    breaks_nobody(
        &by,
        json!([{"type": "object", "properties": {"name": {"type": "string"}}, "required": ["name"]}, reference("Ending")]),
    );
    let ending = format!("{SCHEMAS}/Receipt/properties/ending");
    breaks_nobody(&ending, reference("Ending"));
    breaks(
        &ending,
        json!({"oneOf": [{"type": "string"}, {"type": "null"}]}),
        "answer Ending: type is {\"string\"}, before {\"object\"}",
    );
}

#[test]
fn the_name_of_a_schema_may_change() {
    let text = small().to_string().replace("schemas/Line", "schemas/Row").replace("\"Line\"", "\"Row\"");
    assert_eq!(breaking_changes(&small(), &document(&text)), BTreeSet::new());
}

#[test]
fn keywords_without_a_rule_are_reported_if_they_differ() {
    breaks("/security", json!([{"token": []}]), "document: `security` is different: [{\"token\":[]}], before null");
    breaks(&format!("{SCHEMAS}/Line/not"), json!({}), "answer Line: `not` is {}, before none");
}

#[test]
fn listed_changes_pass_only_with_a_reason_and_if_they_happened() {
    let found = BTreeSet::from(["/v1/orders: path removed".to_owned()]);
    let list = |change: &str, reason: &str| BTreeMap::from([(change.to_owned(), reason.to_owned())]);
    assert_eq!(judge(&found, &list("/v1/orders: path removed", "Orders are no longer supported."), "0.2.0"), Ok(()));
    let unlisted = judge(&found, &BTreeMap::new(), "0.2.0").expect_err("the change is not listed");
    assert!(unlisted.contains("since version 0.2.0") && unlisted.contains("changes-since-release.toml"));
    let unexplained = judge(&found, &list("/v1/orders: path removed", " "), "0.2.0").expect_err("no reason");
    assert!(unexplained.starts_with("openapi/changes-since-release.toml gives no reason"), "{unexplained}");
    let stale =
        judge(&BTreeSet::new(), &list("/v1/parts: path removed", "Moved."), "0.2.0").expect_err("did not happen");
    assert!(stale.contains("did not happen") && stale.contains("/v1/parts"), "{stale}");
}

#[test]
fn only_a_new_minor_version_may_break_clients_before_version_1() {
    assert!(may_break("0.2.0", "0.3.0") && may_break("0.9.1", "1.0.0") && may_break("1.4.0", "2.0.0"));
    assert!(!may_break("0.2.0", "0.2.1") && !may_break("1.0.0", "1.1.0") && !may_break("0.10.0", "0.9.0"));
}

#[test]
fn a_document_does_not_differ_from_itself() {
    let current = document(CURRENT);
    assert!(current["paths"].as_object().is_some_and(|paths: &Map<_, _>| paths.len() > 20));
    assert_eq!(breaking_changes(&current, &current), BTreeSet::new());
}
