//! The tracker: finds each frame's pose (paper, Sec. III-B), says whether it can be trusted, and grows
//! the sparse map at tracking keyframes. A plain struct without threads.
//!
//! A frame is registered from where the motion model expects it. If what is found there is doubtful,
//! other starts are tried (search.rs), and the best pose is judged (verdict.rs). Where a lost camera is
//! found by the look of a place, a second frame has to agree; one that is not found for a while starts a
//! sub-map (footing.rs).
//!
//! What moves is left out (sighting.rs), and the frame registered again without it.
//!
//! Differs from the paper: it starts from a constant-velocity prediction, its target grows
//! incrementally, every frame gets a verdict instead of a silent failure, and what the rows of a
//! rolling shutter saw is brought to one moment.

mod footing;
mod saved;
mod search;
mod sighting;

use std::sync::Arc;
use std::time::Instant;

use fgs_geom::{Camera, KeyframeId, RgbdFrame, Se3};
use fgs_gicp::{DepthGrid, Point, SurfacePoint};
use fgs_splat::SparseId;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::color_aligner::ColorAligner;
use crate::config::{KeyframeConfig, SlamConfig};
use crate::frame_result::TrackingQuality;
use crate::keyframes::{
    Admission, FrameWork, Keyframe, KeyframeKind, KeyframePolicy, Motions, NewPoint,
};
use crate::loops::Memory;
use crate::map_alignment::FrameToAlign;
use crate::motion::MotionModel;
use crate::moving::{Moving, MovingThings};
use crate::registrar::{Attempt, Known, Located, Measured, Registrar, Start, shared};
use crate::relocalizer::Relocalizer;
use crate::repeats::{Clock, LatestFrame, Repeat};
use crate::sparse_map::SparseMap;
use crate::surface::tracking_grid;
use crate::two_motions::UsualFit;
use crate::verdict::Verdict;

use footing::Footing;
pub use saved::SavedTracker;
use sighting::Sighting;

/// Finds the poses of frames.
pub struct Tracker {
    keyframes: KeyframeConfig,
    policy: KeyframePolicy,
    grid: DepthGrid,
    registrar: Registrar,
    map: SparseMap,
    color: ColorAligner,
    relocalizer: Relocalizer,
    motion: MotionModel,
    moving: MovingThings,
    usual_fit: UsualFit,
    footing: Footing,
    latest: Option<LatestFrame>,
    clock: Clock,
    newest_keyframe: Option<KeyframeId>,
    /// The keyframe that the camera is tracked from: its pose moves with that one's.
    home: Option<KeyframeId>,
    unmapped: Option<Unmapped>,
}

/// The last trusted frame that was not held out, unless it became a keyframe.
#[derive(Clone, Serialize, Deserialize)]
struct Unmapped<F = Arc<RgbdFrame>> {
    frame: F,
    located: Located,
    home: Option<KeyframeId>,
}

impl<F> Unmapped<F> {
    /// The same with its frame, or a name for it, in another form.
    fn with_frame<G>(&self, frame: G) -> Unmapped<G> {
        Unmapped {
            frame,
            located: self.located,
            home: self.home,
        }
    }
}

/// What the tracker says of a frame.
pub struct Tracked {
    /// What its pose is worth.
    pub verdict: Verdict,
    /// Its pose; `None` when lost.
    pub world_from_camera: Option<Se3>,
    /// How well it could be registered.
    pub quality: TrackingQuality,
    /// What it gives the mapper, if anything.
    pub work: Option<FrameWork>,
}

