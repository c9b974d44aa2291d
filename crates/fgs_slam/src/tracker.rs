//! The tracker: registers each frame with the sparse map (paper, Sec. III-B), says whether it can
//! be trusted, and grows the sparse map at tracking keyframes. A plain struct without threads.
//!
//! Differs from the paper: it starts from a constant-velocity prediction, its target grows
//! incrementally, every frame gets a verdict instead of a silent failure, and what the rows of a
//! rolling shutter saw is brought to one moment.

use std::borrow::Cow;
use std::sync::Arc;
use std::time::Instant;

use fgs_direct::{IntensityPyramid, PosePrior};
use fgs_geom::{Camera, KeyframeId, RgbdFrame, Se3};
use fgs_gicp::{Alignment, DepthGrid, Point, Settings, SurfacePoint, align};
use fgs_splat::SparseId;
use nalgebra::{Matrix6, Vector6};
use rayon::prelude::*;

use crate::color_aligner::ColorAligner;
use crate::config::{KeyframeConfig, SlamConfig, SurfaceConfig, TrackingConfig};
use crate::frame_result::TrackingQuality;
use crate::keyframes::{Admission, FrameWork, Keyframe, KeyframeKind, KeyframePolicy, NewPoint};
use crate::map_alignment::FrameToAlign;
use crate::motion::MotionModel;
use crate::sparse_map::SparseMap;
use crate::surface::tracking_grid;
use crate::weak_directions::{fused_pose, held_information};

/// Fewer points with a surface say nothing about the camera.
const MIN_POINTS: usize = 50;

/// A registration has converged when a step is smaller. Half of the published 2e-3 and 5e-4: the
/// last step costs little, and what it misses adds up along the way.
const ROTATION_EPSILON_RAD: f64 = 1e-3;
const TRANSLATION_EPSILON_M: f64 = 2e-4;

/// No depth camera measures a surface better than this at the distances of a room: a floor under
/// the noise that a registration finds in its residuals.
const SENSOR_NOISE_M: f64 = 1e-4;

/// Standard deviations of what a hand does between two frames that the motion model does not predict.
const PREDICTED_ROTATION_RAD: f64 = 0.02;
const PREDICTED_TRANSLATION_M: f64 = 0.02;

/// Registers frames with the sparse map.
pub struct Tracker {
    config: TrackingConfig,
    surface: SurfaceConfig,
    keyframes: KeyframeConfig,
    policy: KeyframePolicy,
    grid: DepthGrid,
    map: SparseMap,
    color: ColorAligner,
    motion: MotionModel,
    newest_keyframe: Option<KeyframeId>,
    /// The last trusted frame that was not held out, unless it became a keyframe.
    unmapped: Option<(Arc<RgbdFrame>, Located)>,
}

/// A trusted pose of the depth camera.
#[derive(Clone, Copy)]
struct Registered {
    world_from_depth: Se3,
    /// Tangent in the depth camera's axes.
    information: Option<Matrix6<f64>>,
}

/// Where a trusted frame was taken.
#[derive(Clone, Copy)]
struct Located {
    world_from_camera: Se3,
    /// Twist `[omega, v]` in the camera's axes, rad/s and m/s.
    velocity: Vector6<f64>,
    /// See [`Keyframe::information`].
    information: Option<Matrix6<f64>>,
}

impl Located {
    /// What is known of the pose; `None` where nothing was registered.
    fn prior(&self) -> Option<PosePrior> {
        Some(PosePrior {
            world_from_camera: self.world_from_camera,
            information: self.information?,
        })
    }
}

/// What the tracker says of a frame.
pub struct Tracked {
    /// Its pose; `None` when lost.
    pub world_from_camera: Option<Se3>,
    /// How well it could be registered.
    pub quality: TrackingQuality,
    /// What it gives the mapper, if anything.
    pub work: Option<FrameWork>,
}

impl Tracker {
    /// For frames of one camera, with an empty map. The first frame with enough depth defines the
    /// world's axes.
    pub fn new(camera: &Camera, config: &SlamConfig) -> Self {
        Self {
            policy: KeyframePolicy::new(&config.keyframes),
            grid: tracking_grid(config, camera),
            map: SparseMap::new(config.tracking.max_correspondence_distance_m),
            color: ColorAligner::default(),
            motion: MotionModel::default(),
            newest_keyframe: None,
            unmapped: None,
            keyframes: config.keyframes.clone(),
            surface: config.surface.clone(),
            config: config.tracking.clone(),
        }
    }

