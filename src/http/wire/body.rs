//! Receives bodies piece by piece within limits of size, time and speed. For a scan in a body, it determines the compression and
//! the declared format, and writes the bytes to the store.

use std::collections::VecDeque;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use http_body_util::BodyExt;
use tokio::time::timeout;

use crate::http::app::App;
use crate::http::server::guarded::Pace;
use crate::http::server::shares::{ConnectionInfo, Full, Peer, Place};
use crate::scan::decode::Encoding;
use crate::service::{Origin, ReceivedScan, ResolvedOrder, Stopwatch, Upload};

use super::names::FormatName;
use super::problem::{Code, Problem};

/// Bytes of a refused body that are read and discarded, so that its sender can read the refusal: a client that is still
/// writing when the connection closes would get a broken pipe instead.
const DRAIN_BYTES_MAX: usize = 16 << 20;
const DRAIN_TIME_MAX: Duration = Duration::from_secs(2);

/// A body that is being read.
#[derive(Debug)]
pub(in crate::http) struct Pieces {
    peer: Peer,
    body: Option<Body>,
    /// Pieces that were examined before; they are returned first.
    ahead: VecDeque<Bytes>,
    bytes_count: u64,
    bytes_max: u64,
    announced_bytes: Option<u64>,
    idle: Duration,
    total: Duration,
    /// Speed of the body.
    pace: Pace,
    bytes_per_s_min: u64,
    /// Time since the start of the body.
    watch: Stopwatch,
    /// Nothing is to be discarded: the client waits for `100 Continue`, which further reading would send, or sends no body.
    silent: bool,
}

impl Pieces {
    /// Starts to read a body of at most `bytes_max` bytes.
    ///
    /// # Errors
    /// [`Code::BodyTooLarge`] if the announced length is greater; nothing is read then.
    pub(in crate::http) fn new(parts: &Parts, body: Body, app: &App, bytes_max: u64) -> Result<Self, Problem> {
        let announced_bytes = announced_bytes(&parts.headers);
        let pieces = Self {
            announced_bytes,
            peer: ConnectionInfo::of(&parts.extensions).peer,
            body: Some(body),
            ahead: VecDeque::new(),
            bytes_count: 0,
            bytes_max,
            idle: Duration::from_millis(app.timeouts.body_idle_ms),
            pace: Pace::new(Duration::from_millis(app.timeouts.body_idle_ms), app.limits.bytes_per_s_min),
            bytes_per_s_min: app.limits.bytes_per_s_min,
            total: Duration::from_millis(app.timeouts.body_total_ms),
            watch: app.service.start_stopwatch(),
            silent: parts.headers.contains_key(header::EXPECT),
        };
        match announced_bytes {
            Some(announced) if announced > bytes_max => Err(too_large(bytes_max).with("announced_bytes", announced)),
            _ => Ok(pieces),
        }
    }

    /// The next piece; `None` at the end.
    ///
    /// # Errors
    /// [`Code::BodyTooLarge`], [`Code::BodyTimeout`], [`Code::BodyInterrupted`].
    pub(in crate::http) async fn next(&mut self) -> Result<Option<Bytes>, Problem> {
        match self.ahead.pop_front() {
            Some(piece) => Ok(Some(piece)),
            None => self.receive().await,
        }
    }

    /// Reads until `enough` bytes have arrived or the body ends; all of them will be returned again. The result includes whether
    /// the body ended.
    ///
    /// # Errors
    /// Those of [`Pieces::next`].
    pub(in crate::http) async fn look_ahead(&mut self, enough: usize) -> Result<(Vec<u8>, bool), Problem> {
        let mut head: Vec<u8> = self.ahead.iter().flatten().copied().collect();
        while head.len() < enough {
            let Some(piece) = self.receive().await? else { return Ok((head, true)) };
            head.extend_from_slice(&piece);
            self.ahead.push_back(piece);
        }
        Ok((head, false))
    }

    /// The complete body.
    ///
    /// # Errors
    /// Those of [`Pieces::next`].
    pub(in crate::http) async fn all(&mut self) -> Result<Vec<u8>, Problem> {
        let mut whole = Vec::new();
        while let Some(piece) = self.next().await? {
            whole.extend_from_slice(&piece);
        }
        Ok(whole)
    }

