//! Conversion between requests and values: extractors, bodies, numbers, paging, names and problems.

pub(in crate::http) mod body;
pub(in crate::http) mod command;
pub(in crate::http) mod extract;
pub(in crate::http) mod names;
pub(in crate::http) mod numbers;
pub(in crate::http) mod paging;
pub(in crate::http) mod problem;
