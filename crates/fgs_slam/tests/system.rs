//! The whole system on synthetic rooms: accuracy, repeatability, shutdown, and losing the camera or
//! the mapper.

#![allow(clippy::unwrap_used)]

mod common;

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use common::{Frames, config, frames, psnr_of_map_db, room, worst_position_error_m};
use fgs_geom::{Camera, FrameIndex, Image, KeyframeId, RgbdFrame, Se3, View};
use fgs_slam::{
    Execution, MapperError, Observer, SlamError, SlamEvent, SlamOutput, TrackingStatus,
    model_settings, run,
};
use fgs_splat::{
    CpuModel, GaussianModel, Gaussians, GpuError, ModelError, PruneRule, Rendered, Seeds, SparseId,
    StepStats, Target,
};
use fgs_synth::Sequence;

const EVERY_MODE: [Execution; 3] = [
    Execution::Lockstep,
    Execution::Parallel,
    Execution::Realtime,
];

fn go(frames: Frames, camera: &Camera, execution: Execution) -> Result<SlamOutput, SlamError> {
    go_observed(frames, camera, execution, &mut ())
}

fn go_observed(
    frames: Frames,
    camera: &Camera,
    execution: Execution,
    observer: &mut dyn Observer,
) -> Result<SlamOutput, SlamError> {
    let config = config();
    let model = CpuModel::new(model_settings(&config.mapping));
    let stop = AtomicBool::new(false);
    run(
        frames.into_iter(),
        camera,
        &config,
        execution,
        model,
        observer,
        &stop,
    )
}

/// Makes each frame's tracking take at least so long.
struct Slow(Duration);

impl Observer for Slow {
    fn on(&mut self, event: &SlamEvent<'_>) {
        if matches!(event, SlamEvent::Frame { .. }) {
            std::thread::sleep(self.0);
        }
    }
}

fn go_on(threads: usize, sequence: &Sequence) -> SlamOutput {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
    pool.build()
        .unwrap()
        .install(|| go(frames(sequence), sequence.camera(), Execution::Lockstep).unwrap())
}

#[test]
fn tracks_and_maps_a_room_in_every_mode() {
    let sequence = room(40);
    let moved = (sequence.world_from_camera(39).translation
        - sequence.world_from_camera(0).translation)
        .norm();
    for execution in [Execution::Lockstep, Execution::Parallel] {
        let output = go(frames(&sequence), sequence.camera(), execution).unwrap();
        assert_eq!(output.frames.len(), 40);
        assert_eq!(output.timings.steps, 80);
        let error_m = worst_position_error_m(&output, &sequence);
        assert!(
            error_m <= moved / 50.0,
            "{execution:?}: {error_m} m of {moved} m"
        );
        assert!(output.gaussians.len() >= 1000);

        let psnr = psnr_of_map_db(&output, &sequence, 20);
        assert!(psnr >= 24.0, "{execution:?}: {psnr} dB");
    }
}

/// At the recording's own pace, or dropping what comes too late.
#[test]
fn realtime_ends_and_counts_every_frame() {
    let sequence = room(30);
    let output = go(frames(&sequence), sequence.camera(), Execution::Realtime).unwrap();
    assert_eq!(output.frames.len() + output.frames_dropped, 30);
    assert!(!output.gaussians.is_empty());
    assert!(output.timings.total >= Duration::from_secs_f64(29.0 / 30.0));
}

/// A tracker that takes longer than frames take to come.
#[test]
fn realtime_drops_what_has_waited_too_long_and_tracks_the_rest() {
    let sequence = room(30);
    let output = go_observed(
        frames(&sequence),
        sequence.camera(),
        Execution::Realtime,
        &mut Slow(Duration::from_millis(60)),
    )
    .unwrap();
    // The second frame is some 30 ms late when its turn comes, and not dropped for that.
    assert!(output.frames[1].index.0 == 1 && output.frames_dropped >= 10);
    assert_eq!(output.frames.len() + output.frames_dropped, 30);
}

#[test]
fn lockstep_repeats_itself_on_any_number_of_threads() {
    let sequence = room(16);
    let first = go_on(1, &sequence);
    for threads in [1, 8] {
        let again = go_on(threads, &sequence);
        assert!(first.gaussians == again.gaussians, "{threads} threads");
        let poses = |output: &SlamOutput| -> Vec<_> {
            output
                .frames
                .iter()
                .map(|frame| frame.world_from_camera)
                .collect()
        };
        assert_eq!(poses(&first), poses(&again), "{threads} threads");
    }
}

fn statuses(output: &SlamOutput) -> String {
    let letter = |status| match status {
        TrackingStatus::Tracked => 'T',
        TrackingStatus::Lost => 'L',
    };
    output
        .frames
        .iter()
        .map(|frame| letter(frame.status))
        .collect()
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
        let output = go(input, sequence.camera(), Execution::Lockstep).unwrap();
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
    let output = go(input, sequence.camera(), Execution::Lockstep).unwrap();
    assert_eq!(statuses(&output), "LTTTTT");
}

