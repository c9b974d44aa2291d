//! A mapper that fails, panics or is slow: the session ends or waits, and nothing is lost.

#![allow(clippy::unwrap_used)]

mod common;

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use common::{config, feed, room, session_with};
use fgs_geom::{FrameIndex, Image, KeyframeId, RgbdFrame, Se3, View};
use fgs_slam::{Execution, MapperError, SlamOutput, model_settings};
use fgs_splat::{
    CpuModel, GaussianModel, Gaussians, GpuError, ModelError, PruneRule, Rendered, SavedModel,
    Seeds, SparseId, StepStats, Target,
};
use fgs_synth::Sequence;

/// A model that is slow, and fails or panics after some calls.
struct BadModel {
    model: CpuModel,
    step_takes: Duration,
    steps_left: usize,
    inserts_left: usize,
    panics: bool,
    failed: Arc<OnceLock<Instant>>,
}

impl BadModel {
    fn new() -> Self {
        Self {
            model: CpuModel::new(model_settings(&config().mapping)),
            step_takes: Duration::ZERO,
            steps_left: usize::MAX,
            inserts_left: usize::MAX,
            panics: false,
            failed: Arc::default(),
        }
    }

    fn fail(&self) -> ModelError {
        assert!(!self.panics, "a model that panics");
        self.failed.set(Instant::now()).unwrap();
        GpuError::Lost("unplugged".into()).into()
    }
}

impl GaussianModel for BadModel {
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
    fn remove(&mut self, indices: &[usize]) -> Result<(), ModelError> {
        self.model.remove(indices)
    }
    fn make_room(&mut self, added: usize, max: usize) -> Result<(), ModelError> {
        self.model.make_room(added, max)
    }
    fn fade_contradicted(&mut self, view: &View, depth_m: &Image<f32>) -> Result<(), ModelError> {
        self.model.fade_contradicted(view, depth_m)
    }
    fn render(&mut self, view: &View) -> Result<Rendered, ModelError> {
        self.model.render(view)
    }
    fn see_through(&mut self, view: &View, min_alpha: f32) -> Result<Image<bool>, ModelError> {
        self.model.see_through(view, min_alpha)
    }
    fn match_exposure(&mut self, id: KeyframeId) -> Result<(), ModelError> {
        self.model.match_exposure(id)
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
    fn save(&mut self) -> Result<SavedModel, ModelError> {
        self.model.save()
    }
    fn restore(&mut self, saved: SavedModel, targets: Vec<Target>) -> Result<(), ModelError> {
        self.model.restore(saved, targets)
    }
    fn into_gaussians(self: Box<Self>) -> Gaussians {
        Box::new(self.model).into_gaussians()
    }
}

fn go_badly(
    input: impl Iterator<Item = RgbdFrame>,
    sequence: &Sequence,
    execution: Execution,
    model: BadModel,
) -> SlamOutput {
    let mut slam = session_with(sequence, execution, Box::new(model));
    feed(&mut slam, execution, input.map(Ok));
    slam.finish()
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
    for execution in Execution::ALL {
        for (steps_left, inserts_left) in [(6, usize::MAX), (usize::MAX, 1)] {
            let failed = Arc::new(OnceLock::new());
            let model = BadModel {
                steps_left,
                inserts_left,
                failed: Arc::clone(&failed),
                ..BadModel::new()
            };
            let frames = endless_frames(&sequence);
            let output = go_badly(frames, &sequence, execution, model);
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
    for execution in Execution::ALL {
        let failed = Arc::new(OnceLock::new());
        let model = BadModel {
            inserts_left: 1,
            failed: Arc::clone(&failed),
            ..BadModel::new()
        };
        let frames = sequence.frames();
        let output = go_badly(frames, &sequence, execution, model);
        assert!(output.failure.is_some(), "{execution:?}");
        assert_eq!(output.frames.len(), 5);
        assert!(output.gaussians.len() > 100, "{execution:?}");
    }
}

/// Five frames take ten steps, and three more are taken before the model fails or panics.
#[test]
fn a_mapper_that_fails_while_it_refines_leaves_both_maps() {
    let sequence = room(5);
    for execution in [Execution::Lockstep, Execution::Parallel] {
        for panics in [false, true] {
            let model = BadModel {
                steps_left: 13,
                panics,
                ..BadModel::new()
            };
            let mut slam = session_with(&sequence, execution, Box::new(model));
            feed(&mut slam, execution, sequence.frames().map(Ok));
            let output = slam.finish_refined(100, &AtomicBool::new(false));
            assert!(output.failure.is_some(), "{execution:?}");
            assert_eq!((output.frames.len(), output.timings.steps), (5, 10));
            let refined = output.refined.unwrap();
            assert_eq!(refined.steps, 3, "{execution:?}");
            assert!(refined.gaussians.len() > 100 && output.gaussians.len() > 100);
        }
    }
}

#[test]
fn a_mapper_that_panics_ends_the_run_and_what_there_was_is_kept() {
    let sequence = room(20);
    for execution in Execution::ALL {
        let model = BadModel {
            steps_left: 6,
            panics: true,
            ..BadModel::new()
        };
        let frames = endless_frames(&sequence);
        let start = Instant::now();
        let output = go_badly(frames, &sequence, execution, model);
        assert!(start.elapsed() <= Duration::from_secs(20), "{execution:?}");
        let failure = output.failure.unwrap();
        assert!(
            matches!(&failure, MapperError::Panicked(text) if text == "a model that panics"),
            "{execution:?}: {failure:?}"
        );
        assert!(output.frames[0].world_from_camera.is_some());
        assert!(output.gaussians.len() > 100, "{execution:?}");
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
    let output = go_badly(sequence.frames(), &sequence, execution, model);
    assert_eq!((output.frames.len(), output.timings.steps), (25, 50));
}
