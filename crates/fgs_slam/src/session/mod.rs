//! A session: frames in, one by one; poses, events and a map out. Everything that runs the system
//! drives this one type.

mod closing;
mod error;
mod output;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use fgs_geom::{Camera, FrameIndex, KeyframeId, RgbdFrame, Se3};
use fgs_graph::KeyframeGraph;
use fgs_splat::{GaussianModel, Gaussians, Target};
use rayon::ThreadPool;

use crate::config::SlamConfig;
use crate::event::{EventHub, SlamEvent, Subscription};
use crate::frame_result::{FrameResult, FrameStatus};
use crate::holdout::Holdout;
use crate::keyframes::{Admission, FrameWork, Keyframe, KeyframeKind};
use crate::loops::{LoopCloser, seen_by_both, successive_edge};
use crate::refinement::RefinedMap;
use crate::saved_session::{RecordedFrame, SavedSession};
use crate::separation::Separation;
use crate::submaps::Submaps;
use crate::system::{self, Correcting, Execution, MapStatus, Mapping, Moves};
use crate::tracker::Tracker;
use crate::verdict::Verdict;

pub use error::SlamError;
pub use output::{FurtherMap, KeyframeRecord, SlamOutput, Timings};

/// Follows a camera and maps what it sees.
///
/// [`push`](Self::push) each frame, [`finish`](Self::finish) at the end. [`drive`](crate::drive),
/// [`replay`](crate::replay) and [`live`](crate::live) do so for a recording or a camera.
pub struct Slam {
    camera: Camera,
    tracker: Tracker,
    /// The tracker's own threads, if it has any.
    tracker_threads: Option<ThreadPool>,
    mapping: Box<dyn Mapping>,
    map: Arc<MapStatus>,
    events: EventHub,
    /// The one owner of keyframe poses.
    graph: KeyframeGraph,
    submaps: Submaps,
    closes_loops: bool,
    loops: LoopCloser,
    correcting: Correcting,
    closed_loops: usize,
    keyframes: Vec<(KeyframeId, KeyframeKind, FrameIndex)>,
    frames: Vec<RecordedFrame>,
    first: FrameIndex,
    holdout: Option<Holdout>,
    /// Whether no frame becomes a keyframe.
    localizes_only: bool,
    /// Keyframes' images that nobody has taken yet; `None` if nobody wants them.
    new_keyframes: Option<Vec<(KeyframeId, Arc<RgbdFrame>)>>,
    start: Instant,
    /// Wall time before `start`, in sessions that this one goes on with.
    elapsed: Duration,
}

impl Slam {
    /// A session of frames of one camera, with an empty map. The model must be empty; it is made
    /// with [`model_settings`](crate::model_settings).
    ///
    /// # Errors
    /// If a setting is impossible or threads do not start.
    pub fn new(
        camera: &Camera,
        config: &SlamConfig,
        execution: Execution,
        model: Box<dyn GaussianModel>,
    ) -> Result<Self, SlamError> {
        let nothing = SavedSession::new(camera, config.seed);
        Self::restore(config, execution, model, nothing, |_| {
            Err(SlamError::Inconsistent)
        })
    }

