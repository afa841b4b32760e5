//! Measures: a scan in the body with options in the query, or a JSON order that names a stored scan or the sensor.

use super::document::MeasurementDocument;
use super::plc::PlcDocument;
use super::sensor::{PlcSensorDocument, SensorMeasurementDocument, SensorOrderDocument, Shown};
use crate::http::app::App;
use crate::http::wire::body::{Pieces, content_encoding, origin, receive, request_id};
use crate::http::wire::command::{lease_id, made};
use crate::http::wire::extract::{is_json, json, query, without_mark};
use crate::http::wire::names::{DecimalName, FormatName, MethodName, UnitName, View, recipe_name};
use crate::http::wire::numbers::{LENGTH_MAX_MM, within};
use crate::http::wire::problem::{Code, Problem};
use crate::scan::decode::Encoding;
use crate::service::{Answer, MeasurementOrder, Recipe, ScanWay, SensorRequest};
use axum::extract::{Request, State};
use axum::http::HeaderMap;
use axum::response::Response;
use serde::Deserialize;
use serde::de::{Deserializer, Error as _, IgnoredAny, MapAccess, Visitor};
use std::fmt;
use std::time::Duration;
use utoipa::{IntoParams, ToSchema};

/// What is said about the scan and its measurement. What the query says holds over the recipe.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::http) struct CreateQuery {
    /// Format of the scan; found by Content-Type and first bytes by default.
    #[param(inline)]
    format: Option<FormatName>,
    /// Unit of its coordinates; by default that of the file, or mm.
    #[param(inline)]
    unit: Option<UnitName>,
    /// Which points belong to one profile: `column`, `column=NAME`, `row`, `x_pitch_mm`, `x_pitch_mm=NUMBER`, `x_value`;
    /// the first that fits by default.
    #[param(example = "x_value")]
    profile_by: Option<String>,
    /// Sign before the decimals of a text file's numbers, where its cells do not show it.
    #[param(inline)]
    decimal: Option<DecimalName>,
    /// Distance between the profiles of a scan that is a matrix of heights; its first column is y where `y_pitch_mm` is left out.
    #[param(exclusive_minimum = 0.0, maximum = 100000.0)]
    x_pitch_mm: Option<f64>,
    /// Distance between the points of a profile in such a matrix; its first column is x where `x_pitch_mm` is left out. With both, a
    /// profile is a row, or with `profile_by=column` a column.
    #[param(exclusive_minimum = 0.0, maximum = 100000.0)]
    y_pitch_mm: Option<f64>,
    /// Values of x, y or z, in the unit of the file, that mark points as missing, separated by commas: `-9999,0`. They are looked for
    /// where none are given; an empty list says that there are none.
    #[param(value_type = Option<String>, example = "-9999")]
    missing: Option<MissingList>,
    /// How the pose is found.
    #[param(inline)]
    method: Option<MethodName>,
    /// Name of a stored recipe.
    #[param(pattern = "^[a-z0-9][a-z0-9_-]{0,63}$")]
    recipe: Option<String>,
    /// The radius that the drawing gives.
    #[param(exclusive_minimum = 0.0, maximum = 100000.0)]
    nominal_radius_mm: Option<f64>,
    /// The same as the header Idempotency-Key: a repeated request of the same id gets the first answer again.
    #[param(pattern = "^[A-Za-z0-9._:-]{1,128}$")]
    request_id: Option<String>,
    /// The same as the header `Lease-Id`, which a scan by the sensor needs; nothing else does.
    lease_id: Option<String>,
    /// `plc` answers integers in one flat object below 1024 bytes, of several parts the first.
    #[param(inline)]
    view: Option<View>,
}

/// Numbers separated by commas.
#[derive(Debug)]
struct MissingList(Vec<f64>);

impl<'de> Deserialize<'de> for MissingList {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let cells = text.split(',').map(str::trim).filter(|cell| !cell.is_empty());
        let values = cells.map(|cell| {
            let shown: String = cell.chars().take(40).collect();
            cell.parse().map_err(|_| D::Error::custom(format!("{shown:?} is not a number; write e.g. missing=-9999,0")))
        });
        values.collect::<Result<_, _>>().map(Self)
    }
}

