//! A camera goes round and round a ring of rooms, or one room, for as long as wanted: memory, and time per
//! frame.
//!
//!     cargo run --release -p fgs_slam --example soak -- SECONDS [realtime|lockstep] [ROOMS] [MAX_GAUSSIANS]
//!
//! An even number of rooms, four or more, make a ring.
//! In real time frames come at 30 Hz and are dropped when late. Prints a line of CSV each minute. Memory is
//! what the process has in use, tracking is CPU time of the threads that track and of the one that delivers
//! frames, a frame that was tracked (both Linux only).

#![allow(clippy::print_stdout, reason = "an example prints")]

use std::convert::Infallible;
use std::error::Error;
use std::fs;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use fgs_geom::{FrameIndex, RgbdFrame, Se3};
use fgs_slam::{Execution, FrameStatus, Slam, SlamConfig, SlamEvent, Subscription, model_settings};
use fgs_splat::CpuModel;
use fgs_synth::{FRAMES_PER_LOOP, FRAMES_PER_SECOND, SensorModel, Sequence, kinect_camera};

const LINE_EVERY: Duration = Duration::from_secs(60);

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let seconds = arguments.next().map_or(Ok(60.0), |text| text.parse())?;
    let execution = arguments.next().unwrap_or("realtime".into()).parse()?;
    let mut config = SlamConfig::default();
    config.mapping.iterations_per_frame = 1.0;
    let rooms: usize = arguments.next().map_or(Ok(6), |text| text.parse())?;

    if let Some(max) = arguments.next() {
        config.mapping.max_gaussians = max.parse()?;
    }
    let camera = kinect_camera(320, 240)?;
    // A walk round the rooms ends half a room beyond its beginning.
    let len = rooms * FRAMES_PER_LOOP + FRAMES_PER_LOOP / 2 + 1;
    let sequence = Sequence::around_rooms(3, rooms, len, camera, SensorModel::kinect());
    // Rendered once, so that rendering takes no part in what is measured.
    let frames = 0..rooms * FRAMES_PER_LOOP;
    let round: Vec<RgbdFrame> = frames.map(|index| sequence.frame(index)).collect();
    let frames = (0..).map(|index| {
        let mut frame = round[index % round.len()].clone();
        frame.index = FrameIndex(index);
        frame.timestamp_secs = index as f64 / FRAMES_PER_SECOND;
        Ok::<_, Infallible>(frame)
    });
    let model = CpuModel::new(model_settings(&config.mapping));
    let mut slam = Slam::new(&camera, &config, execution, Box::new(model))?;
    let looker_on = slam.subscribe(10_000);
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            let truth = |index| sequence.world_from_camera(index % round.len());
            report(&looker_on, truth, Duration::from_secs_f64(seconds));
            stop.store(true, Ordering::Relaxed);
        });
        match execution {
            Execution::Realtime => fgs_slam::replay(&mut slam, frames, &stop),
            Execution::Lockstep | Execution::Parallel => fgs_slam::drive(&mut slam, frames, &stop),
        }
    });
    Ok(())
}

/// Prints what happens, for so long; `world_from_camera` is where the camera truly is at a frame.
fn report(looker_on: &Subscription, world_from_camera: impl Fn(usize) -> Se3, duration: Duration) {
    println!(
        "minute,memory_mb,frames,tracked,dropped,tracking_cpu_ms,tracking_median_ms,gaussians,steps,\
         keyframes,loops,position_error_m"
    );
    let (start, mut line_at) = (Instant::now(), Instant::now() + LINE_EVERY);
    let (mut keyframes, mut loops) = (0, 0);
    let mut minute = Minute::begin();
    while start.elapsed() < duration {
        match looker_on.events().recv_deadline(line_at) {
            Ok(SlamEvent::Frame {
                result,
                num_gaussians,
                steps,
                ..
            }) => {
                keyframes += usize::from(result.keyframe.is_some());
                minute.frames += 1;
                minute.tracked += usize::from(result.status == FrameStatus::Tracked);
                minute.dropped += usize::from(result.status == FrameStatus::Dropped);
                minute.gaussians = num_gaussians;
                minute.steps = steps;
                if let Some(tracking) = result.tracking {
                    minute
                        .tracking_ms
                        .push(1e3 * tracking.duration.as_secs_f64());
                }
                // Other sub-maps have axes of their own.
                if let Some(pose) = result.world_from_camera
                    && result.submap == Some(0)
                {
                    let truth = world_from_camera(0).inverse() * world_from_camera(result.index.0);
                    minute.error_m = (pose.translation - truth.translation).norm();
                }
            }
            Ok(SlamEvent::Loop { .. }) => loops += 1,
            Ok(_) => {}
            Err(_) => {
                let minutes = start.elapsed().as_secs_f64() / 60.0;
                minute.print(minutes, keyframes, loops);
                minute = Minute::begin();
                line_at += LINE_EVERY;
            }
        }
    }
}

/// What happened in a minute.
#[derive(Default)]
struct Minute {
    cpu_before: Duration,
    frames: usize,
    tracked: usize,
    dropped: usize,
    tracking_ms: Vec<f64>,
    gaussians: usize,
    steps: usize,
    error_m: f64,
}

impl Minute {
    fn begin() -> Self {
        Self {
            cpu_before: tracking_cpu(),
            ..Self::default()
        }
    }

    fn print(mut self, minutes: f64, keyframes: usize, loops: usize) {
        self.tracking_ms.sort_by(f64::total_cmp);
        let count = self.tracking_ms.len();
        let cpu = tracking_cpu().saturating_sub(self.cpu_before);
        println!(
            "{minutes:.1},{:.1},{},{},{},{:.2},{:.2},{},{},{keyframes},{loops},{:.4}",
            memory_mb(),
            self.frames,
            self.tracked,
            self.dropped,
            1e3 * cpu.as_secs_f64() / count as f64,
            self.tracking_ms.get(count / 2).copied().unwrap_or(f64::NAN),
            self.gaussians,
            self.steps,
            self.error_m,
        );
    }
}

/// CPU time of the tracker's threads and the first one; zero where the system does not say.
fn tracking_cpu() -> Duration {
    /// How Linux counts it for everyone to read.
    const TICK: Duration = Duration::from_millis(10);
    let first = std::process::id().to_string();
    let threads = fs::read_dir("/proc/self/task").into_iter().flatten();
    let ticks = threads.flatten().filter_map(|thread| {
        let stat = fs::read_to_string(thread.path().join("stat")).ok()?;
        let (name, numbers) = stat.rsplit_once(')')?;
        if !name.contains("(tracker") && thread.file_name().to_str() != Some(&first) {
            return None;
        }
        // Fields 14 and 15 of proc(5): in the program and in the system.
        let mut numbers = numbers.split_whitespace().skip(11);
        let mut next = || numbers.next()?.parse::<u32>().ok();
        Some(next()? + next()?)
    });
    TICK * ticks.sum::<u32>()
}

/// Resident memory of this process, megabytes; NaN where the system does not say.
fn memory_mb() -> f64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kilobytes = resident.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    kilobytes.map_or(f64::NAN, |kilobytes| kilobytes / 1024.0)
}
