//! Writes a response.

use std::io::{self, Read, Write};

use flate2::read::GzDecoder;

use crate::page::File;

/// The page may load nothing from elsewhere, nor be shown inside another. Spark computes in WebAssembly, on a
/// worker that it makes from text.
const POLICY: &str = "default-src 'self'; script-src 'self' 'wasm-unsafe-eval' blob:; worker-src blob:; \
     connect-src 'self' data: blob:; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; \
     base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Begins a response; its body, if its length is not given, ends with the connection.
pub fn write_head(
    out: &mut impl Write,
    status: &str,
    content_type: &str,
    length: Option<usize>,
    is_gzip: bool,
) -> io::Result<()> {
    write!(out, "HTTP/1.1 {status}\r\nContent-Type: {content_type}\r\n")?;
    if let Some(length) = length {
        write!(out, "Content-Length: {length}\r\n")?;
    }
    if is_gzip {
        write!(out, "Content-Encoding: gzip\r\n")?;
    }
    write!(
        out,
        "Content-Security-Policy: {POLICY}\r\nX-Content-Type-Options: nosniff\r\n\
         Referrer-Policy: no-referrer\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n"
    )
}

/// Answers with a line of text.
pub fn write_text(out: &mut impl Write, status: &str) -> io::Result<()> {
    write_head(
        out,
        status,
        "text/plain; charset=utf-8",
        Some(status.len() + 1),
        false,
    )?;
    writeln!(out, "{status}")
}

/// Answers with a file.
pub fn write_file(out: &mut impl Write, file: &File, accepts_gzip: bool) -> io::Result<()> {
    const OK: &str = "200 OK";
    if file.is_gzip && !accepts_gzip {
        let plain = unzipped(file)?;
        write_head(out, OK, file.content_type, Some(plain.len()), false)?;
        return out.write_all(&plain);
    }
    write_head(
        out,
        OK,
        file.content_type,
        Some(file.bytes.len()),
        file.is_gzip,
    )?;
    out.write_all(&file.bytes)
}

/// A file's bytes as they are meant.
pub fn unzipped(file: &File) -> io::Result<Vec<u8>> {
    if !file.is_gzip {
        return Ok(file.bytes.to_vec());
    }
    let mut plain = Vec::new();
    GzDecoder::new(&*file.bytes).read_to_end(&mut plain)?;
    Ok(plain)
}
