//! Where a request comes from: the peer whose share of the places it takes, and whether its connection is a reserved one.

use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use std::convert::Infallible;
use std::net::{IpAddr, Ipv4Addr};

/// The network address that counts as one client: an IPv4 address, or the /64 network of an IPv6 address, since one host
/// may use every address of its /64.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Peer {
    /// An IPv4 address, also one that is written as IPv6.
    V4(Ipv4Addr),
    /// The first 64 bits of an IPv6 address.
    V6([u16; 4]),
}

/// The connection of a request; every request carries it as an extension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ConnectionInfo {
    /// Who is at the other end.
    pub(super) peer: Peer,
    /// All other places were taken, so only urgent requests are answered on this connection.
    pub(super) reserved: bool,
}

impl From<IpAddr> for Peer {
    fn from(address: IpAddr) -> Self {
        match address.to_canonical() {
            IpAddr::V4(address) => Self::V4(address),
            IpAddr::V6(address) => {
                let [a, b, c, d, ..] = address.segments();
                Self::V6([a, b, c, d])
            }
        }
    }
}

impl ConnectionInfo {
    /// The connection of a request. A request that did not come through a listener counts for the unspecified address.
    pub(super) fn of(extensions: &axum::http::Extensions) -> Self {
        let unspecified = Self { peer: Peer::V4(Ipv4Addr::UNSPECIFIED), reserved: false };
        extensions.get().copied().unwrap_or(unspecified)
    }
}

impl<S: Sync> FromRequestParts<S> for Peer {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Infallible> {
        Ok(ConnectionInfo::of(&parts.extensions).peer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_addresses_of_one_ipv6_network_are_one_peer_and_mapped_addresses_are_ipv4() {
        let peer = |text: &str| Peer::from(text.parse::<IpAddr>().expect("an address"));
        assert_eq!(peer("2001:db8:1:2::1"), peer("2001:db8:1:2:ffff::9"));
        assert_ne!(peer("2001:db8:1:2::1"), peer("2001:db8:1:3::1"));
        assert_eq!(peer("::ffff:192.0.2.7"), peer("192.0.2.7"));
        assert_ne!(peer("192.0.2.7"), peer("192.0.2.8"));
    }
}
