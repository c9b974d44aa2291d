use std::fs;
use std::ops::ControlFlow;

use std::sync::atomic::Ordering;

use fgs_slam::{FrameStatus, Holdout, KeyframeKind};
use fgs_splat::Gaussians;
use fgs_synth::{SensorModel, Sequence, kinect_camera};
use tempfile::TempDir;

use super::*;
use crate::frame_log::FrameRow;
use crate::observer::RunEvent;
use crate::run_folder::{MAP, REFINED_MAP, RunFolder, TRAJECTORY};
use crate::{FinishedRun, Scores, score_images};

const FRAME_COUNT: usize = 3;

/// A plan for a tiny recording of a room, seen with exact depth.
fn room() -> (TempDir, Plan) {
    let folder = tempfile::tempdir().unwrap();
    write_room(1, FRAME_COUNT, &folder.path().join("room"));
    plan_in(folder)
}

fn write_room(seed: u64, frames: usize, recording: &Path) {
    let camera = kinect_camera(160, 120).unwrap();
    let sequence = Sequence::new(seed, frames, camera, SensorModel::exact());
    fgs_synth::write_tum(&sequence, recording, |_| ControlFlow::Continue(())).unwrap();
}

fn plan_in(folder: TempDir) -> (TempDir, Plan) {
    let recording = folder.path().join("room");
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

fn saved(folder: &OutputFolder) -> Result<RunResult, RunError> {
    RunResult::read(&RunFolder::open(folder.path())?)
}

fn run(plan: &Plan) -> Result<RunResult, RunError> {
    plan.run(on_cpu(), &mut (), &AtomicBool::new(false))
}

#[test]
fn what_is_saved_is_what_was_returned() {
    let (_folder, plan) = room();
    let result = run(&plan).unwrap();
    let saved = saved(&plan.folder).unwrap();
    assert_eq!(saved.rows, result.rows);
    assert_eq!(saved.metrics, result.metrics);
    assert_eq!(saved.gaussians, result.gaussians);
    let settings = Settings::read(&plan.folder.path().join(CONFIG)).unwrap();
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
                RunEvent::Refined { done, total } => format!("refined {done} of {total}"),
                RunEvent::Mapped { .. } => "mapped".into(),
                RunEvent::Scored { done, total } => format!("scored {done} of {total}"),
            });
        }
    }
    let (_folder, mut plan) = room();
    plan.refine = 2;
    let mut seen = Seen(Vec::new());
    plan.run(on_cpu(), &mut seen, &AtomicBool::new(false))
        .unwrap();
    let refined = ["refined 1 of 2", "refined 2 of 2"];
    let expected = [
        &["frame 0", "frame 1", "frame 2"],
        &refined[..],
        &["mapped", "scored 3 of 3"],
    ]
    .concat();
    assert_eq!(seen.0, expected);
}

#[test]
fn a_run_whose_mapper_failed_is_saved_and_scored() {
    let (_folder, plan) = room();
    let stop = AtomicBool::new(false);
    let mut result = drive(&plan, on_cpu(), &mut (), &stop).unwrap();
    assert_eq!(result.metrics.failure, None);
    result.metrics.failure = Some("unplugged".into());
    plan.conclude(result, &mut (), &stop).unwrap();
    let saved = saved(&plan.folder).unwrap();
    assert_eq!(saved.metrics.failure.as_deref(), Some("unplugged"));
    assert!(saved.rows.len() == FRAME_COUNT && saved.gaussians.len() > 100);
    assert!(saved.metrics.scores.get("psnr_db").is_some());
}

