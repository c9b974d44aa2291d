//! Natural sort order of file names: `frame2` before `frame10`.

use std::cmp::Ordering;
use std::fs;
use std::path::Path;

use crate::DataError;

/// The names of a folder's entries, runs of digits compared as numbers. Hidden entries are left out.
///
/// # Errors
/// If the folder cannot be read, or the name of an image in it is not UTF-8.
pub(crate) fn sorted_names(folder: &Path) -> Result<Vec<String>, DataError> {
    let error = |source| DataError::Io {
        path: folder.into(),
        source,
    };
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(error)? {
        match entry.map_err(error)?.file_name().into_string() {
            Ok(name) if !name.starts_with('.') => names.push(name),
            Err(name) if is_image_name(&name.to_string_lossy()) => {
                return Err(DataError::NotUtf8(folder.join(name)));
            }
            _ => {}
        }
    }
    // The plain order decides between `1` and `01`, so that the result is the same everywhere.
    names.sort_by(|a, b| natural_order(a, b).then_with(|| a.cmp(b)));
    Ok(names)
}

/// Whether a name ends like a colour image's.
pub(crate) fn is_image_name(name: &str) -> bool {
    let extension = name.rsplit_once('.').map_or("", |(_, extension)| extension);
    ["jpg", "jpeg", "png"]
        .iter()
        .any(|known| extension.eq_ignore_ascii_case(known))
}

/// Compares names, runs of digits as numbers.
pub fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut a, mut b) = (a, b);
    while !a.is_empty() && !b.is_empty() {
        let (run_a, rest_a) = split_run(a);
        let (run_b, rest_b) = split_run(b);
        let order = if run_a.starts_with(is_digit) && run_b.starts_with(is_digit) {
            // Numbers of any length: without leading zeros the longer one is the larger.
            let (run_a, run_b) = (run_a.trim_start_matches('0'), run_b.trim_start_matches('0'));
            run_a.len().cmp(&run_b.len()).then_with(|| run_a.cmp(run_b))
        } else {
            run_a.cmp(run_b)
        };
        if order != Ordering::Equal {
            return order;
        }
        (a, b) = (rest_a, rest_b);
    }
    a.len().cmp(&b.len())
}

/// The longest start that is all digits or has none, and the rest.
fn split_run(text: &str) -> (&str, &str) {
    let digits = text.starts_with(is_digit);
    text.split_at(text.find(|c| is_digit(c) != digits).unwrap_or(text.len()))
}

fn is_digit(c: char) -> bool {
    c.is_ascii_digit()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_count_as_numbers() {
        let sorted = [
            "1.5.png",
            "1.10.png",
            "2.png",
            "10.png",
            "99999999999999999999998.png",
            "99999999999999999999999.png",
            "frame0.jpg",
            "frame02.jpg",
            "frame10.jpg",
            "frames1.jpg",
        ];
        let folder = tempfile::tempdir().unwrap();
        for name in sorted.iter().rev().chain(&[".hidden.png"]) {
            fs::write(folder.path().join(name), "").unwrap();
        }
        assert_eq!(sorted_names(folder.path()).unwrap(), sorted);
    }

    #[test]
    fn image_names() {
        assert!(is_image_name("a.JPG") && is_image_name("a.b.png"));
        assert!(!is_image_name("png") && !is_image_name("a.txt"));
    }
}
