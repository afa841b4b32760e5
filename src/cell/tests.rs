//! Tests of the whole cell on the made devices, on paused time, with fixed seeds. The pure machine has its own, in `machine`.

mod answers;
mod bench;
mod campaign;
mod faults;
mod homing;
mod laser;
mod leases;
mod links;
mod machine;
mod moves;
mod scans;
mod stops;
mod stuck;
