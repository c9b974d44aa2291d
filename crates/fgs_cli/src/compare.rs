//! `fgs compare`: several runs on one page.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use fgs_run::{RunFolder, comparison_page};

use crate::console::Console;
use crate::failure::{EXIT_DONE, UsageError, explain};

/// Compare finished runs
///
/// Writes one page with the numbers of the runs side by side, and their plots over each other.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  fgs compare runs/desk runs/desk-2
  fgs compare runs/* --out desk.html")]
pub struct CompareArgs {
    /// Folders of the runs
    #[arg(required = true, num_args = 2.., value_name = "RUN")]
    runs: Vec<PathBuf>,
    /// The page; one of that name is replaced
    #[arg(long, value_name = "FILE", default_value = "comparison.html")]
    out: PathBuf,
}

/// Executes `fgs compare`.
///
/// # Errors
/// If a run cannot be read, or the page cannot be written.
pub fn run(args: &CompareArgs) -> anyhow::Result<u8> {
    let page = comparison_page(&args.runs).map_err(explain)?;
    let out = args.out.display();
    for run in &args.runs {
        if RunFolder::open(run)
            .map_err(explain)?
            .holds_result(&args.out)
        {
            return Err(UsageError(format!("--out: {out} belongs to a run")).into());
        }
    }
    fgs_files::write_file(&args.out, |file| file.write_all(page.as_bytes()))
        .with_context(|| format!("cannot write {out}"))?;
    Console::People.say(out.to_string());
    Ok(EXIT_DONE)
}
