//! `fgs synth`: writes a synthetic recording with exact ground truth.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use clap::{Args, ValueEnum};
use fgs_synth::{SensorModel, Sequence, SynthError, kinect_camera};

use crate::console::Console;
use crate::failure::{EXIT_DONE, EXIT_INTERRUPTED, UsageError};
use crate::image_size::ImageSize;
use crate::interrupt;

/// Write a synthetic recording of a furnished room
///
/// Its ground truth is exact, so it shows what tracking and mapping can do. The same options always
/// give the same recording.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  fgs synth recordings/room
  fgs synth recordings/room --layout replica --frames 100 --size 320x240 --noise none --seed 3
  fgs synth recordings/house --rooms 7 --frames 2100
  fgs synth recordings/ring --rooms 6 --frames 1950 --round
  fgs run recordings/room --eval")]
pub struct SynthArgs {
    /// Folder to write; must not exist
    out: PathBuf,
    /// Layout of the files
    #[arg(long, value_enum, default_value_t = Layout::Tum)]
    layout: Layout,
    /// Seed; another seed gives another room and path
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How many rooms in a row to walk through
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=20))]
    rooms: u8,
    /// Walk round a ring of rooms, an even number and four at least, back to where it began
    #[arg(long)]
    round: bool,
    /// Number of frames; 300 go once round a room, and 300 per room make a calm walk through several
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    frames: u32,
    /// Size of the images
    #[arg(long, value_name = "WxH", default_value = "640x480")]
    size: ImageSize,
    /// Sensor model
    #[arg(long, value_enum, default_value_t = Noise::Kinect)]
    noise: Noise,
}

/// `--layout`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Layout {
    /// TUM RGB-D: PNG, depth scale 5000, time stamps
    Tum,
    /// Replica: JPEG, depth scale 6553.5
    Replica,
}

/// `--noise`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Noise {
    /// Like a Kinect: noise, quantisation and holes in depth, exposure changes and motion blur in colour
    Kinect,
    /// Exact images
    None,
}

/// Executes `fgs synth`.
///
/// # Errors
/// If the folder exists or cannot be written.
pub fn run(args: &SynthArgs) -> anyhow::Result<u8> {
    let camera = kinect_camera(args.size.width, args.size.height)
        .map_err(|error| UsageError(format!("--size: {error}")))?;
    let sensor = match args.noise {
        Noise::Kinect => SensorModel::kinect(),
        Noise::None => SensorModel::exact(),
    };
    if args.round && !Sequence::is_ring(args.rooms.into()) {
        return Err(
            UsageError("--round: a ring has an even number of rooms, four or more".into()).into(),
        );
    }
    let make = if args.round {
        Sequence::around_rooms
    } else {
        Sequence::through_rooms
    };
    let sequence = make(
        args.seed,
        args.rooms.into(),
        args.frames as usize,
        camera,
        sensor,
    );
    let stop = interrupt::stop_flag()?;
    write(
        &sequence,
        args.layout == Layout::Replica,
        &args.out,
        Console::People,
        &stop,
    )
}

/// Writes a sequence with a progress bar, in Replica's layout or TUM's; returns the exit code.
///
/// # Errors
/// If the folder exists or cannot be written.
pub fn write(
    sequence: &Sequence,
    as_replica: bool,
    out: &Path,
    console: Console,
    stop: &AtomicBool,
) -> anyhow::Result<u8> {
    if let Some(parent) = out.parent() {
        std::fs::create_dir_all(parent)
            .with_context(|| format!("cannot make {}", parent.display()))?;
    }
    let bar = console.progress(sequence.len(), "synthesis");
    let progress = |frames: usize| {
        bar.set_position(frames as u64);
        if stop.load(Ordering::Relaxed) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    };
    let written = if as_replica {
        fgs_synth::write_replica(sequence, out, progress)
    } else {
        fgs_synth::write_tum(sequence, out, progress)
    };
    bar.finish_and_clear();
    match written {
        Err(SynthError::Stopped { .. }) => Ok(EXIT_INTERRUPTED),
        Err(error) => Err(error.into()),
        Ok(()) => {
            console.say(format!("{}: {} frames", out.display(), sequence.len()));
            Ok(EXIT_DONE)
        }
    }
}
