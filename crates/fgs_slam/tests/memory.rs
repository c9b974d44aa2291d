//! Memory is bounded by settings.

#![allow(clippy::unwrap_used)]

mod common;

use common::{config, count, cpu_model, feed, frames, room, worst_position_error_m};
use fgs_slam::{Execution, FrameStatus, Slam, SlamEvent, SlamOutput};

/// What a run gives whose map has at most so many gaussians, and the most that it had.
fn run(max_gaussians: usize, execution: Execution) -> (SlamOutput, usize) {
    let sequence = room(FRAMES);
    let mut config = config();
    config.mapping.max_gaussians = max_gaussians;
    let mut slam = Slam::new(sequence.camera(), &config, execution, cpu_model()).unwrap();
    let looker_on = slam.subscribe(10 * FRAMES);
    feed(&mut slam, execution, frames(&sequence));
    let output = slam.finish();
    let sizes = looker_on.events().iter().filter_map(|event| match event {
        SlamEvent::Frame { num_gaussians, .. } => Some(num_gaussians),
        _ => None,
    });
    let most = sizes.max().unwrap().max(output.gaussians.len());
    (output, most)
}

const FRAMES: usize = 80;

#[test]
fn a_full_map_stays_full_and_the_camera_is_followed() {
    let (free, most) = run(1_000_000, Execution::Lockstep);
    let cap = most / 2;
    let sparse_points = |output: &SlamOutput| {
        let tracking = output.frames.last().and_then(|frame| frame.tracking);
        tracking.unwrap().sparse_points
    };
    for execution in [Execution::Lockstep, Execution::Parallel] {
        let (full, most) = run(cap, execution);
        assert!(most <= cap, "{most} of {cap}");
        assert!(full.gaussians.len() > cap / 2, "{}", full.gaussians.len());
        assert_eq!(count(&full, FrameStatus::Tracked), FRAMES);
        // The tracker hears of what went.
        assert!(sparse_points(&full) < sparse_points(&free));
        let error_m = worst_position_error_m(&full, &room(FRAMES));
        assert!(error_m <= 0.01, "{error_m}");
    }
}

/// Fewer than a single keyframe brings.
#[test]
fn a_map_can_be_tiny() {
    let (output, most) = run(300, Execution::Lockstep);
    // The camera is lost in so little, and may begin anew.
    let elsewhere = output.further.iter().map(|map| map.gaussians.len());
    let all = output.gaussians.len() + elsewhere.sum::<usize>();
    assert!(most <= 300 && (1..=300).contains(&all), "{most} {all}");
    assert!(output.failure.is_none());
}
