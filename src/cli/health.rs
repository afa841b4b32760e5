//! `coaxis health`: asks a running service whether it can do its work; the health check of the container, which has no
//! shell and no curl.

use super::Outcome;
use std::error::Error;
use std::process::ExitCode;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

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

/// The first line and the code of a problem are enough; more is not read.
const ANSWER_BYTES_MAX: u64 = 16 << 10;

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let wait = Duration::from_millis(arguments.timeout_ms);
    let answer = runtime.block_on(async { timeout(wait, ask(&arguments.url)).await });
    let answer =
        answer.map_err(|_| format!("{} did not answer within {} ms", arguments.url, arguments.timeout_ms))??;
    let status = answer.split(' ').nth(1).unwrap_or_default();
    if status == "200" {
        return Ok(ExitCode::SUCCESS);
    }
    let body = answer.split_once("\r\n\r\n").map_or("", |(_, body)| body);
    Err(format!("{} answered {status}: {body}", arguments.url).into())
}

async fn ask(url: &str) -> Result<String, Box<dyn Error>> {
    let rest = url.strip_prefix("http://").ok_or("the address must begin with http://")?;
    let (authority, path) = rest.split_once('/').unwrap_or((rest, "health/ready"));
    let mut stream = TcpStream::connect(authority).await.map_err(|error| format!("{authority}: {error}"))?;
    let request = format!("GET /{path} HTTP/1.1\r\nHost: {authority}\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await?;
    let mut answer = Vec::new();
    stream.take(ANSWER_BYTES_MAX).read_to_end(&mut answer).await?;
    Ok(String::from_utf8_lossy(&answer).into_owned())
}