#[test]
fn repeated_frames_stand_still() {
    let sequence = room(1);
    let input: Frames = (0..5).map(|_| Ok(sequence.frame(0))).collect();
    let output = go(input, sequence.camera(), Execution::Lockstep).unwrap();
    assert_eq!(statuses(&output), "TTTTT");
    assert!(worst_position_error_m(&output, &sequence) <= 1e-6);
}

#[test]
fn damaged_frames_are_skipped_and_counted() {
    let sequence = room(8);
    let mut input = frames(&sequence);
    input[3] = Err(std::io::Error::other("a torn file"));
    let output = go(input, sequence.camera(), Execution::Lockstep).unwrap();
    assert_eq!((output.frames.len(), output.frames_damaged), (7, 1));
    assert_eq!(statuses(&output), "TTTTTTT");
}

#[test]
fn no_frames_give_an_empty_map() {
    let camera = *room(1).camera();
    for execution in EVERY_MODE {
        let output = go(Vec::new(), &camera, execution).unwrap();
        assert!(output.frames.is_empty() && output.gaussians.is_empty());
    }
}

/// Stops a run after some frames.
struct StopAfter<'a> {
    left: usize,
    stop: &'a AtomicBool,
}

impl Observer for StopAfter<'_> {
    fn on(&mut self, event: &SlamEvent<'_>) {
        if matches!(event, SlamEvent::Frame { .. }) {
            self.left -= 1;
            self.stop.store(self.left == 0, Ordering::Relaxed);
        }
    }
}

#[test]
fn a_stopped_run_keeps_what_it_has() {
    let sequence = room(30);
    for execution in EVERY_MODE {
        let config = config();
        let stop = AtomicBool::new(false);
        let mut observer = StopAfter {
            left: 4,
            stop: &stop,
        };
        let model = CpuModel::new(model_settings(&config.mapping));
        // Slowly, so that a busy machine drops none in real time either.
        let mut input = frames(&sequence);
        for frame in input.iter_mut().flatten() {
            frame.timestamp_secs *= 5.0;
        }
        let output = run(
            input.into_iter(),
            sequence.camera(),
            &config,
            execution,
            model,
            &mut observer,
            &stop,
        )
        .unwrap();
        assert_eq!(output.frames.len(), 4, "{execution:?}");
        assert!(!output.gaussians.is_empty(), "{execution:?}");
    }
}

/// A model that is slow, and fails or panics after some calls.
struct BadModel<'a> {
    model: CpuModel,
    step_takes: Duration,
    steps_left: usize,
    inserts_left: usize,
    panics: bool,
    failed: Option<&'a OnceLock<Instant>>,
}

impl BadModel<'_> {
    fn new() -> Self {
        Self {
            model: CpuModel::new(model_settings(&config().mapping)),
            step_takes: Duration::ZERO,
            steps_left: usize::MAX,
            inserts_left: usize::MAX,
            panics: false,
            failed: None,
        }
    }

    fn fail(&self) -> ModelError {
        assert!(!self.panics, "a model that panics");
        self.failed.unwrap().set(Instant::now()).unwrap();
        GpuError::Lost("unplugged".into()).into()
    }
}

impl GaussianModel for BadModel<'_> {
    fn len(&self) -> usize {
        self.model.len()
    }
    fn add_view(&mut self, id: KeyframeId, view: View, target: Target) -> Result<(), ModelError> {
        self.model.add_view(id, view, target)
    }
    fn drop_view(&mut self, id: KeyframeId) -> Result<(), ModelError> {
        self.model.drop_view(id)
    }
    fn insert(&mut self, seeds: &Seeds, anchor: KeyframeId) -> Result<(), ModelError> {
        let left = self.inserts_left.checked_sub(1);
        self.inserts_left = left.ok_or_else(|| self.fail())?;
        self.model.insert(seeds, anchor)
    }
    fn move_anchored(&mut self, moves: &[(KeyframeId, Se3)]) -> Result<(), ModelError> {
        self.model.move_anchored(moves)
    }
    fn prune(&mut self, rule: &PruneRule) -> Result<(), ModelError> {
        self.model.prune(rule)
    }
    fn render(&mut self, view: &View) -> Result<Rendered, ModelError> {
        self.model.render(view)
    }
    fn see_through(&mut self, view: &View, min_alpha: f32) -> Result<Image<bool>, ModelError> {
        self.model.see_through(view, min_alpha)
    }
    fn step(&mut self, id: KeyframeId) -> Result<(), ModelError> {
        std::thread::sleep(self.step_takes);
        let left = self.steps_left.checked_sub(1);
        self.steps_left = left.ok_or_else(|| self.fail())?;
        self.model.step(id)
    }
    fn take_stats(&mut self) -> Vec<StepStats> {
        self.model.take_stats()
    }
    fn covisibility(&mut self, id: KeyframeId) -> Result<Vec<(KeyframeId, f32)>, ModelError> {
        self.model.covisibility(id)
    }
    fn take_removed(&mut self) -> Result<Vec<SparseId>, ModelError> {
        self.model.take_removed()
    }
    fn gaussians(&mut self) -> Result<Gaussians, ModelError> {
        self.model.gaussians()
    }
    fn into_gaussians(self: Box<Self>) -> Gaussians {
        Box::new(self.model).into_gaussians()
    }
}