impl Tracker {
    /// For frames of one camera; its keyframes must be [added](Self::remember). With an empty map, the
    /// first frame with enough depth defines the world's axes.
    pub fn restored(camera: &Camera, config: &SlamConfig, saved: SavedTracker) -> Self {
        let mut relocalizer = Relocalizer::default();
        let frames = saved.frames;
        if let Some((place, world_from_camera)) = &saved.last
            && let Some(frame) = frames.get(*place)
        {
            relocalizer.observe(&frame, world_from_camera);
        }
        let search_distance_m = config.tracking.max_correspondence_distance_m;
        Self {
            policy: KeyframePolicy::new(&config.keyframes, saved.frames_since_keyframe),
            grid: tracking_grid(config, camera),
            registrar: Registrar::new(config),
            map: SparseMap::restored(search_distance_m, saved.map),
            color: ColorAligner::default(),
            relocalizer,
            motion: saved.motion,
            moving: saved.moving,
            usual_fit: saved.usual_fit,
            footing: saved.footing,
            latest: saved
                .latest
                .and_then(|latest| Some(latest.with_frame(frames.get(latest.frame)?))),
            clock: saved.clock,
            newest_keyframe: None,
            home: saved.home,
            unmapped: saved.unmapped.and_then(|unmapped| {
                let frame = frames.get(unmapped.frame)?;
                Some(unmapped.with_frame(frame))
            }),
            keyframes: config.keyframes.clone(),
        }
    }

    /// Adds a keyframe of an earlier session, whose points are in the sparse map.
    pub fn remember(&mut self, keyframe: &Keyframe) {
        if self.registrar.uses_color() {
            let pyramid = ColorAligner::pyramid(&keyframe.frame);
            self.color.add(keyframe, &pyramid);
        }
        self.remember_place(keyframe);
        self.newest_keyframe = Some(keyframe.id);
    }

    fn remember_place(&mut self, keyframe: &Keyframe) {
        if let Some(forgotten) = self.relocalizer.add(keyframe) {
            self.color.forget(forgotten);
        }
    }

    /// Tracks a frame. It becomes a keyframe only if that is allowed; one that was not is due again at
    /// the next frame. Without a map, a frame that is not allowed is lost: it cannot start one.
    pub fn track(&mut self, frame: &Arc<RgbdFrame>, admission: Admission) -> Tracked {
        let start = Instant::now();
        let latest = self.latest.as_ref();
        let repeat = latest.and_then(|latest| latest.repeated_by(frame));
        let mut tracked = match (repeat, latest) {
            (Some(Repeat::Color), Some(latest)) => Tracked {
                verdict: latest.verdict,
                world_from_camera: latest.world_from_camera,
                quality: latest.quality,
                work: None,
            },
            (Some(Repeat::Depth), _) => self.track_by_color(frame),
            _ => {
                self.clock.take(frame.timestamp_secs);
                self.track_new(frame, admission)
            }
        };
        tracked.quality.duration = start.elapsed();
        if repeat.is_some() {
            self.clock.repeat(frame.timestamp_secs);
        } else if self.newest_keyframe.is_some() {
            self.latest = Some(LatestFrame {
                frame: Arc::clone(frame),
                verdict: tracked.verdict,
                world_from_camera: tracked.world_from_camera,
                quality: tracked.quality,
            });
        }
        tracked
    }

    /// Where a frame was taken whose depth image is an old one: where motion and colour say, which is too
    /// little to build on.
    fn track_by_color(&self, frame: &Arc<RgbdFrame>) -> Tracked {
        let measured = Measured {
            frame,
            points: &[],
            seconds: frame.timestamp_secs,
        };
        let predicted = match self.footing {
            Footing::Firm => (self.motion).predict(measured.seconds, frame.device_pose.as_ref()),
            Footing::Lost { .. } | Footing::Found { .. } => None,
        };
        let start = predicted.as_ref().map(Start::predicted);
        let followed =
            start.and_then(|start| self.registrar.follow(measured, self.known(), &start));
        let pose = followed.map(|located| located.world_from_camera);
        Tracked {
            verdict: pose.map_or(Verdict::Lost, |_| Verdict::Weak),
            world_from_camera: pose,
            quality: TrackingQuality::default(),
            work: None,
        }
    }

