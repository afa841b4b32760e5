//! The Gocator adaptor: its bytes against those of the maker's own library, its link against a simulated sensor on
//! loopback. No hardware was ever on the other side.

#![expect(
    clippy::expect_used,
    clippy::panic,
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may fail, and says what it saw"
)]

mod contract;
mod golden;
mod hostile;
mod link;
mod pose;
mod sensor;
mod stream;
