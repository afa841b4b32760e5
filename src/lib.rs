//! coaxis measures the pose of the axis of a cylindrical part from laser profile scans.
//!
//! The way of the data, each arrow one function in one file, each noun one type:
//!
//! ```text
//! bytes -> Cloud -> Scan (profiles) -> Estimate (axis, diagnostics) -> Measurement (record) -> Plan -> move
//!
//!                  MES / PLC / curl / browser
//!                             |
//! http, cli ----------------- v ---- the edges: wire types, problems, commands
//!                             |
//! service ------------------- v ---- the product's verbs; makes ids and times, owns the compute pool
//!          |             |             |               |                |
//!          v             v             v               v                v
//!       estimation     plot         motion (pure)     cell            store
//!       scan           SVG, pure    kinematics,       lease, moves,   records, raw scans; SQLite
//!       geometry (pure)             limits, plans     scans, stop
//!                                                      |
//!                                                     device: simulated | gocator | modbus | opcua
//! ```
//!
//! Read them in the order in which data pass: geometry, scan, estimation, plot, motion, device, cell, store, config, service,
//! http, cli. Nothing points back: `tests/architecture.rs` reads the imports and holds us to it. The first five are a crate of their own,
//! `coaxis-calculation` in src/calculation, which is here under the same names: it neither waits, logs nor reads a clock, and
//! chance comes from seeds.

pub mod cell;
pub mod cli;
pub mod config;
pub mod device;
pub mod http;
pub mod service;
pub mod store;

pub use coaxis_calculation::{estimation, geometry, motion, plot, scan};
