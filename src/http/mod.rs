//! The service over HTTP/1.1: the only room that knows it. Wire types, their documentation and handlers stand together, a
//! file a resource; the route table is `router`, every refusal goes through `problem`.
//!
//! ```text
//! connection --server--> request --edge (id, log, limits, panics)--> router --> handler --> service
//!                                    <-- Problem, rendered at the edge <--
//! ```

mod accept;
mod admission;
mod app;
mod axes;
mod body;
mod cell;
mod command;
mod connections;
mod docs;
mod edge;
mod entry;
mod events;
mod extract;
mod guarded;
mod listeners;
mod manipulators;
mod measurements;
mod metrics;
mod moves;
mod names;
mod numbers;
mod openapi;
mod pace;
mod paging;
mod peer;
mod plans;
mod problem;
mod receive;
mod recipes;
mod router;
mod same_origin;
mod scans;
mod server;
mod shares;
mod status;
mod times;

pub use measurements::{
    MeasurementDocument, PartDocument, PoseDocument, ProfileDocument, ReasonDocument, ScopeDocument, TallyDocument,
    UncertaintyDocument, VerdictName, profiles_csv,
};
pub use openapi::{COMMITTED, openapi_json};
pub use problem::Code;
pub use server::{Server, Stopper};
