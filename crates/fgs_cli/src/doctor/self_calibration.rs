//! Intrinsics from depth alone: frames that see the same surfaces from different directions agree
//! only with the camera's true focal lengths and principal point.
//!
//! Input: registered pairs. Output: the intrinsics for which the pairs' depths agree best, with
//! standard errors. Gauss-Newton over the camera and every pair's motion; the motions are eliminated
//! (Schur complement). Pure translations say nothing about the camera, because the space that wrong
//! intrinsics reconstruct is sheared but stays consistent under them; the standard errors are then
//! large.

use fgs_geom::{Camera, Intrinsics, Se3};
use fgs_gicp::SurfacePoint;
use nalgebra::{Matrix4, Matrix6, Matrix6x4, SMatrix, SVector, Vector3, Vector4, Vector6};

use super::frame_pairs::{FramePair, grid};
use super::statistics::median;

type Vector10 = SVector<f64, 10>;

/// Far from the solution each step at least halves the error; this many leave a thousandth of it.
const MAX_ITERATIONS: usize = 10;

/// Converged when no parameter changes by more; far below any correction that matters.
const MAX_LAST_STEP: f64 = 1e-4;

/// Points whose depths differ by a larger share lie on different objects.
const MAX_RESIDUAL: f64 = 0.1;

/// Fewer common points than this do not determine a motion.
const MIN_POINTS: usize = 100;

/// Standard deviations of the prior on [`Calibration::change`]. It matters only for what the pairs
/// leave undetermined.
const PRIOR: [f64; 4] = [0.2, 0.2, 0.05, 0.05];

/// The best fitting intrinsics.
pub struct Calibration {
    /// Change of ln fx, ln fy, cx / width and cy / height: best fitting minus given.
    pub change: Vector4<f64>,
    /// Standard errors of `change`, from the disagreement between pairs.
    pub standard_error: Vector4<f64>,
    /// The best fitting camera.
    pub camera: Camera,
    /// `first_from_second` of each pair, with that camera.
    pub first_from_second: Vec<Se3>,
    /// Median relative depth difference before and after.
    pub residual: [f64; 2],
}

/// A pixel of a pair's second frame with its depth, smoothed.
pub struct Sample {
    /// Column.
    pub u: f64,
    /// Row.
    pub v: f64,
    /// In the metres of the recording's depth.
    pub depth_m: f64,
}

/// One Gauss-Newton step.
struct Step {
    change: Vector4<f64>,
    /// Change of the camera's parameters.
    standard_error: Vector4<f64>,
    /// Change of each pair's motion.
    motions: Vec<Vector6<f64>>,
}

/// A pair's normal equations.
struct PairSystem {
    motion: Matrix6<f64>,
    motion_gradient: Vector6<f64>,
    mixed: Matrix6x4<f64>,
    camera: Matrix4<f64>,
    camera_gradient: Vector4<f64>,
    median_residual: f64,
}

/// The camera that fits the pairs best, starting from the given one. `None` if there are fewer than
/// two pairs, or if they have too few points in common.
pub fn calibrate(pairs: &[FramePair], given: &Camera) -> Option<Calibration> {
    let samples: Vec<Vec<Sample>> = pairs.iter().map(|pair| samples(pair, given)).collect();
    let mut motions: Vec<Se3> = pairs.iter().map(|pair| pair.first_from_second).collect();
    let prior = Matrix4::from_diagonal(&Vector4::from(PRIOR).map(|sigma| 1.0 / (sigma * sigma)));
    let mut change = Vector4::zeros();
    let mut standard_error = Vector4::zeros();
    let mut residuals = Vec::new();
    for _ in 0..MAX_ITERATIONS {
        let camera = changed(given, &change);
        let systems: Vec<PairSystem> = (pairs.iter().zip(&samples).zip(&motions))
            .map(|((pair, samples), motion)| linearize(pair, samples, motion, &camera))
            .collect::<Option<_>>()?;
        let step = solve(&systems, &change, &prior)?;
        standard_error = step.standard_error;
        residuals.push(median(systems.iter().map(|s| s.median_residual).collect())?);
        for (motion, step) in motions.iter_mut().zip(&step.motions) {
            *motion = *motion * Se3::exp(step);
        }
        change += step.change;
        if step.change.amax() <= MAX_LAST_STEP {
            break;
        }
    }
    Some(Calibration {
        change,
        standard_error,
        camera: changed(given, &change),
        first_from_second: motions,
        residual: [*residuals.first()?, *residuals.last()?],
    })
}