/// A measurement of a kept scan.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = MeasurementOrder, example = json!({
    "scan_id": "s-0000000000000000000000000000000000000000000000000000000000000000", "method": "section_line"
}))]
pub(in crate::http) struct OrderDocument {
    /// Which scan.
    scan_id: String,
    /// Name of a stored recipe.
    #[schema(pattern = "^[a-z0-9][a-z0-9_-]{0,63}$")]
    recipe: Option<String>,
    /// How the pose is found.
    method: Option<MethodName>,
    /// The radius that the drawing gives.
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    nominal_radius_mm: Option<f64>,
    /// Unit of the scan's coordinates.
    unit: Option<UnitName>,
    /// Which points belong to one profile.
    profile_by: Option<String>,
    /// Sign before the decimals of a text file's numbers.
    decimal: Option<DecimalName>,
    /// Distance between the profiles of a scan that is a matrix of heights.
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    x_pitch_mm: Option<f64>,
    /// Distance between the points of a profile in such a matrix.
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    y_pitch_mm: Option<f64>,
    /// Values that mark points as missing, in the unit of the file.
    #[schema(max_items = 16)]
    missing_values: Option<Vec<f64>>,
    /// A repeated request of the same id gets the first answer again.
    #[schema(pattern = "^[A-Za-z0-9._:-]{1,128}$")]
    request_id: Option<String>,
}

/// The possible forms of a JSON body.
#[derive(Debug, ToSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "only its schema is used; a scan in JSON is read as a stream")]
pub(in crate::http) enum JsonBody {
    /// A measurement of a kept scan.
    Order(OrderDocument),
    /// A measurement by the sensor.
    Sensor(SensorOrderDocument),
    /// A scan.
    Scan(JsonScan),
}

/// An order in JSON.
enum JsonOrder {
    /// Measures a stored scan.
    Kept(OrderDocument),
    /// Scans with the sensor and measures the scan.
    Sensor(SensorOrderDocument),
}

/// A scan in JSON.
#[derive(Debug, ToSchema)]
#[schema(example = json!({"profiles": [{"x_mm": 0.0, "points": [[-1.0, 199.9], [0.0, 200.0], [1.0, 199.9]]}]}))]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "only its schema is used; a scan in JSON is read as a stream")]
pub(in crate::http) struct JsonScan {
    /// The profiles, in any order.
    profiles: Vec<JsonProfile>,
}

/// A profile of a scan in JSON.
#[derive(Debug, ToSchema)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "only its schema is used; a scan in JSON is read as a stream")]
pub(in crate::http) struct JsonProfile {
    /// Its plane.
    x_mm: f64,
    /// Its points, each `[y, z]` in mm.
    points: Vec<[f64; 2]>,
}

/// Measure a scan
///
/// The body is a scan file, its format given by `?format=`, by Content-Type or by its first bytes; gzip and zstd are
/// decompressed, by Content-Encoding or by their first bytes. Or it is JSON that names a kept scan: an object with `scan_id`, where what the body says
/// holds over the query. A JSON body with `profiles`, or of more than 64 KiB, is a scan.
///
/// Or it is JSON with `"source": "sensor"`: the cell's sensor scans first, which needs the lease. 201 comes at once, with the
/// record in state `scanning`; GET it with `?wait_s=` for the end.
///
/// With `?view=plc` the answer is that of `GET …/{id}?view=plc`.
///
/// 201 with verdict `accepted` or `refused`: a refusal is a result, with its reason and numbers. Repeating a request of the
/// same `request_id` gives the first answer again, with status 200 and `Idempotency-Replayed: true`.
#[utoipa::path(
    post, path = "/v1/measurements", tag = "measurements",
    params(
        CreateQuery,
        ("Idempotency-Key" = Option<String>, Header, description = "The same as `request_id`", pattern = "^[A-Za-z0-9._:-]{1,128}$"),
        ("Lease-Id" = Option<String>, Header, description = "The lease, for a scan by the sensor"),
    ),
    request_body(
        description = "A scan file, or an order to measure a kept scan",
        content((Vec<u8> = "application/octet-stream"), (JsonBody = "application/json"))
    ),
    responses(
        (status = 201, description = "Measured and recorded; or, by the sensor, begun", body = Shown,
            headers(("Location" = String, description = "Address of the measurement"))),
        (status = 200, description = "Measured, or begun, before, for a request of the same id", body = Shown,
            headers(("Location" = String, description = "Address of the measurement"),
                ("Idempotency-Replayed" = String, description = "true"))),
    )
)]
pub(in crate::http) async fn create_measurement(State(app): State<App>, request: Request) -> Result<Response, Problem> {
    let (parts, body) = request.into_parts();
    let mut pieces = Pieces::new(&parts, body, &app, app.limits.body_bytes_max)?;
    let query: CreateQuery = query(&parts)?;
    let encoding = content_encoding(&parts.headers)?;
    if is_json(&parts.headers)
        && query.format.is_none()
        && encoding.is_none()
        && let Some(order) = read_order(&mut pieces, &app).await?
    {
        return match order {
            JsonOrder::Kept(order) => measure_kept(&app, order, query, &parts.headers).await,
            JsonOrder::Sensor(order) => {
                let view = query.view.unwrap_or(View::Full);
                measure_from_sensor(&app, query.under(order)?, &parts.headers, view).await
            }
        };
    }
    let origin = origin(query.format, &parts.headers)?;
    let view = query.view.unwrap_or(View::Full);
    let accepted = app.service.accept(query.order(&parts.headers)?).await?;
    let arrived = receive(&app, &mut pieces, encoding, origin, accepted).await?;
    answer(&app, app.service.measuring.measure_upload(arrived).await?, view)
}

