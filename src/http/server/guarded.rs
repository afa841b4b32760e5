//! The stream of a connection. It ends if its client receives the answer too slowly, or if its reserved place is given to
//! a newer connection; hyper supports neither.
//!
//! The minimum speed of a transfer is checked over windows of the time spent waiting for the client, so that a fast start does not
//! compensate for a slow end, and time in which the service is busy does not count.

use std::future::Future;
use std::io::{self, ErrorKind, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::sync::oneshot;
use tokio::time::{Sleep, sleep};

/// Signals that the connection's place is given to another one; the sender is dropped when that can no longer happen.
pub(in crate::http) type Displaced = oneshot::Receiver<()>;

/// How long a client may receive no byte of an answer, and its minimum speed, bytes per second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::http) struct WriteLimits {
    pub(in crate::http) window: Duration,
    pub(in crate::http) bytes_per_s_min: u64,
}

/// A stream that limits the time of waiting for its client.
#[derive(Debug)]
pub(in crate::http) struct Guarded {
    stream: TcpStream,
    displaced: Option<Displaced>,
    limits: WriteLimits,
    pace: Pace,
    /// Runs while the client receives nothing; the pace is checked at its end.
    waiting: Option<Pin<Box<Sleep>>>,
    /// Whether the last write was blocked by a full send buffer.
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

    /// Before a write: an error if the client received too little during a complete window of waiting.
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

    /// After a write: counts the bytes, and wakes the task when the window of waiting is over.
    fn note(&mut self, context: &mut Context<'_>, written: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        match written {
            Poll::Ready(Ok(bytes_count)) => {
                self.blocked = false;
                self.pace.note(u64::try_from(bytes_count).unwrap_or(u64::MAX), Duration::ZERO);
            }
            Poll::Ready(Err(_)) => {}
            Poll::Pending => {
                // A window without data to write does not indicate a slow client.
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

/// The speed of a transfer.
#[derive(Debug, Clone)]
pub(in crate::http) struct Pace {
    window: Duration,
    bytes_min: u64,
    waited: Duration,
    bytes_count: u64,
}

impl Pace {
    /// At least `bytes_per_s_min` bytes per second, checked after every `window` of waiting; 0 accepts any speed except a
    /// complete standstill.
    pub(in crate::http) fn new(window: Duration, bytes_per_s_min: u64) -> Self {
        let millis = u64::try_from(window.as_millis()).unwrap_or(u64::MAX);
        let bytes_min = (bytes_per_s_min.saturating_mul(millis) / 1000).max(1);
        Self { window, bytes_min, waited: Duration::ZERO, bytes_count: 0 }
    }

    /// Time of waiting until the end of the window.
    pub(in crate::http) fn remaining(&self) -> Duration {
        self.window.saturating_sub(self.waited)
    }

    /// Counts transferred bytes after a time of waiting.
    pub(in crate::http) fn note(&mut self, bytes_count: u64, waited: Duration) {
        self.bytes_count = self.bytes_count.saturating_add(bytes_count);
        self.waited = self.waited.saturating_add(waited);
    }

    /// Whether a window has ended in which too few bytes were transferred. Starts the next window if one has ended.
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
    fn a_fast_start_does_not_compensate_for_a_slow_end() {
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
    fn without_a_minimum_speed_only_a_standstill_is_too_slow() {
        let mut pace = Pace::new(Duration::from_secs(10), 0);
        pace.note(1, Duration::from_secs(10));
        assert!(!pace.is_too_slow());
        pace.note(0, Duration::from_secs(10));
        assert!(pace.is_too_slow());
    }
}
