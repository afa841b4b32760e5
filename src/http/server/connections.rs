//! Limits the number of simultaneous connections, and reserves places for urgent requests.
//!
//! ```text
//! accepted --a place is free, and the peer has less than its share--> general: any request
//!          --else---------------------------------------------------> reserved: one urgent request, then it is closed
//! all reserved places taken: the connection that has waited longest for its request loses its place to the newest
//! ```
//!
//! A client that stops the cell sends its request together with the connection, so its place is never lost; a connection without
//! an urgent request loses its reserved place to the next one. `edge` decides which requests are urgent.

use super::guarded::{Displaced, Guarded, WriteLimits};
use super::shares::{ConnectionInfo, Peer, Place, Shares};
use crate::config::{Limits, Timeouts};
use axum::http::Request;
use axum_server::accept::Accept;
use std::collections::BTreeMap;
use std::future::{Ready, ready};
use std::io::{self, ErrorKind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::sync::oneshot;
use tower::Service;

/// Places for connections. Inexpensive to clone.
#[derive(Debug, Clone)]
pub(in crate::http) struct Connections {
    general: Shares,
    reserved: Arc<Mutex<Reserved>>,
    refused_count: Arc<AtomicU64>,
    write_limits: WriteLimits,
}

/// The reserved places.
#[derive(Debug)]
struct Reserved {
    places_max: usize,
    /// Places whose connection has not sent an urgent request yet, oldest first.
    waiting: BTreeMap<u64, oneshot::Sender<()>>,
    /// Number of places with an urgent request that is being answered.
    answering_count: usize,
    next_number: u64,
}

/// A reserved place, occupied until it is dropped.
#[derive(Debug)]
struct ReservedPlace {
    reserved: Arc<Mutex<Reserved>>,
    number: u64,
    answering: AtomicBool,
}

/// The reserved place of a request's connection, stored as an extension of the request.
#[derive(Debug, Clone)]
pub(in crate::http) struct Reservation(Arc<Held>);

/// The place that a connection occupies during its lifetime.
#[derive(Debug)]
enum Held {
    General(#[expect(dead_code, reason = "it is only dropped, never read")] Place),
    Reserved(ReservedPlace),
}

/// Number of occupied places, and of connections that found none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::http) struct ConnectionsCount {
    pub(in crate::http) general: u64,
    pub(in crate::http) reserved: u64,
    pub(in crate::http) refused: u64,
}

impl Connections {
    pub(in crate::http) fn new(limits: &Limits, timeouts: &Timeouts) -> Self {
        let places_max = usize::try_from(limits.connections_reserved).unwrap_or(usize::MAX);
        let reserved = Reserved { places_max, waiting: BTreeMap::new(), answering_count: 0, next_number: 0 };
        Self {
            general: Shares::new(limits.connections_max, limits.peer_share_percent),
            reserved: Arc::new(Mutex::new(reserved)),
            refused_count: Arc::default(),
            write_limits: WriteLimits {
                window: Duration::from_millis(timeouts.response_idle_ms),
                bytes_per_s_min: limits.bytes_per_s_min,
            },
        }
    }

    /// The present numbers.
    pub(in crate::http) fn count(&self) -> ConnectionsCount {
        let reserved = lock(&self.reserved);
        let count = reserved.waiting.len().saturating_add(reserved.answering_count);
        ConnectionsCount {
            general: self.general.taken_count(),
            reserved: u64::try_from(count).unwrap_or(u64::MAX),
            refused: self.refused_count.load(Ordering::Relaxed),
        }
    }

    fn take(&self, peer: Peer) -> Option<(Held, Option<Displaced>)> {
        if let Ok(place) = self.general.take(peer) {
            return Some((Held::General(place), None));
        }
        let (place, displaced) = ReservedPlace::take(&self.reserved)?;
        Some((Held::Reserved(place), Some(displaced)))
    }
}

impl ReservedPlace {
    /// Takes a reserved place; if all are occupied, from the connection that has waited longest. `None` if every one of them is
    /// answering a request.
    fn take(places: &Arc<Mutex<Reserved>>) -> Option<(Self, Displaced)> {
        let mut reserved = lock(places);
        if reserved.waiting.len().saturating_add(reserved.answering_count) >= reserved.places_max {
            let (_, oldest) = reserved.waiting.pop_first()?;
            // Its stream may have ended a moment ago, which frees the place as well.
            let _ = oldest.send(());
        }
        let (sender, displaced) = oneshot::channel();
        let number = reserved.next_number;
        reserved.next_number = number.wrapping_add(1);
        reserved.waiting.insert(number, sender);
        let place = Self { reserved: Arc::clone(places), number, answering: AtomicBool::new(false) };
        Some((place, displaced))
    }

    /// Marks the place as answering an urgent request, so that it is no longer given to another connection.
    fn answer(&self) {
        let mut reserved = lock(&self.reserved);
        if reserved.waiting.remove(&self.number).is_some() {
            reserved.answering_count = reserved.answering_count.saturating_add(1);
            self.answering.store(true, Ordering::Relaxed);
        }
    }
}

impl Reservation {
    /// Keeps the place for an urgent request until it is answered.
    pub(in crate::http) fn keep(&self) {
        if let Held::Reserved(place) = &*self.0 {
            place.answer();
        }
    }
}

impl Drop for ReservedPlace {
    fn drop(&mut self) {
        let mut reserved = lock(&self.reserved);
        reserved.waiting.remove(&self.number);
        if self.answering.load(Ordering::Relaxed) {
            reserved.answering_count = reserved.answering_count.saturating_sub(1);
        }
    }
}

fn lock(reserved: &Mutex<Reserved>) -> MutexGuard<'_, Reserved> {
    reserved.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<S> Accept<TcpStream, S> for Connections {
    type Stream = Guarded;
    type Service = Placed<S>;
    type Future = Ready<io::Result<(Guarded, Placed<S>)>>;

    fn accept(&self, stream: TcpStream, service: S) -> Self::Future {
        let peer = match stream.peer_addr() {
            Ok(address) => Peer::from(address.ip()),
            Err(error) => return ready(Err(error)),
        };
        let Some((held, displaced)) = self.take(peer) else {
            self.refused_count.fetch_add(1, Ordering::Relaxed);
            return ready(Err(io::Error::new(ErrorKind::ConnectionRefused, "all reserved places are being answered")));
        };
        let info = ConnectionInfo { peer, reserved: matches!(held, Held::Reserved(_)) };
        let stream = Guarded::new(stream, displaced, self.write_limits);
        ready(Ok((stream, Placed { service, held: Arc::new(held), info })))
    }
}

/// The service of a connection; it occupies the connection's place during its lifetime.
#[derive(Debug, Clone)]
pub(in crate::http) struct Placed<S> {
    service: S,
    held: Arc<Held>,
    info: ConnectionInfo,
}

impl<B, S: Service<Request<B>>> Service<Request<B>> for Placed<S> {
    type Response = S::Response;
    type Error = S::Error;
    type Future = S::Future;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), Self::Error>> {
        self.service.poll_ready(context)
    }

    fn call(&mut self, mut request: Request<B>) -> Self::Future {
        request.extensions_mut().insert(self.info);
        if self.info.reserved {
            request.extensions_mut().insert(Reservation(Arc::clone(&self.held)));
        }
        self.service.call(request)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{IpAddr, Ipv4Addr};

    fn connections(general: u64, reserved: u64) -> Connections {
        let limits = Limits { connections_max: general, connections_reserved: reserved, ..Limits::default() };
        Connections::new(&limits, &Timeouts::default())
    }

    fn peer(number: u8) -> Peer {
        IpAddr::V4(Ipv4Addr::new(192, 0, 2, number)).into()
    }

    #[test]
    fn a_connection_beyond_its_share_or_beyond_all_places_gets_a_reserved_place() {
        let connections = connections(2, 2);
        let general = connections.take(peer(1)).expect("a place");
        assert!(matches!(general.0, Held::General(_)) && general.1.is_none());
        let beyond_its_share = connections.take(peer(1)).expect("a place");
        assert!(matches!(beyond_its_share.0, Held::Reserved(_)));
        let another = connections.take(peer(2)).expect("a place");
        assert!(matches!(another.0, Held::General(_)));
        let beyond_all = connections.take(peer(3)).expect("a place");
        assert!(matches!(beyond_all.0, Held::Reserved(_)));
        assert_eq!(connections.count(), ConnectionsCount { general: 2, reserved: 2, refused: 0 });
        drop((general, beyond_its_share, another, beyond_all));
        assert_eq!(connections.count(), ConnectionsCount { general: 0, reserved: 0, refused: 0 });
    }

    #[test]
    fn a_reserved_place_without_a_request_goes_to_the_next_connection_unless_it_is_answering() {
        let connections = connections(1, 2);
        let _general = connections.take(peer(1)).expect("a place");
        let reserved = || connections.take(peer(1)).and_then(|(held, displaced)| Some((held, displaced?)));
        let (answered, mut first) = reserved().expect("a place");
        let Held::Reserved(place) = &answered else { panic!("{answered:?}") };
        place.answer();
        let (oldest, mut second) = reserved().expect("a place");
        let (newest, _third) = reserved().expect("the place of the oldest that waits");
        assert_eq!(second.try_recv(), Ok(()));
        assert_eq!(first.try_recv(), Err(oneshot::error::TryRecvError::Closed), "it is not displaced any more");
        drop(oldest);
        assert_eq!(connections.count().reserved, 2, "a displaced connection has no place");
        let Held::Reserved(place) = &newest else { panic!("{newest:?}") };
        place.answer();
        assert!(reserved().is_none(), "both are being answered");
        drop(answered);
        assert!(reserved().is_some());
    }
}