async fn measure_kept(
    app: &App,
    body: OrderDocument,
    query: CreateQuery,
    headers: &HeaderMap,
) -> Result<Response, Problem> {
    let query = CreateQuery {
        format: query.format,
        unit: body.unit.or(query.unit),
        profile_by: body.profile_by.or(query.profile_by),
        decimal: body.decimal.or(query.decimal),
        x_pitch_mm: body.x_pitch_mm.or(query.x_pitch_mm),
        y_pitch_mm: body.y_pitch_mm.or(query.y_pitch_mm),
        missing: body.missing_values.map(MissingList).or(query.missing),
        method: body.method.or(query.method),
        recipe: body.recipe.or(query.recipe),
        nominal_radius_mm: body.nominal_radius_mm.or(query.nominal_radius_mm),
        request_id: body.request_id.or(query.request_id),
        lease_id: None,
        view: query.view,
    };
    let view = query.view.unwrap_or(View::Full);
    let accepted = app.service.accept(query.order(headers)?).await?;
    answer(app, app.service.measuring.measure_scan(&body.scan_id, accepted).await?, view)
}

fn answer(app: &App, Answer { measurement, replayed }: Answer, view: View) -> Result<Response, Problem> {
    if !replayed {
        // Precise enough for every realistic duration.
        let seconds = std::time::Duration::from_millis(measurement.duration_ms).as_secs_f64();
        app.metrics.measured(measurement.verdict(), measurement.method.name(), seconds);
    }
    let address = format!("/v1/measurements/{}", measurement.id);
    match view {
        View::Full => made(&address, replayed, MeasurementDocument::from(&measurement)),
        View::Plc => made(&address, replayed, PlcDocument::new(&measurement, measurement.result.choose(None)?)),
    }
}

impl CreateQuery {
    /// An order for the sensor, completed with values of the query.
    fn under(self, mut order: SensorOrderDocument) -> Result<SensorOrderDocument, Problem> {
        let about_files = self.unit.is_some()
            || self.profile_by.is_some()
            || self.decimal.is_some()
            || self.x_pitch_mm.is_some()
            || self.y_pitch_mm.is_some()
            || self.missing.is_some();
        if about_files {
            let detail = "unit, profile_by, decimal, x_pitch_mm, y_pitch_mm and missing are about files; a scan by the sensor is in mm, \
                          has its profiles and marks what is missing";
            return Err(Problem::new(Code::QueryInvalid, detail));
        }
        order.recipe = order.recipe.or(self.recipe);
        order.method = order.method.or(self.method);
        order.nominal_radius_mm = order.nominal_radius_mm.or(self.nominal_radius_mm);
        order.request_id = order.request_id.or(self.request_id);
        order.lease_in_query = self.lease_id;
        Ok(order)
    }

    fn order(self, headers: &HeaderMap) -> Result<MeasurementOrder, Problem> {
        let recipe = self.recipe.map(recipe_name);
        let overrides = Recipe {
            method: self.method.map(Into::into),
            nominal_radius_mm: self.nominal_radius_mm,
            unit: self.unit.map(Into::into),
            profile_by: self.profile_by,
            decimal: self.decimal.map(Into::into),
            x_pitch_mm: self.x_pitch_mm,
            y_pitch_mm: self.y_pitch_mm,
            missing_values: self.missing.map(|MissingList(values)| values),
            ..Recipe::default()
        };
        Ok(MeasurementOrder {
            recipe: recipe.transpose()?,
            overrides,
            request_id: request_id(self.request_id, headers)?,
        })
    }
}