    /// Goes on with a saved session as if it had never ended: in lockstep with the same settings and
    /// the same kind of model to the last bit. The model must be empty. `image_of` gives a keyframe's
    /// images, as [`take_new_keyframes`](Self::take_new_keyframes) did; it is asked for each of
    /// [`SavedSession::keyframes`] once, in their order, and none is kept that the session does not
    /// optimise the map with.
    ///
    /// # Errors
    /// Whatever `image_of` returns; if a setting is impossible, threads do not start, or what was saved
    /// contradicts itself.
    pub fn restore<E: From<SlamError>>(
        config: &SlamConfig,
        execution: Execution,
        model: Box<dyn GaussianModel>,
        saved: SavedSession,
        mut image_of: impl FnMut(KeyframeId) -> Result<RgbdFrame, E>,
    ) -> Result<Self, E> {
        config.validate().map_err(SlamError::from)?;
        if !saved.is_consistent() {
            return Err(SlamError::Inconsistent.into());
        }
        let camera = saved.camera;
        let mut tracker = Tracker::restored(&camera, config, saved.tracker);
        let views: BTreeSet<KeyframeId> = saved.mapping.views().collect();
        let mut targets = Vec::new();
        let mut color_valid = None;
        for ((id, kind, _), (_, pose)) in saved.keyframes.iter().zip(saved.graph.poses()) {
            let mut frame = image_of(*id)?;
            // Frames of one recording share the mask, if the lens alone makes it.
            if frame.color_valid == color_valid {
                frame.color_valid = color_valid;
            }
            color_valid = frame.color_valid.clone();
            let frame = Arc::new(frame);
            if frame.camera != camera || frame.check().is_err() {
                return Err(SlamError::Inconsistent.into());
            }
            if views.contains(id) {
                targets.push(Target::from_frame(&frame).map_err(SlamError::from)?);
            }
            tracker.remember(&Keyframe {
                id: *id,
                kind: *kind,
                frame,
                world_from_camera: *pose,
                previous: None,
                information: None,
                new_points: Vec::new(),
            });
        }
        let ready = saved.mapping.put_into(model, targets);
        let (map, events) = (
            Arc::new(MapStatus::restored(saved.report)),
            EventHub::default(),
        );
        let (mapping, tracker_threads) = system::start(
            &camera,
            config,
            execution,
            ready.map_err(SlamError::from)?,
            &map,
            &events,
        )
        .map_err(SlamError::from)?;
        Ok(Self {
            camera,
            tracker,
            tracker_threads,
            mapping,
            map,
            events,
            graph: saved.graph,
            submaps: saved.submaps,
            closes_loops: config.loops.enabled,
            loops: saved.loops,
            correcting: Correcting::new(execution),
            closed_loops: saved.closed_loops,
            keyframes: saved.keyframes,
            frames: saved.frames,
            first: saved.first,
            holdout: saved.holdout,
            localizes_only: saved.localizes_only,
            new_keyframes: None,
            start: Instant::now(),
            elapsed: saved.elapsed,
        })
    }

    /// From now on keyframes' images are kept until they are [taken](Self::take_new_keyframes), for
    /// whoever wants to [save](Self::save) the session.
    pub fn keep_new_keyframes(&mut self) {
        self.new_keyframes.get_or_insert_default();
    }

    /// The keyframes since the last call, with their images, as
    /// [`keep_new_keyframes`](Self::keep_new_keyframes) asked for them.
    pub fn take_new_keyframes(&mut self) -> Vec<(KeyframeId, Arc<RgbdFrame>)> {
        let new = self.new_keyframes.as_mut().map(std::mem::take);
        new.unwrap_or_default()
    }

    /// All that the session knows between two frames, to be [restored](Self::restore) some day. The
    /// mapper first does what it was given.
    ///
    /// # Errors
    /// If the mapper has stopped.
    pub fn save(&mut self) -> Result<SavedSession, SlamError> {
        self.await_correction()?;
        let mapping = self.mapping.save()?;
        Ok(SavedSession {
            camera: self.camera,
            tracker: self.tracker.save(),
            mapping,
            report: self.map.save(),
            graph: self.graph.clone(),
            submaps: self.submaps.clone(),
            loops: self.loops.clone(),
            closed_loops: self.closed_loops,
            keyframes: self.keyframes.clone(),
            frames: self.frames.clone(),
            first: self.first,
            holdout: self.holdout,
            localizes_only: self.localizes_only,
            elapsed: self.elapsed + self.start.elapsed(),
        })
    }

    /// The number of the first frame, for recordings that are not taken from their beginning: frames
    /// that cannot be read are numbered on from it.
    pub fn start_at(&mut self, first: FrameIndex) {
        self.first = first;
    }

    /// Keeps frames out of the map, to judge it by: they are tracked like any other, but do not become
    /// keyframes; where one would have, the next does. They are counted from the number of the first
    /// frame ([`start_at`](Self::start_at)).
    pub fn hold_out(&mut self, holdout: Holdout) {
        self.holdout = Some(holdout);
    }

    /// A queue of up to `capacity` events. When it is full, events are missed and counted; the
    /// session never waits. The map, images and masks come only where [`Subscription`]'s requests ask
    /// for them, one for each request.
    pub fn subscribe(&self, capacity: usize) -> Subscription {
        self.events.subscribe(capacity)
    }

