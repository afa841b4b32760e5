//! Asks a service over HTTP/1.1, one request a connection: enough for the health check and the demonstration, which must work
//! where there is no curl.

use std::error::Error;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

/// More of an answer is not read.
const ANSWER_BYTES_MAX: u64 = 16 << 20;

/// What bytes are sent as that are no document.
const BYTES: &str = "application/octet-stream";

/// An answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Answer {
    /// E.g. 200; 0 where there was none.
    pub(super) status: u16,
    /// What came with it.
    pub(super) body: String,
}

/// GET, answered within `wait`.
pub(super) async fn get(url: &str, wait: Duration) -> Result<Answer, Box<dyn Error>> {
    ask("GET", url, (BYTES, &[]), wait).await
}

/// DELETE, answered within `wait`.
pub(super) async fn delete(url: &str, wait: Duration) -> Result<Answer, Box<dyn Error>> {
    ask("DELETE", url, (BYTES, &[]), wait).await
}

/// POST of a JSON document, answered within `wait`.
pub(super) async fn post_json(url: &str, body: &str, wait: Duration) -> Result<Answer, Box<dyn Error>> {
    ask("POST", url, ("application/json", body.as_bytes()), wait).await
}

/// POST of `body`, answered within `wait`.
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
