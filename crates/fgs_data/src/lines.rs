//! Text files of whitespace-separated columns, one line at a time.
//!
//! Empty lines and comments (`#`) are passed over. No more than one line of bounded length is ever
//! in memory, and each error carries file and line.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Take};
use std::path::Path;

use fgs_files::{BYTE_ORDER_MARK, is_utf16, open_regular};

use crate::{DataError, LineFault};

/// Sixteen numbers in full precision or a long path fit many times over.
const MAX_LINE_BYTES: usize = 8192;

/// A million lines of seventeen numbers in full precision.
const MAX_FILE_BYTES: u64 = 512 << 20;

/// The lines of one file.
pub(crate) struct Lines<'a> {
    path: &'a Path,
    reader: Take<BufReader<File>>,
    buffer: Vec<u8>,
    number: usize,
}

/// One line that holds something.
pub(crate) struct Line<'a> {
    path: &'a Path,
    text: &'a str,
    /// From 1.
    pub number: usize,
}

impl<'a> Lines<'a> {
    pub fn open(path: &'a Path) -> Result<Self, DataError> {
        let open = || -> io::Result<_> {
            let mut reader = BufReader::new(open_regular(path)?);
            let start = reader.fill_buf()?;
            let is_utf16 = is_utf16(start);
            if start.starts_with(BYTE_ORDER_MARK) {
                reader.consume(BYTE_ORDER_MARK.len());
            }
            Ok((reader.take(MAX_FILE_BYTES), is_utf16))
        };
        let (reader, is_utf16) = open().map_err(|source| DataError::Io {
            path: path.into(),
            source,
        })?;
        if is_utf16 {
            return Err(line_error(path, 1, LineFault::Utf16));
        }
        Ok(Self {
            path,
            reader,
            buffer: Vec::new(),
            number: 0,
        })
    }

    /// The next line that is neither empty nor a comment.
    pub fn next_line(&mut self) -> Result<Option<Line<'_>>, DataError> {
        loop {
            self.buffer.clear();
            let limit = MAX_LINE_BYTES as u64 + 1;
            let len = (&mut self.reader)
                .take(limit)
                .read_until(b'\n', &mut self.buffer)
                .map_err(|source| DataError::Io {
                    path: self.path.into(),
                    source,
                })?;
            if len == 0 && self.reader.limit() == 0 {
                return Err(DataError::FileTooLong {
                    path: self.path.into(),
                    max_bytes: MAX_FILE_BYTES,
                });
            }
            if len == 0 {
                return Ok(None);
            }
            self.number += 1;
            let first = self.buffer.iter().find(|byte| !byte.is_ascii_whitespace());
            if len > MAX_LINE_BYTES || !matches!(first, None | Some(b'#')) {
                break;
            }
        }
        let fault = |fault| line_error(self.path, self.number, fault);
        if self.buffer.len() > MAX_LINE_BYTES {
            return Err(fault(LineFault::TooLong(MAX_LINE_BYTES)));
        }
        Ok(Some(Line {
            path: self.path,
            text: str::from_utf8(&self.buffer).map_err(|_| fault(LineFault::NotText))?,
            number: self.number,
        }))
    }
}

impl<'a> Line<'a> {
    /// Exactly `N` columns.
    pub fn columns<const N: usize>(&self) -> Result<[&'a str; N], DataError> {
        let mut columns = [""; N];
        let mut found = 0;
        for text in self.text.split_whitespace() {
            if let Some(column) = columns.get_mut(found) {
                *column = text;
            }
            found += 1;
        }
        if found != N {
            return Err(self.error(LineFault::Columns { expected: N, found }));
        }
        Ok(columns)
    }

    /// Exactly `N` columns, each a finite number.
    pub fn numbers<const N: usize>(&self) -> Result<[f64; N], DataError> {
        let columns = self.columns::<N>()?;
        let mut numbers = [0.0; N];
        for (number, column) in numbers.iter_mut().zip(columns) {
            *number = self.parse_number(column)?;
        }
        Ok(numbers)
    }

    pub fn parse_number(&self, column: &str) -> Result<f64, DataError> {
        let number = column
            .parse()
            .ok()
            .filter(|number: &f64| number.is_finite());
        number.ok_or_else(|| self.error(LineFault::NotANumber(column.chars().take(40).collect())))
    }

    pub fn error(&self, fault: LineFault) -> DataError {
        line_error(self.path, self.number, fault)
    }
}

/// An error on a line of a file.
pub(crate) fn line_error(path: &Path, line: usize, fault: LineFault) -> DataError {
    DataError::Line {
        path: path.into(),
        line,
        fault,
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn read(content: &[u8]) -> Result<Vec<(usize, [f64; 2])>, DataError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("numbers.txt");
        fs::write(&path, content).unwrap();
        let mut lines = Lines::open(&path)?;
        let mut read = Vec::new();
        while let Some(line) = lines.next_line()? {
            read.push((line.number, line.numbers()?));
        }
        Ok(read)
    }

    #[test]
    fn comments_and_blank_lines_count_but_are_passed_over() {
        let read = read(b"# head\n\n1 2\r\n  # more\n\t3\t-4e-1").unwrap();
        assert_eq!(read, [(3, [1.0, 2.0]), (5, [3.0, -0.4])]);
    }

    #[test]
    fn faults_name_their_line() {
        let fault = |content: &[u8]| match read(content).unwrap_err() {
            DataError::Line { line, fault, .. } => (line, fault),
            other => panic!("{other}"),
        };
        let columns = |found| LineFault::Columns { expected: 2, found };
        assert_eq!(fault(b"1 2\n3"), (2, columns(1)));
        assert_eq!(fault(b"1 2 3"), (1, columns(3)));
        assert_eq!(fault(b"#\n1 x"), (2, LineFault::NotANumber("x".into())));
        assert_eq!(fault(b"1 inf"), (1, LineFault::NotANumber("inf".into())));
        assert_eq!(fault(b"1 \xff\xfe"), (1, LineFault::NotText));
        let endless = [b"1 2\n".as_slice(), &[b'7'; 1 << 20]].concat();
        assert_eq!(fault(&endless), (2, LineFault::TooLong(MAX_LINE_BYTES)));
        let endless_comment = [b'#'; 1 << 20];
        assert_eq!(
            fault(&endless_comment),
            (1, LineFault::TooLong(MAX_LINE_BYTES))
        );
    }
}
