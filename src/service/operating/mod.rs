//! Operating the cell: its lease, plans, moves, scans by its sensor, and commands to single devices. Each is recorded.

pub(in crate::service) mod cell_handle;
pub(in crate::service) mod commands;
pub(in crate::service) mod equipment;
pub(in crate::service) mod job;
pub(in crate::service) mod jobs;
pub(in crate::service) mod leases;
pub(in crate::service) mod moves;
pub(in crate::service) mod plans;
pub(in crate::service) mod scan_order;
pub(in crate::service) mod sensor;
pub(in crate::service) mod state;
