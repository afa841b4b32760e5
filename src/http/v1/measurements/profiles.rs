//! The verdict on every profile of a measurement: JSON in pages, CSV or NDJSON in one piece.

use crate::estimation::Profile;
use crate::http::app::App;
use crate::http::wire::extract;
use crate::http::wire::extract::{Path, Query};
use crate::http::wire::paging::link_next;
use crate::http::wire::problem::{Code, Problem};
use crate::service::{Chosen, MeasurementResult};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, Uri, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use tokio::task::spawn_blocking;
use utoipa::{IntoParams, ToSchema};

const CSV: &str = "text/csv";
const NDJSON: &str = "application/x-ndjson";
const JSON: &str = "application/json";

/// One profile and what became of it.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Profile)]
pub struct ProfileDocument {
    /// Its position in the scan, from 0.
    pub index: u64,
    /// Its plane.
    pub x_mm: f64,
    /// Its points.
    pub points_count: u64,
    /// Whether it takes part in the pose.
    pub verdict: ProfileVerdict,
    /// Why it does not.
    pub reason: Option<&'static str>,
    /// Share of its points nearer than epsilon to its section.
    pub inlier_ratio: Option<f64>,
    /// Centre of its section.
    pub centre_y_mm: Option<f64>,
    /// Centre of its section.
    pub centre_z_mm: Option<f64>,
    /// Distance of its centre from the axis.
    pub offset_mm: Option<f64>,
    /// Root mean square distance of its inliers from its section.
    pub rms_mm: Option<f64>,
    /// Robust spread of its points about its section.
    pub sigma_mm: Option<f64>,
    /// Arc that its inliers span.
    pub arc_deg: Option<f64>,
    /// Longer half axis of its section.
    pub semi_major_mm: Option<f64>,
    /// Shorter half axis of its section.
    pub semi_minor_mm: Option<f64>,
    /// Direction of the longer axis, from Y towards Z.
    pub rotation_deg: Option<f64>,
    /// Fits made.
    pub iterations_count: Option<u32>,
    /// Name of the part that it belongs to; null where the recipe does not ask for parts, or it lies outside of them.
    pub part: Option<String>,
}

/// Whether a profile takes part in the pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ProfileVerdict {
    /// It does.
    Valid,
    /// It does not.
    Rejected,
}

/// A page of profiles, in station order.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ProfileList)]
pub(in crate::http) struct ProfileList {
    /// The profiles.
    profiles: Vec<ProfileDocument>,
    /// All profiles of the measurement.
    total_count: u64,
    /// The `cursor` of the next page; null at the end.
    next_cursor: Option<String>,
}

/// Which profiles, in which form.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::http) struct ProfilesQuery {
    /// Most profiles of the answer; 1000 in JSON by default, all of them in CSV and NDJSON.
    #[param(minimum = 1, maximum = 10000)]
    limit: Option<u32>,
    /// `next_cursor` of the page before: the index of the first profile.
    #[param(value_type = Option<u64>, minimum = 0, maximum = 4_294_967_295_u64)]
    cursor: Option<u32>,
    /// The same as the header Accept, for those who cannot set it.
    #[param(inline)]
    format: Option<ProfilesForm>,
    /// Only those of this part, by name or by number from 1 in order of x. `cursor` and `total_count` count within it.
    #[param(pattern = "^[A-Za-z0-9_-]{1,32}$")]
    part: Option<String>,
}

/// How profiles are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(in crate::http) enum ProfilesForm {
    /// A page as one document.
    Json,
    /// RFC 4180, units in the header.
    Csv,
    /// A document a line.
    Ndjson,
}

/// Default number of profiles of a page.
const LIMIT_DEFAULT: u32 = 1000;

/// Maximum number of profiles of a page.
const LIMIT_MAX: u32 = 10_000;

/// List the profiles of a measurement
///
/// The verdict on every profile, in station order: JSON by the page, CSV (`text/csv`) or NDJSON (`application/x-ndjson`)
/// by Accept or `?format=`.
#[utoipa::path(
    get, path = "/v1/measurements/{id}/profiles", tag = "measurements",
    params(("id" = String, Path, description = "Id of the measurement"), ProfilesQuery),
    responses(
        (status = 200, description = "The profiles", headers(("Link" = String, description = "The next page, rel=\"next\"; absent at the end")),
            content((ProfileList = "application/json"), (String = "text/csv"), (String = "application/x-ndjson"))),
    )
)]
pub(in crate::http) async fn list_profiles(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(query): Query<ProfilesQuery>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let form = query.form(&headers)?;
    let limit = query.limit(form)?;
    let result = app.service.operating.measurement(&id).await?.result;
    let stations = query.stations(&result)?;
    let all = app.service.measuring.profiles(&id).await?;
    let first = usize::try_from(query.cursor.unwrap_or(0)).unwrap_or(usize::MAX);
    // A hundred thousand lines take a while, so they are written outside the async threads.
    let rendered = spawn_blocking(move || render(form, &all, stations, &result, first, limit, &uri)).await;
    rendered.map_err(|error| Problem::internal(error.to_string()))
}

fn render(
    form: ProfilesForm,
    all: &[Profile],
    stations: Option<Range<usize>>,
    result: &MeasurementResult,
    first: usize,
    limit: usize,
    uri: &Uri,
) -> Response {
    let stations = stations.unwrap_or(0..all.len());
    let profiles = all.get(stations.clone()).unwrap_or_default();
    let part = documents(profiles, stations.start, result).skip(first).take(limit);
    match form {
        ProfilesForm::Csv => {
            ([(header::CONTENT_TYPE, "text/csv; charset=utf-8; header=present")], csv(part)).into_response()
        }
        ProfilesForm::Ndjson => ([(header::CONTENT_TYPE, NDJSON)], ndjson(part)).into_response(),
        ProfilesForm::Json => {
            let end = first.saturating_add(limit);
            let next_cursor = (end < profiles.len()).then(|| end.to_string());
            let link = link_next(uri, next_cursor.as_deref());
            let total_count = u64::try_from(profiles.len()).unwrap_or(u64::MAX);
            (link, Json(ProfileList { profiles: part.collect(), total_count, next_cursor })).into_response()
        }
    }
}

