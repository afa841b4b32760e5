//! The Gocator adaptor: its bytes are compared with those of the manufacturer's library, and its link is tested with a simulated
//! sensor on loopback. No real sensor was used.

#![expect(
    clippy::expect_used,
    clippy::panic,
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may fail, and prints its results"
)]

mod contract;
mod golden;
mod hostile;
mod link;
mod pose;
mod sensor;
mod stream;