    /// Address of the sender.
    pub(in crate::http) const fn peer(&self) -> Peer {
        self.peer
    }

    /// Announced number of bytes.
    pub(in crate::http) const fn announced_bytes(&self) -> Option<u64> {
        self.announced_bytes
    }

    /// Bytes received so far.
    pub(in crate::http) const fn bytes_count(&self) -> u64 {
        self.bytes_count
    }

    async fn receive(&mut self) -> Result<Option<Bytes>, Problem> {
        let mut idle = self.idle;
        while let Some(body) = &mut self.body {
            self.silent = false;
            let begun = self.watch.elapsed();
            let left = self.total.saturating_sub(begun);
            let patience = idle.min(left).min(self.pace.remaining());
            let frame = timeout(patience, body.frame()).await;
            self.pace.note(0, self.watch.elapsed().saturating_sub(begun).min(patience));
            let Ok(frame) = frame else {
                if left <= patience {
                    return Err(self.too_slow("it was incomplete after", "total_ms", self.total));
                }
                if idle <= patience {
                    return Err(self.too_slow("no data arrived for", "idle_ms", self.idle));
                }
                self.check_pace()?;
                idle = idle.saturating_sub(patience);
                continue;
            };
            match frame.transpose().map_err(|_| self.interrupted())?.map(|frame| frame.into_data()) {
                Some(Ok(data)) if data.is_empty() => {}
                Some(Ok(data)) => return self.count(data).map(Some),
                // Trailers are ignored.
                Some(Err(_)) => {}
                None => self.body = None,
            }
        }
        Ok(None)
    }

    /// Refuses a body whose pieces are so small that it would occupy its place for long.
    fn check_pace(&mut self) -> Result<(), Problem> {
        if !self.pace.is_too_slow() {
            return Ok(());
        }
        self.silent = true;
        let bytes_per_s_min = self.bytes_per_s_min;
        let detail = format!(
            "the body came too slowly: less than {bytes_per_s_min} bytes a second (limits.bytes_per_s_min); send it again"
        );
        Err(Problem::new(Code::BodyTimeout, detail)
            .with("bytes_per_s_min", bytes_per_s_min)
            .with("received_bytes", self.bytes_count))
    }

    fn count(&mut self, data: Bytes) -> Result<Bytes, Problem> {
        let bytes_count = u64::try_from(data.len()).unwrap_or(u64::MAX);
        self.bytes_count += bytes_count;
        self.pace.note(bytes_count, Duration::ZERO);
        if self.bytes_count > self.bytes_max { Err(too_large(self.bytes_max)) } else { Ok(data) }
    }

    fn too_slow(&mut self, what: &str, member: &'static str, limit: Duration) -> Problem {
        self.silent = true;
        let limit_ms = u64::try_from(limit.as_millis()).unwrap_or(u64::MAX);
        Problem::new(Code::BodyTimeout, format!("the body came too slowly: {what} {limit_ms} ms; send it again"))
            .with(member, limit_ms)
            .with("received_bytes", self.bytes_count)
    }

    fn interrupted(&self) -> Problem {
        Problem::new(Code::BodyInterrupted, "the body ended before its announced length; send it again")
            .with("received_bytes", self.bytes_count)
    }
}

impl Drop for Pieces {
    fn drop(&mut self) {
        if let Some(body) = self.body.take().filter(|_| !self.silent) {
            tokio::spawn(timeout(DRAIN_TIME_MAX, drain(body)));
        }
    }
}

async fn drain(mut body: Body) {
    let mut drained = 0;
    while let Some(Ok(frame)) = body.frame().await {
        drained += frame.data_ref().map_or(0, Bytes::len);
        if drained > DRAIN_BYTES_MAX {
            break;
        }
    }
}

fn too_large(bytes_max: u64) -> Problem {
    let detail = format!("the body is larger than {bytes_max} bytes; thin it out, compress it or raise the limit");
    Problem::new(Code::BodyTooLarge, detail).with("bytes_max", bytes_max)
}

