//! Bodies piece by piece, within limits of size, time and speed.

use super::app::App;
use super::pace::Pace;
use super::peer::{ConnectionInfo, Peer};
use super::problem::{Code, Problem};
use crate::service::Stopwatch;
use axum::body::{Body, Bytes};
use axum::http::request::Parts;
use axum::http::{HeaderMap, header};
use http_body_util::BodyExt;
use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::timeout;

/// How much of a refused body is read and thrown away, so that its sender gets to read the refusal: one that is still
/// writing when the connection closes would see a broken pipe instead.
const DRAIN_BYTES_MAX: usize = 16 << 20;
const DRAIN_TIME_MAX: Duration = Duration::from_secs(2);

/// A body that is being read.
#[derive(Debug)]
pub(super) struct Pieces {
    peer: Peer,
    body: Option<Body>,
    /// Pieces looked at before, to be handed out first.
    ahead: VecDeque<Bytes>,
    bytes_count: u64,
    bytes_max: u64,
    announced_bytes: Option<u64>,
    idle: Duration,
    total: Duration,
    /// How fast it comes.
    pace: Pace,
    bytes_per_s_min: u64,
    /// Runs since the body began.
    watch: Stopwatch,
    /// Nothing is to be thrown away: the client waits for a go-ahead, which reading on would give, or sends nothing.
    silent: bool,
}

impl Pieces {
    /// Begins to read a body of at most `bytes_max` bytes.
    ///
    /// # Errors
    /// [`Code::BodyTooLarge`] where the announced length is beyond; nothing is read then.
    pub(super) fn new(parts: &Parts, body: Body, app: &App, bytes_max: u64) -> Result<Self, Problem> {
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
    pub(super) async fn next(&mut self) -> Result<Option<Bytes>, Problem> {
        match self.ahead.pop_front() {
            Some(piece) => Ok(Some(piece)),
            None => self.receive().await,
        }
    }

    /// Reads until `enough` bytes are here or the body ends; all of them will be handed out again. Says whether the body
    /// ended.
    ///
    /// # Errors
    /// Those of [`Pieces::next`].
    pub(super) async fn look_ahead(&mut self, enough: usize) -> Result<(Vec<u8>, bool), Problem> {
        let mut head: Vec<u8> = self.ahead.iter().flatten().copied().collect();
        while head.len() < enough {
            let Some(piece) = self.receive().await? else { return Ok((head, true)) };
            head.extend_from_slice(&piece);
            self.ahead.push_back(piece);
        }
        Ok((head, false))
    }

    /// The whole body.
    ///
    /// # Errors
    /// Those of [`Pieces::next`].
    pub(super) async fn all(&mut self) -> Result<Vec<u8>, Problem> {
        let mut whole = Vec::new();
        while let Some(piece) = self.next().await? {
            whole.extend_from_slice(&piece);
        }
        Ok(whole)
    }

    /// Who sends it.
    pub(super) const fn peer(&self) -> Peer {
        self.peer
    }

    /// Bytes that were announced.
    pub(super) const fn announced_bytes(&self) -> Option<u64> {
        self.announced_bytes
    }

    /// Bytes received so far.
    pub(super) const fn bytes_count(&self) -> u64 {
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
                    return Err(self.too_slow("it was not whole after", "total_ms", self.total));
                }
                if idle <= patience {
                    return Err(self.too_slow("nothing came for", "idle_ms", self.idle));
                }
                self.check_pace()?;
                idle = idle.saturating_sub(patience);
                continue;
            };
            match frame.transpose().map_err(|_| self.interrupted())?.map(|frame| frame.into_data()) {
                Some(Ok(data)) if data.is_empty() => {}
                Some(Ok(data)) => return self.count(data).map(Some),
                // Trailers say nothing to us.
                Some(Err(_)) => {}
                None => self.body = None,
            }
        }
        Ok(None)
    }

    /// Refuses a body that comes in such small pieces that it would hold its place for long.
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
