//! `coaxis health`: asks a running service whether it can do its work; the health check of the container, which has no
//! shell and no curl.

use super::{Outcome, client};
use std::process::ExitCode;
use std::time::Duration;

/// Ask a running service whether it is ready; exit code 0 if it is
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// What to ask
    #[arg(default_value = "http://127.0.0.1:8080/health/ready")]
    url: String,
    /// How long to wait for the answer, milliseconds
    #[arg(long, default_value_t = 3000, value_parser = clap::value_parser!(u64).range(1..=60_000))]
    timeout_ms: u64,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let answer = runtime.block_on(client::get(&arguments.url, Duration::from_millis(arguments.timeout_ms)))?;
    if answer.status == 200 {
        return Ok(ExitCode::SUCCESS);
    }
    Err(format!("{} answered {}: {}", arguments.url, answer.status, answer.body).into())
}
