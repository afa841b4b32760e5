//! What every handler may use. Must not hold anything of a single request.

use super::listeners::Listeners;
use super::metrics::Metrics;
use crate::config::{Limits, Timeouts};
use crate::service::Service;
use std::sync::Arc;

/// Shared by all requests; cheap to clone.
#[derive(Debug, Clone)]
pub(super) struct App {
    /// The product's verbs.
    pub(super) service: Arc<Service>,
    /// What is too much.
    pub(super) limits: Arc<Limits>,
    /// What is too slow.
    pub(super) timeouts: Arc<Timeouts>,
    /// Places for those that wait for something.
    pub(super) listeners: Listeners,
    /// What is counted.
    pub(super) metrics: Arc<Metrics>,
}
