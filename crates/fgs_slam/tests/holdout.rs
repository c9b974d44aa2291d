//! Frames that are held out: tracked, and never part of the map.

#![allow(clippy::unwrap_used)]

mod common;

use common::{Frames, feed, frames, room, session, statuses};
use fgs_geom::FrameIndex;
use fgs_slam::{Execution, Holdout, SlamOutput};
use fgs_synth::Sequence;

const EVERY: usize = 4;

fn go(input: Frames, sequence: &Sequence, execution: Execution) -> SlamOutput {
    let mut slam = session(sequence, execution);
    slam.hold_out(Holdout::every(EVERY).unwrap());
    feed(&mut slam, execution, input);
    slam.finish()
}

fn keyframes(output: &SlamOutput) -> Vec<usize> {
    let keyframes = output.keyframes.iter();
    keyframes.map(|keyframe| keyframe.index.0).collect()
}

/// The last frame, 23, is held out too, so the one before it closes the map.
#[test]
fn they_are_tracked_and_never_become_keyframes() {
    let sequence = room(24);
    for execution in Execution::ALL {
        let output = go(frames(&sequence), &sequence, execution);
        assert_eq!(output.frames.len(), 24, "{execution:?}");
        let keyframes = keyframes(&output);
        assert!(
            keyframes.iter().all(|index| index % EVERY != EVERY - 1),
            "{execution:?}: {keyframes:?}"
        );
        if execution != Execution::Realtime {
            assert_eq!(statuses(&output), "T".repeat(24));
            assert_eq!(keyframes.last(), Some(&22), "{execution:?}");
        }
    }
}

#[test]
fn what_they_look_like_changes_nothing_in_the_map() {
    let sequence = room(12);
    let painted: Frames = sequence
        .frames()
        .map(|mut frame| {
            if frame.index.0 % EVERY == EVERY - 1 {
                frame.color = frame.color.map(|_| [255, 0, 255]);
            }
            Ok(frame)
        })
        .collect();
    let mut config = common::config();
    // Without colour in tracking, a frame's colours could only come in by way of the map.
    config.tracking.color = false;
    let go = |input: Frames| {
        let execution = Execution::Lockstep;
        let model = common::cpu_model();
        let mut slam = fgs_slam::Slam::new(sequence.camera(), &config, execution, model).unwrap();
        slam.hold_out(Holdout::every(EVERY).unwrap());
        feed(&mut slam, execution, input);
        slam.finish()
    };
    assert!(go(frames(&sequence)).gaussians == go(painted).gaussians);
}

/// A mapping keyframe is due every tenth frame: where that one is held out, the next is taken.
#[test]
fn a_keyframe_is_put_off_to_the_next_frame() {
    let sequence = room(1);
    let input: Frames = (0..24)
        .map(|i| {
            let mut frame = sequence.frame(0);
            frame.index = FrameIndex(i);
            frame.timestamp_secs = i as f64 / 30.0;
            // No camera takes the same image twice; one that comes twice is not a new frame.
            frame.color.set(0, 0, [i as u8; 3]);
            frame.depth_m.set(0, 0, 1.0 + 0.001 * i as f32);
            Ok(frame)
        })
        .collect();
    let mut slam = session(&sequence, Execution::Lockstep);
    slam.hold_out(Holdout::every(11).unwrap());
    feed(&mut slam, Execution::Lockstep, input);
    let output = slam.finish();
    assert_eq!(keyframes(&output), [0, 11, 22, 23]);
}

#[test]
fn they_are_counted_from_the_first_frame_of_the_session() {
    let sequence = room(12);
    let mut slam = session(&sequence, Execution::Lockstep);
    slam.start_at(FrameIndex(3));
    slam.hold_out(Holdout::every(EVERY).unwrap());
    feed(
        &mut slam,
        Execution::Lockstep,
        frames(&sequence).split_off(3),
    );
    let output = slam.finish();
    // Frames 6 and 10 are held out; 3, which is not, starts the map, and 11 closes it.
    let keyframes = keyframes(&output);
    assert_eq!((keyframes[0], keyframes.last()), (3, Some(&11)));
}

/// A camera that sees nothing until a frame that is held out: the frame after it starts the map.
#[test]
fn one_cannot_start_the_map() {
    let sequence = room(8);
    let mut input = frames(&sequence);
    for frame in input[..3].iter_mut().flatten() {
        frame.depth_m = frame.depth_m.map(|_| 0.0);
    }
    let output = go(input, &sequence, Execution::Lockstep);
    assert_eq!(statuses(&output), "LLLLTTTT");
    assert_eq!(keyframes(&output), [4, 6]);
}
