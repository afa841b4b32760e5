//! The resources of the API, one file each: wire types, their documentation and handlers together.

pub(in crate::http) mod cell;
pub(in crate::http) mod events;
pub(in crate::http) mod manipulators;
pub(in crate::http) mod measurements;
pub(in crate::http) mod moves;
pub(in crate::http) mod plans;
pub(in crate::http) mod recipes;
pub(in crate::http) mod scans;
pub(in crate::http) mod status;
