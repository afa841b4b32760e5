//! The stream of a connection, ended where its client takes the answer too slowly, and where its reserved place is given to
//! a newer connection. hyper knows neither.
//!
//! The least speed of a transfer. It is judged over windows of the time in which the other side is waited for, so a fast
//! beginning does not pay for a slow end, and time in which this side is busy does not count.

use std::future::Future;
use std::io::{self, ErrorKind, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::sync::oneshot;
use tokio::time::{Sleep, sleep};

/// Says that the connection's place is given to another one; dropped where that cannot happen any more.
pub(in crate::http) type Displaced = oneshot::Receiver<()>;

/// How long a client may take nothing of an answer, and how fast it must take it, bytes a second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::http) struct WriteLimits {
    pub(in crate::http) window: Duration,
    pub(in crate::http) bytes_per_s_min: u64,
}

/// A stream that does not wait for its client without end.
#[derive(Debug)]
pub(in crate::http) struct Guarded {
    stream: TcpStream,
    displaced: Option<Displaced>,
    limits: WriteLimits,
    pace: Pace,
    /// Runs while the client takes nothing; the pace is judged when it is over.
    waiting: Option<Pin<Box<Sleep>>>,
    /// The last write found no room.
    blocked: bool,
}

impl WriteLimits {
    fn pace(self) -> Pace {
        Pace::new(self.window, self.bytes_per_s_min)
    }
}

impl Guarded {
    pub(in crate::http) fn new(stream: TcpStream, displaced: Option<Displaced>, limits: WriteLimits) -> Self {
        Self { stream, displaced, limits, pace: limits.pace(), waiting: None, blocked: false }
    }

    fn check_displaced(&mut self, context: &mut Context<'_>) -> io::Result<()> {
        let Some(displaced) = &mut self.displaced else { return Ok(()) };
        match Pin::new(displaced).poll(context) {
            Poll::Pending => Ok(()),
            Poll::Ready(Ok(())) => {
                Err(io::Error::new(ErrorKind::ConnectionAborted, "a newer connection has the place"))
            }
            Poll::Ready(Err(_)) => {
                self.displaced = None;
                Ok(())
            }
        }
    }

    /// Before a write: an error where the client was waited for a whole window and took too little in it.
    fn judge(&mut self, context: &mut Context<'_>) -> io::Result<()> {
        if self.blocked && self.is_window_over(context) {
            self.waiting = None;
            self.pace.note(0, self.limits.window);
            if self.pace.is_too_slow() {
                return Err(io::Error::new(ErrorKind::TimedOut, "the answer was taken too slowly"));
            }
        }
        Ok(())
    }

    /// After a write: counts what was taken, and has the task woken when the window of waiting is over.
    fn note(&mut self, context: &mut Context<'_>, written: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        match written {
            Poll::Ready(Ok(bytes_count)) => {
                self.blocked = false;
                self.pace.note(u64::try_from(bytes_count).unwrap_or(u64::MAX), Duration::ZERO);
            }
            Poll::Ready(Err(_)) => {}
            Poll::Pending => {
                // A window that went by while there was nothing to write says nothing about the client.
                if !self.blocked && self.is_window_over(context) {
                    self.waiting = None;
                    self.pace = self.limits.pace();
                }
                self.blocked = true;
                let window = self.limits.window;
                let waiting = self.waiting.get_or_insert_with(|| Box::pin(sleep(window)));
                if waiting.as_mut().poll(context).is_ready() {
                    context.waker().wake_by_ref();
                }
            }
        }
        written
    }

    fn is_window_over(&mut self, context: &mut Context<'_>) -> bool {
        self.waiting.as_mut().is_some_and(|waiting| waiting.as_mut().poll(context).is_ready())
    }
}

impl AsyncRead for Guarded {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        self.check_displaced(context)?;
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for Guarded {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        self.judge(context)?;
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.note(context, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        self.judge(context)?;
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        self.note(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

/// How fast a transfer is, at this moment.
#[derive(Debug, Clone)]
pub(in crate::http) struct Pace {
    window: Duration,
    bytes_min: u64,
    waited: Duration,
    bytes_count: u64,
}

impl Pace {
    /// At least `bytes_per_s_min` bytes a second, judged after every `window` of waiting; 0 accepts any speed but
    /// none at all.
    pub(in crate::http) fn new(window: Duration, bytes_per_s_min: u64) -> Self {
        let millis = u64::try_from(window.as_millis()).unwrap_or(u64::MAX);
        let bytes_min = (bytes_per_s_min.saturating_mul(millis) / 1000).max(1);
        Self { window, bytes_min, waited: Duration::ZERO, bytes_count: 0 }
    }

    /// How long may be waited until the window is over.
    pub(in crate::http) fn remaining(&self) -> Duration {
        self.window.saturating_sub(self.waited)
    }

    /// Notes bytes that came through, after a time of waiting.
    pub(in crate::http) fn note(&mut self, bytes_count: u64, waited: Duration) {
        self.bytes_count = self.bytes_count.saturating_add(bytes_count);
        self.waited = self.waited.saturating_add(waited);
    }

    /// Whether a window is over in which fewer bytes came through than must. Begins the next window where one is over.
    pub(in crate::http) fn is_too_slow(&mut self) -> bool {
        if self.waited < self.window {
            return false;
        }
        let too_few = self.bytes_count < self.bytes_min;
        self.waited = Duration::ZERO;
        self.bytes_count = 0;
        too_few
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fast_beginning_does_not_pay_for_a_slow_end() {
        let mut pace = Pace::new(Duration::from_secs(10), 100);
        pace.note(1 << 30, Duration::from_secs(9));
        assert!(!pace.is_too_slow() && pace.remaining() == Duration::from_secs(1));
        pace.note(0, Duration::from_secs(1));
        assert!(!pace.is_too_slow(), "the first window had bytes enough");
        pace.note(999, Duration::from_secs(10));
        assert!(pace.is_too_slow(), "the second had one too few");
        pace.note(1000, Duration::from_secs(10));
        assert!(!pace.is_too_slow());
    }

    #[test]
    fn without_a_least_speed_only_standing_still_is_too_slow() {
        let mut pace = Pace::new(Duration::from_secs(10), 0);
        pace.note(1, Duration::from_secs(10));
        assert!(!pace.is_too_slow());
        pace.note(0, Duration::from_secs(10));
        assert!(pace.is_too_slow());
    }
}
