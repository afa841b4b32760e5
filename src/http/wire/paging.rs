//! Lists: `limit` and `cursor` in the query, the next page in the body and in `Link`. A record that cannot be read is listed with
//! its known properties.

use axum::http::{HeaderMap, HeaderValue, Uri, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use tokio::task::spawn_blocking;
use utoipa::{IntoParams, ToSchema};

use crate::service::{Entry, UnreadableRecord};
use crate::store::{Cursor, Listing, Page};

use super::problem::{Code, Problem};

/// Default number of entries of a page.
const LIMIT_DEFAULT: u32 = 100;

/// Maximum number of entries of a page.
const LIMIT_MAX: u32 = 1000;

/// Which page of a list without filters.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::http) struct PageQuery {
    /// Most entries of the page; 100 by default.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the page before.
    #[param(pattern = "^[0-9a-f]{16}$")]
    cursor: Option<String>,
}

impl PageQuery {
    /// The requested page.
    pub(in crate::http) fn page(&self) -> Result<Page, Problem> {
        page(self.limit, self.cursor.as_deref())
    }
}

/// The page of these parameters.
pub(in crate::http) fn page(limit: Option<u32>, cursor: Option<&str>) -> Result<Page, Problem> {
    let limit = limit.unwrap_or(LIMIT_DEFAULT);
    if !(1..=LIMIT_MAX).contains(&limit) {
        return Err(Problem::new(Code::QueryInvalid, format!("limit must be between 1 and {LIMIT_MAX}, got {limit}"))
            .with("limit", limit)
            .with("limit_max", LIMIT_MAX));
    }
    let before = cursor.map(Cursor::parse).transpose()?;
    Ok(Page { limit, before })
}

/// A page of any list: the header that names the next page, and the document that `document` builds from the entries and
/// the cursor of the next page. A thousand entries take a while, so this runs outside the async threads.
pub(in crate::http) async fn listed<R: Send + 'static, D: Serialize>(
    uri: &Uri,
    page: Listing<R>,
    document: impl FnOnce(Vec<R>, Option<String>) -> D + Send + 'static,
) -> Result<Response, Problem> {
    let next_cursor = page.next.map(|cursor| cursor.to_string());
    let link = link_next(uri, next_cursor.as_deref());
    let rendered = spawn_blocking(move || serde_json::to_vec(&document(page.rows, next_cursor))).await;
    let body = rendered.map_err(|error| Problem::internal(error.to_string()))?;
    let body = body.map_err(|error| Problem::internal(error.to_string()))?;
    Ok((link, [(header::CONTENT_TYPE, "application/json")], body).into_response())
}

/// The `Link` header to the next page: the same address with another cursor.
pub(in crate::http) fn link_next(uri: &Uri, cursor: Option<&str>) -> HeaderMap {
    let mut headers = HeaderMap::new();
    let Some(cursor) = cursor else { return headers };
    let others = uri.query().unwrap_or_default().split('&').filter(|pair| {
        let name = pair.split('=').next().unwrap_or_default();
        !name.is_empty() && name != "cursor"
    });
    let query: Vec<_> = others.map(str::to_owned).chain([format!("cursor={cursor}")]).collect();
    // The address was parsed before, and a cursor consists of letters and digits, so this does not fail.
    if let Ok(value) = HeaderValue::from_str(&format!("<{}?{}>; rel=\"next\"", uri.path(), query.join("&"))) {
        headers.insert(header::LINK, value);
    }
    headers
}

/// A record of a list, or the known fields of one that cannot be read.
#[derive(Debug, Serialize, ToSchema)]
#[serde(untagged)]
pub(in crate::http) enum EntryDocument<T> {
    /// The record.
    Record(T),
    /// It is damaged, or a later version of the service has written it.
    Unreadable(UnreadableDocument),
}

/// The known fields of a record that cannot be read.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Unreadable)]
pub(in crate::http) struct UnreadableDocument {
    /// Its id, or its name.
    id: String,
    /// `unreadable`.
    #[schema(example = "unreadable")]
    state: &'static str,
    /// When it was made, UTC.
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    /// Why it cannot be read.
    text: String,
}

impl<T> EntryDocument<T> {
    /// The document of an entry.
    pub(in crate::http) fn of<R>(entry: Entry<R>, show: impl FnOnce(R) -> T) -> Self {
        match entry {
            Entry::Record(record) => Self::Record(show(record)),
            Entry::Unreadable(UnreadableRecord { id, created_at, cause }) => {
                let text = format!("the record cannot be read: {cause}");
                Self::Unreadable(UnreadableDocument { id, state: "unreadable", created_at, text })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_page_keeps_filters_and_replaces_the_cursor() {
        let uri = Uri::from_static("/v1/measurements?verdict=refused&cursor=aa&limit=2");
        let headers = link_next(&uri, Some("bb"));
        assert_eq!(headers[header::LINK], "</v1/measurements?verdict=refused&limit=2&cursor=bb>; rel=\"next\"");
        assert!(link_next(&uri, None).is_empty());
    }

    #[test]
    fn a_limit_out_of_range_is_refused_not_clamped() {
        assert!(page(Some(0), None).is_err() && page(Some(1001), None).is_err() && page(Some(1000), None).is_ok());
    }
}
