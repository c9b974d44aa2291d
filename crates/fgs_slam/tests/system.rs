//! The whole system on synthetic rooms: accuracy, repeatability, and losing the camera.

#![allow(clippy::unwrap_used)]

mod common;

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use common::{
    Frames, config, count, cpu_model, frames, go, poses, psnr_of_map_db, room, session, statuses,
    worst_position_error_m,
};
use fgs_geom::{RgbdFrame, Se3};
use fgs_slam::{Execution, FrameStatus, Slam, SlamError, drive, replay};
use fgs_synth::Sequence;

fn go_on(threads: usize, sequence: &Sequence) -> fgs_slam::SlamOutput {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
    pool.build()
        .unwrap()
        .install(|| go(frames(sequence), sequence, Execution::Lockstep))
}

#[test]
fn tracks_and_maps_a_room() {
    let sequence = room(40);
    let moved = (sequence.world_from_camera(39).translation
        - sequence.world_from_camera(0).translation)
        .norm();
    for execution in [Execution::Lockstep, Execution::Parallel] {
        let output = go(frames(&sequence), &sequence, execution);
        assert_eq!(statuses(&output), "T".repeat(40));
        assert_eq!(output.timings.steps, 80);
        let error_m = worst_position_error_m(&output, &sequence);
        assert!(
            error_m <= moved / 50.0,
            "{execution:?}: {error_m} m of {moved} m"
        );
        assert!(output.gaussians.len() >= 1000);

        let psnr = psnr_of_map_db(&output, &output.gaussians, &sequence, 20);
        assert!(psnr >= 24.0, "{execution:?}: {psnr} dB");
    }
}

/// At the recording's own pace, or dropping what comes too late.
#[test]
fn realtime_ends_and_counts_every_frame() {
    let sequence = room(30);
    let output = go(frames(&sequence), &sequence, Execution::Realtime);
    assert_eq!(output.frames.len(), 30);
    assert!(!output.gaussians.is_empty());
    assert!(output.timings.total >= Duration::from_secs_f64(29.0 / 30.0));
}

/// A recording whose frames come faster than any tracker follows.
#[test]
fn realtime_drops_what_has_waited_too_long_and_tracks_the_rest() {
    let sequence = room(60);
    let mut input = frames(&sequence);
    for (i, frame) in input.iter_mut().flatten().enumerate() {
        frame.timestamp_secs = 1e-4 * i as f64;
    }
    let output = go(input, &sequence, Execution::Realtime);
    assert_eq!(output.frames.len(), 60);
    let dropped = count(&output, FrameStatus::Dropped);
    assert!(dropped >= 5, "{}", statuses(&output));
    assert!(statuses(&output).starts_with("TT"));
}

/// Clocks that say nothing: each frame is due when it comes.
#[test]
fn realtime_drops_nothing_for_the_sake_of_a_damaged_clock() {
    let sequence = room(20);
    let clocks: [fn(usize) -> f64; 2] = [|_| 3.0, |i| -(i as f64)];
    for clock in clocks {
        let mut input = frames(&sequence);
        for (i, frame) in input.iter_mut().flatten().enumerate() {
            frame.timestamp_secs = clock(i);
        }
        let output = go(input, &sequence, Execution::Realtime);
        assert_eq!(statuses(&output), "T".repeat(20));
    }
}

#[test]
fn lockstep_repeats_itself_on_any_number_of_threads() {
    let sequence = room(16);
    let first = go_on(1, &sequence);
    for threads in [1, 8] {
        let again = go_on(threads, &sequence);
        assert!(first.gaussians == again.gaussians, "{threads} threads");
        assert_eq!(poses(&first), poses(&again), "{threads} threads");
    }
}

#[test]
fn a_recording_with_every_third_frame_missing_is_tracked() {
    let sequence = room(40);
    let input: Frames = (0..40)
        .filter(|i| i % 3 != 2)
        .map(|i| Ok(sequence.frame(i)))
        .collect();
    let output = go(input, &sequence, Execution::Lockstep);
    assert_eq!(statuses(&output), "T".repeat(27));
    assert!(worst_position_error_m(&output, &sequence) <= 0.002);
}

fn covered(mut frame: RgbdFrame) -> RgbdFrame {
    frame.color = frame.color.map(|_| [0; 3]);
    frame.depth_m = frame.depth_m.map(|_| 0.0);
    frame
}

/// A wall that fills the view, without texture.
fn blank_wall(mut frame: RgbdFrame) -> RgbdFrame {
    frame.color = frame.color.map(|_| [200; 3]);
    frame.depth_m = frame.depth_m.map(|_| 1.0);
    frame
}

