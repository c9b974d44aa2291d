//! Finds a frame's pose from a guess: registration of its surfaces with the sparse map, then
//! alignment with keyframes by brightness. Says how much speaks for the answer.

use std::borrow::Cow;
use std::sync::Arc;

use fgs_direct::{IntensityPyramid, PosePrior};
use fgs_geom::{KeyframeId, RgbdFrame, Se3};
use fgs_gicp::{Alignment, Factor, Point, Settings, SurfacePoint, align};
use nalgebra::{Matrix6, Vector6};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::color_aligner::ColorAligner;
use crate::config::{SlamConfig, SurfaceConfig, TrackingConfig};
use crate::motion::{MotionModel, Prediction};
use crate::sparse_map::SparseMap;
use crate::verdict::{Evidence, Verdict};
use crate::weak_directions::{fused_pose, held_information};

/// Fewer points with a surface say nothing about the camera.
const MIN_POINTS: usize = 50;

/// A registration has converged when a step is smaller. Half of the published 2e-3 and 5e-4: the
/// last step costs little, and what it misses adds up along the way.
const ROTATION_EPSILON_RAD: f64 = 1e-3;
const TRANSLATION_EPSILON_M: f64 = 2e-4;

/// Steps after which the velocity is known well enough to correct for rolling shutters.
const ROUGH_STEPS: usize = 4;

/// No depth camera measures a surface better than this at the distances of a room: a floor under
/// the noise that a registration finds in its residuals.
const SENSOR_NOISE_M: f64 = 1e-4;

/// How much of the corners' information counts: their errors are not as independent as it says. With all
/// of it they moved poses of slow cameras by centimetres; with a hundredth fast ones slid along walls.
const CORNER_TRUST: f64 = 0.1;

/// Registers frames; settings only.
pub struct Registrar {
    config: TrackingConfig,
    surface: SurfaceConfig,
}

/// What frames are registered with.
#[derive(Clone, Copy)]
pub struct Known<'a> {
    pub map: &'a SparseMap,
    pub keyframes: &'a ColorAligner,
    pub motion: &'a MotionModel,
}

/// A frame and its surface points.
#[derive(Clone, Copy)]
pub struct Measured<'a> {
    pub frame: &'a Arc<RgbdFrame>,
    pub points: &'a [SurfacePoint],
    /// When it was taken.
    pub seconds: f64,
}

/// Where a registration starts: the depth camera's pose.
#[derive(Clone, Copy)]
pub struct Start {
    pub world_from_depth: Se3,
    /// How sure it is, tangent `[omega, v]`: where the frame's points do not hold the camera, it stays.
    pub information: Matrix6<f64>,
    /// Whether it holds the camera where nothing else does.
    pub holds: bool,
}

impl Start {
    /// What corners say.
    pub fn from_corners(world_from_depth: Se3, information: &Matrix6<f64>) -> Self {
        Self {
            world_from_depth,
            information: CORNER_TRUST * information,
            holds: false,
        }
    }

    /// What the motion model predicts.
    pub fn predicted(predicted: &Prediction) -> Self {
        let (turn, shift) = (
            predicted.rotation_rad.powi(-2),
            predicted.translation_m.powi(-2),
        );
        let information =
            Matrix6::from_diagonal(&Vector6::new(turn, turn, turn, shift, shift, shift));
        Self {
            world_from_depth: predicted.world_from_camera,
            information,
            holds: predicted.holds,
        }
    }
}

/// A pose that was found, and what speaks for it.
pub struct Attempt {
    pub located: Located,
    /// The frame as of the middle row of its colour image.
    pub frame: Arc<RgbdFrame>,
    /// Its brightness, if colour takes part in tracking.
    pub pyramid: Option<IntensityPyramid>,
    pub evidence: Evidence,
    /// What the evidence is worth.
    pub verdict: Verdict,
    /// Whether it is worth looking for a better pose.
    pub is_doubtful: bool,
    /// The keyframe by whose look it was found, if nothing else led there.
    pub relocalized_by: Option<KeyframeId>,
    /// The [uncertainty](Evidence::uncertainty_m) by depth and colour alone.
    pub uncertainty_m: f64,
    /// The depth camera's pose by registration alone.
    pub world_from_depth: Se3,
    /// [`Alignment::residual_variance`]; 0 if nothing was registered.
    pub residual_variance: f64,
}