/// The order in a JSON body; `None` if the body is a scan, whose bytes can then still be read from `pieces`.
async fn read_order(pieces: &mut Pieces, app: &App) -> Result<Option<JsonOrder>, Problem> {
    let enough = usize::try_from(app.limits.json_bytes_max).unwrap_or(usize::MAX).saturating_add(1);
    let (head, whole) = pieces.look_ahead(enough).await?;
    if Encoding::sniff(&head).is_some() {
        return Ok(None);
    }
    let keys = top_level_keys(without_mark(&head));
    let has = |name: &str| keys.iter().any(|key| key == name);
    match (has("profiles"), has("scan_id") || has("source"), whole) {
        (true, false, _) | (false, false, false) => Ok(None),
        (_, _, true) if has("source") => Ok(Some(JsonOrder::Sensor(json(&head)?))),
        (_, _, true) => Ok(Some(JsonOrder::Kept(json(&head)?))),
        (_, true, false) => {
            let bytes_max = app.limits.json_bytes_max;
            let detail = format!("an order has at most {bytes_max} bytes; send a scan without scan_id");
            Err(Problem::new(Code::BodyTooLarge, detail).with("bytes_max", bytes_max))
        }
    }
}

/// The top-level keys of a JSON object that may be cut off.
fn top_level_keys(head: &[u8]) -> Vec<String> {
    struct Keys<'a>(&'a mut Vec<String>);
    impl<'de> Visitor<'de> for Keys<'_> {
        type Value = ();

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("an object")
        }

        fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
            while let Some(key) = map.next_key()? {
                self.0.push(key);
                map.next_value::<IgnoredAny>()?;
            }
            Ok(())
        }
    }
    let mut keys = Vec::new();
    // If the bytes are cut off, the keys before the cut are known nevertheless.
    let _ = serde_json::Deserializer::from_slice(head).deserialize_map(Keys(&mut keys));
    keys
}

pub(in crate::http) fn bounded(field: &str, value: Option<f64>) -> Result<Option<f64>, Problem> {
    value.map(|value| within(field, value, LENGTH_MAX_MM)).transpose()
}

/// Begins a measurement by the sensor.
pub(in crate::http) async fn measure_from_sensor(
    app: &App,
    body: SensorOrderDocument,
    headers: &HeaderMap,
    view: View,
) -> Result<Response, Problem> {
    let overrides =
        Recipe { method: body.method.map(Into::into), nominal_radius_mm: body.nominal_radius_mm, ..Recipe::default() };
    let order = MeasurementOrder {
        recipe: body.recipe.map(recipe_name).transpose()?,
        overrides,
        request_id: request_id(body.request_id, headers)?,
    };
    let request = SensorRequest {
        lease_id: lease_id(app, [body.lease_id, body.lease_in_query], headers)?,
        way: ScanWay {
            x_from_mm: bounded("x_from_mm", body.x_from_mm)?,
            x_to_mm: bounded("x_to_mm", body.x_to_mm)?,
            profiles_count: body.profiles_count,
            speed_mm_s: bounded("speed_mm_s", body.speed_mm_s)?,
        },
        order,
    };
    let started = app.service.operating.measure_from_sensor(request).await?;
    let address = format!("/v1/measurements/{}", started.job.id);
    if started.replayed {
        let any = app.service.operating.any_measurement(&started.job.id, Duration::ZERO).await?;
        return made(&address, true, Shown::of(any, view, None, &app.service)?);
    }
    // The cell may not have begun.
    let begun = match view {
        View::Full => Shown::Sensor(Box::new(SensorMeasurementDocument::of(started.job, &app.service).not_begun())),
        View::Plc => Shown::PlcSensor(PlcSensorDocument::of(&started.job, &app.service).not_begun()),
    };
    made(&address, false, begun)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_keys_of_a_cut_off_document_are_those_before_the_cut() {
        assert_eq!(top_level_keys(br#"{"profiles": [{"x_mm": 1, "poi"#), ["profiles"]);
        assert_eq!(top_level_keys(br#"{"recipe": "a", "scan_id": "s-1"}"#), ["recipe", "scan_id"]);
        assert_eq!(top_level_keys(b"[1, 2]"), Vec::<String>::new());
    }
}
