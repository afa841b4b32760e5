//! The service from outside: one binary that starts it on a free port with a store of its own, and talks HTTP over loopback.

#![expect(clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "tests may fail")]

mod bodies;
mod cell;
mod command;
mod crowded;
mod documents;
mod field;
mod harness;
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