/// Nothing else goes with it, and earlier results stay whole.
#[test]
fn a_map_that_cannot_be_written_takes_nothing_else_with_it() {
    let (folder, plan) = room();
    let stop = AtomicBool::new(false);
    let mut expected = folder.path().join("out");
    for round in 1..=3 {
        let mut result = drive(&plan, on_cpu(), &mut (), &stop).unwrap();
        result.gaussians.log_scales[7][1] = f32::INFINITY;
        let error = plan.conclude(result, &mut (), &stop).unwrap_err();
        let message = error.to_string();
        assert!(!error.is_usage());
        assert!(
            message.contains("out/map.ply: scale_1 of vertex 7 is inf"),
            "{message}"
        );
        let RunError::Incomplete { saved, kept, .. } = error else {
            panic!("{message}");
        };
        assert_eq!(saved, expected);
        assert_eq!(kept.is_some(), round > 1);
        assert!(!saved.join(MAP).exists());
        let saved = RunFolder::open(&saved).unwrap();
        let metrics = crate::Metrics::read(&saved).unwrap();
        assert_eq!((metrics.frames, metrics.map_bytes), (FRAME_COUNT, 0));
        let rows = crate::frame_log::read(&saved.join(crate::FRAMES)).unwrap();
        assert_eq!(rows.len(), FRAME_COUNT);
        let trajectory = fgs_data::Trajectory::read(&saved.join(crate::TRAJECTORY)).unwrap();
        assert_eq!(trajectory.poses().len(), FRAME_COUNT);
        Settings::read(&saved.join(CONFIG)).unwrap();
        expected = folder.path().join(format!("out-{}", round + 1));
    }
}

#[test]
fn notes_that_appear_during_a_run_are_kept_and_so_is_the_run() {
    let (folder, plan) = room();
    run(&plan).unwrap();
    let map = fs::read(plan.folder.path().join(MAP)).unwrap();
    fs::write(plan.folder.path().join("notes.txt"), "mine").unwrap();
    let message = run(&plan).unwrap_err().to_string();
    assert!(message.contains("notes.txt"), "{message}");
    assert!(plan.folder.path().join("notes.txt").exists());
    assert!(fs::read(plan.folder.path().join(MAP)).unwrap() == map);
    assert!(fs::read(folder.path().join("out-2").join(MAP)).unwrap() == map);
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
        input: Input::Recording(Dataset::open(&small, &fgs_data::OpenOptions::default()).unwrap()),
        ..plan
    };
    let error = plan.conclude(result, &mut (), &stop).unwrap_err();
    assert!(matches!(error, RunError::Eval(_)), "{error}");
    let saved = saved(&plan.folder).unwrap();
    assert_eq!(saved.rows.len(), FRAME_COUNT);
    assert!(saved.gaussians.len() > 100);
    assert_eq!(saved.metrics.scores.get("psnr_db"), None);
}

/// The means of a map's scores, computed directly.
fn means(plan: &Plan, result: &RunResult, map: &Gaussians, holdout: Option<Holdout>) -> Scores {
    let mut rows = result.rows.clone();
    let (trajectory, never) = (&result.trajectory, AtomicBool::new(false));
    score_images(
        &mut rows,
        trajectory,
        map,
        plan.dataset().unwrap(),
        &mut (),
        &never,
    )
    .unwrap();
    let mut means = Scores::default();
    means.set_means(&rows, holdout);
    means
}

