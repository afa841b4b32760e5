//! The made cell: devices that behave like real ones, with faults on demand, for tests and for trying coaxis without a
//! machine. Seeded, on tokio's clock.

mod controller;
mod mechanics;
mod record;
mod servo;

pub use controller::{Controller, ControllerSettings, Taken, code, is_newer};
pub use record::{Executed, Record};
