//! State shared by all handlers; it contains nothing about a single request.

use super::server::connections::Connections;
use super::server::metrics::Metrics;
use super::server::shares::{Listeners, Shares};
use crate::config::{Config, Limits, Timeouts};
use crate::service::Service;
use std::sync::Arc;
use tokio::sync::Semaphore;

/// Shared by all requests; inexpensive to clone.
#[derive(Debug, Clone)]
pub(in crate::http) struct App {
    /// The use cases.
    pub(in crate::http) service: Arc<Service>,
    /// Limits of size and number.
    pub(in crate::http) limits: Arc<Limits>,
    /// Time limits.
    pub(in crate::http) timeouts: Arc<Timeouts>,
    /// Host names of the service, besides its addresses and localhost.
    pub(in crate::http) hosts: Arc<[String]>,
    /// Places for connections.
    pub(in crate::http) connections: Connections,
    /// Health checks on reserved connections.
    pub(in crate::http) health_places: Arc<Semaphore>,
    /// Places for waiting clients.
    pub(in crate::http) listeners: Listeners,
    /// Places for scans that are being received.
    pub(in crate::http) uploads: Shares,
    /// Counters.
    pub(in crate::http) metrics: Arc<Metrics>,
}

impl App {
    pub(in crate::http) fn new(config: &Config, service: Arc<Service>) -> Self {
        let limits = &config.limits;
        // Half of the reserved places, so that the other half remains for stops.
        let health_places = usize::try_from(limits.connections_reserved.div_ceil(2)).unwrap_or(Semaphore::MAX_PERMITS);
        Self {
            service,
            limits: Arc::new(limits.clone()),
            timeouts: Arc::new(config.timeouts.clone()),
            hosts: config.hosts.clone().into(),
            connections: Connections::new(limits, &config.timeouts),
            health_places: Arc::new(Semaphore::new(health_places.min(Semaphore::MAX_PERMITS))),
            listeners: Listeners::new(limits),
            uploads: Shares::new(limits.uploads_max, limits.peer_share_percent),
            metrics: Arc::new(Metrics::new()),
        }
    }
}
