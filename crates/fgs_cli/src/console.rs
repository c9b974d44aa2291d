//! Output: text and progress bars for people, or one JSON object per line for machines.
//!
//! Results go to stdout, progress and warnings to stderr. That the reader of either has gone away does
//! not end the work.

use std::fmt::Display;
use std::io::Write;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

/// How many warnings of one kind are printed; the rest are only counted.
const MAX_WARNINGS: usize = 10;

/// Who reads the output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Console {
    /// Text.
    People,
    /// JSON lines.
    Machines,
}

#[derive(Serialize)]
struct Event<'a, T> {
    event: &'a str,
    #[serde(flatten)]
    data: T,
}

impl Console {
    /// For machines if JSON was asked for.
    pub fn new(json: bool) -> Self {
        if json { Self::Machines } else { Self::People }
    }

    /// Prints a line of text for people.
    pub fn say(self, text: impl Display) {
        if self == Self::People {
            print_line(text);
        }
    }

    /// Prints a line `{"event": name, ...data}` for machines; `data` is a struct or a map.
    pub fn event(self, name: &str, data: impl Serialize) {
        if self == Self::Machines
            && let Ok(line) = serde_json::to_string(&Event { event: name, data })
        {
            print_line(line);
        }
    }

    /// A progress bar for people at a terminal; otherwise a hidden one. Without a number of steps it only
    /// counts.
    pub fn progress(self, steps: impl Into<Option<usize>>, what: &str) -> ProgressBar {
        if self == Self::Machines {
            return ProgressBar::hidden();
        }
        let (bar, template) = match steps.into() {
            Some(steps) => (
                ProgressBar::new(steps as u64),
                "{prefix} {wide_bar} {pos}/{len}  {per_sec}  {msg}  {eta} left",
            ),
            None => (
                ProgressBar::no_length(),
                "{prefix} {spinner} {pos}  {per_sec}  {msg}",
            ),
        };
        let bar = bar.with_prefix(what.to_owned());
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.with_key(
                "per_sec",
                |state: &indicatif::ProgressState, w: &mut dyn std::fmt::Write| {
                    // A line of a progress bar that cannot be formatted is left empty.
                    let _ = write!(w, "{:.1}/s", state.per_sec());
                },
            ));
        }
        bar.enable_steady_tick(Duration::from_millis(200));
        bar
    }
}

/// Warnings of one kind: the first few are printed, all are counted.
#[derive(Debug, Default)]
pub struct Warnings {
    count: usize,
}

impl Warnings {
    /// Prints or counts one more, above the bar.
    pub fn warn(&mut self, bar: &ProgressBar, message: impl Display) {
        self.count += 1;
        if self.count <= MAX_WARNINGS {
            bar.suspend(|| complain(format_args!("warning: {message}")));
        }
        if self.count == MAX_WARNINGS {
            bar.suspend(|| complain("warning: further warnings like this are only counted"));
        }
    }
}

/// Prints a line to stderr.
pub fn complain(text: impl Display) {
    // `eprintln!` would panic where nobody reads, and take the run with it; lints forbid it.
    let _ = writeln!(std::io::stderr().lock(), "{}", escaped(&text.to_string()));
}

fn print_line(text: impl Display) {
    let _ = writeln!(std::io::stdout().lock(), "{}", escaped(&text.to_string()));
}

/// Text that may hold parts of files: what would move a terminal's cursor or turn its text round is shown
/// instead.
fn escaped(text: &str) -> String {
    let is_harmless = |c: char| {
        c == '\n'
            || !(c.is_control() || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}'))
    };
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        if is_harmless(c) {
            shown.push(c);
        } else {
            shown.extend(c.escape_default());
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_of_files_does_nothing_to_a_terminal() {
        assert_eq!(escaped("a\u{1b}[31mb\rc\td"), "a\\u{1b}[31mb\\rc\\td");
        assert_eq!(escaped("ä\n\u{202e}x"), "ä\n\\u{202e}x");
    }
}
