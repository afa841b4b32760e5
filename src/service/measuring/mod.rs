//! Measuring: from the bytes of a scan to a record, and all queries, pictures and proposals from scans and records. Needs
//! no cell.

pub(in crate::service) mod copying_reader;
pub(in crate::service) mod measure;
pub(in crate::service) mod measurements;
pub(in crate::service) mod offline;
pub(in crate::service) mod order;
pub(in crate::service) mod pictures;
pub(in crate::service) mod pipeline;
pub(in crate::service) mod points;
pub(in crate::service) mod propose;
pub(in crate::service) mod reading;
pub(in crate::service) mod recipe;
pub(in crate::service) mod recipes;
pub(in crate::service) mod record;
pub(in crate::service) mod scans;
pub(in crate::service) mod state;
pub(in crate::service) mod upload;