/// Where a frame was taken.
#[derive(Clone, Copy, Serialize, Deserialize)]
pub struct Located {
    pub world_from_camera: Se3,
    /// Twist `[omega, v]` in the camera's axes, rad/s and m/s.
    pub velocity: Vector6<f64>,
    /// See [`Keyframe::information`](crate::Keyframe::information).
    pub information: Option<Matrix6<f64>>,
}

impl Located {
    /// What is known of the pose; `None` where nothing was registered.
    pub fn prior(&self) -> Option<PosePrior> {
        Some(PosePrior {
            world_from_camera: self.world_from_camera,
            information: self.information?,
        })
    }
}

/// The depth camera's pose.
#[derive(Clone, Copy)]
struct Registered {
    world_from_depth: Se3,
    /// Tangent in the depth camera's axes.
    information: Option<Matrix6<f64>>,
    /// What of it the points hold.
    held: Matrix6<f64>,
    /// What else holds the camera.
    carried: Matrix6<f64>,
    residual_variance: f64,
}

impl Registrar {
    pub fn new(config: &SlamConfig) -> Self {
        Self {
            config: config.tracking.clone(),
            surface: config.surface.clone(),
        }
    }

    /// Whether colour takes part.
    pub fn uses_color(&self) -> bool {
        self.config.color
    }

    /// The pose of the frame that starts a map: its colour camera is at a pose of our choice. `None` if
    /// it has too few points.
    pub fn place(
        &self,
        measured: Measured,
        known: Known,
        world_from_camera: &Se3,
    ) -> Option<Attempt> {
        (measured.points.len() >= MIN_POINTS).then(|| {
            let color_from_depth = measured.frame.depth_sensor.color_from_depth;
            let registered = Registered {
                world_from_depth: *world_from_camera * color_from_depth,
                information: None,
                held: Matrix6::zeros(),
                carried: Matrix6::zeros(),
                residual_variance: 0.0,
            };
            Attempt {
                verdict: Verdict::Tracked,
                is_doubtful: false,
                uncertainty_m: 0.0,
                ..self.locate(measured, known, &registered, Evidence::default())
            }
        })
    }

    /// The pose of a frame, found from a start; `None` if it cannot be registered at all.
    pub fn attempt(&self, measured: Measured, known: Known, start: &Start) -> Option<Attempt> {
        if measured.points.len() < MIN_POINTS {
            return None;
        }
        let mut from = start.world_from_depth;
        if measured.frame.depth_sensor.readout_secs != 0.0 {
            // Where the rows were read from follows from the velocity, which a few steps tell.
            let source = self.disks_on_the_way_to(&from, measured, known);
            let roughly = self.align_roughly(&source, known.map, &from)?;
            from = self
                .registered(&roughly, &source, known.map, start)
                .world_from_depth;
        }
        let (alignment, registered) = self.register_from(&from, measured, known, start)?;
        let evidence = Evidence {
            converged: alignment.converged,
            inliers: alignment.inliers,
            inlier_share: alignment.inlier_share,
            residual_m: alignment.rms_residual_m,
            uncertainty_m: 0.0,
            agreement: None,
        };
        Some(self.locate(measured, known, &registered, evidence))
    }

    /// The depth camera's pose from a start, by registration alone. Where a rolling shutter read its rows follows
    /// from the motion to the start.
    pub fn register(&self, measured: Measured, known: Known, start: &Start) -> Option<Se3> {
        let from = start.world_from_depth;
        let (_, registered) = self.register_from(&from, measured, known, start)?;
        Some(registered.world_from_depth)
    }

