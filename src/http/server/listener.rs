//! Listens on a socket, serves connections, and shuts down. It needs an address, a service and limits.

use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::{Arc, Weak};
use std::time::Duration;

use axum_server::Handle;
use tokio::net::TcpSocket;

use crate::config::{Config, Timeouts};
use crate::service::Service;

use super::router::router;
use crate::http::app::App;

/// If the queue of the operating system is full, a client retries after a second. A stop must not wait that long when
/// many connections are opened at the same time.
const BACKLOG: u32 = 4096;

/// A service that listens and does not answer yet.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    app: App,
    handle: Handle<SocketAddr>,
}

/// Handle that stops a server.
#[derive(Debug, Clone)]
pub struct Stopper {
    handle: Handle<SocketAddr>,
    service: Weak<Service>,
}

impl Server {
    /// Listens on the configured address. Must be called within a tokio runtime.
    ///
    /// # Errors
    /// If the address is not available.
    pub fn bind(config: &Config, service: Arc<Service>) -> io::Result<Self> {
        let listener = listen(config.listen)?;
        let address = listener.local_addr()?;
        Ok(Self { listener, address, app: App::new(config, service), handle: Handle::new() })
    }

    /// The address on which it listens, with the actual port.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// The handle that stops it.
    #[must_use]
    pub fn stopper(&self) -> Stopper {
        Stopper { handle: self.handle.clone(), service: Arc::downgrade(&self.app.service) }
    }

    /// Serves requests until it is stopped; then requests under way are finished within the configured time.
    ///
    /// # Errors
    /// If the listener fails.
    pub async fn serve(self) -> io::Result<()> {
        let Self { listener, app, handle, .. } = self;
        let Timeouts { header_ms, .. } = *app.timeouts;
        let connections = app.connections.clone();
        let service = Arc::clone(&app.service);
        let mut server = match axum_server::from_tcp(listener) {
            Ok(server) => server,
            Err(error) => {
                service.close().await;
                return Err(error);
            }
        }
        .handle(handle)
        .acceptor(connections)
        .http1_only();
        let header_timeout = Duration::from_millis(header_ms);
        // axum-server sets hyper's timer, but a timeout applies only if one is set here. It also ends idle connections.
        let header_bytes =
            usize::try_from(app.limits.header_bytes_max + app.limits.url_bytes_max).unwrap_or(usize::MAX);
        server
            .http_builder()
            .http1()
            .header_read_timeout(header_timeout)
            .max_buf_size(header_bytes.saturating_mul(2).max(64 << 10));
        server = server.first_request_timeout(None);
        let served = server.serve(router(app).into_make_service()).await;
        // Whatever ended the server, nothing may move when no client can stop it.
        service.close().await;
        served
    }
}

/// Listens with a queue of [`BACKLOG`] connections that are not accepted yet.
fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
    // A restart need not wait until the connections of the previous process have timed out.
    socket.set_reuseaddr(true)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)?.into_std()
}

impl Stopper {
    /// Accepts no further connection and lets requests under way finish in the remaining time.
    pub fn stop(&self) {
        let left = self.service.upgrade().map_or(Duration::ZERO, |service| service.time_for_requests());
        self.handle.graceful_shutdown(Some(left));
    }
}
