//! A scan in the body of a request: how it is packed, what is said about it, and its way into the store.

use super::app::App;
use super::body::Pieces;
use super::extract::{header_text, media_type};
use super::names::FormatName;
use super::peer::Peer;
use super::problem::{Code, Problem};
use super::shares::{Full, Place};
use crate::scan::decode::Encoding;
use crate::service::{Accepted, Arrived, Origin, Upload};
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};

const IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");

/// Longest id of a request.
const REQUEST_ID_CHARACTERS_MAX: usize = 128;

/// What a browser or `curl -F` wraps files into.
const FORM: &[u8] = b"multipart/";

/// How the body is packed as the client says; `None` where it is not.
///
/// # Errors
/// [`Code::EncodingUnsupported`].
pub(super) fn content_encoding(headers: &HeaderMap) -> Result<Option<Encoding>, Problem> {
    let Some(name) = header_text(headers, &header::CONTENT_ENCODING)? else { return Ok(None) };
    if name.trim().eq_ignore_ascii_case("identity") {
        return Ok(None);
    }
    Encoding::from_name(&name).map(Some).ok_or_else(|| {
        Problem::new(Code::EncodingUnsupported, "the content encoding is not known; use gzip, zstd or none")
            .with("encoding", name)
    })
}

/// What is said about the scan besides its bytes.
///
/// # Errors
/// [`Code::HeaderInvalid`], [`Code::ContentTypeUnsupported`] for a form.
pub(super) fn origin(format: Option<FormatName>, headers: &HeaderMap) -> Result<Origin, Problem> {
    let media_type = match headers.contains_key(header::CONTENT_TYPE) {
        true => Some(
            media_type(headers)
                .ok_or_else(|| Problem::new(Code::HeaderInvalid, "the header content-type is not plain text"))?,
        ),
        false => None,
    };
    let kind = media_type.unwrap_or_default().trim_start().as_bytes();
    if kind.get(..FORM.len()).is_some_and(|start| start.eq_ignore_ascii_case(FORM)) {
        let detail = "a form is not read; send the bare bytes of the scan: curl --data-binary @scan.ply, not -F";
        return Err(Problem::new(Code::ContentTypeUnsupported, detail));
    }
    Ok(Origin { parameter: format.map(Into::into), media_type: media_type.map(str::to_owned), file_name: None })
}

/// What the client calls its request, from the query, the body or the header.
///
/// # Errors
/// [`Code::OptionInvalid`] where it is too long, has other characters, or two places say different things.
pub(super) fn request_id(said: Option<String>, headers: &HeaderMap) -> Result<Option<String>, Problem> {
    let key = header_text(headers, &IDEMPOTENCY_KEY)?;
    if let (Some(said), Some(key)) = (&said, &key)
        && said != key
    {
        let detail = "request_id and the header Idempotency-Key name two different ids; send one of them";
        return Err(Problem::new(Code::OptionInvalid, detail).with("field", "request_id"));
    }
    let id = said.or(key);
    let plain = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'_' | b':' | b'-');
    match id {
        Some(id) if id.is_empty() || id.len() > REQUEST_ID_CHARACTERS_MAX || !id.bytes().all(plain) => {
            let detail = "a request id has 1 to 128 letters, digits or . _ : -";
            Err(Problem::new(Code::OptionInvalid, detail).with("field", "request_id"))
        }
        id => Ok(id),
    }
}

/// The body into a file of the store that is not kept yet; what is refused on the way has left nothing there.
///
/// # Errors
/// What the body, the packing or the store says.
pub(super) async fn receive(
    app: &App,
    pieces: &mut Pieces,
    encoding: Option<Encoding>,
    origin: Origin,
    accepted: Accepted,
) -> Result<Arrived, Problem> {
    let _place = upload_place(app, pieces.peer())?;
    let mut upload = app.service.begin_upload(encoding, pieces.announced_bytes(), origin, accepted).await?;
    if let Err(problem) = write_all(pieces, &mut upload).await {
        upload.abandon().await;
        return Err(problem);
    }
    app.metrics.received(pieces.bytes_count());
    Ok(app.service.complete_upload(upload).await?)
}

/// A place among the uploads that are coming in, so that one client with many slow ones leaves places to the others.
fn upload_place(app: &App, peer: Peer) -> Result<Place, Problem> {
    app.uploads.take(peer).map_err(|full| {
        let (most, whose, keys) = match full {
            Full::All { places_max } => (places_max, "", "limits.uploads_max"),
            Full::Peer { peer_max } => {
                (peer_max, " from this address", "limits.uploads_max, limits.peer_share_percent")
            }
        };
        let detail = format!("{most} uploads{whose} are under way, and no more may ({keys}); send this again later");
        Problem::new(Code::Busy, detail)
            .with("uploads_max_count", most)
            .with_header(header::RETRY_AFTER, HeaderValue::from_static("1"))
    })
}

async fn write_all(pieces: &mut Pieces, upload: &mut Upload) -> Result<(), Problem> {
    while let Some(piece) = pieces.next().await? {
        upload.write(&piece).await?;
    }
    Ok(())
}
