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
//! Read them in the order in which data pass: geometry, scan, estimation, plot, store, config, service, http, cli.
//! Nothing points back: `tests/house.rs` reads the imports and holds us to it. Left of `store` nothing waits, logs or
//! reads a clock, and chance comes from seeds.

pub mod cell;
pub mod cli;
pub mod config;
pub mod device;
pub mod estimation;
pub mod geometry;
pub mod http;
pub mod motion;
pub mod plot;
pub mod scan;
pub mod service;
pub mod store;
