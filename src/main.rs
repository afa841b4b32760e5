//! The `coaxis` command.

fn main() {}
