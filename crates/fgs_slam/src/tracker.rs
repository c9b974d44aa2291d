//! The tracker: finds each frame's pose (paper, Sec. III-B), says whether it can be trusted, and grows
//! the sparse map at tracking keyframes. A plain struct without threads.
//!
//! A frame is registered from where the motion model expects it. If what is found there is doubtful,
//! other starts are tried (relocalizer.rs), and the best pose is judged (verdict.rs). Where a lost camera
//! is found by the look of a place, a second frame has to agree. One that is not found for a while starts a
//! sub-map (submaps.rs).
//!
//! What moves is left out (moving.rs), and the frame registered again without it.
//!
//! Differs from the paper: it starts from a constant-velocity prediction, its target grows
//! incrementally, every frame gets a verdict instead of a silent failure, and what the rows of a
//! rolling shutter saw is brought to one moment.

use std::sync::Arc;
use std::time::Instant;

use fgs_features::Features;
use fgs_geom::{Camera, KeyframeId, RgbdFrame, Se3};
use fgs_gicp::{DepthGrid, Point, SurfacePoint};
use fgs_splat::SparseId;
use nalgebra::{UnitQuaternion, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::color_aligner::ColorAligner;
use crate::config::{KeyframeConfig, SlamConfig};
use crate::frame_result::TrackingQuality;
use crate::keyframes::{Admission, FrameWork, Keyframe, KeyframeKind, KeyframePolicy, NewPoint};
use crate::loops::Memory;
use crate::map_alignment::FrameToAlign;
use crate::merge::Renumbering;
use crate::motion::MotionModel;
use crate::moving::{Moving, MovingThings};
use crate::registrar::{Attempt, Known, Located, Measured, Registrar, Start, shared};
use crate::relocalizer::{Guess, Relocalizer, follows};
use crate::repeats::{Clock, LatestFrame, Repeat};
use crate::sparse_map::{SavedSparseMap, SparseMap};
use crate::submaps::APART_M;
use crate::surface::tracking_grid;
use crate::two_motions::{Suspicion, UsualFit};
use crate::verdict::{Hold, Verdict};

/// A camera is lost for good when it has not been found in so many frames that show what the frame before each
/// shows, less those that do not: it sees well, but nothing that is known.
const MAX_FOLLOWED: usize = 12;

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

/// A frame without what moves in it.
struct Sighting {
    found: Option<Attempt>,
    points: Vec<SurfacePoint>,
    /// What was left out.
    moving: Option<Moving>,
    /// It was part of the map before.
    something_left: bool,
    /// Whether it may not as well be the camera that moved.
    is_sure: bool,
}

impl Sighting {
    /// Of a frame in which all stands still.
    fn whole(found: Option<Attempt>, points: Vec<SurfacePoint>) -> Self {
        Self {
            found,
            points,
            moving: None,
            something_left: false,
            is_sure: true,
        }
    }
}

/// What the camera's last pose is worth.
#[derive(Clone, Default, Serialize, Deserialize)]
enum Footing {
    /// It is trusted.
    #[default]
    Firm,
    /// The camera is lost. So many frames showed what the one before each showed, less those that did not.
    Lost { followed: usize },
    /// One frame says where it is. If the next does not agree, what was before is taken up.
    Found {
        motion_before: Box<MotionModel>,
        home_before: Option<KeyframeId>,
    },
}

/// What a tracker remembers, as plain data, apart from its keyframes.
#[derive(Default, Serialize, Deserialize)]
pub struct SavedTracker {
    frames_since_keyframe: Option<usize>,
    map: SavedSparseMap,
    motion: MotionModel,
    moving: MovingThings,
    usual_fit: UsualFit,
    footing: Footing,
    clock: Clock,
    frames: SavedFrames,
    latest: Option<LatestFrame<usize>>,
    last: Option<(usize, Se3)>,
    home: Option<KeyframeId>,
    unmapped: Option<Unmapped<usize>>,
}

/// The frames that a tracker remembers, mostly one in several roles: each once, named by its place.
#[derive(Default, Serialize, Deserialize)]
struct SavedFrames(Vec<Arc<RgbdFrame>>);

impl SavedFrames {
    fn place_of(&mut self, frame: &Arc<RgbdFrame>) -> usize {
        let place = self.0.iter().position(|saved| Arc::ptr_eq(saved, frame));
        place.unwrap_or_else(|| {
            self.0.push(Arc::clone(frame));
            self.0.len() - 1
        })
    }

    /// `None` if there is none.
    fn get(&self, place: usize) -> Option<Arc<RgbdFrame>> {
        self.0.get(place).map(Arc::clone)
    }
}

impl SavedTracker {
    /// The camera is lost, and nothing is known of where it has been.
    pub fn lose(&mut self) {
        *self = Self {
            frames_since_keyframe: self.frames_since_keyframe,
            map: std::mem::take(&mut self.map),
            footing: Footing::Lost { followed: 0 },
            ..Self::default()
        };
    }

    /// The number of the next sparse point.
    pub fn next_point(&self) -> u32 {
        self.map.next_id()
    }

    /// Takes in another's sparse map.
    pub fn append(&mut self, other: Self, renumbering: Renumbering) {
        self.map.append(other.map, renumbering);
    }

    /// Whether what it remembers is of a camera.
    pub fn is_of(&self, camera: &Camera) -> bool {
        let is_sound = |frame: &Arc<RgbdFrame>| frame.camera == *camera && frame.check().is_ok();
        let last = self.last.iter().map(|(place, _)| *place);
        let latest = self.latest.iter().map(|latest| latest.frame);
        let unmapped = self.unmapped.iter().map(|unmapped| unmapped.frame);
        self.moving.are_of(camera)
            && self.frames.0.iter().all(is_sound)
            && (last.chain(latest).chain(unmapped)).all(|place| place < self.frames.0.len())
    }

    /// The keyframes that it is tracked from, or was.
    pub fn homes(&self) -> impl Iterator<Item = KeyframeId> {
        let before = match &self.footing {
            Footing::Found { home_before, .. } => *home_before,
            Footing::Firm | Footing::Lost { .. } => None,
        };
        let unmapped = self.unmapped.as_ref().and_then(|unmapped| unmapped.home);
        self.home.into_iter().chain(before).chain(unmapped)
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

    /// Everything but the settings and the keyframes.
    pub fn save(&self) -> SavedTracker {
        let mut frames = SavedFrames::default();
        let last = self.relocalizer.last();
        let last = last.map(|(frame, pose)| (frames.place_of(frame), *pose));
        let latest = self.latest.as_ref();
        let latest = latest.map(|latest| latest.with_frame(frames.place_of(&latest.frame)));
        let unmapped = self.unmapped.as_ref();
        let unmapped =
            unmapped.map(|unmapped| unmapped.with_frame(frames.place_of(&unmapped.frame)));
        SavedTracker {
            frames_since_keyframe: self.policy.frames_since_keyframe(),
            map: self.map.save(),
            motion: self.motion.clone(),
            moving: self.moving.clone(),
            usual_fit: self.usual_fit.clone(),
            footing: self.footing.clone(),
            clock: self.clock,
            frames,
            latest,
            last,
            home: self.home,
            unmapped,
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

    /// Finds a frame, without what moves in it.
    fn sight(&mut self, frame: &Arc<RgbdFrame>, admission: Admission) -> Sighting {
        let points = self.grid.surface_points(&frame.depth_m, &frame.camera);
        let Some(attempt) = self.find(frame, &points, admission) else {
            return Sighting::whole(None, points);
        };
        let suspicion = self.investigate(frame, &points, &attempt);
        let mut pose = attempt.located.world_from_camera;
        let mut moves = Vec::new();
        let mut is_sure = matches!(suspicion, Suspicion::Unfounded);
        let mut something_left = false;
        if let Suspicion::Founded(two) = suspicion {
            let depth_from_color = frame.depth_sensor.color_from_depth.inverse();
            pose = two.world_from_depth * depth_from_color;
            moves = (points.iter().zip(&two.moves))
                .filter_map(|(point, moves)| moves.then_some((point.u, point.v)))
                .collect();
            is_sure = two.is_clear;
            something_left = true;
        }
        let Some(moving) = self.moving.find(frame, &pose, &moves) else {
            return Sighting {
                is_sure: is_sure && !something_left,
                ..Sighting::whole(Some(attempt), points)
            };
        };
        if something_left {
            // What the camera seemed to do since was the other's motion.
            self.motion = self.usual_fit.motion().clone();
        }
        let still = Arc::new(moving.left_out_of(frame));
        let points = self.grid.surface_points(&still.depth_m, &still.camera);
        Sighting {
            found: self.find(&still, &points, admission),
            points,
            moving: Some(moving),
            something_left,
            is_sure,
        }
    }

    /// Whether something began to move in a frame that is about to be believed.
    fn investigate(
        &self,
        frame: &Arc<RgbdFrame>,
        points: &[SurfacePoint],
        attempt: &Attempt,
    ) -> Suspicion {
        if attempt.verdict == Verdict::Lost || !matches!(self.footing, Footing::Firm) {
            return Suspicion::Unfounded;
        }
        let measured = Measured {
            frame,
            points,
            seconds: self.clock.now_secs(),
        };
        (self.usual_fit).investigate(&self.registrar, measured, self.known(), attempt)
    }

    /// Where a camera begins a sub-map that has been lost for a while and sees well; `None` if it does not.
    fn start_elsewhere(&mut self, frame: &Arc<RgbdFrame>, admission: Admission) -> Option<Attempt> {
        let Footing::Lost { followed } = &mut self.footing else {
            return None;
        };
        let before = self.latest.as_ref()?;
        let can_be_followed = follows(frame, &before.frame);
        *followed = if can_be_followed {
            *followed + 1
        } else {
            followed.saturating_sub(1)
        };
        if !can_be_followed || *followed < MAX_FOLLOWED || admission != Admission::Allowed {
            return None;
        }
        let height_m = self.relocalizer.highest_m()? + APART_M;
        let elsewhere = Se3::new(
            UnitQuaternion::identity(),
            Vector3::new(0.0, -height_m, 0.0),
        );
        let measured = Measured {
            frame,
            points: &self.grid.surface_points(&frame.depth_m, &frame.camera),
            seconds: self.clock.now_secs(),
        };
        let nowhere = MotionModel::default();
        let known = Known {
            motion: &nowhere,
            ..self.known()
        };
        let attempt = self.registrar.place(measured, known, &elsewhere)?;
        self.footing = Footing::Firm;
        self.home = None;
        self.motion = nowhere;
        self.moving = MovingThings::default();
        Some(attempt)
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
        self.map.move_anchored(moves);
        self.color.move_keyframes(moves);
        self.relocalizer.move_keyframes(moves);
        let motion_of = |home: Option<KeyframeId>| {
            let (_, new_from_old) = moves.iter().find(|(id, _)| Some(*id) == home)?;
            Some(new_from_old)
        };
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

    /// The best pose of a frame that can be found; `None` if it cannot be registered at all, or cannot
    /// start the map.
    fn find(
        &self,
        frame: &Arc<RgbdFrame>,
        points: &[SurfacePoint],
        admission: Admission,
    ) -> Option<Attempt> {
        let measured = Measured {
            frame,
            points,
            seconds: self.clock.now_secs(),
        };
        if self.newest_keyframe.is_none() {
            let place = || (self.registrar).place(measured, self.known(), &Se3::identity());
            return (admission == Admission::Allowed).then(place).flatten();
        }
        let attempt = |start: &Start| self.registrar.attempt(measured, self.known(), start);
        let predict = |device| self.motion.predict(measured.seconds, device);
        let predicted = predict(frame.device_pose.as_ref());
        let is_clear = |best: &Option<Attempt>| best.as_ref().is_some_and(|best| !best.is_doubtful);
        let mut best = predicted.and_then(|predicted| attempt(&Start::predicted(&predicted)));
        if is_clear(&best) {
            return best;
        }
        // The device's world may have jumped.
        if predicted.is_some_and(|predicted| predicted.is_by_device) {
            let steady = predict(None).and_then(|steady| attempt(&Start::predicted(&steady)));
            best = better(best, steady);
            if is_clear(&best) {
                return best;
            }
        }
        let features = Features::detect(measured.frame);
        let color_from_depth = measured.frame.depth_sensor.color_from_depth;
        let start_of = |guess: &Guess| {
            let world_from_depth = guess.world_from_camera * color_from_depth;
            Start::from_corners(world_from_depth, &guess.information)
        };
        for guess in self.relocalizer.guesses_nearby(&features, self.home) {
            best = better(best, attempt(&start_of(&guess)));
            if is_clear(&best) {
                return best;
            }
        }
        if matches!(self.footing, Footing::Firm) {
            return best;
        }
        // Nothing is known of the motion of a camera that is somewhere else.
        let known = Known {
            motion: &MotionModel::default(),
            ..self.known()
        };
        for guess in (self.relocalizer).guesses_anywhere(measured.frame, &features) {
            let relocalized = self.registrar.attempt(measured, known, &start_of(&guess));
            let relocalized = relocalized.map(|attempt| Attempt {
                relocalized_by: guess.keyframe,
                ..attempt
            });
            best = better(best, relocalized);
            if is_clear(&best) {
                return best;
            }
        }
        best
    }

    /// What a frame's own verdict is worth after those before it.
    fn believe(&mut self, attempt: &Attempt) -> Verdict {
        let own = attempt.verdict;
        let is_a_find = own == Verdict::Tracked && attempt.evidence.is_a_find();
        let has_slid =
            attempt.evidence.hold() == Hold::None && self.motion.has_coasted(self.clock.now_secs());
        let is_known = is_a_find || matches!(self.footing, Footing::Firm);
        if own == Verdict::Lost || has_slid || !is_known {
            self.stumble();
            return Verdict::Lost;
        }
        let is_relocalized = attempt.relocalized_by.is_some();
        let is_first = matches!(self.footing, Footing::Lost { .. });
        let needs_another = is_first && (attempt.is_doubtful || is_relocalized);
        self.footing = if needs_another {
            Footing::Found {
                motion_before: Box::new(self.motion.clone()),
                home_before: self.home,
            }
        } else {
            Footing::Firm
        };
        if is_relocalized {
            self.home = attempt.relocalized_by;
            self.motion = MotionModel::default();
        }
        if needs_another { Verdict::Weak } else { own }
    }

    /// A frame is lost, and with it what only the frame before said.
    fn stumble(&mut self) {
        match &self.footing {
            Footing::Lost { .. } => return,
            Footing::Firm => {}
            Footing::Found {
                motion_before,
                home_before,
            } => {
                self.motion = (**motion_before).clone();
                self.home = *home_before;
            }
        }
        self.footing = Footing::Lost { followed: 0 };
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

/// The better of two poses of a frame.
fn better(a: Option<Attempt>, b: Option<Attempt>) -> Option<Attempt> {
    let worth = |attempt: &Attempt| (attempt.verdict, attempt.evidence.strength());
    match (a, b) {
        (Some(a), Some(b)) => Some(if worth(&b) > worth(&a) { b } else { a }),
        (a, b) => a.or(b),
    }
}
