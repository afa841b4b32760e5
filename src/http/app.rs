//! What every handler may use. Nothing here belongs to a single request.

use super::server::connections::Connections;
use super::server::metrics::Metrics;
use super::server::shares::{Listeners, Shares};
use crate::config::{Config, Limits, Timeouts};
use crate::service::Service;
use std::sync::Arc;
use tokio::sync::Semaphore;

/// Shared by all requests; cheap to clone.
#[derive(Debug, Clone)]
pub(in crate::http) struct App {
    /// The product's verbs.
    pub(in crate::http) service: Arc<Service>,
    /// What is too much.
    pub(in crate::http) limits: Arc<Limits>,
    /// What is too slow.
    pub(in crate::http) timeouts: Arc<Timeouts>,
    /// Names under which the service is reached, besides its addresses and localhost.
    pub(in crate::http) hosts: Arc<[String]>,
    /// Places for connections.
    pub(in crate::http) connections: Connections,
    /// Health checks on reserved connections.
    pub(in crate::http) health_places: Arc<Semaphore>,
    /// Places for clients that wait for something.
    pub(in crate::http) listeners: Listeners,
    /// Places for bodies of scans that are coming in.
    pub(in crate::http) uploads: Shares,
    /// What is counted.
    pub(in crate::http) metrics: Arc<Metrics>,
}

impl App {
    pub(in crate::http) fn new(config: &Config, service: Arc<Service>) -> Self {
        let limits = &config.limits;
        // Half of the reserved places, so that health checks leave the other half to stops.
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
