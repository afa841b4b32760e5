//! coaxis measures the pose of the axis of a cylindrical part from laser profile scans, and moves the part to a target pose.
//!
//! The data flow; each arrow is one function in one file, each noun is one type:
//!
//! ```text
//! bytes -> Cloud -> Scan (profiles) -> Estimate (axis, diagnostics) -> Measurement (record) -> Plan -> move
//!
//!                  MES / PLC / curl / browser
//!                             |
//! http (server, wire, v1) --- v ---- the only module that uses HTTP;  cli: the same offline
//!                             |
//! service   measuring | operating -- use cases; creates ids and times
//!          |             |             |               |                |
//!          v             v             v               v                v
//!       estimation     plot         motion           cell            store
//!       scan           SVG          kinematics,      lease, moves,   records, raw scans; SQLite
//!       geometry                    limits, plans    scans, stop
//!                                                      |
//!                                                     device: simulated | gocator | modbus | opcua
//! ```
//!
//! Read the modules in the order in which data pass: geometry, scan, estimation, plot, motion, device, cell, store, config, service,
//! http, cli. None imports a later one (`tests/architecture.rs`), and no files import each other in a circle (`tests/cycles.rs`). The
//! first five are the crate `coaxis-calculation` in src/calculation, which is re-exported here: it neither waits, logs nor reads a
//! clock, and random numbers come from seeds.

pub mod cell;
pub mod cli;
pub mod config;
pub mod device;
pub mod http;
pub mod service;
pub mod store;

pub use coaxis_calculation::{estimation, geometry, motion, plot, scan};
