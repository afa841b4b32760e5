//! Lets only so many connections in at a time; a further one is closed before a byte is read. Must not know what goes over
//! them.

use axum_server::accept::Accept;
use std::future::{Ready, ready};
use std::io;
use std::sync::Arc;
use std::task::{Context, Poll};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tower::Service;

/// Places for connections.
#[derive(Debug, Clone)]
pub(super) struct Connections {
    places: Arc<Semaphore>,
}

impl Connections {
    pub(super) fn new(connections_max: u64) -> Self {
        let places = usize::try_from(connections_max).unwrap_or(usize::MAX).min(Semaphore::MAX_PERMITS);
        Self { places: Arc::new(Semaphore::new(places)) }
    }
}

impl<I, S> Accept<I, S> for Connections {
    type Stream = I;
    type Service = Held<S>;
    type Future = Ready<io::Result<(I, Held<S>)>>;

    fn accept(&self, stream: I, service: S) -> Self::Future {
        let place = Arc::clone(&self.places).try_acquire_owned();
        ready(match place {
            Ok(place) => Ok((stream, Held { service, _place: Arc::new(place) })),
            Err(_) => Err(io::Error::new(io::ErrorKind::ConnectionRefused, "as many connections are open as may")),
        })
    }
}

/// What answers on a connection, holding its place as long as it lives.
#[derive(Debug, Clone)]
pub(super) struct Held<S> {
    service: S,
    _place: Arc<OwnedSemaphorePermit>,
}

impl<R, S: Service<R>> Service<R> for Held<S> {
    type Response = S::Response;
    type Error = S::Error;
    type Future = S::Future;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), Self::Error>> {
        self.service.poll_ready(context)
    }

    fn call(&mut self, request: R) -> Self::Future {
        self.service.call(request)
    }
}
