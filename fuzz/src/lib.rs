//! The functions behind the fuzz targets: each takes arbitrary bytes to a place where bytes of strangers enter coaxis. An error is
//! as good as a result there; a panic, an overflow, a broken promise, too much memory or too much time is a fault. `fuzz/run`
//! builds and runs all targets.

pub mod devices;
pub mod scans;
pub mod settings;
