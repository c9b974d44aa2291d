//! Whether a new keyframe shows what an old one shows, and how the two lie to each other. Corners, the
//! registration of surfaces and the brightness of both must all say so.

use fgs_direct::IntensityPyramid;
use fgs_geom::{KeyframeId, RgbdFrame, Se3};
use fgs_gicp::{Point, PointMap, Settings, SurfacePoint, align};
use fgs_graph::{Edge, KeyframeGraph, RobustKernel};
use nalgebra::{Matrix6, Vector6};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Memory;
use super::detect::Ways;
use crate::relocalizer::Relocalizer;

/// What must speak for a revisit.
pub struct Limits {
    /// Corners that must agree.
    inliers: usize,
    /// The share of the new keyframe's surface points that must lie on the old surfaces.
    inlier_share: f64,
    /// Support of the new keyframe by the old one.
    support: f64,
}

/// For a loop, of which the way round says that it is possible. The corners are twice what a pose without a
/// first guess takes, since nothing is lost by waiting for a better view.
pub const LOOP: Limits = Limits {
    inliers: 20,
    inlier_share: 0.4,
    support: 0.5,
};

/// Where nothing else is known, as between sub-maps: what finds a lost camera.
pub const MEETING: Limits = Limits {
    inliers: 30,
    inlier_share: 0.75,
    support: 0.75,
};

/// Points correspond up to this distance from where corners put them, then up to this, metres.
const SEARCH_M: [f64; 2] = [0.06, 0.03];

/// Two views of one surface do not differ by more, root mean square, relative to the depth.
const MAX_RESIDUAL: f64 = 0.01;

/// So many of the old keyframe's points must be in view, and this share of them.
const MIN_COMPARED: usize = 25;
const MIN_SHARE: f64 = 0.25;

/// Surfaces of keyframes within this way of the old one, but nearer to it than to the new one, belong to the same
/// view of the place: what is far in view was mostly seen long before.
const NEIGHBOURHOOD_M: f64 = 6.0;

/// Errors that residuals do not show, because neighbouring pixels share them: standard deviations of
/// the turn (rad) and the shift (metres). On recordings of consumer sensors corners are off by this.
const CORNERS_FLOOR: [f64; 2] = [0.01, 0.015];
const SURFACES_FLOOR: [f64; 2] = [0.005, 0.006];

/// 99 % of the squared errors of a right prediction are smaller (six degrees of freedom).
const MAX_CHI2: f64 = 16.8;

/// What corners alone find is worth a look beyond this squared error: of successive keyframes on recordings
/// that are tracked well, two in a hundred differ by more from the corners of both.
pub const MAYBE_NEWS: f64 = 4.0;

/// A place seen again.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Revisit {
    pub old: KeyframeId,
    pub new: KeyframeId,
    /// The measured pose of the new keyframe in the axes of the old.
    pub old_from_new: Se3,
    /// Its inverse covariance, tangent `[omega, v]` in the axes of the new.
    pub information: Matrix6<f64>,
}

impl Revisit {
    /// How far the measurement is from what the graph says, in the axes of the new keyframe.
    pub fn drift(&self, graph: &KeyframeGraph) -> Option<Se3> {
        let (old, new) = (graph.pose(self.old)?, graph.pose(self.new)?);
        Some(new.inverse() * *old * self.old_from_new)
    }

    /// The squared error of another measurement of the same, in standard deviations of this one.
    pub fn error_of(&self, old_from_new: &Se3) -> f64 {
        self.squared(&(self.old_from_new.inverse() * *old_from_new))
    }

    /// How far a motion in the axes of the new keyframe is, squared, in standard deviations.
    fn squared(&self, motion: &Se3) -> f64 {
        let tangent = motion.log();
        tangent.dot(&(self.information * tangent))
    }

    /// Whether the graph says otherwise, beyond the measurement's noise.
    pub fn contradicts(&self, graph: &KeyframeGraph) -> bool {
        let drift = self.drift(graph);
        drift.is_some_and(|drift| self.squared(&drift) > MAX_CHI2)
    }

    /// What the graph is told of it.
    pub fn edge(&self, kernel: RobustKernel) -> Edge {
        Edge {
            from: self.old,
            to: self.new,
            from_from_to: self.old_from_new,
            information: self.information,
            kernel,
        }
    }

    /// Whether the graph says otherwise, beyond the measurement's noise, but not more than drift can
    /// explain.
    pub fn is_news(&self, graph: &KeyframeGraph, ways: &Ways, chi2: f64) -> bool {
        self.drift(graph)
            .is_some_and(|drift| ways.allows(self.old, &drift) && self.squared(&drift) > chi2)
    }
}

/// A keyframe to recognise: its images, with depth as its colour camera sees it.
#[derive(Clone, Copy)]
pub struct Seen<'a> {
    pub id: KeyframeId,
    pub frame: &'a RgbdFrame,
    pub pyramid: &'a IntensityPyramid,
}