    /// Tracks a frame and lets the mapper have its turn.
    ///
    /// # Errors
    /// If the frame is damaged or of another camera (it is recorded as such), or the mapper has
    /// stopped.
    pub fn push(&mut self, frame: RgbdFrame) -> Result<FrameResult, SlamError> {
        if let Err(error) = self.check(&frame) {
            self.record_untracked(frame.index, FrameStatus::Damaged, Some(error.to_string()));
            return Err(error);
        }
        let frame = Arc::new(frame);
        self.tracker.remove_points(&self.map.take_removed());
        self.take_moves();
        self.take_correction()?;
        take_aligned(&self.map, &mut self.frames);
        let admission = self.admission(frame.index);
        let tracker = &mut self.tracker;
        let tracked = match &self.tracker_threads {
            Some(threads) => threads.install(|| tracker.track(&frame, admission)),
            None => tracker.track(&frame, admission),
        };
        let keyframe = match &tracked.work {
            Some(FrameWork::Keyframe(keyframe)) => {
                self.add_keyframe(keyframe);
                Some((keyframe.id, keyframe.kind, Arc::clone(&keyframe.frame)))
            }
            _ => None,
        };
        let result = FrameResult {
            index: frame.index,
            timestamp_secs: Some(frame.timestamp_secs),
            status: match tracked.verdict {
                Verdict::Tracked => FrameStatus::Tracked,
                Verdict::Weak => FrameStatus::Weak,
                Verdict::Lost => FrameStatus::Lost,
            },
            world_from_camera: tracked.world_from_camera,
            submap: self.submap_of(tracked.world_from_camera.as_ref()),
            keyframe: keyframe.as_ref().map(|(id, kind, _)| (*id, *kind)),
            tracking: Some(tracked.quality),
        };
        self.record(result.clone(), None);
        self.events.publish_images(&frame);
        self.mapping.after_frame(tracked.work)?;
        if let Some((id, _, frame)) = keyframe
            && self.closes_loops
        {
            self.find_loop(id, &frame)?;
        }
        Ok(result)
    }

    /// Records that the next frame could not be read.
    pub fn skip_damaged(&mut self, error: &str) {
        self.record_untracked(self.next_index(), FrameStatus::Damaged, Some(error.into()));
    }

    /// Records that a frame came too late to be tracked.
    pub fn skip_late(&mut self, frame: &RgbdFrame) {
        self.record_untracked(frame.index, FrameStatus::Dropped, None);
    }

    /// Records that the next frame was dropped before it was read.
    pub(crate) fn skip_overflowed(&mut self) {
        self.record_untracked(self.next_index(), FrameStatus::Dropped, None);
    }

    /// A copy of the map with all keyframes so far. The mapper goes on meanwhile.
    ///
    /// # Errors
    /// If the mapper has stopped.
    pub fn snapshot(&mut self) -> Result<Gaussians, SlamError> {
        Ok(self.mapping.snapshot()?)
    }

    /// Moves keyframes, each by its `new_world_from_old_world`, and with them the poses of their
    /// frames, the map, the tracker and its motion.
    ///
    /// # Errors
    /// If a keyframe is unknown (nothing has moved then) or the mapper has stopped.
    pub fn move_keyframes(&mut self, moves: &[(KeyframeId, Se3)]) -> Result<(), SlamError> {
        self.await_correction()?;
        if let Some((id, _)) = moves.iter().find(|(id, _)| self.graph.pose(*id).is_none()) {
            return Err(SlamError::NoSuchKeyframe(*id));
        }
        self.apply(moves)
    }

    /// Moves known keyframes and all that hangs on them.
    fn apply(&mut self, moves: &[(KeyframeId, Se3)]) -> Result<(), SlamError> {
        self.graph.move_keyframes(moves);
        self.tracker.move_keyframes(moves);
        self.mapping.move_keyframes(&Moves::from(moves))?;
        publish_correction(&self.events, &self.graph, moves);
        Ok(())
    }

    /// The keyframes' poses and how they hang together.
    pub fn graph(&self) -> &KeyframeGraph {
        &self.graph
    }

    /// Whether the mapper has stopped, so that there is no more to do than to finish.
    pub fn has_stopped(&self) -> bool {
        !self.wait_until(Instant::now())
    }

