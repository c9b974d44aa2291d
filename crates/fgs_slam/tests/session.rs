//! What a session offers beside poses: events, snapshots, corrections, live cameras.

#![allow(clippy::unwrap_used)]

mod common;

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use common::{config, cpu_model, feed, frames, go, picture, poses, room, session, statuses};
use crossbeam_channel::bounded;
use fgs_geom::{KeyframeId, Se3};
use fgs_graph::OptimizeSettings;
use fgs_slam::{
    Execution, FrameStatus, KeyframeKind, Slam, SlamConfig, SlamError, SlamEvent, live,
};
use nalgebra::Vector6;

fn distance(a: &Se3, b: &Se3) -> f64 {
    (a.inverse() * *b).log().norm()
}

#[test]
fn every_frame_is_an_event_and_names_its_keyframe() {
    let sequence = room(12);
    for execution in Execution::ALL {
        let mut slam = session(&sequence, execution);
        let looker_on = slam.subscribe(100);
        let mut input = frames(&sequence);
        input[4] = Err(std::io::Error::other("a torn file"));
        feed(&mut slam, execution, input);
        let output = slam.finish();
        let mut seen = Vec::new();
        for event in looker_on.events() {
            let (result, error) = match event {
                SlamEvent::Frame { result, error, .. } => (*result, error),
                // A keyframe was aligned with the map.
                SlamEvent::Correction(poses) => {
                    assert!(output.graph.pose(poses[0].0).is_some());
                    continue;
                }
                other => panic!("{other:?}"),
            };
            assert_eq!(result.status == FrameStatus::Damaged, error.is_some());
            seen.push(result);
        }
        assert_eq!((seen.len(), looker_on.missed()), (12, 0), "{execution:?}");
        assert_eq!(
            seen[0].keyframe,
            Some((KeyframeId(0), KeyframeKind::Tracking))
        );
        let closing = output.keyframes.last().unwrap();
        for (event, frame) in seen.iter().zip(&output.frames) {
            assert_eq!(event.index, frame.index);
            if frame.index == closing.index {
                assert_eq!(frame.keyframe, Some((closing.id, closing.kind)));
            } else {
                assert_eq!(event.keyframe, frame.keyframe);
            }
        }
    }
}

#[test]
fn whoever_looks_on_slowly_misses_events_and_holds_up_nobody() {
    let sequence = room(8);
    let mut slam = session(&sequence, Execution::Lockstep);
    let asleep = slam.subscribe(3);
    feed(&mut slam, Execution::Lockstep, frames(&sequence));
    assert_eq!((asleep.missed(), asleep.events().len()), (5, 3));
    assert_eq!(
        poses(&slam.finish()),
        poses(&go(frames(&sequence), &sequence, Execution::Lockstep))
    );
}

#[test]
fn snapshots_come_on_demand_and_change_nothing() {
    let sequence = room(12);
    let undisturbed = go(frames(&sequence), &sequence, Execution::Lockstep);
    for execution in Execution::ALL {
        let mut slam = session(&sequence, execution);
        let looker_on = slam.subscribe(100);
        let mut sizes = Vec::new();
        for frame in sequence.frames() {
            slam.push(frame).unwrap();
            sizes.push(slam.snapshot().unwrap().len());
            looker_on.request_snapshot();
        }
        assert!(sizes[0] > 100, "{execution:?}");
        let output = slam.finish();
        let mut events = looker_on.events().iter();
        let published = events.find_map(|event| match event {
            SlamEvent::Snapshot(gaussians) => Some(gaussians.len()),
            _ => None,
        });
        assert!(published.unwrap() > 100, "{execution:?}");
        if execution == Execution::Lockstep {
            assert!(output.gaussians == undisturbed.gaussians);
        }
    }
}