/// How a new keyframe lies to one of some old ones, if it shows the same and that is news beyond a squared
/// error.
pub fn verify(
    new: Seen,
    candidates: &[KeyframeId],
    limits: &Limits,
    is_news: impl Fn(&Revisit, f64) -> bool,
    graph: &KeyframeGraph,
    memory: &Memory,
) -> Option<Revisit> {
    let (guess, _) = (candidates.iter())
        .filter_map(|old| by_corners(*old, new.id, limits.inliers, memory.places))
        .filter(|(guess, _)| is_news(guess, MAYBE_NEWS))
        .max_by_key(|(_, inliers)| *inliers)?;
    let revisit = registered(new, &guess, limits, graph, memory)?;
    let is_same = is_news(&revisit, MAX_CHI2) && looks_alike(new, &revisit, limits, memory);
    is_same.then_some(revisit)
}

/// How a keyframe lies to another by their corners, and how many agree; `None` if they are too few.
fn by_corners(
    old: KeyframeId,
    new: KeyframeId,
    min_inliers: usize,
    places: &Relocalizer,
) -> Option<(Revisit, usize)> {
    let relative = places.relative_pose(old, new)?;
    if relative.inliers < min_inliers {
        return None;
    }
    let revisit = Revisit {
        old,
        new,
        old_from_new: relative.a_from_b,
        information: with_errors(&relative.information, CORNERS_FLOOR)?,
    };
    Some((revisit, relative.inliers))
}

/// How a keyframe lies to the one before it by their corners, where these would find a lost camera.
pub fn seen_by_both(before: KeyframeId, new: KeyframeId, places: &Relocalizer) -> Option<Revisit> {
    let (revisit, _) = by_corners(before, new, MEETING.inliers, places)?;
    Some(revisit)
}

/// Whether a new keyframe looks like the old one from where it is said to be.
fn looks_alike(new: Seen, revisit: &Revisit, limits: &Limits, memory: &Memory) -> bool {
    let new_from_old = revisit.old_from_new.inverse();
    let depth_m = &new.frame.depth_m;
    let seen = (memory.color).agreement_with(revisit.old, new.pyramid, depth_m, &new_from_old);
    seen.is_some_and(|seen| {
        seen.points >= MIN_COMPARED && seen.share >= MIN_SHARE && seen.support() >= limits.support
    })
}

/// Registers a new keyframe's surfaces with those around the old one.
fn registered(
    new: Seen,
    guess: &Revisit,
    limits: &Limits,
    graph: &KeyframeGraph,
    memory: &Memory,
) -> Option<Revisit> {
    let around = Ways::from(graph, guess.old);
    let world_from_old = graph.pose(guess.old)?;
    let mut pose = *world_from_old * guess.old_from_new;
    let surface = memory
        .grid
        .surface_points(&new.frame.depth_m, &new.frame.camera);
    let to_disk = |point: &SurfacePoint| memory.registrar.disk(point);
    let source: Vec<Point> = surface.par_iter().map(to_disk).collect();
    let mut target = PointMap::new(4.0 * SEARCH_M[0] as f32);
    let camera_from_world = pose.inverse();
    let reach_m = NEIGHBOURHOOD_M.min(0.5 * around.to(new.id));
    let anchored = (memory.map).anchored(|anchor| around.to(anchor) <= reach_m);
    for (id, point) in anchored {
        let in_camera = camera_from_world.transform(&point.position.cast());
        if new.frame.camera.project(&in_camera).is_some() {
            target.insert(id, *point);
        }
    }
    let mut alignment = None;
    for distance in SEARCH_M {
        let settings = Settings {
            max_correspondence_distance_m: distance as f32,
            ..Settings::default()
        };
        let aligned = align(&source, &target, &pose, &settings).ok()?;
        pose = aligned.target_from_source;
        alignment = Some(aligned);
    }
    let alignment = alignment?;
    let depth_m = surface.iter().map(|point| point.measured.z).sum::<f64>() / surface.len() as f64;
    let holds = alignment.converged
        && alignment.inlier_share >= limits.inlier_share
        && alignment.rms_residual_m <= MAX_RESIDUAL * depth_m
        && guess.error_of(&(world_from_old.inverse() * pose)) <= MAX_CHI2;
    holds.then_some(())?;
    Some(Revisit {
        old_from_new: (world_from_old.inverse() * pose).renormalized(),
        information: with_errors(&memory.registrar.information(&alignment), SURFACES_FLOOR)?,
        ..guess.clone()
    })
}

/// Information after independent errors of these standard deviations, of the turn (rad) and the shift
/// (metres), have been added; `None` if there is none in some direction.
pub fn with_errors(information: &Matrix6<f64>, deviations: [f64; 2]) -> Option<Matrix6<f64>> {
    let [turn, shift] = deviations.map(|deviation| deviation.powi(2));
    let variances = Vector6::new(turn, turn, turn, shift, shift, shift);
    let covariance = information.cholesky()?.inverse() + Matrix6::from_diagonal(&variances);
    let information = covariance.cholesky()?.inverse();
    Some(0.5 * (information + information.transpose()))
}