    /// Tracks a frame that does not repeat the one before.
    fn track_new(&mut self, frame: &Arc<RgbdFrame>, admission: Admission) -> Tracked {
        let sparse_points = self.map.points().len();
        let Sighting {
            found,
            points,
            moving,
            something_left,
            is_sure,
        } = self.sight(frame, admission);
        let mut tracked = Tracked {
            verdict: Verdict::Lost,
            world_from_camera: None,
            quality: TrackingQuality {
                points: points.len(),
                sparse_points,
                moving_share: moving.as_ref().map_or(0.0, Moving::share),
                ..TrackingQuality::default()
            },
            work: None,
        };
        if let Some(attempt) = found {
            tracked.quality.take_over(&attempt.evidence);
            tracked.verdict = self.believe(&attempt);
            if !is_sure {
                tracked.verdict = tracked.verdict.min(Verdict::Weak);
            }
            if tracked.verdict > Verdict::Lost {
                tracked.world_from_camera = Some(attempt.located.world_from_camera);
                self.stand_at(&attempt);
                (self.usual_fit).observe(attempt.residual_variance, &self.motion);
            }
            if tracked.verdict == Verdict::Tracked {
                let pose = &attempt.located.world_from_camera;
                self.moving.observe(frame, pose, moving.as_ref());
                tracked.work = self.work(attempt, &points, admission, something_left);
            }
        } else if self.newest_keyframe.is_some() {
            self.stumble();
        }
        if let Some(attempt) = self.start_elsewhere(frame, admission) {
            tracked.quality.take_over(&attempt.evidence);
            tracked.verdict = attempt.verdict;
            tracked.world_from_camera = Some(attempt.located.world_from_camera);
            self.stand_at(&attempt);
            let points = self.grid.surface_points(&frame.depth_m, &frame.camera);
            tracked.work = self.work(attempt, &points, admission, false);
        }
        tracked
    }

    /// The keyframe that the last trusted frame becomes when the recording ends, so that the map
    /// reaches as far as the camera did; `None` if it already is one.
    pub fn finish(&mut self) -> Option<Keyframe> {
        let Unmapped {
            frame,
            located,
            home,
        } = self.unmapped.take()?;
        self.home = home;
        Some(self.make_keyframe(KeyframeKind::Mapping, &frame, &located, &[]))
    }

    /// The keyframe that the camera's pose is relative to.
    pub fn home(&self) -> Option<KeyframeId> {
        self.home
    }

    /// Forgets sparse points that the mapper has pruned.
    pub fn remove_points(&mut self, ids: &[SparseId]) {
        self.map.remove(ids);
    }

    /// Keyframes were moved, each by its `new_world_from_old_world`: their sparse points move with
    /// them, and the camera with the one that it is tracked from.
    pub fn move_keyframes(&mut self, moves: &[(KeyframeId, Se3)]) {
        let motions = Motions::new(moves);
        self.map.move_anchored(&motions);
        self.color.move_keyframes(&motions);
        self.relocalizer.move_keyframes(&motions);
        let motion_of = |home: Option<KeyframeId>| motions.of(home?);
        if let Some(new_from_old) = motion_of(self.home) {
            self.motion.move_world(new_from_old);
            self.usual_fit.move_world(new_from_old);
            let latest = self.latest.as_mut();
            if let Some(pose) = latest.and_then(|latest| latest.world_from_camera.as_mut()) {
                *pose = *new_from_old * *pose;
            }
        }
        // What a single frame says of the camera is not what trusted frames said.
        let trusted = match &self.footing {
            Footing::Found { home_before, .. } => *home_before,
            Footing::Firm | Footing::Lost { .. } => self.home,
        };
        if let Some(new_from_old) = motion_of(trusted) {
            self.moving.move_world(new_from_old);
            self.relocalizer.move_camera(new_from_old);
            if let Footing::Found { motion_before, .. } = &mut self.footing {
                motion_before.move_world(new_from_old);
            }
        }
        if let Some(unmapped) = &mut self.unmapped
            && let Some(new_from_old) = motion_of(unmapped.home)
        {
            let pose = &mut unmapped.located.world_from_camera;
            *pose = *new_from_old * *pose;
        }
    }

