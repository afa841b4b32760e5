//! The cell: one task owns the devices and executes one activity at a time; all clients send requests to it and watch its state.
//!
//! ```text
//! handlers --requests--> task (state machine, lease, job) --commands--> drivers --> devices
//!    |                    |   ^------------ reports ----------------------'
//!    |                    '--> snapshot (watch), events (ring)
//!    '------- stop: raises the halt flag that every driver checks first -----^
//! ```
//!
//! Reading order: state (the diagram), machine, handle, task, run, driver. The stop of the cell is an operational stop, category 2:
//! not an emergency stop, and no safety function.

mod driver;
mod events;
mod failure;
mod following;
mod handle;
mod input;
mod lease;
mod machine;
mod obstacles;
mod refusal;
mod request;
mod run;
mod scanning;
mod settings;
mod snapshot;
mod state;
mod stop;
mod task;
mod work;

pub use crate::device::clock::now;
pub use driver::context::SILENCE;
pub use events::{EVENTS_KEPT, Event, EventKind, Events};
pub use failure::{Failure, Fault, JobEnd, StopCause};
pub use handle::Cell;
pub use input::{Manual, Taken};
pub use lease::{Lease, LeaseRequest, LeaseView};
pub use refusal::{Refusal, ScanNumber};
pub use request::{Job, JobState};
pub use settings::{Devices, ScanOrder, Settings, SettingsError};
pub use snapshot::{JobView, Link, Live, Quality, Snapshot};
pub use state::State;
pub use stop::{DeviceStop, StopReport};

#[cfg(test)]
mod tests;
