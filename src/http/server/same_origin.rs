//! Prevents web pages of other sites from using the service through the browser of a user who can reach it. A request is refused
//!
//! * if its `Host` is not an address, localhost or a configured name: a foreign name that resolves to this machine
//!   (DNS rebinding) would give the foreign page the origin of this service;
//! * if its `Origin` is another site, or if it is a modifying request that the browser marks as coming from another site
//!   (`Sec-Fetch-Site`).
//!
//! Programs send no `Origin`. The documentation is public. Links and pictures of other sites send no `Origin` either;
//! the page that shows them cannot read them.

use crate::http::wire::problem::{Code, Problem};
use axum::extract::Request;
use axum::http::uri::Authority;
use axum::http::{HeaderName, Method, Version, header};
use std::net::IpAddr;

const FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

/// Checks the target host and the origin of a request; `hosts` are the configured names.
///
/// # Errors
/// [`Code::HostInvalid`], [`Code::HostUnknown`], [`Code::OriginForeign`].
pub(in crate::http) fn check(hosts: &[String], request: &Request) -> Result<(), Problem> {
    let Some(host) = host(request)? else { return Ok(()) };
    if !is_served(hosts, host.host()) {
        return Err(unknown(host.host()));
    }
    match foreign_origin(hosts, &host, request) {
        Some(origin) if !is_public(request) => Err(foreign(origin)),
        _ => Ok(()),
    }
}

/// The host of the request; `None` if an HTTP/1.0 request has none.
fn host(request: &Request) -> Result<Option<Authority>, Problem> {
    let mut named = request.headers().get_all(header::HOST).iter();
    let invalid = |what: &str| {
        let detail = format!("{what}; send one header Host with the address of this service, such as 127.0.0.1:8080");
        Problem::new(Code::HostInvalid, detail)
    };
    match (named.next(), named.next()) {
        (Some(_), Some(_)) => Err(invalid("the request has more than one header Host")),
        (Some(host), None) => {
            let parsed = Authority::try_from(host.as_bytes()).ok().filter(is_host_and_port);
            // An absolute address in the request line has priority over the header.
            let decisive = request.uri().authority().cloned().or(parsed);
            decisive.map(Some).ok_or_else(|| invalid("the header Host is not a host with an optional port"))
        }
        (None, _) if request.version() < Version::HTTP_11 => Ok(request.uri().authority().cloned()),
        (None, _) => Err(invalid("a request of HTTP/1.1 needs the header Host, and this one has none")),
    }
}

/// Whether it contains no user name, and its port, if present, is a number.
fn is_host_and_port(host: &Authority) -> bool {
    !host.as_str().contains('@') && (host.port_u16().is_some() || host.as_str() == host.host())
}

/// Whether requests for this host are answered.
fn is_served(hosts: &[String], host: &str) -> bool {
    is_address(host) || host.eq_ignore_ascii_case("localhost") || is_configured(hosts, host)
}

fn is_address(host: &str) -> bool {
    let inside = host.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(host);
    inside.parse::<IpAddr>().is_ok()
}

fn is_configured(hosts: &[String], host: &str) -> bool {
    let host = host.strip_suffix('.').unwrap_or(host);
    hosts.iter().any(|name| name.eq_ignore_ascii_case(host))
}

/// The origin of a request, if it is another site.
fn foreign_origin<'a>(hosts: &[String], host: &Authority, request: &'a Request) -> Option<&'a str> {
    let headers = request.headers();
    if let Some(origin) = headers.get(header::ORIGIN) {
        let Ok(origin) = origin.to_str() else { return Some("an origin that is not text") };
        return (!is_own(hosts, host, origin)).then_some(origin);
    }
    if is_read(request.method()) {
        return None;
    }
    let site = headers.get(&FETCH_SITE)?.to_str().ok()?;
    ["cross-site", "same-site"].contains(&site).then_some(site)
}

fn is_read(method: &Method) -> bool {
    [Method::GET, Method::HEAD].contains(method)
}

/// Whether an origin is this service: the host of the request, or a configured one, because a proxy may have replaced the host
/// in `Host`. The scheme is ignored, because the proxy may add TLS.
fn is_own(hosts: &[String], host: &Authority, origin: &str) -> bool {
    let Some((scheme, rest)) = origin.split_once("://") else { return false };
    let default_port = match scheme {
        "http" => 80,
        "https" => 443,
        _ => return false,
    };
    let Ok(origin) = Authority::try_from(rest) else { return false };
    let same_port = match host.port_u16() {
        Some(port) => origin.port_u16().unwrap_or(default_port) == port,
        None => origin.port_u16().is_none_or(|port| port == default_port),
    };
    (same_port && origin.host().eq_ignore_ascii_case(host.host())) || is_configured(hosts, origin.host())
}

