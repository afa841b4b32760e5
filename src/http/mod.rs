//! The service over HTTP/1.1: the only module that uses HTTP.
//!
//! * `server`: the listener, the processing common to all requests, the route table, the OpenAPI document, the metrics;
//! * `wire`: conversion between requests and values: extractors, bodies, numbers, paging, names, problems;
//! * `v1`: a file for each resource, with its wire types, their documentation and its handlers.
//!
//! ```text
//! connection --listener--> request --edge (id, log, limits, panics)--> router --> handler --> service
//!                                    <-- Problem, rendered at the edge <--
//! ```

mod app;
mod server;
mod v1;
mod wire;

pub use server::listener::{Server, Stopper};
pub use server::openapi::COMMITTED;
pub use server::router::openapi_json;
pub use v1::measurements::{
    MeasurementDocument, PartDocument, PoseDocument, ProfileDocument, ReasonDocument, ScopeDocument, TallyDocument,
    UncertaintyDocument, VerdictName, profiles_csv,
};
pub use wire::problem::Code;