    /// Tracks a frame. It becomes a keyframe only if that is allowed; one that was not is due again at
    /// the next frame. Without a map, a frame that is not allowed is lost: it cannot start one.
    pub fn track(&mut self, frame: &Arc<RgbdFrame>, admission: Admission) -> Tracked {
        let start = Instant::now();
        let points = self.grid.surface_points(&frame.depth_m, &frame.camera);
        let mut quality = TrackingQuality {
            points: points.len(),
            sparse_points: self.map.points().len(),
            ..TrackingQuality::default()
        };
        let allowed = admission == Admission::Allowed;
        let registered = if allowed || self.newest_keyframe.is_some() {
            self.register(frame, &points, &mut quality)
        } else {
            None
        };
        let mut work = None;
        let mut world_from_camera = None;
        if let Some(registered) = registered {
            let seconds = frame.timestamp_secs;
            let velocity = self
                .motion
                .velocity_to(&registered.world_from_depth, seconds);
            let frame = &shared(frame, frame.with_steady_color(&velocity));
            let pyramid = self.config.color.then(|| ColorAligner::pyramid(frame));
            let located = self.locate(frame, &registered, velocity, pyramid.as_ref());
            quality.agreement = pyramid.as_ref().and_then(|pyramid| {
                (self.color).agreement(pyramid, &frame.depth_m, &located.world_from_camera)
            });
            world_from_camera = Some(located.world_from_camera);
            let color_from_depth = frame.depth_sensor.color_from_depth(&velocity);
            self.motion
                .observe(located.world_from_camera * color_from_depth, seconds);
            let overlap_share = quality.inliers as f64 / points.len() as f64;
            if let Some(kind) = self.policy.decide(overlap_share, allowed) {
                let made = self.make_keyframe(kind, frame, &located, &points);
                if let Some(pyramid) = &pyramid {
                    self.color.add(&made, pyramid);
                }
                self.unmapped = None;
                work = Some(FrameWork::Keyframe(Box::new(made)));
            } else {
                if admission != Admission::HeldOut {
                    self.unmapped = Some((Arc::clone(frame), located));
                }
                let to_align = pyramid.zip(located.prior());
                work = to_align.map(|(pyramid, prior)| {
                    FrameWork::Align(Box::new(FrameToAlign {
                        index: frame.index,
                        pyramid,
                        prior,
                    }))
                });
            }
        }
        quality.duration = start.elapsed();
        Tracked {
            world_from_camera,
            quality,
            work,
        }
    }

    /// The keyframe that the last trusted frame becomes when the recording ends, so that the map
    /// reaches as far as the camera did; `None` if it already is one.
    pub fn finish(&mut self) -> Option<Keyframe> {
        let (frame, located) = self.unmapped.take()?;
        Some(self.make_keyframe(KeyframeKind::Mapping, &frame, &located, &[]))
    }

    /// The keyframe that the camera's pose is relative to.
    pub fn newest_keyframe(&self) -> Option<KeyframeId> {
        self.newest_keyframe
    }

    /// Forgets sparse points that the mapper has pruned.
    pub fn remove_points(&mut self, ids: &[SparseId]) {
        self.map.remove(ids);
    }

    /// Keyframes were moved, each by its `new_world_from_old_world`: their sparse points move with
    /// them, and the camera with the newest.
    pub fn move_keyframes(&mut self, moves: &[(KeyframeId, Se3)]) {
        self.map.move_anchored(moves);
        self.color.move_keyframes(moves);
        let newest = moves
            .iter()
            .find(|(id, _)| Some(*id) == self.newest_keyframe);
        if let Some((_, new_from_old)) = newest {
            self.motion.move_world(new_from_old);
            if let Some((_, located)) = &mut self.unmapped {
                located.world_from_camera = *new_from_old * located.world_from_camera;
            }
        }
    }

    /// The depth camera's pose if it can be trusted; how well it fits goes into `quality`.
    fn register(
        &self,
        frame: &RgbdFrame,
        points: &[SurfacePoint],
        quality: &mut TrackingQuality,
    ) -> Option<Registered> {
        if points.len() < MIN_POINTS {
            return None;
        }
        let Some(predicted) = self.motion.predict(frame.timestamp_secs) else {
            // The first frame with enough depth: its colour camera is at the origin.
            return Some(Registered {
                world_from_depth: frame.depth_sensor.color_from_depth,
                information: None,
            });
        };
        let seconds = frame.timestamp_secs;
        let velocity = self.motion.velocity_at(seconds);
        // A registration that is impossible leaves the frame lost; the run goes on.
        let mut source = self.disks(points, frame, &velocity);
        let mut alignment = self.align(&source, &predicted)?;
        let mut registered = self.registered(&alignment, &source, &predicted);
        if frame.depth_sensor.readout_secs != 0.0 {
            // Where the rows were read from follows from the velocity, which is known better now.
            let start = registered.world_from_depth;
            let velocity = self.motion.velocity_to(&start, seconds);
            source = self.disks(points, frame, &velocity);
            alignment = self.align(&source, &start)?;
            registered = self.registered(&alignment, &source, &predicted);
        }
        quality.inliers = alignment.inliers;
        quality.residual_m = alignment.rms_residual_m;
        quality.conditioning = alignment.conditioning.weakest;
        self.is_trusted(&alignment).then_some(registered)
    }