    /// What the mapper tells, and hears.
    pub(crate) fn map_status(&self) -> Arc<MapStatus> {
        Arc::clone(&self.map)
    }

    /// Waits until a time; `false` as soon as the mapper is gone.
    pub(crate) fn wait_until(&self, time: Instant) -> bool {
        self.mapping.wait_until(time).is_ok()
    }

    /// Ends the session. The last tracked frame becomes a keyframe, so that the map reaches as far as
    /// the camera did. Whatever the mapper's fate, everything so far is returned.
    pub fn finish(self) -> SlamOutput {
        self.finish_refined(0, &AtomicBool::new(false))
    }

    /// Ends the session as [`finish`](Self::finish) does, then optimises a copy of its map by `steps`
    /// further steps, or until `stop` is set. They go to all keyframes that are in memory (see
    /// [`MappingConfig::max_keyframes`](crate::MappingConfig::max_keyframes)), drawn at random, to each
    /// equally often up to one.
    pub fn finish_refined(mut self, steps: usize, stop: &AtomicBool) -> SlamOutput {
        // If the mapper has stopped, the output says why.
        let _ = self.await_correction();
        let closing = self.tracker.finish();
        if let Some(keyframe) = &closing {
            self.add_keyframe(keyframe);
            let mut frames = self.frames.iter_mut().rev();
            if let Some(frame) = frames.find(|frame| frame.result.index == keyframe.frame.index) {
                frame.result.keyframe = Some((keyframe.id, keyframe.kind));
            }
        }
        let mapped = self.mapping.finish(closing, steps, stop);
        let refining = mapped.refined.as_ref().map(|refined| refined.duration);
        let elapsed = self.elapsed + self.start.elapsed();
        take_moved(&self.map, &mut self.graph, &mut self.tracker, &self.events);
        take_aligned(&self.map, &mut self.frames);
        self.events.close();
        let separation = Separation::new(&self.submaps, &self.graph);
        let maps = separation.maps(mapped.gaussians, &self.graph);
        let (refined_maps, refined) = match mapped.refined {
            Some(refined) => {
                let maps = separation.maps(refined.gaussians, &self.graph);
                (maps, Some((refined.steps, refined.duration)))
            }
            None => (Vec::new(), None),
        };
        let (mut maps, mut refined_maps) = (maps.into_iter(), refined_maps.into_iter());
        let gaussians = maps.next().unwrap_or_default();
        let refined = refined.map(|(steps, duration)| RefinedMap {
            gaussians: refined_maps.next().unwrap_or_default(),
            steps,
            duration,
        });
        let further = maps.map(|gaussians| FurtherMap {
            gaussians,
            refined: refined_maps.next(),
        });
        let further = further.collect();
        let graph = separation.graph(self.graph);
        let pose = |id| graph.pose(id).copied().unwrap_or_else(Se3::identity);
        SlamOutput {
            frames: self
                .frames
                .into_iter()
                .map(|frame| FrameResult {
                    world_from_camera: frame.pose.map(|(keyframe, keyframe_from_camera)| {
                        pose(keyframe) * keyframe_from_camera
                    }),
                    submap: (frame.pose).and_then(|(keyframe, _)| separation.number_of(keyframe)),
                    ..frame.result
                })
                .collect(),
            keyframes: self
                .keyframes
                .into_iter()
                .map(|(id, kind, index)| KeyframeRecord {
                    id,
                    index,
                    kind,
                    submap: separation.number_of(id).unwrap_or_default(),
                    world_from_camera: pose(id),
                })
                .collect(),
            loops: self.closed_loops,
            gaussians,
            refined,
            further,
            device_bytes: mapped.device_bytes,
            timings: Timings {
                total: elapsed.saturating_sub(refining.unwrap_or_default()),
                mapping: mapped.busy,
                steps: mapped.steps,
            },
            failure: mapped.failure,
            graph,
        }
    }

    fn check(&self, frame: &RgbdFrame) -> Result<(), SlamError> {
        if frame.camera != self.camera {
            return Err(SlamError::OtherCamera {
                index: frame.index,
                frame: Box::new(frame.camera),
                session: Box::new(self.camera),
            });
        }
        Ok(frame.check()?)
    }