fn announced_bytes(headers: &HeaderMap) -> Option<u64> {
    headers.get(header::CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

const IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");

/// Maximum length of a request id.
const REQUEST_ID_CHARACTERS_MAX: usize = 128;

/// Media type that a browser or `curl -F` uses for files.
const FORM: &[u8] = b"multipart/";

/// The declared compression of the body; `None` if it has none.
///
/// # Errors
/// [`Code::EncodingUnsupported`].
pub(in crate::http) fn content_encoding(headers: &HeaderMap) -> Result<Option<Encoding>, Problem> {
    let Some(name) = header_text(headers, &header::CONTENT_ENCODING)? else { return Ok(None) };
    if name.trim().eq_ignore_ascii_case("identity") {
        return Ok(None);
    }
    Encoding::from_name(&name).map(Some).ok_or_else(|| {
        Problem::new(Code::EncodingUnsupported, "the content encoding is not known; use gzip, zstd or none")
            .with("encoding", name)
    })
}

/// The declared properties of the scan besides its bytes.
///
/// # Errors
/// [`Code::HeaderInvalid`], [`Code::ContentTypeUnsupported`] for a form.
pub(in crate::http) fn origin(format: Option<FormatName>, headers: &HeaderMap) -> Result<Origin, Problem> {
    let media_type = match headers.contains_key(header::CONTENT_TYPE) {
        true => Some(
            media_type(headers)
                .ok_or_else(|| Problem::new(Code::HeaderInvalid, "the header content-type is not text"))?,
        ),
        false => None,
    };
    let kind = media_type.unwrap_or_default().trim_start().as_bytes();
    if kind.get(..FORM.len()).is_some_and(|start| start.eq_ignore_ascii_case(FORM)) {
        let detail = "forms are not supported; send the bytes of the scan: curl --data-binary @scan.ply, not -F";
        return Err(Problem::new(Code::ContentTypeUnsupported, detail));
    }
    Ok(Origin { parameter: format.map(Into::into), media_type: media_type.map(str::to_owned), file_name: None })
}

/// The client's own id of its request, from the query, the body or the header.
///
/// # Errors
/// [`Code::OptionInvalid`] if it is too long, has other characters, or two places give different ids.
pub(in crate::http) fn request_id(said: Option<String>, headers: &HeaderMap) -> Result<Option<String>, Problem> {
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

/// Receives the body into a file of the store that is not recorded yet; the file of a refused body is deleted.
///
/// # Errors
/// Errors of the body, the compression or the store.
pub(in crate::http) async fn receive(
    app: &App,
    pieces: &mut Pieces,
    encoding: Option<Encoding>,
    origin: Origin,
    accepted: ResolvedOrder,
) -> Result<ReceivedScan, Problem> {
    let _place = upload_place(app, pieces.peer())?;
    let mut upload = app.service.measuring.begin_upload(encoding, pieces.announced_bytes(), origin, accepted).await?;
    if let Err(problem) = write_all(pieces, &mut upload).await {
        upload.abandon().await;
        return Err(problem);
    }
    app.metrics.received(pieces.bytes_count());
    Ok(app.service.measuring.complete_upload(upload).await?)
}

/// A place among the uploads under way, so that one client with many slow uploads leaves places for the others.
fn upload_place(app: &App, peer: Peer) -> Result<Place, Problem> {
    app.uploads.take(peer).map_err(|full| {
        let (most, whose, keys) = match full {
            Full::All { places_max } => (places_max, "", "limits.uploads_max"),
            Full::Peer { peer_max } => {
                (peer_max, " from this address", "limits.uploads_max, limits.peer_share_percent")
            }
        };
        let detail = format!("{most} uploads{whose} are under way, the maximum ({keys}); send this again later");
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

/// The declared media type.
pub(in crate::http) fn media_type(headers: &HeaderMap) -> Option<&str> {
    headers.get(header::CONTENT_TYPE)?.to_str().ok()
}

/// The text of a header; `None` if it is absent.
///
/// # Errors
/// [`Code::HeaderInvalid`] if it is not text.
pub(in crate::http) fn header_text(headers: &HeaderMap, name: &HeaderName) -> Result<Option<String>, Problem> {
    let Some(value) = headers.get(name) else { return Ok(None) };
    match value.to_str() {
        Ok(text) => Ok(Some(text.to_owned())),
        Err(_) => Err(Problem::new(Code::HeaderInvalid, format!("the header {name} is not text"))),
    }
}
