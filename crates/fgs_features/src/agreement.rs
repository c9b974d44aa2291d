//! How well a motion between two cameras explains that two features are the same point.
//!
//! Each feature's point, seen by the other camera, must come to lie on the other feature's pixel
//! and, where both have depth, at its depth. Errors are counted in standard deviations: of a
//! corner's place, which grows with the pixels of the image that it was found in, and of depth,
//! which grows with its square.

use fgs_geom::{Camera, Se3, skew};
use nalgebra::{Matrix2x3, Matrix3, Matrix3x6, Matrix6, Vector3, Vector6};

use crate::Feature;

/// Standard deviation of a corner's place, pixels of the image that it was found in.
const CORNER_NOISE_PX: f64 = 2.0;

/// Squared errors from here on, in squared standard deviations, are those of outliers.
pub(crate) const MAX_SQUARED_ERROR: f64 = 9.0;

/// Standard deviation of a corner's depth, metres. Half as much again as that of a structured-light
/// sensor (Nguyen et al. 2012), and millimetres more: corners lie where depth changes, and the two
/// sensors' registration is a pixel or two off.
pub(crate) fn depth_noise_m(depth_m: f64) -> f64 {
    0.005 + 0.003 * depth_m * depth_m
}

/// A motion between two cameras, in both directions.
pub(crate) struct Motion {
    a_from_b: (Matrix3<f64>, Vector3<f64>),
    b_from_a: (Matrix3<f64>, Vector3<f64>),
}

impl Motion {
    pub fn new(a_from_b: &Se3) -> Self {
        let parts = |pose: &Se3| {
            let rotation = pose.rotation.to_rotation_matrix();
            (rotation.into_inner(), pose.translation)
        };
        Self {
            a_from_b: parts(a_from_b),
            b_from_a: parts(&a_from_b.inverse()),
        }
    }
}

/// Least squares for a perturbation of `a_from_b` from the right, `[omega, v]`.
pub(crate) struct NormalEquations {
    pub hessian: Matrix6<f64>,
    pub gradient: Vector6<f64>,
}

impl NormalEquations {
    pub fn zero() -> Self {
        Self {
            hessian: Matrix6::zeros(),
            gradient: Vector6::zeros(),
        }
    }

    /// Adds the errors of a point, in the camera's axes, against the feature that it should be.
    fn add(
        &mut self,
        point: &Vector3<f64>,
        by_motion: &Matrix3x6<f64>,
        feature: &Feature,
        camera: &Camera,
        weight: f64,
    ) {
        let Some(pixel) = camera.project(point) else {
            return;
        };
        let (across, down) = (
            camera.intrinsics.fx / point.z,
            camera.intrinsics.fy / point.z,
        );
        let by_point = Matrix2x3::new(
            across,
            0.0,
            -across * point.x / point.z,
            0.0,
            down,
            -down * point.y / point.z,
        );
        let jacobian = by_point * by_motion;
        let transposed = weight / pixel_variance(feature) * jacobian.transpose();
        self.hessian += transposed * jacobian;
        self.gradient += transposed * (pixel - feature.pixel);
        if let Some(measured) = feature.point {
            let jacobian = by_motion.row(2);
            let transposed = weight / depth_variance(measured.z) * jacobian.transpose();
            self.hessian += transposed * jacobian;
            self.gradient += transposed * (point.z - measured.z);
        }
    }
}

/// Two features that may be the same point, and the cameras that saw them.
pub(crate) struct Pair<'a> {
    pub a: &'a Feature,
    pub b: &'a Feature,
    pub cameras: [&'a Camera; 2],
}

impl Pair<'_> {
    /// The squared error in the worst of all comparisons, squared standard deviations; infinite if
    /// a point lies behind a camera, or if neither feature has depth.
    pub fn squared_error(&self, motion: &Motion) -> f64 {
        let error = |from: &Feature, to: &Feature, camera, (rotation, translation)| {
            let point: Vector3<f64> = from.point?;
            let (rotation, translation): (&Matrix3<f64>, &Vector3<f64>) = (rotation, translation);
            Some(squared_error(&(rotation * point + translation), to, camera))
        };
        let Motion { a_from_b, b_from_a } = motion;
        let in_a = error(self.b, self.a, self.cameras[0], (&a_from_b.0, &a_from_b.1));
        let in_b = error(self.a, self.b, self.cameras[1], (&b_from_a.0, &b_from_a.1));
        match (in_a, in_b) {
            (Some(in_a), Some(in_b)) => in_a.max(in_b),
            (one, other) => one.or(other).unwrap_or(f64::INFINITY),
        }
    }

    /// Adds the pair's errors to the equations.
    pub fn linearize(&self, motion: &Motion, weight: f64, equations: &mut NormalEquations) {
        let derivatives = |by_omega: Matrix3<f64>, by_v: Matrix3<f64>| {
            let mut derivatives = Matrix3x6::zeros();
            derivatives.fixed_columns_mut::<3>(0).copy_from(&by_omega);
            derivatives.fixed_columns_mut::<3>(3).copy_from(&by_v);
            derivatives
        };
        if let Some(point) = &self.b.point {
            let (rotation, translation) = &motion.a_from_b;
            let by_motion = derivatives(-rotation * skew(point), *rotation);
            let in_a = rotation * point + translation;
            equations.add(&in_a, &by_motion, self.a, self.cameras[0], weight);
        }
        if let Some(point) = &self.a.point {
            let (rotation, translation) = &motion.b_from_a;
            let in_b = rotation * point + translation;
            let by_motion = derivatives(skew(&in_b), -Matrix3::identity());
            equations.add(&in_b, &by_motion, self.b, self.cameras[1], weight);
        }
    }
}

/// The squared error of a point, in the camera's axes, against the feature that it should be.
fn squared_error(point: &Vector3<f64>, feature: &Feature, camera: &Camera) -> f64 {
    let Some(pixel) = camera.project(point) else {
        return f64::INFINITY;
    };
    let place = (pixel - feature.pixel).norm_squared() / pixel_variance(feature);
    let depth = feature.point.map_or(0.0, |measured| {
        (point.z - measured.z).powi(2) / depth_variance(measured.z)
    });
    place.max(depth)
}

fn pixel_variance(feature: &Feature) -> f64 {
    (CORNER_NOISE_PX * feature.scale).powi(2)
}

/// Variance of the difference of two measurements.
fn depth_variance(depth_m: f64) -> f64 {
    2.0 * depth_noise_m(depth_m).powi(2)
}
