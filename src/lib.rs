//! coaxis measures the pose of the axis of a cylindrical part from laser profile scans.
//!
//! The way of the data, each arrow one function in one file, each noun one type:
//!
//! ```text
//! bytes -> Cloud -> Scan (profiles) -> Estimate (axis, diagnostics) -> Measurement (record)
//!
//!                  MES / PLC / curl / browser
//!                             |
//! http, cli ----------------- v ---- the edges: wire types, problems, commands
//!                             |
//! service ------------------- v ---- the product's verbs; makes ids and times, owns the compute pool
//!          |                  |                    |
//!          v                  v                    v
//!       estimation           plot                store
//!       scan                 SVG, pure           records, raw scans; SQLite
//!       geometry (pure)
//! ```
//!
//! The rooms below stand in the order in which data pass them. Nothing points back: `tests/house.rs` reads the
//! imports and holds us to it. Left of `store` nothing waits, logs, reads a clock or draws a random number.

pub mod cli;
pub mod config;
pub mod estimation;
pub mod geometry;
pub mod http;
pub mod plot;
pub mod scan;
pub mod service;
pub mod store;
