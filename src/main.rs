//! The `coaxis` command; all of it stands in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    coaxis::cli::run()
}