fn go_badly(
    input: impl Iterator<Item = RgbdFrame>,
    camera: &Camera,
    execution: Execution,
    model: BadModel<'_>,
) -> Result<SlamOutput, SlamError> {
    let frames = input.map(Ok::<_, std::io::Error>);
    let stop = AtomicBool::new(false);
    run(frames, camera, &config(), execution, model, &mut (), &stop)
}

/// Forth and back without end: a run must not wait for the end of its frames.
fn endless_frames(sequence: &Sequence) -> impl Iterator<Item = RgbdFrame> {
    let last = sequence.len() - 1;
    (0..).map(move |i| {
        let mut frame = sequence.frame(last.abs_diff(i % (2 * last)));
        frame.index = FrameIndex(i);
        frame.timestamp_secs = i as f64 / 30.0;
        frame
    })
}

#[test]
fn a_mapper_that_fails_ends_the_run_and_what_there_was_is_kept() {
    let sequence = room(20);
    for execution in EVERY_MODE {
        for (steps_left, inserts_left) in [(6, usize::MAX), (usize::MAX, 1)] {
            let failed = OnceLock::new();
            let model = BadModel {
                steps_left,
                inserts_left,
                failed: Some(&failed),
                ..BadModel::new()
            };
            let frames = endless_frames(&sequence);
            let output = go_badly(frames, sequence.camera(), execution, model).unwrap();
            let took = failed.get().unwrap().elapsed();
            assert!(took <= Duration::from_secs(1), "{execution:?}: {took:?}");
            let failure = output.failure.unwrap();
            assert!(matches!(failure, MapperError::Model(ModelError::Device(_))));
            assert_eq!(
                failure.to_string(),
                "the graphics device was lost: unplugged"
            );
            assert!(output.keyframes[0].index == FrameIndex(0) && output.gaussians.len() > 100);
            if steps_left == 6 {
                assert_eq!(output.timings.steps, 6, "{execution:?}");
            }
            // Two steps a frame; the tracking keyframe after the first comes when it must.
            match (execution, inserts_left) {
                (Execution::Lockstep, usize::MAX) => assert_eq!(output.frames.len(), 4),
                (Execution::Lockstep, _) => {
                    assert_eq!(
                        output.frames.last().unwrap().index,
                        output.keyframes[1].index
                    );
                }
                _ => assert!(!output.frames.is_empty()),
            }
        }
    }
}

#[test]
fn a_mapper_that_fails_at_the_closing_keyframe_costs_only_that() {
    let sequence = room(5);
    for execution in EVERY_MODE {
        let failed = OnceLock::new();
        let model = BadModel {
            inserts_left: 1,
            failed: Some(&failed),
            ..BadModel::new()
        };
        let frames = sequence.frames();
        let output = go_badly(frames, sequence.camera(), execution, model).unwrap();
        assert!(output.failure.is_some(), "{execution:?}");
        assert_eq!(output.frames.len() + output.frames_dropped, 5);
        assert!(output.gaussians.len() > 100, "{execution:?}");
    }
}

/// In lockstep there is no other thread whose panic could go unnoticed.
#[test]
fn a_mapper_that_panics_ends_the_run() {
    let sequence = room(20);
    for execution in [Execution::Parallel, Execution::Realtime] {
        let model = BadModel {
            steps_left: 6,
            panics: true,
            ..BadModel::new()
        };
        let frames = endless_frames(&sequence);
        let start = Instant::now();
        let result = go_badly(frames, sequence.camera(), execution, model);
        assert!(
            matches!(result, Err(SlamError::MapperPanicked)),
            "{execution:?}: {result:?}"
        );
        assert!(start.elapsed() <= Duration::from_secs(20), "{execution:?}");
    }
}

#[test]
fn a_slow_mapper_delays_but_loses_nothing() {
    let sequence = room(25);
    let model = BadModel {
        step_takes: Duration::from_millis(5),
        ..BadModel::new()
    };
    let execution = Execution::Parallel;
    let output = go_badly(sequence.frames(), sequence.camera(), execution, model).unwrap();
    assert_eq!((output.frames.len(), output.timings.steps), (25, 50));
}

#[test]
fn a_slow_tracker_is_waited_for() {
    let sequence = room(10);
    let output = go_observed(
        frames(&sequence),
        sequence.camera(),
        Execution::Parallel,
        &mut Slow(Duration::from_millis(20)),
    )
    .unwrap();
    assert_eq!((output.frames.len(), output.timings.steps), (10, 20));
}

#[test]
fn impossible_settings_are_refused() {
    let sequence = room(1);
    let mut config = config();
    config.mapping.prune_every = 0;
    let result = run(
        frames(&sequence).into_iter(),
        sequence.camera(),
        &config,
        Execution::Lockstep,
        CpuModel::default(),
        &mut (),
        &AtomicBool::new(false),
    );
    assert!(matches!(result, Err(SlamError::Config(error)) if error.key == "mapping.prune_every"));
}
