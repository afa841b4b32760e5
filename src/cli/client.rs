//! `coaxis health`, the health check of the container, which has no shell and no curl; and the HTTP/1.1 client with which it and
//! `coaxis demo` send requests to a service, one for each connection.

use std::error::Error;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::process::ExitCode;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

use super::client;
use super::config::Sources;
use super::output::Outcome;

/// Greatest number of bytes of an answer that are read.
const ANSWER_BYTES_MAX: u64 = 16 << 20;

/// Media type of a body that is not JSON.
const BYTES: &str = "application/octet-stream";

/// An answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Answer {
    /// HTTP status, e.g. 200; 0 if there was none.
    pub(super) status: u16,
    /// Body of the answer.
    pub(super) body: String,
}

/// Sends a GET request and returns the answer within `wait`.
pub(super) async fn get(url: &str, wait: Duration) -> Result<Answer, Box<dyn Error>> {
    ask("GET", url, (BYTES, &[]), wait).await
}

/// Sends a DELETE request and returns the answer within `wait`.
pub(super) async fn delete(url: &str, wait: Duration) -> Result<Answer, Box<dyn Error>> {
    ask("DELETE", url, (BYTES, &[]), wait).await
}

/// Sends a POST request with a JSON document and returns the answer within `wait`.
pub(super) async fn post_json(url: &str, body: &str, wait: Duration) -> Result<Answer, Box<dyn Error>> {
    ask("POST", url, ("application/json", body.as_bytes()), wait).await
}

/// Sends a POST request with `body` and returns the answer within `wait`.
pub(super) async fn post(url: &str, body: &[u8], wait: Duration) -> Result<Answer, Box<dyn Error>> {
    ask("POST", url, (BYTES, body), wait).await
}

async fn ask(method: &str, url: &str, body: (&str, &[u8]), wait: Duration) -> Result<Answer, Box<dyn Error>> {
    let late = |_| format!("{url} did not answer within {} ms", wait.as_millis());
    timeout(wait, exchange(method, url, body)).await.map_err(late)?
}

async fn exchange(method: &str, url: &str, (kind, body): (&str, &[u8])) -> Result<Answer, Box<dyn Error>> {
    let rest = url.strip_prefix("http://").ok_or_else(|| format!("{url}: the address must begin with http://"))?;
    let (authority, path) = rest.split_once('/').unwrap_or((rest, ""));
    let mut stream = TcpStream::connect(authority).await.map_err(|error| format!("{authority}: {error}"))?;
    let head = format!(
        "{method} /{path} HTTP/1.1\r\nHost: {authority}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\n\
         Connection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes()).await?;
    stream.write_all(body).await?;
    let mut answer = Vec::new();
    stream.take(ANSWER_BYTES_MAX).read_to_end(&mut answer).await?;
    let answer = String::from_utf8_lossy(&answer);
    let (head, body) = answer.split_once("\r\n\r\n").ok_or_else(|| format!("{url}: not an HTTP answer"))?;
    let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
    Ok(Answer { status, body: body.to_owned() })
}

/// Ask a running service whether it is ready; exit code 0 if it is
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// What to ask [default: /health/ready at the address that the configuration says]
    url: Option<String>,
    /// How long to wait for the answer, milliseconds
    #[arg(long, default_value_t = 3000, value_parser = clap::value_parser!(u64).range(1..=60_000))]
    timeout_ms: u64,
    #[command(flatten)]
    sources: Sources,
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let url = match &arguments.url {
        Some(url) => url.clone(),
        None => configured(arguments.sources.config()?.listen)?,
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let answer = runtime.block_on(client::get(&url, Duration::from_millis(arguments.timeout_ms)));
    let answer = answer.map_err(|error| format!("{error}; is the service running?"))?;
    if answer.status == 200 {
        return Ok(ExitCode::SUCCESS);
    }
    Err(format!("{url} answered {}: {}", answer.status, answer.body).into())
}

/// The address under which a service that listens on `listen` is reached from the same machine.
fn configured(listen: SocketAddr) -> Result<String, Box<dyn Error>> {
    if listen.port() == 0 {
        return Err(format!("listen = \"{listen}\" selects any free port; give the address of the service").into());
    }
    let ip = match listen.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
        ip => ip,
    };
    Ok(format!("http://{}/health/ready", SocketAddr::new(ip, listen.port())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unspecified_listen_address_is_reached_on_this_machine() {
        let asked = |listen: &str| configured(listen.parse().expect("an address")).ok();
        assert_eq!(asked("0.0.0.0:9000").as_deref(), Some("http://127.0.0.1:9000/health/ready"));
        assert_eq!(asked("[::]:9000").as_deref(), Some("http://[::1]:9000/health/ready"));
        assert_eq!(asked("192.168.1.7:80").as_deref(), Some("http://192.168.1.7:80/health/ready"));
        assert_eq!(asked("127.0.0.1:0"), None);
    }
}
