//! Pictures of a measurement, drawn from the stored scan on each request.

use crate::http::app::App;
use crate::http::wire::extract::{Path, Query};
use crate::http::wire::problem::{Code, Problem};
use crate::plot::Picture;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

/// The pictures, by the name of their file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[schema(as = Picture)]
pub(in crate::http) enum PictureFile {
    /// The centres of the profiles along x, and their distance from the axis.
    #[serde(rename = "centres.svg")]
    Centres,
    /// The unrolled surface by its distance from the fitted cylinder.
    #[serde(rename = "residual_map.svg")]
    ResidualMap,
    /// One profile with its section.
    #[serde(rename = "section.svg")]
    Section,
    /// All points along the axis.
    #[serde(rename = "end_view.svg")]
    EndView,
}

impl From<PictureFile> for Picture {
    fn from(file: PictureFile) -> Self {
        match file {
            PictureFile::Centres => Self::Centres,
            PictureFile::ResidualMap => Self::ResidualMap,
            PictureFile::Section => Self::Section,
            PictureFile::EndView => Self::EndView,
        }
    }
}

/// What of the measurement is drawn.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::http) struct PlotQuery {
    /// Index of the profile that `section.svg` shows, from 0; the valid one nearest to the middle by default.
    #[param(value_type = Option<u64>, minimum = 0, maximum = 4_294_967_295_u64)]
    profile: Option<u32>,
    /// Which part is shown, by name or by number from 1 in order of x; the first by default. Not together with
    /// `profile`, which says it already.
    #[param(pattern = "^[A-Za-z0-9_-]{1,32}$")]
    part: Option<String>,
}

/// Pictures are SVG files with inline styles; all other content is blocked.
const CONTENT_SECURITY: &str = "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'self'";

/// Draw a picture of a measurement
///
/// An SVG document, drawn anew from the kept scan, with the result and its expanded uncertainty. Of a refused scan it shows the
/// points in the coordinates of the scan, and the reason.
#[utoipa::path(
    get, path = "/v1/measurements/{id}/plots/{picture}", tag = "measurements",
    params(
        ("id" = String, Path, description = "Id of the measurement"),
        ("picture" = inline(PictureFile), Path, description = "Which picture"),
        PlotQuery
    ),
    responses((status = 200, description = "The picture", content((String = "image/svg+xml"))))
)]
pub(in crate::http) async fn get_plot(
    State(app): State<App>,
    Path((id, file)): Path<(String, String)>,
    Query(query): Query<PlotQuery>,
) -> Result<Response, Problem> {
    let name = file.strip_suffix(".svg").and_then(Picture::from_name);
    let picture = name.ok_or_else(|| {
        let names: Vec<_> = Picture::ALL.iter().map(|picture| format!("{}.svg", picture.name())).collect();
        Problem::new(Code::RouteUnknown, format!("there is no picture {file}; there are {}", names.join(", ")))
    })?;
    if query.part.is_some() && query.profile.is_some() {
        let detail =
            "give part or profile: profiles are numbered over the complete scan, so a profile already selects its part";
        return Err(Problem::new(Code::QueryInvalid, detail));
    }
    let measurement = app.service.operating.measurement(&id).await?;
    let svg = app.service.measuring.picture(measurement, picture, query.part, query.profile.map(u64::from)).await?;
    let headers = [(header::CONTENT_TYPE, "image/svg+xml"), (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY)];
    Ok((headers, svg).into_response())
}