#[test]
fn a_refined_map_has_scores_of_its_own_and_leaves_the_others_alone() {
    let (_folder, mut plan) = room();
    let plain = run(&plan).unwrap();
    assert!(plain.metrics.refined.is_none() && !plan.folder.path().join(REFINED_MAP).exists());
    let plain_map = fs::read(plan.folder.path().join(MAP)).unwrap();

    plan.refine = 40;
    let result = run(&plan).unwrap();
    assert_eq!(fs::read(plan.folder.path().join(MAP)).unwrap(), plain_map);
    assert_eq!(result.metrics.scores, plain.metrics.scores);
    assert_eq!(result.metrics.iterations, plain.metrics.iterations);
    let refined = result.metrics.refined.as_ref().unwrap();
    assert_eq!(
        (refined.steps, refined.num_gaussians),
        (40, result.refined.as_ref().unwrap().len())
    );
    let bytes = fs::metadata(plan.folder.path().join(REFINED_MAP))
        .unwrap()
        .len();
    assert_eq!(refined.map_bytes, bytes);
    assert_eq!(
        refined.scores,
        means(&plan, &result, result.refined.as_ref().unwrap(), None)
    );
    for name in ["psnr_valid_depth_db", "psnr_db", "psnr_heldout_db"] {
        let (after, before) = (refined.scores.get(name), plain.metrics.scores.get(name));
        assert!(
            after.unwrap() >= before.unwrap() + 0.5,
            "{name}: {before:?}, then {after:?}"
        );
    }

    let saved = saved(&plan.folder).unwrap();
    assert_eq!(saved.refined, result.refined);
    assert_eq!(saved.metrics, result.metrics);

    // Results of another run take those of the first with them.
    plan.refine = 0;
    run(&plan).unwrap();
    assert!(!plan.folder.path().join(REFINED_MAP).exists());
}

#[test]
fn test_views_are_no_keyframes_and_have_scores_of_their_own() {
    let (_folder, mut plan) = room();
    let holdout = Holdout::every(3).unwrap();
    (plan.eval_holdout, plan.refine) = (Some(holdout), 5);
    let result = run(&plan).unwrap();
    // The last frame is held out: the one before it closes the map.
    let keyframes: Vec<_> = result.rows.iter().map(|row| row.keyframe).collect();
    let [first, closing] = [KeyframeKind::Tracking, KeyframeKind::Mapping];
    assert_eq!(keyframes, [Some(first), Some(closing), None]);
    let metrics = &result.metrics;
    assert_eq!(metrics.eval_holdout, Some(holdout));
    for (test, of_frame) in [
        ("test_psnr_valid_depth_db", "psnr_valid_depth_db"),
        ("test_psnr_db", "psnr_db"),
        (
            "test_psnr_exposure_valid_depth_db",
            "psnr_exposure_valid_depth_db",
        ),
        ("test_psnr_exposure_db", "psnr_exposure_db"),
        ("test_ssim", "ssim"),
        ("test_depth_l1_m", "depth_l1_m"),
    ] {
        assert!(metrics.scores.get(test).is_some(), "{test}");
        assert_eq!(
            metrics.scores.get(test),
            result.rows[2].scores.get(of_frame),
            "{test}"
        );
    }
    let refined = metrics.refined.as_ref().unwrap();
    let direct = means(
        &plan,
        &result,
        result.refined.as_ref().unwrap(),
        Some(holdout),
    );
    assert_eq!(refined.scores, direct);
    assert_ne!(
        refined.scores.get("test_psnr_db"),
        metrics.scores.get("test_psnr_db")
    );
}

#[test]
fn a_finished_run_is_scored_again_with_both_maps() {
    let (_folder, mut plan) = room();
    (plan.eval_holdout, plan.refine) = (Some(Holdout::every(2).unwrap()), 5);
    plan.settings.run.eval_holdout = plan.eval_holdout;
    let scored = run(&plan).unwrap().metrics;
    plan.evaluate = false;
    assert_eq!(run(&plan).unwrap().metrics.scores.get("test_ssim"), None);
    let out = plan.folder.path().to_owned();
    drop(plan);
    let finished = FinishedRun::open(&out, None).unwrap();
    let never = AtomicBool::new(false);
    let again = finished.rescore(&mut (), &never).unwrap().unwrap().metrics;
    let pairs = |a: &Scores, b: &Scores| {
        for ((score, a), (_, b)) in a.iter().zip(b.iter()) {
            // Quaternions are normalised again on reading, which may change their last bits.
            let error = (a.unwrap_or(0.0) - b.unwrap_or(0.0)).abs();
            assert!(
                a.is_some() == b.is_some() && error <= 1e-9,
                "{}: {a:?} {b:?}",
                score.name
            );
        }
    };
    pairs(&again.scores, &scored.scores);
    assert!(again.scores.get("test_ssim").is_some());
    let refined = |metrics: &crate::Metrics| metrics.refined.clone().unwrap().scores;
    pairs(&refined(&again), &refined(&scored));
    assert!(refined(&again).get("test_ssim").is_some());
}