    /// The pose of a registration where its points hold the camera, the predicted one where they do not.
    fn registered(&self, alignment: &Alignment, source: &[Point], predicted: &Se3) -> Registered {
        let thickness = self.surface.disk_thickness;
        let held = held_information(alignment, source, thickness, SENSOR_NOISE_M);
        let trust = self.config.depth_trust;
        Registered {
            world_from_depth: fused_pose(
                &alignment.target_from_source,
                predicted,
                [&(trust * held), &predicted_information()],
            ),
            information: Some(trust * alignment.information(SENSOR_NOISE_M)),
        }
    }

    /// Registers points with the sparse map.
    fn align(&self, source: &[Point], start: &Se3) -> Option<Alignment> {
        let settings = Settings {
            max_correspondence_distance_m: self.config.max_correspondence_distance_m as f32,
            rotation_epsilon_rad: ROTATION_EPSILON_RAD,
            translation_epsilon_m: TRANSLATION_EPSILON_M,
            ..Settings::default()
        };
        let alignment = align(source, self.map.points(), start, &settings).ok()?;
        if alignment.converged {
            return Some(alignment);
        }
        // Oscillating correspondences keep it from the last digits: the published tolerances will do.
        let published = Settings {
            rotation_epsilon_rad: Settings::default().rotation_epsilon_rad,
            translation_epsilon_m: Settings::default().translation_epsilon_m,
            ..settings
        };
        let start = alignment.target_from_source;
        align(source, self.map.points(), &start, &published).ok()
    }

    /// The colour camera's pose: from the depth camera's by its motion between the two images, then
    /// by what the colours say.
    fn locate(
        &self,
        frame: &RgbdFrame,
        registered: &Registered,
        velocity: Vector6<f64>,
        pyramid: Option<&IntensityPyramid>,
    ) -> Located {
        let depth_from_color = frame.depth_sensor.color_from_depth(&velocity).inverse();
        let mut located = Located {
            world_from_camera: registered.world_from_depth * depth_from_color,
            velocity,
            information: registered.information.map(|information| {
                let depth_by_color = depth_from_color.adjoint();
                depth_by_color.transpose() * information * depth_by_color
            }),
        };
        if let Some(pyramid) = pyramid
            && let Some(information) = &mut located.information
        {
            let prior = PosePrior {
                world_from_camera: located.world_from_camera,
                information: *information,
            };
            if let Some(aligned) = self.color.align(pyramid, &prior) {
                located.world_from_camera = aligned.world_from_camera;
                *information += aligned.information;
            }
        }
        located
    }

    fn is_trusted(&self, alignment: &Alignment) -> bool {
        alignment.converged
            && alignment.inlier_share >= self.config.min_inlier_share
            && alignment.conditioning.weakest >= self.config.min_conditioning
    }

    /// Disks in the depth camera's axes when it read its middle row.
    fn disks(
        &self,
        points: &[SurfacePoint],
        frame: &RgbdFrame,
        velocity: &Vector6<f64>,
    ) -> Vec<Point> {
        if frame.depth_sensor.readout_secs == 0.0 {
            return points.par_iter().map(|point| self.disk(point)).collect();
        }
        let middle_from_rows =
            (frame.depth_sensor).middle_from_rows(frame.depth_m.height(), velocity);
        points
            .par_iter()
            .map(|point| self.disk(point).transformed(&middle_from_rows[point.v]))
            .collect()
    }

    fn disk(&self, point: &SurfacePoint) -> Point {
        point.disk(self.surface.disk_thickness, self.surface.noise_power)
    }

    fn make_keyframe(
        &mut self,
        kind: KeyframeKind,
        measured: &Arc<RgbdFrame>,
        located: &Located,
        points: &[SurfacePoint],
    ) -> Keyframe {
        let id = self.next_keyframe_id();
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
        let to_world = |point: &&SurfacePoint| self.disk(point).transformed(world_from_camera);
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

/// How sure the motion model is of a pose, tangent `[omega, v]`.
fn predicted_information() -> Matrix6<f64> {
    let (turn, shift) = (
        PREDICTED_ROTATION_RAD.powi(-2),
        PREDICTED_TRANSLATION_M.powi(-2),
    );
    Matrix6::from_diagonal(&Vector6::new(turn, turn, turn, shift, shift, shift))
}

/// A frame that may be the same as one that is shared already.
fn shared(frame: &Arc<RgbdFrame>, changed: Cow<'_, RgbdFrame>) -> Arc<RgbdFrame> {
    match changed {
        Cow::Borrowed(_) => Arc::clone(frame),
        Cow::Owned(changed) => Arc::new(changed),
    }
}