    /// Registers a frame from a pose near the start.
    fn register_from(
        &self,
        from: &Se3,
        measured: Measured,
        known: Known,
        start: &Start,
    ) -> Option<(Alignment, Registered)> {
        let source = self.disks_on_the_way_to(from, measured, known);
        let alignment = self.align(&source, known.map, from)?;
        let registered = self.registered(&alignment, &source, known.map, start);
        Some((alignment, registered))
    }

    /// The pose of a frame without depth of its own, from a start and its colours; `None` if no keyframe
    /// speaks for it.
    pub fn follow(&self, measured: Measured, known: Known, start: &Start) -> Option<Located> {
        let started = Registered {
            world_from_depth: start.world_from_depth,
            information: Some(start.information),
            held: start.information,
            carried: Matrix6::zeros(),
            residual_variance: 0.0,
        };
        let attempt = self.locate(measured, known, &started, Evidence::default());
        attempt.evidence.agrees().then_some(attempt.located)
    }

    /// The pose of a registration where its points hold the camera, the start where they do not.
    fn registered(
        &self,
        alignment: &Alignment,
        source: &[Point],
        map: &SparseMap,
        start: &Start,
    ) -> Registered {
        let held = held_information(
            alignment,
            source,
            map.points(),
            self.surface.disk_thickness,
            self.config.max_correspondence_distance_m,
            SENSOR_NOISE_M,
        );
        let held = self.config.depth_trust * held;
        let carried = if start.holds {
            start.information
        } else {
            Matrix6::zeros()
        };
        Registered {
            world_from_depth: fused_pose(
                &alignment.target_from_source,
                &start.world_from_depth,
                [&held, &start.information],
            ),
            information: Some(self.information(alignment) + carried),
            held,
            carried,
            residual_variance: alignment.residual_variance,
        }
    }

    /// Which of a frame's points fit the map at a pose of the depth camera: the squared residual relative to the
    /// points' covariances is at most `limit`.
    pub fn fitting(
        &self,
        measured: Measured,
        known: Known,
        world_from_depth: &Se3,
        limit: f64,
    ) -> Vec<bool> {
        let disks = self.disks_on_the_way_to(world_from_depth, measured, known);
        let rotation = world_from_depth.rotation.to_rotation_matrix().into_inner();
        let translation = world_from_depth.translation;
        let reach_m = self.config.max_correspondence_distance_m as f32;
        let fits = |disk: &Point| {
            let p = disk.position.cast::<f64>();
            let query = (rotation * p + translation).cast();
            let found = known.map.points().nearest(&query, reach_m)?;
            let factor = Factor::new(
                &p,
                &disk.covariance.matrix(),
                &found.point.position.cast(),
                &found.point.covariance.matrix(),
                &rotation,
                &translation,
            )?;
            Some(factor.cost() <= limit)
        };
        let fits = disks.par_iter().map(|disk| fits(disk).unwrap_or(false));
        fits.collect()
    }

    /// Takes the first steps of a registration.
    fn align_roughly(&self, source: &[Point], map: &SparseMap, start: &Se3) -> Option<Alignment> {
        let settings = Settings {
            max_correspondence_distance_m: self.config.max_correspondence_distance_m as f32,
            max_iterations: ROUGH_STEPS,
            ..Settings::default()
        };
        align(source, map.points(), start, &settings).ok()
    }

    /// Registers points with the sparse map.
    fn align(&self, source: &[Point], map: &SparseMap, start: &Se3) -> Option<Alignment> {
        let settings = Settings {
            max_correspondence_distance_m: self.config.max_correspondence_distance_m as f32,
            rotation_epsilon_rad: ROTATION_EPSILON_RAD,
            translation_epsilon_m: TRANSLATION_EPSILON_M,
            ..Settings::default()
        };
        let alignment = align(source, map.points(), start, &settings).ok()?;
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
        align(source, map.points(), &start, &published).ok()
    }

