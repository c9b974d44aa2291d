use std::fs;
use std::ops::ControlFlow;

use fgs_slam::{FrameStatus, KeyframeKind};
use fgs_synth::{SensorModel, Sequence, kinect_camera};
use tempfile::TempDir;

use super::*;
use crate::observer::RunEvent;
use crate::run_folder::{FRAMES, MAP, METRICS};

const FRAME_COUNT: usize = 3;

/// A plan for a tiny recording of a room, seen with exact depth.
fn room() -> (TempDir, Plan) {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("room");
    let camera = kinect_camera(160, 120).unwrap();
    let sequence = Sequence::new(1, FRAME_COUNT, camera, SensorModel::exact());
    fgs_synth::write_tum(&sequence, &recording, |_| ControlFlow::Continue(())).unwrap();
    let options = RunOptions {
        dataset: recording,
        backend: Some(Backend::Cpu),
        out: Some(folder.path().join("out")),
        evaluate: true,
        ..RunOptions::default()
    };
    let (plan, _) = Plan::resolve(&options).unwrap();
    (folder, plan)
}

fn on_cpu() -> Model {
    Backend::Cpu.model(&Default::default(), None).unwrap()
}

fn run(plan: &Plan) -> Result<RunResult, RunError> {
    plan.run(on_cpu(), &mut (), &AtomicBool::new(false))
}

#[test]
fn what_is_saved_is_what_was_returned() {
    let (_folder, plan) = room();
    let result = run(&plan).unwrap();
    let saved = RunResult::read(&plan.folder).unwrap();
    assert_eq!(saved.rows, result.rows);
    assert_eq!(saved.metrics, result.metrics);
    assert_eq!(saved.gaussians, result.gaussians);
    let settings = Settings::read(&plan.folder.join(CONFIG)).unwrap();
    assert_eq!(settings, plan.settings);
}

/// The closing keyframe is optimised like any other, so its frame is not held out.
#[test]
fn the_closing_keyframe_has_a_row_and_is_not_held_out() {
    let (_folder, plan) = room();
    let result = run(&plan).unwrap();
    let keyframes: Vec<_> = result.rows.iter().map(|row| row.keyframe).collect();
    assert_eq!(
        keyframes,
        [
            Some(KeyframeKind::Tracking),
            None,
            Some(KeyframeKind::Mapping)
        ]
    );
    assert_eq!(result.metrics.keyframes, 2);
    assert_eq!(
        result.metrics.scores.get("psnr_heldout_db"),
        result.rows[1].scores.get("psnr_valid_depth_db")
    );
}

#[test]
fn an_observer_sees_each_frame_and_each_scored_batch() {
    struct Seen(Vec<String>);
    impl RunObserver for Seen {
        fn on(&mut self, event: &RunEvent<'_>) {
            self.0.push(match event {
                RunEvent::Frame { row, .. } => {
                    assert_eq!(row.status, FrameStatus::Tracked);
                    format!("frame {}", row.index)
                }
                RunEvent::Scored { done, total } => format!("scored {done} of {total}"),
            });
        }
    }
    let (_folder, plan) = room();
    let mut seen = Seen(Vec::new());
    plan.run(on_cpu(), &mut seen, &AtomicBool::new(false))
        .unwrap();
    assert_eq!(seen.0, ["frame 0", "frame 1", "frame 2", "scored 3 of 3"]);
}

#[test]
fn a_run_whose_mapper_failed_is_saved_and_scored() {
    let (_folder, plan) = room();
    let stop = AtomicBool::new(false);
    let mut result = drive(&plan, on_cpu(), &mut (), &stop).unwrap();
    assert_eq!(result.metrics.failure, None);
    result.metrics.failure = Some("unplugged".into());
    plan.conclude(result, &mut (), &stop).unwrap();
    let saved = RunResult::read(&plan.folder).unwrap();
    assert_eq!(saved.metrics.failure.as_deref(), Some("unplugged"));
    assert!(saved.rows.len() == FRAME_COUNT && saved.gaussians.len() > 100);
    assert!(saved.metrics.scores.get("psnr_db").is_some());
}

#[test]
fn a_map_that_cannot_be_written_takes_nothing_else_with_it() {
    let (_folder, plan) = room();
    // Results of an earlier run, and a folder where the map should go.
    let earlier = [METRICS, TRAJECTORY, FRAMES, CONFIG];
    for name in earlier {
        fs::write(plan.folder.join(name), "of an earlier run").unwrap();
    }
    let in_the_way = plan.folder.join(MAP);
    fs::create_dir_all(in_the_way.join("sub")).unwrap();
    let error = run(&plan).unwrap_err();
    assert!(matches!(error, RunError::Map(_)), "{error}");
    assert!(!error.is_usage());
    assert!(error.to_string().contains("map.ply"), "{error}");
    let metrics = crate::Metrics::read(&plan.folder).unwrap();
    assert_eq!((metrics.frames, metrics.map_bytes), (FRAME_COUNT, 0));
    assert!(metrics.scores.get("psnr_db").is_some());
    let rows = crate::frame_log::read(&plan.folder.join(FRAMES)).unwrap();
    assert!(rows.iter().all(|row| row.scores.get("ssim").is_some()));
    let trajectory = fgs_data::Trajectory::read(&plan.folder.join(TRAJECTORY)).unwrap();
    assert_eq!(trajectory.poses().len(), FRAME_COUNT);
    Settings::read(&plan.folder.join(CONFIG)).unwrap();
}

/// Where scoring fails, everything is saved by then, and only the scores are missing.
#[test]
fn frames_that_cannot_be_scored_are_saved_without_scores() {
    let (folder, plan) = room();
    let stop = AtomicBool::new(false);
    let result = drive(&plan, on_cpu(), &mut (), &stop).unwrap();
    // Smaller images than SSIM's window.
    let small = folder.path().join("small");
    let camera = kinect_camera(8, 8).unwrap();
    let sequence = Sequence::new(1, FRAME_COUNT, camera, SensorModel::exact());
    fgs_synth::write_tum(&sequence, &small, |_| ControlFlow::Continue(())).unwrap();
    let plan = Plan {
        dataset: Dataset::open(&small, &fgs_data::OpenOptions::default()).unwrap(),
        ..plan
    };
    let error = plan.conclude(result, &mut (), &stop).unwrap_err();
    assert!(matches!(error, RunError::Eval(_)), "{error}");
    let saved = RunResult::read(&plan.folder).unwrap();
    assert_eq!(saved.rows.len(), FRAME_COUNT);
    assert!(saved.gaussians.len() > 100);
    assert_eq!(saved.metrics.scores.get("psnr_db"), None);
}
