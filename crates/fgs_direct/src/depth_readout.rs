//! The time that the depth camera takes to read its rows, from surfaces that two of its images show.
//!
//! A point of the first image should lie in the plane that the second image shows there; both images
//! have rolling shutters, see [`crate::readout`].

use std::sync::Arc;

use fgs_geom::{Camera, Image, Se3};
use nalgebra::{SVector, Vector2, Vector3, Vector6};

use crate::TimeEstimate;
use crate::normal_equations::NormalEquations;
use crate::readout::{self, Pair, RollingJacobian, RollingMotion, Row};

/// A floor on the noise of the residuals, metres at a depth of one metre.
const MIN_NOISE: f64 = 1e-4;

/// Points further from the plane, as a share of its depth, are not of the same surface, ...
const MAX_DISTANCE: f64 = 0.03;

/// ... nor are those whose normals' cosine is smaller.
const MIN_COSINE: f64 = 0.9;

/// A small piece of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    /// In the depth camera's axes when its row was read, metres.
    pub point: Vector3<f64>,
    /// Unit normal, in the same axes.
    pub normal: Vector3<f64>,
    /// The row that it was read from.
    pub row: usize,
}

/// The patches of a depth image, one for each cell of some pixels in either direction.
#[derive(Clone, Debug)]
pub struct PatchGrid {
    /// Of the depth image.
    pub camera: Camera,
    /// Pixels on each side of a cell, at least 1.
    pub cell_px: usize,
    /// For each cell.
    pub patches: Image<Option<Patch>>,
}

impl PatchGrid {
    /// The patch where a point is seen.
    #[inline]
    fn at(&self, pixel: &Vector2<f64>) -> Option<&Patch> {
        let (u, v) = (pixel.x.round(), pixel.y.round());
        let cell = |x: f64| x as usize / self.cell_px;
        let is_inside = u >= 0.0
            && v >= 0.0
            && cell(u) < self.patches.width()
            && cell(v) < self.patches.height();
        self.patches
            .data()
            .get(cell(v) * self.patches.width() + cell(u))
            .filter(|_| is_inside)?
            .as_ref()
    }
}

/// Two depth images.
#[derive(Clone, Debug)]
pub struct DepthPair {
    first: Arc<PatchGrid>,
    second: Arc<PatchGrid>,
    motion: RollingMotion,
}

impl DepthPair {
    /// `second_from_first` is the motion between the images as far as it
    /// is known, and `velocities` are the depth camera's twists `[omega, v]` at the time of each image
    /// in its own axes, rad/s and m/s.
    pub fn new(
        first: Arc<PatchGrid>,
        second: Arc<PatchGrid>,
        second_from_first: Se3,
        velocities: [Vector6<f64>; 2],
    ) -> Self {
        Self {
            first,
            second,
            motion: RollingMotion {
                second_from_first,
                velocities,
            },
        }
    }

    /// The motion between the images.
    pub fn second_from_first(&self) -> Se3 {
        self.motion.second_from_first
    }

    /// Distance of a point from its plane as a multiple of what a sensor errs by that errs by 1 at 1 m,
    /// and its derivatives.
    #[inline]
    fn row(
        &self,
        patch: &Patch,
        rows: [&[Row]; 2],
        first_velocity_in_second: &Vector6<f64>,
    ) -> Option<(f64, SVector<f64, 7>)> {
        let first_row = rows[0].get(patch.row)?;
        let middle = (self.motion.second_from_first).transform(&first_row.in_middle(&patch.point));
        let pixel = readout::pixel(&middle, rows[1], &self.second.camera)?;
        let plane = self.second.at(&pixel)?;
        let second_row = rows[1].get(plane.row)?;
        let distance = plane
            .normal
            .dot(&(second_row.of_middle(&middle) - plane.point));
        let normal = self.motion.second_from_first.rotation * patch.normal;
        if distance.abs() > MAX_DISTANCE * plane.point.z || normal.dot(&plane.normal) < MIN_COSINE {
            return None;
        }
        // The error of structured light and stereo grows with the square of the depth.
        let scale = 1.0 / plane.point.z.powi(2);
        let RollingJacobian {
            by_motion,
            by_readout,
        } = self.motion.jacobian(
            [first_row, second_row],
            first_velocity_in_second,
            &middle,
            &(scale * plane.normal),
        );
        let mut jacobian = SVector::<f64, 7>::zeros();
        jacobian.fixed_rows_mut::<6>(0).copy_from(&by_motion);
        jacobian[6] = by_readout;
        Some((scale * distance, jacobian))
    }
}

impl Pair<7> for DepthPair {
    fn linearize(&self, readout_secs: f64) -> Option<NormalEquations<7>> {
        let [first, second] = self.motion.velocities;
        let first_rows = Row::all(self.first.camera.height, &first, readout_secs);
        let second_rows = Row::all(self.second.camera.height, &second, readout_secs);
        let velocity = self.motion.first_velocity_in_second();
        let patches = self.first.patches.data().iter().flatten();
        let rows: Vec<_> = patches
            .filter_map(|patch| self.row(patch, [&first_rows, &second_rows], &velocity))
            .collect();
        NormalEquations::robust(&rows, MIN_NOISE)
    }

    fn step(&mut self, step: &SVector<f64, 7>) {
        self.motion.perturb(&step.fixed_rows::<6>(0).into_owned());
    }
}

/// The readout of the depth camera that best explains the pairs, which are in temporal order:
/// [`fgs_geom::DepthSensor::readout_secs`]. The search starts at `start_secs`. `None` if too few pairs
/// tell it, as at rest. The motions of the pairs become those that fit.
pub fn depth_readout(pairs: &mut [DepthPair], start_secs: f64) -> Option<TimeEstimate> {
    readout::fit(pairs, start_secs)
}
