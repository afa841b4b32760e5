//! The listener and the processing common to all requests, the route table, the OpenAPI document and the metrics.

pub(in crate::http) mod connections;
pub(in crate::http) mod edge;
pub(in crate::http) mod guarded;
pub(in crate::http) mod listener;
pub(in crate::http) mod metrics;
pub(in crate::http) mod openapi;
pub(in crate::http) mod router;
pub(in crate::http) mod same_origin;
pub(in crate::http) mod shares;