/// The step of the camera and of every motion.
fn solve(systems: &[PairSystem], change: &Vector4<f64>, prior: &Matrix4<f64>) -> Option<Step> {
    let mut hessian = *prior;
    let mut gradient = prior * change;
    let mut scatter = Matrix4::zeros();
    let mut inverses = Vec::new();
    for system in systems {
        let inverse = system.motion.cholesky()?.inverse();
        let eliminate = system.mixed.transpose() * inverse;
        let score = system.camera_gradient - eliminate * system.motion_gradient;
        hessian += system.camera - eliminate * system.mixed;
        gradient += score;
        scatter += score * score.transpose();
        inverses.push(inverse);
    }
    let n = systems.len() as f64;
    if n < 2.0 {
        return None;
    }
    let covariance = hessian.cholesky()?.inverse();
    let step = -covariance * gradient;
    // The sandwich estimator: pairs are independent of one another, points of a pair are not.
    let error = (covariance * (scatter * (n / (n - 1.0)) + prior) * covariance).diagonal();
    let motions = (systems.iter().zip(&inverses))
        .map(|(system, inverse)| -inverse * (system.motion_gradient + system.mixed * step))
        .collect();
    let is_finite = step
        .iter()
        .chain(error.iter())
        .all(|value| value.is_finite());
    is_finite.then(|| Step {
        change: step,
        standard_error: error.map(f64::sqrt),
        motions,
    })
}

fn linearize(
    pair: &FramePair,
    samples: &[Sample],
    first_from_second: &Se3,
    camera: &Camera,
) -> Option<PairSystem> {
    let grid = grid(camera);
    let rows: Vec<(f64, Vector10)> = samples
        .iter()
        .filter_map(|sample| {
            let point = camera.unproject(sample.u, sample.v, sample.depth_m);
            let pixel = camera.project(&first_from_second.transform(&point))?;
            if !camera.contains(&pixel) {
                return None;
            }
            let (u, v) = (pixel.x.round() as usize, pixel.y.round() as usize);
            let surface = grid.surface_point(&pair.first.depth_m, camera, u, v)?;
            let row = row(&point, first_from_second, &surface, camera);
            (row.0.abs() <= MAX_RESIDUAL).then_some(row)
        })
        .collect();
    if rows.len() < MIN_POINTS {
        return None;
    }
    let median_residual = median(rows.iter().map(|(residual, _)| residual.abs()).collect())?;
    // Exact depth has no spread: a hundredth of a per mille is its rounding.
    let scale = 3.0 * median_residual.max(1e-5);
    let mut hessian = SMatrix::<f64, 10, 10>::zeros();
    let mut gradient = Vector10::zeros();
    for (residual, jacobian) in &rows {
        let cauchy = 1.0 / (1.0 + (residual / scale).powi(2));
        let weight = cauchy / (scale * scale);
        hessian += weight * jacobian * jacobian.transpose();
        gradient += weight * *residual * jacobian;
    }
    Some(PairSystem {
        motion: hessian.fixed_view::<6, 6>(0, 0).into_owned(),
        motion_gradient: gradient.fixed_rows::<6>(0).into_owned(),
        mixed: hessian.fixed_view::<6, 4>(0, 6).into_owned(),
        camera: hessian.fixed_view::<4, 4>(6, 6).into_owned(),
        camera_gradient: gradient.fixed_rows::<4>(6).into_owned(),
        median_residual,
    })
}

/// Relative difference between the depth of a point of the second frame and the first frame's
/// surface there, and its derivatives with respect to `[omega, v]` of the motion (right perturbation)
/// and to [`Calibration::change`].
///
/// A plane's inverse depth is `1/z = a (u - u0) + b (v - v0) + c` whatever the camera, so with
/// `y = R x + t` the difference `y.z / z - 1` is `m . y - 1` for
/// `m = (a fx, b fy, c + a (cx - u0) + b (cy - v0))`.
fn row(
    point: &Vector3<f64>,
    first_from_second: &Se3,
    surface: &SurfacePoint,
    camera: &Camera,
) -> (f64, Vector10) {
    let k = camera.intrinsics;
    let m = surface.normal / surface.normal.dot(&surface.fitted);
    let y = first_from_second.transform(point);
    let w = first_from_second.rotation.inverse() * m;
    let turn = point.cross(&w);
    let d_cx = m.x / k.fx * y.z - w.x * point.z / k.fx;
    let d_cy = m.y / k.fy * y.z - w.y * point.z / k.fy;
    let jacobian = Vector10::from([
        turn.x,
        turn.y,
        turn.z,
        w.x,
        w.y,
        w.z,
        m.x * y.x - w.x * point.x,
        m.y * y.y - w.y * point.y,
        d_cx * camera.width as f64,
        d_cy * camera.height as f64,
    ]);
    (m.dot(&y) - 1.0, jacobian)
}

