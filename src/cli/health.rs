//! `coaxis health`: asks a running service whether it can do its work; the health check of the container, which has no
//! shell and no curl.

use super::config::Sources;
use super::{Outcome, client};
use std::error::Error;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::process::ExitCode;
use std::time::Duration;

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

/// Where a service that listens there is asked from the same machine.
fn configured(listen: SocketAddr) -> Result<String, Box<dyn Error>> {
    if listen.port() == 0 {
        return Err(format!("listen = \"{listen}\" takes any free port; say which address to ask").into());
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
    fn an_address_of_every_interface_is_asked_on_this_machine() {
        let asked = |listen: &str| configured(listen.parse().expect("an address")).ok();
        assert_eq!(asked("0.0.0.0:9000").as_deref(), Some("http://127.0.0.1:9000/health/ready"));
        assert_eq!(asked("[::]:9000").as_deref(), Some("http://[::1]:9000/health/ready"));
        assert_eq!(asked("192.168.1.7:80").as_deref(), Some("http://192.168.1.7:80/health/ready"));
        assert_eq!(asked("127.0.0.1:0"), None);
    }
}
