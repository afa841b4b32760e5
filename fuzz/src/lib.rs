//! The functions of the fuzz targets: each passes arbitrary bytes to a function through which untrusted bytes enter coaxis. An
//! error is an acceptable result; a panic, an overflow, a violated guarantee, excessive memory or excessive time is a fault. `fuzz/run`
//! builds and runs all targets.

pub mod devices;
pub mod scans;
pub mod settings;
