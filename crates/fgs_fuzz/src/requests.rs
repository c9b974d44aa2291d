//! What comes over the network.

use std::io::Read;

use fgs_view::Request;

/// The longest head of which the pieces that it comes in make no difference, bytes.
const SURELY_READ_BYTES: usize = 16 << 10;

/// What somebody sends to the server of a page, in one piece and in two.
pub fn request(bytes: &[u8]) {
    let whole = Request::read(&mut &*bytes);
    if let Some(request) = &whole {
        assert!(!request.method.is_empty() && !request.path.contains('?'));
    }
    if bytes.len() <= SURELY_READ_BYTES {
        let (first, rest) = bytes.split_at(bytes.len() / 2);
        assert_eq!(Request::read(&mut first.chain(rest)), whole);
    }
}