/// Whether it is public: the documentation.
fn is_public(request: &Request) -> bool {
    let path = request.uri().path();
    is_read(request.method()) && (path == "/openapi.json" || path == "/docs" || path.starts_with("/docs/"))
}

fn unknown(host: &str) -> Problem {
    let detail = format!(
        "this service does not answer for the host {host}: use its address or localhost, or add the name to `hosts` in the \
         configuration (COAXIS_HOSTS={host})"
    );
    Problem::new(Code::HostUnknown, detail).with("host", host)
}

fn foreign(origin: &str) -> Problem {
    let detail = format!(
        "the request comes from a web page of another site ({origin}), and only pages of this service may use it; where the \
         page is served under another name of this service, add that name to `hosts` in the configuration"
    );
    Problem::new(Code::OriginForeign, detail).with("origin", origin)
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::body::Body;

    fn checked(method: Method, path: &str, headers: &[(&str, &str)]) -> Result<(), Code> {
        let request = Request::builder().method(method).uri(path);
        let request = headers.iter().fold(request, |request, (name, value)| request.header(*name, *value));
        let request = request.body(Body::empty()).expect("a request");
        check(&["line3.example".to_owned()], &request).map_err(|problem| problem.code())
    }

    fn post(headers: &[(&str, &str)]) -> Result<(), Code> {
        checked(Method::POST, "/v1/cell/stop", headers)
    }

    #[test]
    fn a_host_is_an_address_localhost_or_configured() {
        for host in
            ["127.0.0.1:8080", "10.1.2.3", "[::1]:8080", "[fe80::1]", "localhost", "LocalHost:80", "LINE3.example.:1"]
        {
            assert_eq!(post(&[("host", host)]), Ok(()), "{host}");
        }
        for host in ["attacker.example", "127.0.0.1.attacker.example", "localhost.attacker.example:8080", "line4"] {
            assert_eq!(post(&[("host", host)]), Err(Code::HostUnknown), "{host}");
        }
        for host in ["", "a b", "user@localhost", "localhost:port"] {
            assert_eq!(post(&[("host", host)]), Err(Code::HostInvalid), "{host}");
        }
        assert_eq!(post(&[]), Err(Code::HostInvalid), "HTTP/1.1 without Host");
        assert_eq!(post(&[("host", "localhost"), ("host", "localhost")]), Err(Code::HostInvalid));
    }

    #[test]
    fn the_own_origin_is_the_host_of_the_request_or_a_configured_one() {
        let own = [
            ("127.0.0.1:8080", "http://127.0.0.1:8080"),
            ("localhost:8080", "http://localhost:8080"),
            ("[::1]:8080", "http://[::1]:8080"),
            ("10.1.2.3", "http://10.1.2.3"),
            ("10.1.2.3", "https://10.1.2.3:443"),
            ("10.1.2.3:443", "https://10.1.2.3"),
            ("127.0.0.1:8080", "https://line3.example"),
        ];
        for (host, origin) in own {
            assert_eq!(post(&[("host", host), ("origin", origin)]), Ok(()), "{host} {origin}");
        }
        let foreign = [
            "null",
            "http://attacker.example",
            "http://localhost:3000",
            "http://127.0.0.1:8080.attacker.example",
            "file://localhost:8080",
            "http://line3.example.attacker.example",
            "",
        ];
        for origin in foreign {
            let answer = post(&[("host", "localhost:8080"), ("origin", origin)]);
            assert_eq!(answer, Err(Code::OriginForeign), "{origin}");
        }
    }

    #[test]
    fn pages_of_other_sites_may_read_the_documentation_show_pictures_and_do_nothing_else() {
        let origin = [("host", "localhost"), ("origin", "http://attacker.example")];
        for path in ["/openapi.json", "/docs", "/docs/swagger-ui.css"] {
            assert_eq!(checked(Method::GET, path, &origin), Ok(()), "{path}");
        }
        assert_eq!(checked(Method::POST, "/docs", &origin), Err(Code::OriginForeign));
        assert_eq!(checked(Method::GET, "/v1/status", &origin), Err(Code::OriginForeign));
        for site in ["cross-site", "same-site"] {
            let marked = [("host", "localhost"), ("sec-fetch-site", site)];
            assert_eq!(checked(Method::GET, "/v1/measurements/m/plots/section.svg", &marked), Ok(()), "a picture");
            assert_eq!(post(&marked), Err(Code::OriginForeign), "{site}");
        }
        for site in ["same-origin", "none"] {
            assert_eq!(post(&[("host", "localhost"), ("sec-fetch-site", site)]), Ok(()), "{site}");
        }
    }
}
