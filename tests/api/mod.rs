//! The service as a client uses it: started on a free port with its own store, and tested by HTTP over loopback.
//! Tests of a cell, in `cell`, are declared with those that have deadlines in `tests/main.rs`.

#![expect(clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "tests may fail")]

pub(crate) mod bodies;
mod command;
mod crowded;
mod documents;
mod field;
pub(crate) mod harness;
mod kept;
mod life;
mod limits;
mod measurements;
mod on_the_way;
mod origin;
mod parts;
mod recipes;
mod scans;
mod wrong_scans;
