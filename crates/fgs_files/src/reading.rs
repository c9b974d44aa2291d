//! Reading files that may be anything: only regular files are opened, and text has a limit.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;

/// The mark that some editors put before text.
pub const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Opens a regular file. Opening a pipe would wait for ever, and a device may never end.
///
/// # Errors
/// The operating system's refusal, or what the path leads to instead.
pub fn open_regular(path: &Path) -> io::Result<File> {
    check_regular(path)?;
    File::open(path)
}

/// Whether a path leads to a regular file.
///
/// # Errors
/// The operating system's refusal, or what the path leads to instead.
pub fn check_regular(path: &Path) -> io::Result<()> {
    let metadata = match fs::metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound && path.is_symlink() => {
            return Err(refusal("is a link that leads nowhere"));
        }
        Err(error) if is_loop(&error) => {
            return Err(refusal("is a link that leads round in a circle"));
        }
        metadata => metadata?,
    };
    if metadata.is_file() {
        return Ok(());
    }
    Err(refusal(match kind(metadata.file_type()) {
        Some(kind) => kind,
        None => "is no regular file",
    }))
}

/// Whether there is anything by this name, even a link that leads nowhere.
pub fn is_present(path: &Path) -> bool {
    path.symlink_metadata().is_ok()
}

/// The text of a file of at most `max_bytes`, without a byte order mark.
///
/// # Errors
/// What [`open_regular`] refuses, a file that is longer, and one that is not UTF-8.
pub fn read_text(path: &Path, max_bytes: u64) -> io::Result<String> {
    let mut bytes = Vec::new();
    open_regular(path)?
        .take(max_bytes + 1)
        .read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes {
        return Err(refusal(&format!("is longer than {max_bytes} bytes")));
    }
    if is_utf16(&bytes) {
        return Err(refusal("is UTF-16 text: save it as UTF-8"));
    }
    let text = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(&bytes);
    str::from_utf8(text)
        .map(str::to_owned)
        .map_err(|_| refusal("is no text"))
}

/// Whether bytes begin as UTF-16 text does.
pub fn is_utf16(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff])
}

#[cfg(any(target_os = "linux", target_vendor = "apple"))]
fn is_loop(error: &io::Error) -> bool {
    error.raw_os_error() == Some(rustix::io::Errno::LOOP.raw_os_error())
}

#[cfg(not(any(target_os = "linux", target_vendor = "apple")))]
fn is_loop(_: &io::Error) -> bool {
    false
}

fn refusal(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, what)
}

fn kind(kind: fs::FileType) -> Option<&'static str> {
    if kind.is_dir() {
        return Some("is a folder");
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if kind.is_fifo() {
            return Some("is a named pipe, not a file");
        }
        if kind.is_socket() {
            return Some("is a socket, not a file");
        }
        if kind.is_char_device() || kind.is_block_device() {
            return Some("is a device, not a file");
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_bounded_and_utf_8() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x");
        let read = |bytes: &[u8]| {
            fs::write(&path, bytes).unwrap();
            read_text(&path, 8).map_err(|error| error.to_string())
        };
        assert_eq!(read(b"12345678"), Ok("12345678".into()));
        assert_eq!(read(b"123456789"), Err("is longer than 8 bytes".into()));
        assert_eq!(read(b"\xef\xbb\xbfabc"), Ok("abc".into()));
        assert_eq!(
            read(b"\xff\xfea\0"),
            Err("is UTF-16 text: save it as UTF-8".into())
        );
        assert_eq!(read(b"a\xff"), Err("is no text".into()));
    }

    #[cfg(unix)]
    #[test]
    fn what_is_no_file_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |path: &Path| open_regular(path).unwrap_err().to_string();
        assert_eq!(refused(folder.path()), "is a folder");
        assert_eq!(refused(Path::new("/dev/zero")), "is a device, not a file");
        let fifo = folder.path().join("fifo");
        let made = std::process::Command::new("mkfifo")
            .arg(&fifo)
            .status()
            .unwrap();
        assert!(made.success());
        assert_eq!(refused(&fifo), "is a named pipe, not a file");
        let nowhere = folder.path().join("nowhere");
        std::os::unix::fs::symlink("absent", &nowhere).unwrap();
        assert_eq!(refused(&nowhere), "is a link that leads nowhere");
        let round = folder.path().join("round");
        std::os::unix::fs::symlink("round", &round).unwrap();
        assert_eq!(refused(&round), "is a link that leads round in a circle");
    }
}
