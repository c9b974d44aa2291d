//! The time that the depth camera takes to read its rows, from surfaces that two of its images show.
//!
//! A point of the first image should lie in the plane that the second image shows there; both images
//! have rolling shutters, see [`crate::readout`].

use fgs_geom::Se3;
use nalgebra::{SVector, Vector3, Vector6};

use crate::TimeEstimate;
use crate::normal_equations::NormalEquations;
use crate::readout::{self, Pair, RollingJacobian, RollingMotion, Row};

/// A floor on the noise of the residuals, metres at a depth of one metre.
const MIN_NOISE: f64 = 1e-4;

/// A point of the first image and the plane that it lies in according to the second.
#[derive(Clone, Debug)]
pub struct PlaneMatch {
    /// Measured in the first image, in the depth camera's axes when that row was read, metres.
    pub point: Vector3<f64>,
    /// The row that it was read from.
    pub point_row: usize,
    /// A point of the plane in the second image, in the camera's axes when that row was read, metres.
    pub plane_point: Vector3<f64>,
    /// Unit normal of the plane, in the same axes.
    pub plane_normal: Vector3<f64>,
    /// The row that the plane was read from.
    pub plane_row: usize,
}

/// Two depth images.
#[derive(Clone, Debug)]
pub struct DepthPair {
    matches: Vec<PlaneMatch>,
    height: usize,
    motion: RollingMotion,
}

impl DepthPair {
    /// For images of `height` rows. `second_from_first` is the motion between the images as far as it
    /// is known, and `velocities` are the depth camera's twists `[omega, v]` at the time of each image
    /// in its own axes, rad/s and m/s.
    pub fn new(
        matches: Vec<PlaneMatch>,
        height: usize,
        second_from_first: Se3,
        velocities: [Vector6<f64>; 2],
    ) -> Self {
        Self {
            matches,
            height,
            motion: RollingMotion {
                second_from_first,
                velocities,
            },
        }
    }

    /// Distance of a point from its plane as a multiple of what a sensor errs by that errs by 1 at 1 m,
    /// and its derivatives.
    #[inline]
    fn row(
        &self,
        pair: &PlaneMatch,
        rows: [&[Row]; 2],
        first_velocity_in_second: &Vector6<f64>,
    ) -> Option<(f64, SVector<f64, 7>)> {
        let (first_row, second_row) = (rows[0].get(pair.point_row)?, rows[1].get(pair.plane_row)?);
        let middle = (self.motion.second_from_first).transform(&first_row.to_middle(&pair.point));
        let distance =
            (pair.plane_normal).dot(&(second_row.from_middle(&middle) - pair.plane_point));
        // The error of structured light and stereo grows with the square of the depth.
        let scale = 1.0 / pair.plane_point.z.powi(2);
        let RollingJacobian {
            by_motion,
            by_readout,
        } = self.motion.jacobian(
            [first_row, second_row],
            first_velocity_in_second,
            &middle,
            &(scale * pair.plane_normal),
        );
        let mut jacobian = SVector::<f64, 7>::zeros();
        jacobian.fixed_rows_mut::<6>(0).copy_from(&by_motion);
        jacobian[6] = by_readout;
        Some((scale * distance, jacobian))
    }
}

impl Pair<7> for DepthPair {
    fn linearize(&self, readout_secs: f64) -> Option<NormalEquations<7>> {
        let [first_rows, second_rows] =
            (self.motion.velocities).map(|velocity| Row::all(self.height, &velocity, readout_secs));
        let velocity = self.motion.first_velocity_in_second();
        let rows: Vec<_> = self
            .matches
            .iter()
            .filter_map(|pair| self.row(pair, [&first_rows, &second_rows], &velocity))
            .collect();
        NormalEquations::robust(&rows, MIN_NOISE)
    }

    fn step(&mut self, step: &SVector<f64, 7>) {
        self.motion.perturb(&step.fixed_rows::<6>(0).into_owned());
    }
}

/// The readout of the depth camera that best explains the pairs, which are in temporal order:
/// [`fgs_geom::DepthSensor::readout_secs`]. The search starts at `start_secs`. `None` if too few pairs
/// tell it, as at rest.
pub fn depth_readout(pairs: Vec<DepthPair>, start_secs: f64) -> Option<TimeEstimate> {
    readout::fit(pairs, start_secs)
}