    /// The colour camera's pose: from the depth camera's by its motion between the two images, then
    /// by what the colours say.
    fn locate(
        &self,
        measured: Measured,
        known: Known,
        registered: &Registered,
        mut evidence: Evidence,
    ) -> Attempt {
        let velocity = (known.motion).velocity_to(&registered.world_from_depth, measured.seconds);
        let frame = shared(measured.frame, measured.frame.with_steady_color(&velocity));
        let pyramid = self.uses_color().then(|| ColorAligner::pyramid(&frame));
        let depth_from_color = frame.depth_sensor.color_from_depth(&velocity).inverse();
        let depth_by_color = depth_from_color.adjoint();
        let in_color_axes =
            |information: &Matrix6<f64>| depth_by_color.transpose() * information * depth_by_color;
        let mut located = Located {
            world_from_camera: registered.world_from_depth * depth_from_color,
            velocity,
            information: registered.information.as_ref().map(in_color_axes),
        };
        let mut held = in_color_axes(&registered.held);
        if let Some(pyramid) = &pyramid {
            let at = |pose: &Se3| Evidence {
                agreement: known.keyframes.agreement(pyramid, &frame.depth_m, pose),
                ..evidence
            };
            let prior = located.prior();
            let aligned = prior.and_then(|prior| known.keyframes.align(pyramid, &prior));
            // Far alignments are mostly false minima, but not if they look better.
            let is_better =
                |by_color: &Evidence| by_color.agrees_better_than(&at(&located.world_from_camera));
            let believed = aligned
                .map(|aligned| (at(&aligned.world_from_camera), aligned))
                .filter(|(by_color, aligned)| !aligned.contradicts_prior || is_better(by_color));
            if let Some((by_color, aligned)) = believed {
                located.world_from_camera = aligned.world_from_camera;
                located.information = located.information.map(|known| known + aligned.information);
                held += aligned.information;
                evidence = by_color;
            } else {
                evidence = at(&located.world_from_camera);
            }
        }
        evidence.uncertainty_m = position_uncertainty_m(&held);
        let uncertainty_m = evidence.uncertainty_m;
        if registered.carried != Matrix6::zeros() {
            held += in_color_axes(&registered.carried);
            evidence.uncertainty_m = position_uncertainty_m(&held);
        }
        Attempt {
            world_from_depth: registered.world_from_depth,
            residual_variance: registered.residual_variance,
            uncertainty_m,
            verdict: evidence.verdict(&self.config),
            is_doubtful: evidence.is_doubtful(&self.config),
            relocalized_by: None,
            located,
            frame,
            pyramid,
            evidence,
        }
    }

    /// The disks of a frame to which the depth camera came by the motion to a pose.
    fn disks_on_the_way_to(&self, pose: &Se3, measured: Measured, known: Known) -> Vec<Point> {
        let velocity = known.motion.velocity_to(pose, measured.seconds);
        self.disks(measured.points, measured.frame, &velocity)
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

    /// What a registration is worth beside other measurements: inverse covariance, tangent
    /// `[omega, v]` in the axes of what was registered.
    pub fn information(&self, alignment: &Alignment) -> Matrix6<f64> {
        self.config.depth_trust * alignment.information(SENSOR_NOISE_M)
    }

    /// A point as a disk in the depth camera's axes.
    pub fn disk(&self, point: &SurfacePoint) -> Point {
        point.disk(self.surface.disk_thickness, self.surface.noise_power)
    }
}

/// The standard deviation of a position along its worst direction, metres, given the information of a pose,
/// `[omega, v]`.
fn position_uncertainty_m(information: &Matrix6<f64>) -> f64 {
    // What is not known at all is known to 30 m and rad.
    let known: Matrix6<f64> = information + 1e-3 * Matrix6::identity();
    let covariance = known.try_inverse().unwrap_or_else(Matrix6::zeros);
    let of_position = covariance.fixed_view::<3, 3>(3, 3).into_owned();
    of_position.symmetric_eigenvalues().max().max(0.0).sqrt()
}

/// A frame that may be the same as one that is shared already.
pub fn shared(frame: &Arc<RgbdFrame>, changed: Cow<'_, RgbdFrame>) -> Arc<RgbdFrame> {
    match changed {
        Cow::Borrowed(_) => Arc::clone(frame),
        Cow::Owned(changed) => Arc::new(changed),
    }
}