impl ProfilesQuery {
    fn form(&self, headers: &HeaderMap) -> Result<ProfilesForm, Problem> {
        let offered = [(JSON, ProfilesForm::Json), (CSV, ProfilesForm::Csv), (NDJSON, ProfilesForm::Ndjson)];
        self.format.map_or_else(|| extract::choose(headers, &offered), Ok)
    }

    /// The range of profiles of the requested part; `None` for the complete scan.
    fn stations(&self, result: &MeasurementResult) -> Result<Option<Range<usize>>, Problem> {
        let Some(asked) = self.part.as_deref() else { return Ok(None) };
        Ok(match result.choose(Some(asked))? {
            Chosen::Part(part, _) => Some(part.stations()),
            Chosen::Whole(_) | Chosen::None(_) => None,
        })
    }

    fn limit(&self, form: ProfilesForm) -> Result<usize, Problem> {
        let limit = match (self.limit, form) {
            (Some(limit), _) if !(1..=LIMIT_MAX).contains(&limit) => {
                let detail = format!("limit must be between 1 and {LIMIT_MAX}, got {limit}");
                return Err(Problem::new(Code::QueryInvalid, detail).with("limit", limit).with("limit_max", LIMIT_MAX));
            }
            (Some(limit), _) => limit,
            (None, ProfilesForm::Json) => LIMIT_DEFAULT,
            (None, ProfilesForm::Csv | ProfilesForm::Ndjson) => return Ok(usize::MAX),
        };
        Ok(usize::try_from(limit).unwrap_or(usize::MAX))
    }
}

/// All profiles of an estimate as CSV, RFC 4180, units in the header.
#[must_use]
pub fn profiles_csv(profiles: &[Profile], result: &MeasurementResult) -> String {
    csv(documents(profiles, 0, result))
}

/// The documents of profiles of a scan, starting with index `first`.
fn documents(profiles: &[Profile], first: usize, result: &MeasurementResult) -> impl Iterator<Item = ProfileDocument> {
    let part = |index: usize| result.part_of_profile(index).map(str::to_owned);
    let document = move |(index, profile)| ProfileDocument::new(first + index, profile, part(first + index));
    profiles.iter().enumerate().map(document)
}

impl ProfileDocument {
    fn new(index: usize, profile: &Profile, part: Option<String>) -> Self {
        let wide = |count: usize| u64::try_from(count).unwrap_or(u64::MAX);
        let section = profile.section.as_ref();
        Self {
            index: wide(index),
            x_mm: profile.x,
            points_count: wide(profile.points_count),
            verdict: if profile.rejected.is_none() { ProfileVerdict::Valid } else { ProfileVerdict::Rejected },
            reason: profile.rejected.map(|reason| reason.name()),
            inlier_ratio: section.map(|s| s.inlier_ratio),
            centre_y_mm: section.map(|s| s.ellipse.centre_y),
            centre_z_mm: section.map(|s| s.ellipse.centre_z),
            offset_mm: profile.offset,
            rms_mm: section.map(|s| s.rms),
            sigma_mm: section.map(|s| s.sigma),
            arc_deg: section.map(|s| s.arc.degrees()),
            semi_major_mm: section.map(|s| s.ellipse.semi_major),
            semi_minor_mm: section.map(|s| s.ellipse.semi_minor),
            rotation_deg: section.map(|s| s.ellipse.rotation.degrees()),
            iterations_count: section.map(|s| s.iterations_count),
            part,
        }
    }
}

/// No field contains a comma, a quotation mark or a line break, so none needs quoting.
fn csv(profiles: impl Iterator<Item = ProfileDocument>) -> String {
    let mut text =
        "index,x_mm,points_count,verdict,reason,inlier_ratio,centre_y_mm,centre_z_mm,offset_mm,rms_mm,sigma_mm,\
                    arc_deg,semi_major_mm,semi_minor_mm,rotation_deg,iterations_count,part\r\n"
            .to_owned();
    for p in profiles {
        let verdict = match p.verdict {
            ProfileVerdict::Valid => "valid",
            ProfileVerdict::Rejected => "rejected",
        };
        let cell = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
        let cells = [
            p.index.to_string(),
            p.x_mm.to_string(),
            p.points_count.to_string(),
            verdict.to_owned(),
            p.reason.unwrap_or_default().to_owned(),
            cell(p.inlier_ratio),
            cell(p.centre_y_mm),
            cell(p.centre_z_mm),
            cell(p.offset_mm),
            cell(p.rms_mm),
            cell(p.sigma_mm),
            cell(p.arc_deg),
            cell(p.semi_major_mm),
            cell(p.semi_minor_mm),
            cell(p.rotation_deg),
            p.iterations_count.map(|count| count.to_string()).unwrap_or_default(),
            p.part.unwrap_or_default(),
        ];
        text += &cells.join(",");
        text += "\r\n";
    }
    text
}

fn ndjson(profiles: impl Iterator<Item = ProfileDocument>) -> String {
    let mut text = String::new();
    for profile in profiles {
        // Numbers, words and nulls can always be serialised.
        text += &serde_json::to_string(&profile).unwrap_or_default();
        text.push('\n');
    }
    text
}
