//! Reads a request's head.

use std::io::Read;

/// No browser sends longer ones.
const MAX_HEAD_BYTES: usize = 16 << 10;
const MAX_HEADERS: usize = 64;

/// What of a request matters here.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Request {
    /// As sent: `GET`.
    pub method: String,
    /// Without the query.
    pub path: String,
    /// The server's name, as the browser knows it; empty if it does not say.
    pub host: String,
    /// The page that sends it, if it says so.
    pub origin: Option<String>,
    /// Whether an answer may be packed.
    pub accepts_gzip: bool,
}

impl Request {
    /// Reads a head; `None` if it is none, is too long or does not come.
    pub fn read(stream: &mut impl Read) -> Option<Self> {
        let mut head = Vec::new();
        let mut block = [0; 2048];
        loop {
            let count = stream.read(&mut block).ok().filter(|count| *count > 0)?;
            head.extend_from_slice(&block[..count]);
            if let Some(request) = Self::parse(&head)? {
                return Some(request);
            }
            if head.len() > MAX_HEAD_BYTES {
                return None;
            }
        }
    }

    /// `Some(None)` if it is not whole yet.
    fn parse(head: &[u8]) -> Option<Option<Self>> {
        let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
        let mut parsed = httparse::Request::new(&mut headers);
        if parsed.parse(head).ok()?.is_partial() {
            return Some(None);
        }
        let header = |name: &str| {
            let mut headers = parsed.headers.iter();
            let header = headers.find(|header| header.name.eq_ignore_ascii_case(name))?;
            Some(String::from_utf8_lossy(header.value).into_owned())
        };
        let path = parsed.path?.split('?').next()?;
        Some(Some(Self {
            method: parsed.method?.into(),
            path: path.into(),
            host: header("host").unwrap_or_default(),
            origin: header("origin"),
            accepts_gzip: header("accept-encoding").is_some_and(|value| value.contains("gzip")),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_head_is_read_in_whatever_pieces_it_comes() {
        let head = b"GET /a/b?c=1 HTTP/1.1\r\nHOST: x:1\r\nOrigin: http://x:1\r\naccept-encoding: br, gzip\r\n\r\n";
        let expected = Request {
            method: "GET".into(),
            path: "/a/b".into(),
            host: "x:1".into(),
            origin: Some("http://x:1".into()),
            accepts_gzip: true,
        };
        assert_eq!(Request::read(&mut &head[..]).unwrap(), expected);
        let (first, rest) = head.split_at(30);
        assert_eq!(Request::read(&mut first.chain(rest)).unwrap(), expected);
    }

    #[test]
    fn what_is_no_head_or_never_ends_is_refused() {
        assert_eq!(Request::read(&mut &b"GET /a HTTP/1.1\r\nHost: x"[..]), None);
        assert_eq!(Request::read(&mut &b"\x16\x03\x01\x02\r\n\r\n"[..]), None);
        assert_eq!(Request::read(&mut &b""[..]), None);
        let mut endless = (&b"GET /a HTTP/1.1\r\nA: "[..]).chain(std::io::repeat(b'x'));
        assert_eq!(Request::read(&mut endless), None);
    }
}