/// Correcting every keyframe by one rigid motion changes the world's axes and nothing else.
#[test]
fn after_a_common_correction_everything_goes_on_as_if_nothing_had_happened() {
    let sequence = room(30);
    let motion = Se3::exp(&Vector6::new(0.3, -0.5, 0.2, 0.8, -0.4, 1.1));
    for execution in Execution::ALL {
        // With colour a keyframe is aligned with the map as it then is, which beside a mapper of its
        // own differs from run to run.
        let mut config = config();
        config.tracking.color = execution == Execution::Lockstep;
        let start =
            |execution| Slam::new(sequence.camera(), &config, execution, cpu_model()).unwrap();
        let mut plain = start(Execution::Lockstep);
        feed(&mut plain, Execution::Lockstep, frames(&sequence));
        let plain = plain.finish();
        let mut slam = start(execution);
        let looker_on = slam.subscribe(100);
        for (i, frame) in sequence.frames().enumerate() {
            slam.push(frame).unwrap();
            if i == 14 {
                let moves: Vec<_> = slam.graph().poses().map(|(id, _)| (id, motion)).collect();
                slam.move_keyframes(&moves).unwrap();
            }
        }
        let output = slam.finish();
        assert_eq!(statuses(&output), "T".repeat(30), "{execution:?}");
        let frames = output.frames.iter().zip(&plain.frames);
        let mut errors: Vec<f64> = frames
            .map(|(frame, plain)| {
                let expected = motion * plain.world_from_camera.unwrap();
                distance(&frame.world_from_camera.unwrap(), &expected)
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        // The camera moves several centimetres. Rounding may change which pixels of a single frame are
        // aligned with the map.
        let (median, worst) = (errors[15], errors[29]);
        assert!(median <= 5e-5, "{execution:?}: {median}");
        assert!(worst <= 5e-4, "{execution:?}: {worst}");
        let corrected = looker_on.events().iter().find_map(|event| match event {
            // Not that of a single keyframe, aligned with the map.
            SlamEvent::Correction(poses) if poses[0].0 == KeyframeId(0) => Some(poses),
            _ => None,
        });
        let corrected = corrected.unwrap();
        assert!(distance(&corrected[0].1, &motion) <= 1e-12);
        let pose = output.frames[20].world_from_camera.unwrap();
        let seen = sequence.frame(20).color;
        let error = picture(&output.gaussians, &sequence, pose)
            .data()
            .as_flattened()
            .iter()
            .zip(seen.data().as_flattened())
            .map(|(a, b)| (a - f32::from(*b) / 255.0).abs())
            .sum::<f32>()
            / (3 * seen.data().len()) as f32;
        assert!(error <= 0.05, "{execution:?}: mean colour error {error}");
    }
}

#[test]
fn a_frame_follows_the_keyframe_it_was_seen_from() {
    let sequence = room(15);
    let mut slam = session(&sequence, Execution::Lockstep);
    feed(&mut slam, Execution::Lockstep, frames(&sequence));
    let first = KeyframeId(0);
    let motion = Se3::exp(&Vector6::new(0.0, 0.1, 0.0, 0.0, 0.0, 0.2));
    let before = *slam.graph().pose(first).unwrap();
    slam.move_keyframes(&[(first, motion)]).unwrap();
    let output = slam.finish();
    let plain = go(frames(&sequence), &sequence, Execution::Lockstep);
    assert!(distance(&output.keyframes[0].world_from_camera, &(motion * before)) <= 1e-12);
    let second = output.keyframes[1].index.0;
    assert!(second > 1);
    for (frame, plain) in output.frames.iter().zip(&plain.frames) {
        let old = plain.world_from_camera.unwrap();
        let expected = if frame.index.0 < second {
            motion * old
        } else {
            old
        };
        assert!(distance(&frame.world_from_camera.unwrap(), &expected) <= 1e-12);
    }
}

/// Keyframes are tied to each other, and the ties fit the poses they were made from.
#[test]
fn successive_keyframes_are_tied_by_how_well_they_were_registered() {
    let sequence = room(25);
    let output = go(frames(&sequence), &sequence, Execution::Lockstep);
    let edges = output.graph.edges();
    assert!(edges.len() >= 2 && edges.len() + 1 == output.keyframes.len());
    for (edge, pair) in edges.iter().zip(output.keyframes.windows(2)) {
        assert_eq!((edge.from, edge.to), (pair[0].id, pair[1].id));
        assert!(edge.chi2(&pair[0].world_from_camera, &pair[1].world_from_camera) <= 1e-9);
        let covariance = edge.information.try_inverse().unwrap();
        let sigma_m = covariance.fixed_view::<3, 3>(3, 3).trace().sqrt();
        // Thousands of exact points: up to a few millimetres. Drift: 1 mm and 1 % of the way on each
        // axis, where a radian counts as a metre.
        let motion = edge.from_from_to;
        let way = motion.translation.norm() + motion.rotation.angle();
        let drift_m = 3.0_f64.sqrt() * (1e-3 + 0.01 * way);
        assert!((drift_m..drift_m + 3e-3).contains(&sigma_m), "{sigma_m} m");
    }
    let optimized = output.graph.optimize(&OptimizeSettings::default()).unwrap();
    let still = |(_, motion): &(KeyframeId, Se3)| distance(motion, &Se3::identity()) <= 1e-9;
    assert!(optimized.corrections.iter().all(still));
}

#[test]
fn what_does_not_belong_to_the_session_is_refused() {
    let sequence = room(2);
    let mut slam = session(&sequence, Execution::Lockstep);
    slam.push(sequence.frame(0)).unwrap();
    let mut other = sequence.frame(1);
    other.camera = fgs_synth::kinect_camera(160, 121).unwrap();
    assert!(matches!(
        slam.push(other),
        Err(SlamError::OtherCamera { .. })
    ));
    let mut oversized = sequence.frame(1);
    oversized.depth_m = fgs_geom::Image::filled(320, 240, 1.0);
    assert!(matches!(slam.push(oversized), Err(SlamError::Frame(_))));
    let unknown = slam.move_keyframes(&[(KeyframeId(9), Se3::identity())]);
    assert!(matches!(
        unknown,
        Err(SlamError::NoSuchKeyframe(KeyframeId(9)))
    ));
    assert_eq!(statuses(&slam.finish()), "TMM");
}

#[test]
fn a_stop_is_seen_while_a_live_source_blocks() {
    let sequence = room(3);
    let mut slam = session(&sequence, Execution::Realtime);
    let stop = AtomicBool::new(false);
    // The camera hangs after its third frame, for as long as the other end is kept.
    let (_kept, hung) = bounded::<()>(0);
    let mut input = frames(&sequence).into_iter();
    let source = move || {
        input.next().or_else(|| {
            let _ = hung.recv();
            None
        })
    };
    thread::scope(|scope| {
        let stopping = scope.spawn(|| {
            thread::sleep(Duration::from_millis(500));
            stop.store(true, Ordering::Relaxed);
            Instant::now()
        });
        live(&mut slam, source, &stop).unwrap();
        assert!(stopping.join().unwrap().elapsed() <= Duration::from_secs(5));
    });
    assert!(!slam.finish().frames.is_empty());
}

/// A camera faster than any tracker: its frames do not pile up.
#[test]
fn a_live_source_that_is_too_fast_loses_frames_and_they_are_recorded() {
    let sequence = room(4);
    let mut slam = Slam::new(
        sequence.camera(),
        &SlamConfig::default(),
        Execution::Realtime,
        cpu_model(),
    )
    .unwrap();
    let frame = sequence.frame(0);
    let mut left = 3000;
    let source = move || {
        left -= 1;
        (left >= 0).then(|| Ok::<_, std::io::Error>(frame.clone()))
    };
    live(&mut slam, source, &AtomicBool::new(false)).unwrap();
    let output = slam.finish();
    assert!(common::count(&output, FrameStatus::Dropped) > 100);
    assert!(statuses(&output).contains('T'));
}
