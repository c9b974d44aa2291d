//! A run as one page for people: what ran, its numbers, plots and pictures. The page needs nothing but
//! itself: plots are inline SVG, pictures lie in it, and there are no scripts.
//!
//! It is made from what a run's folder holds, so that it can be made again. Texts from files are escaped
//! by [`maud`].

mod comparison;
mod error_colors;
mod measures;
mod numbers;
mod page;
mod path_view;
mod photos;
mod plot;
mod run_data;
mod run_page;
mod setting_changes;
mod strips;

use std::io::Write;
use std::path::PathBuf;

pub use comparison::comparison_page;
use fgs_files::StagedFolder;
use run_data::RunData;

use crate::error::RunError;
use crate::run_folder::{REPORT, RunFolder, write};

/// Writes the page of a run whose other results are written.
///
/// # Errors
/// If a result is missing or damaged, or the page cannot be written.
pub fn write_report(results: &StagedFolder<'_>) -> Result<(), RunError> {
    let mut run = RunData::read(&RunFolder::open(results.path())?)?;
    // What is not finished has another name.
    run.name = run_data::file_name(&results.shown(""));
    let page = page_of(&run, results.shown(REPORT))?;
    write(results, REPORT, |file| file.write_all(page.as_bytes())).map(drop)
}

fn page_of(run: &RunData, path: PathBuf) -> Result<String, RunError> {
    run_page::run_page(run).map_err(|source| plot_error(path, source))
}

fn plot_error(path: PathBuf, source: std::io::Error) -> RunError {
    RunError::Write { path, source }
}

#[cfg(test)]
mod tests;
