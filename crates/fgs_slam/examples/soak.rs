//! A camera goes round and round a room for as long as wanted: memory, and time per frame.
//!
//!     cargo run --release -p fgs_slam --example soak -- SECONDS MAX_GAUSSIANS
//!
//! Prints a line of CSV every 200 frames. Memory is what the process has in use (Linux only).

#![allow(clippy::print_stdout, reason = "an example prints")]

use std::error::Error;
use std::time::{Duration, Instant};

use fgs_slam::{Execution, FrameStatus, Slam, SlamConfig, SlamEvent, model_settings};
use fgs_splat::CpuModel;
use fgs_synth::{SensorModel, Sequence, kinect_camera};

/// Frames once round the room, back to where the camera began.
const ROUND: usize = 600;
const FRAMES_PER_LINE: usize = 200;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let seconds = arguments.next().map_or(Ok(60.0), |text| text.parse())?;
    let mut config = SlamConfig::default();
    config.mapping.iterations_per_frame = 1.0;
    if let Some(max) = arguments.next() {
        config.mapping.max_gaussians = max.parse()?;
    }
    let camera = kinect_camera(160, 120)?;
    let sequence = Sequence::new(3, ROUND, camera, SensorModel::kinect());
    let model = CpuModel::new(model_settings(&config.mapping));
    let mut slam = Slam::new(&camera, &config, Execution::Lockstep, Box::new(model))?;
    println!("frame,memory_mb,ms_per_frame,gaussians,keyframes,tracked,position_error_m");
    let (start, mut busy, mut tracked) = (Instant::now(), Duration::ZERO, 0);
    let looker_on = slam.subscribe(10);
    let (mut frame_number, mut gaussians) = (0, 0);
    while start.elapsed().as_secs_f64() < seconds {
        // Past its last frame the sequence goes on with the next round.
        let frame = sequence.frame(frame_number);
        let before = Instant::now();
        let result = slam.push(frame)?;
        busy += before.elapsed();
        tracked += usize::from(result.status == FrameStatus::Tracked);
        frame_number += 1;
        for event in looker_on.events().try_iter() {
            if let SlamEvent::Frame { num_gaussians, .. } = event {
                gaussians = num_gaussians;
            }
        }
        if frame_number.is_multiple_of(FRAMES_PER_LINE) {
            let world_from_camera = sequence.world_from_camera(0).inverse()
                * sequence.world_from_camera(result.index.0);
            let error_m = result.world_from_camera.map_or(f64::NAN, |pose| {
                (pose.translation - world_from_camera.translation).norm()
            });
            println!(
                "{frame_number},{:.1},{:.2},{gaussians},{},{tracked},{error_m:.4}",
                memory_mb(),
                1e3 * busy.as_secs_f64() / FRAMES_PER_LINE as f64,
                slam.graph().poses().count(),
            );
            (busy, tracked) = (Duration::ZERO, 0);
        }
    }
    Ok(())
}

/// Resident memory of this process, megabytes; NaN where the system does not say.
fn memory_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kilobytes = resident.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    kilobytes.map_or(f64::NAN, |kilobytes| kilobytes / 1024.0)
}
