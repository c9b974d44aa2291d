//! `fgs merge`: two maps of one place become one.

use std::path::PathBuf;

use clap::Args;
use fgs_run::{Backend, MergeOptions, merge, pipeline_cache_folder};

use crate::console::Console;
use crate::failure::{EXIT_DONE, explain};
use crate::threads::Threads;
use crate::{choices, interrupt};

/// Merge two maps of one place
///
/// Finds what both maps show, brings the second to the first and corrects both. The maps are left as they are.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  fgs run recordings/ground-floor --checkpoint-every 60
  fgs run recordings/stairs --checkpoint-every 60
  fgs merge runs/ground-floor runs/stairs --out runs/house
  fgs view runs/house.map                        with the keyframes of both; runs/house/map.ply: the map alone
  fgs run recordings/attic --map runs/house      goes on in the merged map

Both recordings must be of one camera, and show some place alike. Axes and settings are the first map's.
runs/house/map.ply is the map to look at, after --refine steps; runs/house.map is what a run goes on
with.")]
pub struct MergeArgs {
    /// Folder of a run that had checkpoints, or of its map
    first: PathBuf,
    /// Folder of another
    second: PathBuf,
    /// Folder for the merged map
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Optimise map.ply by N steps with the keyframes of both maps
    #[arg(long, value_name = "N", default_value_t = 300)]
    refine: u32,
    /// Where the map is optimised [default: auto]
    #[arg(long, value_parser = choices::backend())]
    backend: Option<Backend>,
    #[command(flatten)]
    threads: Threads,
    /// Write the numbers to stdout as JSON
    #[arg(long)]
    json: bool,
}

/// Executes `fgs merge`.
///
/// # Errors
/// If a map cannot be read, the two meet nowhere, or the result cannot be written.
pub fn run(args: &MergeArgs) -> anyhow::Result<u8> {
    let console = Console::new(args.json);
    args.threads.apply()?;
    let stop = interrupt::stop_flag()?;
    let options = MergeOptions {
        maps: [args.first.clone(), args.second.clone()],
        out: args.out.clone(),
        backend: args.backend.unwrap_or_default(),
        refine: args.refine as usize,
        pipeline_cache: pipeline_cache_folder(),
    };
    let merged = merge(&options, &stop).map_err(explain)?;
    console.event("merged", &merged);
    console.say(format!(
        "  meetings   {}\n  map        {} gaussians from {} keyframes, {:.1} MB\n  results    {}",
        merged.loops,
        merged.num_gaussians,
        merged.keyframes,
        merged.map_bytes as f64 / 1e6,
        args.out.display()
    ));
    Ok(EXIT_DONE)
}
