//! Ctrl-C: the first asks the run to end and save its results, the second ends the program at once.

use std::process;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;

use crate::console::complain;
use crate::failure::EXIT_INTERRUPTED;

/// The flag that the first Ctrl-C (or SIGTERM) sets. Call it once.
pub fn stop_flag() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let handler = Arc::clone(&stop);
    ctrlc::set_handler(move || {
        if handler.swap(true, Ordering::Relaxed) {
            process::exit(EXIT_INTERRUPTED.into());
        }
        complain("stopping: the results so far are saved (Ctrl-C again to quit without)");
    })
    .context("cannot listen for Ctrl-C")?;
    Ok(stop)
}
