//! The time that the colour camera takes to read its rows, from the brightness of points with depth.
//!
//! As in the alignment of two images, a point of the first image should be as bright in the second, up
//! to gain and offset; here both images have rolling shutters, see [`crate::readout`].

use std::sync::Arc;

use fgs_geom::Se3;
use nalgebra::{SVector, Vector3, Vector6};

use crate::image_alignment::MIN_NOISE;
use crate::normal_equations::NormalEquations;
use crate::readout::{self, Pair, RollingJacobian, RollingMotion, Row, nearest_row};
use crate::residual::brightness;
use crate::{IntensityImage, TimeEstimate};

/// Two colour images, of the first only the brightness of some points.
#[derive(Clone, Debug)]
pub struct ColorPair {
    points: Vec<ColoredPoint>,
    /// Rows of the first image.
    first_height: usize,
    second: Arc<IntensityImage>,
    motion: RollingMotion,
    gain: f64,
    offset: f64,
}

#[derive(Clone, Debug)]
struct ColoredPoint {
    /// In the camera's axes when its row was read.
    position: Vector3<f64>,
    row: usize,
    brightness: f64,
}

impl ColorPair {
    /// `points` are where the first image shows them, in the camera's axes, metres;
    /// `second_from_first` is the motion between the images as far as it is known, and `velocities` are
    /// the camera's twists `[omega, v]` at the time of each image in its own axes, rad/s and m/s.
    pub fn new(
        first: &IntensityImage,
        second: Arc<IntensityImage>,
        points: &[Vector3<f64>],
        second_from_first: Se3,
        velocities: [Vector6<f64>; 2],
    ) -> Self {
        let seen = |point: &Vector3<f64>| {
            let pixel = first.camera.project(point)?;
            let [brightness, ..] = first.sample(pixel.x, pixel.y)?;
            Some(ColoredPoint {
                position: *point,
                row: nearest_row(pixel.y, first.camera.height),
                brightness: brightness.into(),
            })
        };
        Self {
            points: points.iter().filter_map(seen).collect(),
            first_height: first.camera.height,
            second,
            motion: RollingMotion {
                second_from_first,
                velocities,
            },
            gain: 1.0,
            offset: 0.0,
        }
    }

    /// The motion between the images.
    pub fn second_from_first(&self) -> Se3 {
        self.motion.second_from_first
    }

    /// The camera's twists at the time of each image.
    pub fn velocities(&self) -> [Vector6<f64>; 2] {
        self.motion.velocities
    }

    /// Residual of a point and its derivatives.
    #[inline]
    fn row(
        &self,
        point: &ColoredPoint,
        rows: [&[Row]; 2],
        first_velocity_in_second: &Vector6<f64>,
    ) -> Option<(f64, SVector<f64, 9>)> {
        let first_row = &rows[0][point.row];
        let middle =
            (self.motion.second_from_first).transform(&first_row.in_middle(&point.position));
        let pixel = readout::pixel(&middle, rows[1], &self.second.camera)?;
        let second_row = &rows[1][nearest_row(pixel.y, rows[1].len())];
        let (value, by_pose) = brightness(&self.second, &second_row.of_middle(&middle))?;
        // The camera's pose moves the point the other way.
        let by_point = -by_pose.fixed_rows::<3>(3);
        let RollingJacobian {
            by_motion,
            by_readout,
        } = self.motion.jacobian(
            [first_row, second_row],
            first_velocity_in_second,
            &middle,
            &by_point,
        );
        let mut jacobian = SVector::<f64, 9>::zeros();
        jacobian.fixed_rows_mut::<6>(0).copy_from(&by_motion);
        (jacobian[6], jacobian[7], jacobian[8]) = (-point.brightness, -1.0, by_readout);
        Some((value - self.gain * point.brightness - self.offset, jacobian))
    }
}

impl Pair<9> for ColorPair {
    fn linearize(&self, readout_secs: f64) -> Option<NormalEquations<9>> {
        let [first, second] = [self.first_height, self.second.camera.height];
        let first_rows = Row::all(first, &self.motion.velocities[0], readout_secs);
        let second_rows = Row::all(second, &self.motion.velocities[1], readout_secs);
        let velocity = self.motion.first_velocity_in_second();
        let rows: Vec<_> = self
            .points
            .iter()
            .filter_map(|point| self.row(point, [&first_rows, &second_rows], &velocity))
            .collect();
        NormalEquations::robust(&rows, MIN_NOISE)
    }

    fn step(&mut self, step: &SVector<f64, 9>) {
        self.motion.perturb(&step.fixed_rows::<6>(0).into_owned());
        self.gain += step[6];
        self.offset += step[7];
    }
}

/// The readout of the colour camera that best explains the pairs, which are in temporal order: from the
/// first row to the last, negative from the last to the first. The search starts at `start_secs`.
/// `None` if too few pairs tell it, as at rest. The motions of the pairs become those that fit.
pub fn color_readout(pairs: &mut [ColorPair], start_secs: f64) -> Option<TimeEstimate> {
    readout::fit(pairs, start_secs)
}
