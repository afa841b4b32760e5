//! The service from outside: started on a free port with a store of its own, and asked by HTTP over loopback.
//! Tests of a cell, in `cell`, are declared among those with deadlines in `tests/main.rs`.

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
