//! The tracker: registers each frame with the sparse map (paper, Sec. III-B), says whether it can
//! be trusted, and grows the sparse map at tracking keyframes. A plain struct without threads.
//!
//! Differs from the paper: it starts from a constant-velocity prediction, its target grows
//! incrementally, and every frame gets a verdict instead of a silent failure.

use std::sync::Arc;
use std::time::{Duration, Instant};

use fgs_geom::{Camera, FrameIndex, RgbdFrame, Se3};
use fgs_gicp::{
    Alignment, DepthGrid, Point, PointMap, Settings, SurfacePoint, align,
    covariances_from_neighbors,
};
use fgs_splat::SparseId;
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::config::{KeyframeConfig, SlamConfig, TargetCovariance, TrackingConfig};
use crate::keyframes::{Keyframe, KeyframeKind, KeyframePolicy, NewPoint};
use crate::surface::tracking_grid;

/// Fewer points with a surface say nothing about the camera.
const MIN_POINTS: usize = 50;

/// A registration has converged when a step is smaller. Half of the published 2e-3 and 5e-4: the
/// last step costs little, and what it misses adds up along the way.
const ROTATION_EPSILON_RAD: f64 = 1e-3;
const TRANSLATION_EPSILON_M: f64 = 2e-4;

/// Neighbours of a recomputed covariance, as in the published code, and how far they may be.
const NEIGHBORS: usize = 10;
const NEIGHBOR_DISTANCE_M: f32 = 0.2;

/// Whether a frame's pose can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackingStatus {
    /// Yes.
    Tracked,
    /// No: it has none.
    Lost,
}

/// A frame's result.
#[derive(Clone, Debug)]
pub struct Tracked {
    /// Which frame.
    pub index: FrameIndex,
    /// Its time, seconds on the recording's clock.
    pub timestamp_secs: f64,
    /// The verdict.
    pub status: TrackingStatus,
    /// Its pose; `None` when lost.
    pub world_from_camera: Option<Se3>,
    /// How many of its points have a surface and were to be registered.
    pub points: usize,
    /// How many points the sparse map had then.
    pub sparse_points: usize,
    /// How many of its points correspond to the sparse map.
    pub inliers: usize,
    /// Root mean square distance of those along the surface normal, metres.
    pub residual_m: f64,
    /// How well the weakest direction is constrained relative to the strongest, 0 to 1.
    pub conditioning: f64,
    /// Wall time.
    pub duration: Duration,
}

/// Registers frames with the sparse map.
pub struct Tracker {
    config: TrackingConfig,
    keyframe_config: KeyframeConfig,
    policy: KeyframePolicy,
    grid: DepthGrid,
    map: PointMap,
    next_id: u32,
    /// The last trusted pose.
    last: Option<Se3>,
    /// The motion from it to the frame after it, as far as known: `last_from_next`.
    motion: Se3,
    /// The last trusted frame, unless it became a keyframe.
    unmapped: Option<(Arc<RgbdFrame>, Se3)>,
}

/// Side of the sparse map's cells in distances that are searched: a query then mostly meets one cell,
/// of a few dozen points that lie together. Speed alone depends on it: from 3 to 6 it is the same, at
/// 1 tracking takes twice as long.
const CELL_DISTANCES: f32 = 4.0;

impl Tracker {
    /// For frames of one camera, with an empty map; the first frame with enough depth defines the world's axes.
    pub fn new(camera: &Camera, config: &SlamConfig) -> Self {
        let tracking = config.tracking.clone();
        Self {
            policy: KeyframePolicy::new(&config.keyframes),
            grid: tracking_grid(&tracking, camera),
            map: PointMap::new(CELL_DISTANCES * config.keyframes.overlap_distance_m as f32),
            next_id: 0,
            last: None,
            motion: Se3::identity(),
            unmapped: None,
            keyframe_config: config.keyframes.clone(),
            config: tracking,
        }
    }

    /// The frame's verdict and pose, and the keyframe it becomes, if any, whose points have then
    /// joined the sparse map.
    pub fn track(&mut self, frame: &Arc<RgbdFrame>) -> (Tracked, Option<Keyframe>) {
        let start = Instant::now();
        let points = self.grid.surface_points(&frame.depth_m, &frame.camera);
        let sparse_points = self.map.len();
        let registration = self.register(&points);
        let world_from_camera = registration.world_from_camera;
        match (world_from_camera, self.last) {
            (Some(pose), Some(last)) => self.motion = last.inverse() * pose,
            // A lost camera may have moved any way.
            (None, _) => self.motion = Se3::identity(),
            (Some(_), None) => {}
        }
        self.last = world_from_camera.or(self.last);
        let keyframe = world_from_camera.and_then(|pose| {
            let keyframe = self.decide(frame, pose, &points, registration.inliers);
            self.unmapped = keyframe.is_none().then(|| (Arc::clone(frame), pose));
            keyframe
        });
        let tracked = Tracked {
            index: frame.index,
            timestamp_secs: frame.timestamp_secs,
            status: match world_from_camera {
                Some(_) => TrackingStatus::Tracked,
                None => TrackingStatus::Lost,
            },
            world_from_camera,
            points: points.len(),
            sparse_points,
            inliers: registration.inliers,
            residual_m: registration.residual_m,
            conditioning: registration.conditioning,
            duration: start.elapsed(),
        };
        (tracked, keyframe)
    }

    /// The keyframe that the last trusted frame becomes when the recording ends, so that the map
    /// reaches as far as the camera did; `None` if it already is one.
    pub fn finish(&mut self) -> Option<Keyframe> {
        let (frame, world_from_camera) = self.unmapped.take()?;
        Some(Keyframe {
            kind: KeyframeKind::Mapping,
            frame,
            world_from_camera,
            new_points: Vec::new(),
        })
    }

