//! Who may see the pages: whoever is at this machine, or knows the token in the address.
//!
//! A browser runs pages of strangers too. They cannot read what is served here, since a browser keeps
//! origins apart, unless their name is made to point here after they were loaded (DNS rebinding): so a
//! request must name this machine as its host.

use std::fmt;
use std::net::{IpAddr, SocketAddr, ToSocketAddrs};
use std::str::FromStr;

/// The port unless another is asked for.
const PORT: u16 = 7070;

/// Where to serve: `HOST:PORT`, `:PORT` or `HOST`. Port 0 is any that is free.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    host: String,
    /// `None`: the usual one, or any if that is taken.
    port: Option<u16>,
}

impl Default for Address {
    /// This machine only.
    fn default() -> Self {
        Self {
            host: "127.0.0.1".into(),
            port: None,
        }
    }
}

impl FromStr for Address {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let refusal =
            || format!("'{text}' is not an address such as 127.0.0.1:{PORT} or 0.0.0.0:{PORT}");
        let (host, port) = match text.parse::<IpAddr>() {
            Ok(_) => (text, None),
            Err(_) => match text.rsplit_once(':') {
                Some((host, port)) => (host, Some(port.parse().map_err(|_| refusal())?)),
                None => (text, None),
            },
        };
        let host = host.trim_start_matches('[').trim_end_matches(']');
        let is_name = |c: char| c.is_ascii_alphanumeric() || "-.:".contains(c);
        if !host.chars().all(is_name) {
            return Err(refusal());
        }
        let host = if host.is_empty() { "127.0.0.1" } else { host };
        Ok(Self {
            host: host.into(),
            port,
        })
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.host, self.port.unwrap_or(PORT))
    }
}

impl Address {
    /// What to listen at, in turn.
    ///
    /// # Errors
    /// If the host is not known.
    pub(crate) fn candidates(&self) -> std::io::Result<Vec<SocketAddr>> {
        let ports = self.port.map_or(vec![PORT, 0], |port| vec![port]);
        let mut candidates = Vec::new();
        for port in ports {
            candidates.extend((self.host.as_str(), port).to_socket_addrs()?);
        }
        Ok(candidates)
    }
}

/// What a request must bring.
#[derive(Debug)]
pub struct Access {
    /// The first part of every path, if there must be one.
    token: Option<String>,
    /// The host's name as it was asked to listen at.
    host: String,
}

impl Access {
    /// For a server that listens at `bound`: a token is needed where others can reach it.
    pub fn new(address: &Address, bound: &SocketAddr) -> Self {
        let token = (!bound.ip().is_loopback()).then(|| format!("{:032x}", rand::random::<u128>()));
        Self {
            token,
            host: address.host.clone(),
        }
    }

    /// The path of the pages, with a slash at both ends.
    pub fn root(&self) -> String {
        (self.token.as_ref()).map_or("/".into(), |token| format!("/{token}/"))
    }

    /// The rest of a path that begins with the token, if one is needed.
    pub fn path_of<'a>(&self, path: &'a str) -> Option<&'a str> {
        let path = path.strip_prefix('/')?;
        let Some(token) = &self.token else {
            return Some(path);
        };
        let (given, rest) = path.split_once('/')?;
        is_equal(given.as_bytes(), token.as_bytes()).then_some(rest)
    }

    /// Whether a `Host` header names this machine and not a stranger's. Any port will do: it may be
    /// forwarded.
    pub fn is_host(&self, header: &str) -> bool {
        let host = match header.rsplit_once(':') {
            Some((host, port)) if port.parse::<u16>().is_ok() => host,
            _ => header,
        };
        let host = host.trim_start_matches('[').trim_end_matches(']');
        match host.parse::<IpAddr>() {
            // An attacker has names, but no name is an address.
            Ok(address) => self.token.is_some() || address.is_loopback(),
            Err(_) => {
                host.eq_ignore_ascii_case("localhost") || host.eq_ignore_ascii_case(&self.host)
            }
        }
    }
}

/// Compares in a time that does not tell how many bytes are right.
fn is_equal(a: &[u8], b: &[u8]) -> bool {
    let differences = a.iter().zip(b).fold(0, |sum, (a, b)| sum | (a ^ b));
    a.len() == b.len() && differences == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn access(address: &str, bound: &str) -> Access {
        Access::new(&address.parse().unwrap(), &bound.parse().unwrap())
    }

    #[test]
    fn addresses_are_read() {
        let parsed = |text: &str| text.parse::<Address>().map(|address| address.to_string());
        assert_eq!(parsed("0.0.0.0:80").unwrap(), "0.0.0.0:80");
        assert_eq!(parsed(":80").unwrap(), "127.0.0.1:80");
        assert_eq!(parsed("robot.local").unwrap(), "robot.local:7070");
        assert_eq!(parsed("::1").unwrap(), "::1:7070");
        assert_eq!(parsed("[::1]:80").unwrap(), "::1:80");
        for text in ["recordings/desk", "1.2.3.4:x", "1.2.3.4:70000", "a b"] {
            assert!(parsed(text).unwrap_err().contains(text));
        }
        assert_eq!(Address::default().candidates().unwrap().len(), 2);
    }

    #[test]
    fn only_strangers_need_a_token() {
        let own = access("127.0.0.1", "127.0.0.1:1");
        assert_eq!(
            (own.root().as_str(), own.path_of("/a/b")),
            ("/", Some("a/b"))
        );
        let open = access("0.0.0.0", "0.0.0.0:1");
        let root = open.root();
        assert_eq!(root.len(), 34);
        assert_ne!(root, access("0.0.0.0", "0.0.0.0:1").root());
        assert_eq!(open.path_of(&format!("{root}a/b")), Some("a/b"));
        let wrong = root.replace(|c: char| c.is_ascii_hexdigit(), "0");
        for path in ["/", "/a/b", "//a", &root[..20], &root[..33], &wrong] {
            assert_eq!(open.path_of(path), None, "{path}");
        }
    }

    #[test]
    fn a_strangers_name_is_no_host() {
        let own = access("127.0.0.1", "127.0.0.1:1");
        for host in ["localhost:9000", "127.0.0.1:1", "[::1]:5", "LOCALHOST"] {
            assert!(own.is_host(host), "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:1",
            "10.0.0.1:1",
            "",
            "localhost.evil.example",
        ] {
            assert!(!own.is_host(host), "{host}");
        }
        let open = access("robot.local:80", "10.0.0.1:80");
        for host in [
            "robot.local:80",
            "10.0.0.1",
            "[fe80::1]:80",
            "localhost:9000",
        ] {
            assert!(open.is_host(host), "{host}");
        }
        assert!(!open.is_host("evil.example:80"));
    }
}