    /// What is remembered of all keyframes, to recognise places by.
    pub fn memory(&self) -> Memory<'_> {
        Memory {
            places: &self.relocalizer,
            color: &self.color,
            map: &self.map,
            grid: &self.grid,
            registrar: &self.registrar,
        }
    }

    fn known(&self) -> Known<'_> {
        Known {
            map: &self.map,
            keyframes: &self.color,
            motion: &self.motion,
        }
    }

    /// The camera is where a frame was found.
    fn stand_at(&mut self, attempt: &Attempt) {
        let Attempt { located, frame, .. } = attempt;
        let color_from_depth = frame.depth_sensor.color_from_depth(&located.velocity);
        let world_from_depth = located.world_from_camera * color_from_depth;
        let now_secs = self.clock.now_secs();
        let device = frame.device_pose;
        (self.motion).observe(world_from_depth, now_secs, attempt.uncertainty_m, device);
    }

    /// What a trusted frame gives the mapper: a keyframe, or a frame to align.
    fn work(
        &mut self,
        attempt: Attempt,
        points: &[SurfacePoint],
        admission: Admission,
        something_left: bool,
    ) -> Option<FrameWork> {
        let Attempt {
            located,
            frame,
            pyramid,
            evidence,
            ..
        } = attempt;
        self.relocalizer.observe(&frame, &located.world_from_camera);
        let overlap_share = evidence.inliers as f64 / points.len() as f64;
        let allowed = admission == Admission::Allowed;
        let leaves_newest = pyramid.as_ref().is_some_and(|pyramid| {
            (self.color).has_left_newest(pyramid, &located.world_from_camera)
        });
        // A keyframe that shows what has left speaks against all that is seen without it.
        let has_left = leaves_newest || something_left;
        let is_slipping = evidence.is_slipping();
        if let Some(kind) = (self.policy).decide(overlap_share, has_left, is_slipping, allowed) {
            let made = self.make_keyframe(kind, &frame, &located, points);
            if let Some(pyramid) = &pyramid {
                self.color.add(&made, pyramid);
            }
            self.remember_place(&made);
            self.unmapped = None;
            return Some(FrameWork::Keyframe(Box::new(made)));
        }
        if admission != Admission::HeldOut {
            self.unmapped = Some(Unmapped {
                frame: Arc::clone(&frame),
                located,
                home: self.home,
            });
        }
        Some(FrameWork::Align(Box::new(FrameToAlign {
            index: frame.index,
            pyramid: pyramid?,
            prior: located.prior()?,
        })))
    }

    fn make_keyframe(
        &mut self,
        kind: KeyframeKind,
        measured: &Arc<RgbdFrame>,
        located: &Located,
        points: &[SurfacePoint],
    ) -> Keyframe {
        let id = self.next_keyframe_id();
        let previous = self.home.replace(id);
        let world_from_camera = located.world_from_camera;
        let frame = shared(measured, measured.synchronized(&located.velocity));
        let new_points = match kind {
            KeyframeKind::Mapping => Vec::new(),
            KeyframeKind::Tracking if Arc::ptr_eq(&frame, measured) => {
                self.extend_map(id, &frame, &world_from_camera, points)
            }
            KeyframeKind::Tracking => {
                let points = self.grid.surface_points(&frame.depth_m, &frame.camera);
                self.extend_map(id, &frame, &world_from_camera, &points)
            }
        };
        Keyframe {
            id,
            kind,
            frame,
            world_from_camera,
            previous,
            information: located.information,
            new_points,
        }
    }

    /// Lets what a keyframe's surface points add join the sparse map.
    fn extend_map(
        &mut self,
        id: KeyframeId,
        frame: &RgbdFrame,
        world_from_camera: &Se3,
        points: &[SurfacePoint],
    ) -> Vec<NewPoint> {
        // A sparse point is a gaussian too, and needs a colour.
        let points: Vec<&SurfacePoint> = points
            .iter()
            .filter(|point| frame.has_color(point.u, point.v))
            .collect();
        let to_world =
            |point: &&SurfacePoint| self.registrar.disk(point).transformed(world_from_camera);
        let in_world: Vec<Point> = points.par_iter().map(to_world).collect();
        let spacing_m = self.keyframes.new_point_distance_m;
        let joined = self.map.extend(id, &in_world, spacing_m);
        let named = joined.into_iter().map(|(i, id)| NewPoint {
            u: points[i].u,
            v: points[i].v,
            id,
        });
        named.collect()
    }

    fn next_keyframe_id(&mut self) -> KeyframeId {
        let id = self
            .newest_keyframe
            .map_or(KeyframeId(0), |newest| KeyframeId(newest.0 + 1));
        self.newest_keyframe = Some(id);
        id
    }
}