    /// Forgets points that the mapper pruned.
    pub fn update_map(&mut self, removed: &[SparseId]) {
        for id in removed {
            self.map.remove(id.0.into());
        }
    }

    fn register(&self, points: &[SurfacePoint]) -> Registration {
        let Some(last) = self.last else {
            // The first frame: at the origin, if it shows anything at all.
            return Registration {
                world_from_camera: (points.len() >= MIN_POINTS).then(Se3::identity),
                ..Registration::default()
            };
        };
        if points.len() < MIN_POINTS {
            return Registration::default();
        }
        let source: Vec<Point> = points.par_iter().map(|point| self.disk(point)).collect();
        let settings = Settings {
            max_correspondence_distance_m: self.config.max_correspondence_distance_m as f32,
            rotation_epsilon_rad: ROTATION_EPSILON_RAD,
            translation_epsilon_m: TRANSLATION_EPSILON_M,
            ..Settings::default()
        };
        let mut alignment = align(&source, &self.map, &(last * self.motion), &settings);
        if let Ok(unsettled) = &alignment
            && !unsettled.converged
        {
            // Pairs that swap for ever keep it from the last digits: the published ones will do.
            let published = Settings {
                rotation_epsilon_rad: Settings::default().rotation_epsilon_rad,
                translation_epsilon_m: Settings::default().translation_epsilon_m,
                ..settings
            };
            alignment = align(
                &source,
                &self.map,
                &unsettled.target_from_source,
                &published,
            );
        }
        match alignment {
            Ok(alignment) => self.verdict(&alignment),
            // Nothing to align with is a lost frame, not a broken run.
            Err(_) => Registration::default(),
        }
    }

    fn disk(&self, point: &SurfacePoint) -> Point {
        point.disk(self.config.disk_thickness, self.config.noise_power)
    }

    fn verdict(&self, alignment: &Alignment) -> Registration {
        let trusted = alignment.converged
            && alignment.inlier_share >= self.config.min_inlier_share
            && alignment.conditioning.weakest >= self.config.min_conditioning;
        Registration {
            world_from_camera: trusted.then_some(alignment.target_from_source),
            inliers: alignment.inliers,
            residual_m: alignment.rms_residual_m,
            conditioning: alignment.conditioning.weakest,
        }
    }

    fn decide(
        &mut self,
        frame: &Arc<RgbdFrame>,
        world_from_camera: Se3,
        points: &[SurfacePoint],
        inliers: usize,
    ) -> Option<Keyframe> {
        let overlapping = if self.keyframe_config.overlap_distance_m
            == self.config.max_correspondence_distance_m
        {
            // The registration has counted them already.
            inliers
        } else {
            self.count_overlapping(&self.in_world(points, &world_from_camera))
        };
        let kind = self
            .policy
            .decide(overlapping as f64 / points.len() as f64)?;
        let new_points = match kind {
            KeyframeKind::Mapping => Vec::new(),
            KeyframeKind::Tracking => {
                let in_world = self.in_world(points, &world_from_camera);
                self.extend(points, &in_world)
            }
        };
        Some(Keyframe {
            kind,
            frame: Arc::clone(frame),
            world_from_camera,
            new_points,
        })
    }

    fn in_world(&self, points: &[SurfacePoint], world_from_camera: &Se3) -> Vec<Point> {
        let to_world = |point| self.disk(point).transformed(world_from_camera);
        points.par_iter().map(to_world).collect()
    }

    /// How many points have one of the sparse map near.
    fn count_overlapping(&self, in_world: &[Point]) -> usize {
        let reach = self.keyframe_config.overlap_distance_m as f32;
        let overlaps = |point: &&Point| self.map.nearest(&point.position, reach).is_some();
        in_world.par_iter().filter(overlaps).count()
    }

    /// Lets those points join the sparse map that it does not have yet.
    fn extend(&mut self, points: &[SurfacePoint], in_world: &[Point]) -> Vec<NewPoint> {
        let spacing = self.keyframe_config.new_point_distance_m as f32;
        // Decided before any joins: a frame's own points do not keep each other out.
        let new: Vec<usize> = (0..points.len())
            .filter(|&i| self.map.nearest(&in_world[i].position, spacing).is_none())
            .collect();
        let mut new_points = Vec::with_capacity(new.len());
        for &i in &new {
            let id = SparseId(self.next_id);
            self.next_id += 1;
            self.map.insert(id.0.into(), in_world[i]);
            let (u, v) = (points[i].u, points[i].v);
            new_points.push(NewPoint { u, v, id });
        }
        if self.config.target == TargetCovariance::Neighbors {
            self.recompute_covariances(&new_points);
        }
        new_points
    }

    fn recompute_covariances(&mut self, new_points: &[NewPoint]) {
        let ids = new_points.iter().map(|point| u64::from(point.id.0));
        let known: Vec<_> = ids
            .filter_map(|id| Some((id, *self.map.get(id)?)))
            .collect();
        let positions: Vec<Vector3<f32>> = known.iter().map(|(_, point)| point.position).collect();
        let covariances =
            covariances_from_neighbors(&self.map, &positions, NEIGHBORS, NEIGHBOR_DISTANCE_M);
        for ((id, mut point), covariance) in known.into_iter().zip(covariances) {
            if let Some(covariance) = covariance {
                point.covariance = covariance;
                self.map.insert(id, point);
            }
        }
    }
}

/// What a registration says of a frame; by default nothing.
#[derive(Default)]
struct Registration {
    world_from_camera: Option<Se3>,
    inliers: usize,
    residual_m: f64,
    conditioning: f64,
}
