//! `fgs bench`: how long each stage takes on this machine, beside the least it could take.
//!
//! Each stage is checked before it is timed. Its floor is the time this machine needs to move the
//! bytes the stage must touch once or to do its operations, whichever is longer, at the rates
//! measured in the same run.

mod decoding;
mod input;
mod machine;
mod mapping;
mod stage;
mod tracking;

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use serde::Serialize;

use crate::console::Console;
use crate::failure::EXIT_DONE;
use input::Input;
use machine::Rates;
use stage::{Stage, Times};

/// Time every stage of the system on this machine
///
/// Prints, for one and two threads, the median and the best of several runs in milliseconds, and
/// how far that is from what memory and arithmetic of this machine allow.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  fgs bench                          synthetic rooms of 640x480 and 1200x680
  fgs bench recordings/desk --json   frames of a recording with known poses, decoding included")]
pub struct BenchArgs {
    /// Recordings with known poses, in place of the synthetic rooms
    recordings: Vec<PathBuf>,
    /// First frame of a recording to use
    #[arg(long, value_name = "N", default_value_t = 0)]
    first: usize,
    /// Camera file for recordings that have none
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// One JSON object a line instead of text
    #[arg(long)]
    json: bool,
}

/// One line of the table.
#[derive(Serialize)]
struct Row<'a> {
    input: &'a str,
    stage: &'a str,
    work: &'a str,
    threads: usize,
    median_ms: f64,
    best_ms: f64,
    floor_ms: f64,
}

/// Executes `fgs bench`.
///
/// # Errors
/// If a recording cannot be read, has no known poses, or a stage gives a wrong result.
pub fn run(args: &BenchArgs) -> anyhow::Result<u8> {
    let console = Console::new(args.json);
    let pools = [1, 2].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.with_context(|| format!("cannot start {threads} threads"))
    });
    let [one, two] = pools;
    let pools = [one?, two?];
    let rates = [Rates::measure(&pools[0]), Rates::measure(&pools[1])];
    for (pool, rates) in pools.iter().zip(&rates) {
        console.say(format!(
            "{} thread(s): {:.1} GB/s, {:.0} GFLOP/s",
            pool.current_num_threads(),
            1e-9 * rates.bytes_per_sec,
            1e-9 * rates.flops_per_sec,
        ));
        console.event("machine", rates);
    }
    console.say(format!(
        "\n{:<10} {:<28} {:<44} threads  median ms    best ms   floor ms",
        "input", "stage", "work"
    ));
    for input in inputs(args)? {
        let mut bench = |stage: Stage<'_>| -> anyhow::Result<()> {
            let Stage {
                name,
                work,
                bytes,
                flops,
                mut check,
                mut run,
            } = stage;
            check().with_context(|| format!("{name} on {} is wrong", input.name))?;
            for (pool, rates) in pools.iter().zip(&rates) {
                let Times { median_ms, best_ms } = pool.install(|| Times::measure(&mut *run));
                let row = Row {
                    input: &input.name,
                    stage: name,
                    work: &work,
                    threads: pool.current_num_threads(),
                    median_ms,
                    best_ms,
                    floor_ms: rates.floor_ms(bytes, flops),
                };
                console.say(format!(
                    "{:<10} {:<28} {:<44} {:>7} {:>10.3} {:>10.3} {:>10.3}",
                    row.input,
                    row.stage,
                    row.work,
                    row.threads,
                    row.median_ms,
                    row.best_ms,
                    row.floor_ms
                ));
                console.event("stage", &row);
            }
            Ok(())
        };
        decoding::bench(&input, &mut bench)?;
        tracking::bench(&input, console, &mut bench)?;
        mapping::bench(&input, &mut bench)?;
    }
    Ok(EXIT_DONE)
}

fn inputs(args: &BenchArgs) -> anyhow::Result<Vec<Input>> {
    if args.recordings.is_empty() {
        return Ok(vec![
            Input::synthetic(640, 480)?,
            Input::synthetic(1200, 680)?,
        ]);
    }
    let camera = args.camera.as_deref();
    args.recordings
        .iter()
        .map(|path| Input::recorded(path, args.first, camera))
        .collect()
}
