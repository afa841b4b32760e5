//! The calculation of coaxis: file bytes to points, points to a pose, a pose to a motion plan, and pictures of the results. It does
//! no waiting, logging or clock access, and random numbers come from seeds.
//!
//! It is a separate crate, so that it is not recompiled when the service changes and can be tested alone.

pub mod estimation;
pub mod geometry;
pub mod motion;
pub mod plot;
pub mod scan;