/// The grid pixels of a pair's second frame that lie on a surface.
pub fn samples(pair: &FramePair, camera: &Camera) -> Vec<Sample> {
    let points = grid(camera).surface_points(&pair.second.depth_m, camera);
    let sample = |point: SurfacePoint| Sample {
        u: point.u as f64,
        v: point.v as f64,
        depth_m: point.fitted.z,
    };
    points.into_iter().map(sample).collect()
}

fn changed(camera: &Camera, change: &Vector4<f64>) -> Camera {
    let k = camera.intrinsics;
    Camera {
        intrinsics: Intrinsics {
            fx: k.fx * change[0].exp(),
            fy: k.fy * change[1].exp(),
            cx: k.cx + change[2] * camera.width as f64,
            cy: k.cy + change[3] * camera.height as f64,
        },
        ..*camera
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::color_misfit::color_misfit;
    use crate::doctor::frame_pairs::PairBuilder;
    use crate::doctor::test_room;
    use fgs_gicp::DepthGrid;

    fn pairs(camera: Camera) -> Vec<FramePair> {
        let mut builder = PairBuilder::new(camera);
        (0..60).for_each(|i| builder.add(&test_room::frame(i)));
        builder.interrupt();
        builder.pairs
    }

    #[test]
    fn derivatives_are_those_of_the_residual() {
        let camera = test_room::camera();
        let depth_m = test_room::frame(0).depth_m;
        let motion = Se3::exp(&Vector6::new(0.1, -0.07, 0.05, 0.1, -0.06, 0.08));
        let (u, v, depth) = (60.0, 120.0, 1.9);
        let surface = DepthGrid::default()
            .surface_point(&depth_m, &camera, 70, 110)
            .unwrap();
        let m = surface.normal / surface.normal.dot(&surface.fitted);
        let slope = [m.x / camera.intrinsics.fx, m.y / camera.intrinsics.fy];
        // The definition: predicted depth times measured inverse depth there.
        let residual = |delta: Vector10| {
            let camera = changed(&camera, &delta.fixed_rows::<4>(6).into_owned());
            let motion = motion * Se3::exp(&delta.fixed_rows::<6>(0).into_owned());
            let y = motion.transform(&camera.unproject(u, v, depth));
            let pixel = camera.project(&y).unwrap();
            let inverse_depth =
                1.0 / surface.fitted.z + slope[0] * (pixel.x - 70.0) + slope[1] * (pixel.y - 110.0);
            y.z * inverse_depth - 1.0
        };
        let (value, jacobian) = row(&camera.unproject(u, v, depth), &motion, &surface, &camera);
        assert!((value - residual(Vector10::zeros())).abs() <= 1e-12);
        assert!(
            jacobian.iter().all(|slope| slope.abs() >= 1e-3),
            "{jacobian}"
        );
        for i in 0..10 {
            let step = Vector10::from_fn(|row, _| if row == i { 1e-5 } else { 0.0 });
            let slope = (residual(step) - residual(-step)) / 2e-5;
            assert!(
                (jacobian[i] - slope).abs() <= 1e-8,
                "{i}: {} {slope}",
                jacobian[i]
            );
        }
    }

    #[test]
    fn wrong_intrinsics_are_put_right() {
        let truth = test_room::camera();
        let mut given = truth;
        given.intrinsics.fx *= 1.2;
        given.intrinsics.fy *= 1.1;
        given.intrinsics.cx += 15.0;
        given.intrinsics.cy -= 8.0;
        let pairs = pairs(given);
        let found = calibrate(&pairs, &given).unwrap();
        let (k, expected) = (found.camera.intrinsics, truth.intrinsics);
        assert!((k.fx - expected.fx).abs() <= 0.5, "{k:?}");
        assert!((k.fy - expected.fy).abs() <= 0.5, "{k:?}");
        assert!((k.cx - expected.cx).abs() <= 0.5, "{k:?}");
        assert!((k.cy - expected.cy).abs() <= 0.4, "{k:?}");
        assert!(
            found.residual[1] <= 0.1 * found.residual[0],
            "{:?}",
            found.residual
        );
        let given_motions: Vec<Se3> = pairs.iter().map(|pair| pair.first_from_second).collect();
        let before = color_misfit(&pairs, &given_motions, &given, &given).unwrap();
        let after = color_misfit(&pairs, &found.first_from_second, &given, &found.camera).unwrap();
        assert!(after <= 0.7 * before, "{after} {before}");
    }

    #[test]
    fn too_few_pairs_give_nothing() {
        let camera = test_room::camera();
        assert!(calibrate(&[], &camera).is_none());
        assert!(calibrate(&pairs(camera)[..1], &camera).is_none());
    }
}
