//! `coaxis doctor`: examines the data folder, whether a service is running on it or not.

use super::config::Sources;
use super::output::{FAILED, Outcome, print};
use crate::service::{Examined, accept_loss, examine};
use std::process::ExitCode;

/// Examine the database, its records and the files of the scans; exit code 1 if anything is not as it should be
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    sources: Sources,
    /// Read every byte of every scan and compare it with the SHA-256 that was recorded
    #[arg(long)]
    scrub: bool,
    /// Take the database as it is although it lost acknowledged records, so that the service writes again. Not beside a service
    #[arg(long, conflicts_with = "scrub")]
    accept_loss: bool,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let config = arguments.sources.config()?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    if arguments.accept_loss {
        runtime.block_on(accept_loss(&config.data))?;
        print("the records of the database count as complete from now on\n")?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut closed = Ok(());
    let mut tell = |finding: &str| {
        if closed.is_ok() {
            closed = print(&format!("{finding}\n"));
        }
    };
    let examined = runtime.block_on(examine(&config.data, arguments.scrub, &mut tell))?;
    closed?;
    let Examined { records_count, scans_count, findings_count } = examined;
    let depth = if arguments.scrub { "read and compared" } else { "looked for" };
    print(&format!("{records_count} records read, {scans_count} files of scans {depth}: {findings_count} findings\n"))?;
    Ok(if findings_count == 0 { ExitCode::SUCCESS } else { ExitCode::from(FAILED) })
}