    fn admission(&self, index: FrameIndex) -> Admission {
        let place = index.0.saturating_sub(self.first.0);
        if self.localizes_only || self.holdout.is_some_and(|holdout| holdout.contains(place)) {
            Admission::HeldOut
        } else if self.mapping.accepts_keyframe() {
            Admission::Allowed
        } else {
            Admission::PutOff
        }
    }

    /// The sub-map of a frame that has a pose.
    fn submap_of(&self, pose: Option<&Se3>) -> Option<usize> {
        pose.and_then(|_| self.submaps.of(self.tracker.home()?))
    }

    /// Puts a keyframe into the graph, with an edge from the one that it was tracked from. Its pose comes
    /// from the map around both, so the edge is as sure as the registration.
    fn add_keyframe(&mut self, keyframe: &Keyframe) {
        let pose = keyframe.world_from_camera;
        self.graph.add_keyframe(keyframe.id, pose);
        (self.submaps).add(keyframe.id, keyframe.previous, pose.translation);
        if let Some(information) = keyframe.information
            && let Some(previous) = keyframe.previous
            && let Some(world_from_previous) = self.graph.pose(previous)
        {
            let motion = world_from_previous.inverse() * pose;
            // An information that is not positive definite makes no edge: the keyframe then starts
            // a part of its own.
            let places = self.tracker.memory().places;
            let by_corners = self
                .closes_loops
                .then(|| seen_by_both(previous, keyframe.id, places))
                .flatten();
            let edge = successive_edge(previous, keyframe.id, motion, &information, by_corners);
            let _ = edge.map(|edge| self.graph.add_edge(edge));
        }
        self.keyframes
            .push((keyframe.id, keyframe.kind, keyframe.frame.index));
        if let Some(new) = &mut self.new_keyframes {
            new.push((keyframe.id, Arc::clone(&keyframe.frame)));
        }
    }

    /// Takes over where the mapper put keyframes.
    pub(crate) fn take_moves(&mut self) {
        take_moved(&self.map, &mut self.graph, &mut self.tracker, &self.events);
    }

    pub(crate) fn next_index(&self) -> FrameIndex {
        let next = |frame: &RecordedFrame| FrameIndex(frame.result.index.0 + 1);
        self.frames.last().map_or(self.first, next)
    }

    fn record_untracked(&mut self, index: FrameIndex, status: FrameStatus, error: Option<String>) {
        self.record(FrameResult::untracked(index, status), error);
    }

    fn record(&mut self, result: FrameResult, error: Option<String>) {
        let home = self.tracker.home();
        let pose = result.world_from_camera.and_then(|world_from_camera| {
            let keyframe = home?;
            let world_from_keyframe = self.graph.pose(keyframe)?;
            Some((keyframe, world_from_keyframe.inverse() * world_from_camera))
        });
        self.events.publish(|| SlamEvent::Frame {
            result: Box::new(result.clone()),
            error,
            num_gaussians: self.map.num_gaussians(),
            steps: self.map.steps(),
        });
        self.frames.push(RecordedFrame { result, pose });
    }
}

/// Takes over where the mapper put keyframes.
fn take_moved(
    map: &MapStatus,
    graph: &mut KeyframeGraph,
    tracker: &mut Tracker,
    events: &EventHub,
) {
    let moves = map.take_moved();
    if moves.is_empty() {
        return;
    }
    graph.remeasure_keyframes(&moves);
    tracker.move_keyframes(&moves);
    publish_correction(events, graph, &moves);
}

/// Takes over where the map shows frames to have been taken.
fn take_aligned(map: &MapStatus, frames: &mut [RecordedFrame]) {
    for (index, old_from_new) in map.take_aligned() {
        let frame = frames
            .iter_mut()
            .rev()
            .find(|frame| frame.result.index == index);
        if let Some((_, keyframe_from_camera)) = frame.and_then(|frame| frame.pose.as_mut()) {
            *keyframe_from_camera = (*keyframe_from_camera * old_from_new).renormalized();
        }
    }
}

/// Tells who looks on where moved keyframes now are.
fn publish_correction(events: &EventHub, graph: &KeyframeGraph, moves: &[(KeyframeId, Se3)]) {
    events.publish(|| {
        let poses = moves.iter().map(|(id, _)| (*id, graph.pose(*id)));
        SlamEvent::Correction(poses.filter_map(|(id, pose)| Some((id, *pose?))).collect())
    });
}
