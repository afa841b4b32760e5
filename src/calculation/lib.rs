//! The pure calculation of coaxis: bytes to points, points to a pose, a pose to a plan, and pictures of all that. It neither waits
//! nor logs nor reads a clock, and chance comes from seeds.
//!
//! It is a crate of its own, so that it is not compiled again when the service changes, and can be tested without it.

pub mod estimation;
pub mod geometry;
pub mod motion;
pub mod plot;
pub mod scan;
