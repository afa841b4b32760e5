//! Listens, answers, and stops: the one place that knows sockets. In: an address, a service and limits.

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

/// Where the queue of the operating system is full, a client tries again after a second; so long must no stop wait because
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

/// Tells a server to stop.
#[derive(Debug, Clone)]
pub struct Stopper {
    handle: Handle<SocketAddr>,
    service: Weak<Service>,
}

impl Server {
    /// Listens on the configured address. Must be called within a tokio runtime.
    ///
    /// # Errors
    /// Where the address cannot be had.
    pub fn bind(config: &Config, service: Arc<Service>) -> io::Result<Self> {
        let listener = listen(config.listen)?;
        let address = listener.local_addr()?;
        Ok(Self { listener, address, app: App::new(config, service), handle: Handle::new() })
    }

    /// Where it listens, the port filled in.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// What stops it.
    #[must_use]
    pub fn stopper(&self) -> Stopper {
        Stopper { handle: self.handle.clone(), service: Arc::downgrade(&self.app.service) }
    }

    /// Answers until it is stopped; then requests under way are finished, within the time that is set for it.
    ///
    /// # Errors
    /// Where the listener fails.
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
        // hyper's timer is set by axum-server, its timeout is off until one is named. It ends idle connections, too.
        let header_bytes =
            usize::try_from(app.limits.header_bytes_max + app.limits.url_bytes_max).unwrap_or(usize::MAX);
        server
            .http_builder()
            .http1()
            .header_read_timeout(header_timeout)
            .max_buf_size(header_bytes.saturating_mul(2).max(64 << 10));
        server = server.first_request_timeout(None);
        let served = server.serve(router(app).into_make_service()).await;
        // Whatever ended it, nothing is left to move without anybody who could stop it.
        service.close().await;
        served
    }
}

/// Listens with room for [`BACKLOG`] connections that are not accepted yet.
fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
    // A restart need not wait until the connections of the process before have timed out.
    socket.set_reuseaddr(true)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)?.into_std()
}

impl Stopper {
    /// Takes no further connection and lets requests under way finish, as long as there is time for them.
    pub fn stop(&self) {
        let left = self.service.upgrade().map_or(Duration::ZERO, |service| service.time_for_requests());
        self.handle.graceful_shutdown(Some(left));
    }
}
