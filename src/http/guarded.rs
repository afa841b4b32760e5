//! The stream of a connection, ended where its client takes the answer too slowly, and where its reserved place is given to
//! a newer connection. hyper knows neither.

use super::pace::Pace;
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
pub(super) type Displaced = oneshot::Receiver<()>;

/// How long a client may take nothing of an answer, and how fast it must take it, bytes a second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct WriteLimits {
    pub(super) window: Duration,
    pub(super) bytes_per_s_min: u64,
}

/// A stream that does not wait for its client without end.
#[derive(Debug)]
pub(super) struct Guarded {
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
    pub(super) fn new(stream: TcpStream, displaced: Option<Displaced>, limits: WriteLimits) -> Self {
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
