//! `fgs bench`: how long each stage takes on this machine, beside the least it could take.
//!
//! Each stage is checked before it is timed. Its floor is the time this machine needs to move the
//! bytes the stage must touch once or to do its operations, whichever is longer, at the rates
//! measured in the same run. `cpu` times the whole system on the CPU, `gpu` the optimisation step on
//! a graphics device. `robustness` judges verdicts instead of timing stages.

mod baseline;
mod cpu;
mod decoding;
mod gpu;
mod gpu_floors;
mod input;
mod machine;
mod mapping;
mod robustness;
mod scene;
mod stage;
mod tracking;

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::console::Console;
use crate::failure::{EXIT_DONE, UsageError};
use crate::image_size::ImageSize;
use baseline::Baseline;
use input::Input;

/// Time every stage of the system on this machine
///
/// Prints the median and the best of several runs in milliseconds, and how far that is from what
/// memory and arithmetic of this machine allow: on the CPU for one and two threads; on a graphics
/// device each stage of an optimisation step by the device's clock, and whole steps by the wall
/// clock.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  fgs bench                          synthetic rooms of 640x480 and 1200x680
  fgs bench recordings/desk --json   frames of a recording with known poses, decoding included
  fgs bench --instructions avx2      as a processor without AVX-512 computes (also neon, plain)
  fgs bench --save-baseline before.json, then fgs bench --baseline before.json   what got slower
  fgs bench --robustness             whether a camera that is lost says so
  fgs bench --backend gpu            steps of 100k, 500k and 2M gaussians at 1200x680
  fgs bench --backend gpu --size 320x240 --gaussians 20000   small enough for a device in software")]
pub struct BenchArgs {
    /// Recordings with known poses, in place of the synthetic rooms
    recordings: Vec<PathBuf>,
    /// What is timed
    #[arg(long, value_enum, default_value_t)]
    backend: Timed,
    /// Gaussians of each scene to optimise [default: 100000; on a graphics device also 500000 and
    /// 2000000]
    #[arg(long, value_name = "N,...", value_delimiter = ',',
        value_parser = clap::value_parser!(u32).range(1..=16_000_000))]
    gaussians: Vec<u32>,
    /// Size of the synthetic room's images [default: 640x480 and 1200x680; on a graphics device the
    /// latter; with --robustness 320x240]
    #[arg(long, value_name = "WxH", conflicts_with = "recordings")]
    size: Option<ImageSize>,
    /// First frame of a recording to use
    #[arg(long, value_name = "N", default_value_t = 0)]
    first: usize,
    /// Camera file for recordings that have none
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Compare with the times in this file, of the same machine: says what got slower
    #[arg(long, value_name = "FILE")]
    baseline: Option<PathBuf>,
    /// Keep the times in this file
    #[arg(long, value_name = "FILE")]
    save_baseline: Option<PathBuf>,
    /// Instead, follow a camera through scenarios in which it is likely to get lost, all or some
    /// and say how many poses that were believed are wrong
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', num_args = 0..,
        conflicts_with_all = ["recordings", "backend", "gaussians", "baseline", "save_baseline"],
        value_parser = robustness::names())]
    robustness: Option<Vec<String>>,
    /// One JSON object a line instead of text
    #[arg(long)]
    json: bool,
}

/// `--backend`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum Timed {
    /// The whole system on the CPU
    #[default]
    Cpu,
    /// The optimisation step on a graphics device, if need be one in software
    Gpu,
}

/// Executes `fgs bench`.
///
/// # Errors
/// If a recording cannot be read, has no known poses, there is no device, or a stage gives a wrong
/// result.
pub fn run(args: &BenchArgs) -> anyhow::Result<u8> {
    let console = Console::new(args.json);
    if let Some(names) = &args.robustness {
        return robustness::run(names, args.size, console);
    }
    match args.backend {
        Timed::Cpu => time_cpu(args, console),
        Timed::Gpu if args.baseline.is_some() || args.save_baseline.is_some() => {
            Err(UsageError("baselines are of the CPU".to_owned()).into())
        }
        Timed::Gpu => gpu::run(
            &inputs(args, &[(1200, 680)])?,
            &numbers(args, &[100_000, 500_000, 2_000_000]),
            console,
        ),
    }
}

fn time_cpu(args: &BenchArgs, console: Console) -> anyhow::Result<u8> {
    // Before the minutes of timing: a file that cannot be used is said at once.
    let baseline = args.baseline.as_deref().map(Baseline::read).transpose()?;
    let stages = cpu::run(
        &inputs(args, &[(640, 480), (1200, 680)])?,
        &numbers(args, &[100_000]),
        console,
    )?;
    if let Some(baseline) = baseline {
        baseline.compare(&stages, console);
    }
    if let Some(path) = &args.save_baseline {
        let here = Baseline::of_this_machine();
        Baseline { stages, ..here }.write(path)?;
    }
    Ok(EXIT_DONE)
}

fn numbers(args: &BenchArgs, default: &[u32]) -> Vec<usize> {
    let numbers = match args.gaussians.as_slice() {
        [] => default,
        given => given,
    };
    numbers.iter().map(|number| *number as usize).collect()
}

fn inputs(args: &BenchArgs, default: &[(usize, usize)]) -> anyhow::Result<Vec<Input>> {
    if args.recordings.is_empty() {
        let given = args.size.map(|size| (size.width, size.height));
        let sizes = given.as_ref().map_or(default, std::slice::from_ref);
        return sizes.iter().map(|&(w, h)| Input::synthetic(w, h)).collect();
    }
    let camera = args.camera.as_deref();
    args.recordings
        .iter()
        .map(|path| Input::recorded(path, args.first, camera))
        .collect()
}