#[test]
fn a_covered_lens_a_blank_wall_and_a_teleport_are_lost_and_the_camera_is_found_again() {
    let sequence = room(150);
    for damage in [covered, blank_wall, |frame: RgbdFrame| {
        let mut elsewhere = room(150).frame(75);
        elsewhere.index = frame.index;
        elsewhere.timestamp_secs = frame.timestamp_secs;
        elsewhere
    }] {
        let input: Frames = (0..12)
            .map(|i| {
                let frame = sequence.frame(i);
                Ok(if (5..8).contains(&i) {
                    damage(frame)
                } else {
                    frame
                })
            })
            .collect();
        let output = go(input, &sequence, Execution::Lockstep);
        assert_eq!(statuses(&output), "TTTTTLLLTTTT");
        let finite = |pose: Se3| pose.matrix().iter().all(|x| x.is_finite());
        let mut poses = output
            .frames
            .iter()
            .filter_map(|frame| frame.world_from_camera);
        assert!(poses.all(finite));
        let means = output.gaussians.means.as_flattened();
        assert!(means.iter().all(|x| x.is_finite()));
    }
}

#[test]
fn a_camera_that_sees_nothing_at_first_starts_when_it_does() {
    let sequence = room(6);
    let mut input = frames(&sequence);
    input[0] = Ok(covered(sequence.frame(0)));
    let output = go(input, &sequence, Execution::Lockstep);
    assert_eq!(statuses(&output), "LTTTTT");
}

#[test]
fn repeated_frames_stand_still() {
    let sequence = room(1);
    let input: Frames = (0..5).map(|_| Ok(sequence.frame(0))).collect();
    let output = go(input, &sequence, Execution::Lockstep);
    assert_eq!(statuses(&output), "TTTTT");
    // The map is not yet quite like the image that every frame is aligned with it by.
    assert!(worst_position_error_m(&output, &sequence) <= 5e-6);
}

#[test]
fn damaged_frames_are_skipped_and_recorded() {
    let sequence = room(8);
    let mut input = frames(&sequence);
    input[3] = Err(std::io::Error::other("a torn file"));
    let output = go(input, &sequence, Execution::Lockstep);
    assert_eq!(statuses(&output), "TTTMTTTT");
    let indices: Vec<usize> = output.frames.iter().map(|frame| frame.index.0).collect();
    assert_eq!(indices, [0, 1, 2, 3, 4, 5, 6, 7]);
}

#[test]
fn no_frames_give_an_empty_map() {
    for execution in Execution::ALL {
        let output = go(Vec::new(), &room(1), execution);
        assert!(output.frames.is_empty() && output.gaussians.is_empty());
    }
}

#[test]
fn a_stopped_run_keeps_what_it_has() {
    let sequence = room(30);
    for execution in Execution::ALL {
        let (mut slam, stop) = (session(&sequence, execution), AtomicBool::new(false));
        // Slowly, so that a busy machine drops none in real time either.
        let input = (0..30).map(|i| {
            let mut frame = sequence.frame(i);
            frame.timestamp_secs *= 5.0;
            stop.store(i == 3, Ordering::Relaxed);
            Ok::<_, std::io::Error>(frame)
        });
        match execution {
            Execution::Realtime => replay(&mut slam, input, &stop),
            _ => drive(&mut slam, input, &stop),
        }
        let output = slam.finish();
        assert!((3..=4).contains(&output.frames.len()), "{execution:?}");
        assert!(!output.gaussians.is_empty(), "{execution:?}");
    }
}

/// A replay that waits for a frame far in the future sees it too.
#[test]
fn a_stop_is_seen_while_a_replay_waits() {
    let sequence = room(2);
    let (mut slam, stop) = (
        session(&sequence, Execution::Realtime),
        AtomicBool::new(false),
    );
    let start = Instant::now();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            std::thread::sleep(Duration::from_millis(300));
            stop.store(true, Ordering::Relaxed);
        });
        let input = (0..).map(|i| {
            let mut frame = sequence.frame(i % 2);
            frame.timestamp_secs = 3600.0 * i as f64;
            Ok::<_, std::io::Error>(frame)
        });
        replay(&mut slam, input, &stop);
    });
    assert!(start.elapsed() <= Duration::from_secs(5));
    assert!(!slam.finish().frames.is_empty());
}

#[test]
fn impossible_settings_are_refused() {
    let mut config = config();
    config.mapping.prune_every = 0;
    let camera = room(1).camera().to_owned();
    let result = Slam::new(&camera, &config, Execution::Lockstep, cpu_model());
    assert!(matches!(result, Err(SlamError::Setting(error)) if error.key == "mapping.prune_every"));
}