#[test]
fn a_stop_during_refinement_saves_both_maps() {
    struct StopAt<'a>(usize, &'a AtomicBool);
    impl RunObserver for StopAt<'_> {
        fn on(&mut self, event: &RunEvent<'_>) {
            if let RunEvent::Refined { done, .. } = event {
                self.1.store(*done >= self.0, Ordering::Relaxed);
            }
        }
    }
    let (_folder, mut plan) = room();
    plan.refine = usize::MAX;
    let stop = AtomicBool::new(false);
    let result = plan.run(on_cpu(), &mut StopAt(3, &stop), &stop).unwrap();
    assert!(result.metrics.interrupted);
    assert!((3..1000).contains(&result.metrics.refined.as_ref().unwrap().steps));
    let saved = saved(&plan.folder).unwrap();
    assert!(saved.gaussians.len() > 100 && saved.refined.unwrap().len() > 100);
    assert_eq!(saved.metrics.scores.get("psnr_db"), None);
}

/// A recording that is cut from one room into another.
fn two_rooms() -> (TempDir, Plan) {
    const FIRST: usize = 6;
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = ["room", "second"].map(|name| folder.path().join(name));
    write_room(3, FIRST, &first);
    write_room(11, 20, &second);
    for kind in ["rgb", "depth"] {
        let list = format!("{kind}.txt");
        let mut all = fs::read_to_string(first.join(&list)).unwrap();
        for line in fs::read_to_string(second.join(&list)).unwrap().lines() {
            if let Some((secs, file)) = line.split_once(' ').filter(|_| !line.starts_with('#')) {
                let secs = secs.parse::<f64>().unwrap() + FIRST as f64 / 30.0;
                let name = format!("{kind}/second-{secs:.6}.png");
                fs::copy(second.join(file), first.join(&name)).unwrap();
                all += &format!("{secs:.6} {name}\n");
            }
        }
        fs::write(first.join(&list), all).unwrap();
    }
    plan_in(folder)
}

#[test]
fn what_nothing_connects_is_saved_apart() {
    let (_folder, plan) = two_rooms();
    let result = run(&plan).unwrap();
    let metrics = &result.metrics;
    let frames = |submap| {
        let rows = result.rows.iter();
        rows.filter(|row| row.submap == Some(submap)).count()
    };
    assert_eq!(metrics.further_submaps, 1);
    assert!(metrics.frames_elsewhere == frames(1) && frames(0) > 0 && frames(1) > 0);
    assert_eq!(metrics.frames, frames(0) + frames(1) + metrics.frames_lost);
    let folder = plan.folder.path();
    for (submap, poses, map) in [(0, TRAJECTORY, MAP), (1, "trajectory_1.txt", "map_1.ply")] {
        let trajectory = fgs_data::Trajectory::read(&folder.join(poses)).unwrap();
        assert_eq!(trajectory.poses().len(), frames(submap), "{poses}");
        let near = |mean: &[f32; 3]| mean.iter().all(|value| value.abs() < 20.0);
        let map = fgs_splat::read_ply(&folder.join(map)).unwrap();
        assert!(!map.is_empty() && map.means.iter().all(near));
    }
    // Only the largest is scored, and only it has pictures.
    let scored = |row: &FrameRow| row.scores.get("psnr_db").is_some();
    assert!((result.rows.iter()).all(|row| scored(row) == (row.submap == Some(0))));
    assert!(metrics.table().contains("sub-maps   1 more, with "));
    let run_folder = RunFolder::open(folder).unwrap();
    assert!(run_folder.holds_result(&folder.join("map_1.ply")));
    assert!(!run_folder.holds_result(&folder.join("map_2.ply")));
}
