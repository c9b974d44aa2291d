//! Photometric alignment: the pose that minimises the photometric residuals between an image and
//! the points of several keyframes.
//!
//! Residual of a point: `I(pi(p)) - gain I_ref - offset`. Gain and offset are estimated for each
//! pair of image and keyframe, since the exposure changes. Gauss-Newton over the pose with
//! iteratively reweighted least squares (Student's t), from the coarsest pyramid level to the
//! finest. Prior knowledge of the pose, for example from geometric registration, enters as a
//! Gaussian: `e^T information e`, `e = log(prior^-1 pose)`.

use fgs_geom::Se3;
use nalgebra::{Matrix2, Matrix2x6, Matrix6, Vector2, Vector6};

use crate::residual::brightness;
use crate::{IntensityImage, IntensityPyramid, Reference, ReferencePoint};

/// Degrees of freedom of the t distribution of photometric residuals, as measured on RGB-D cameras
/// (Kerl, Sturm and Cremers, ICRA 2013).
const STUDENT_T: f64 = 5.0;

/// Quantisation to 8 bits alone causes residuals of this size.
const MIN_NOISE: f64 = 1.0 / 255.0;

/// Maximum number of steps per pyramid level.
const MAX_ITERATIONS: usize = 8;

/// Converged when rotation and translation of a step are below these.
const ROTATION_EPSILON_RAD: f64 = 1e-5;
const TRANSLATION_EPSILON_M: f64 = 1e-5;

/// Fewer points do not allow the noise of the residuals to be estimated.
const MIN_POINTS: usize = 50;

/// Prior standard deviations of gain and offset: how much the exposure may differ between images.
const GAIN_SIGMA: f64 = 0.2;
const OFFSET_SIGMA: f64 = 0.1;

/// Prior on the pose, from another source.
#[derive(Clone, Copy, Debug)]
pub struct PosePrior {
    /// Mean of the prior.
    pub world_from_camera: Se3,
    /// Information matrix of the prior for right perturbations, `[omega, v]`.
    pub information: Matrix6<f64>,
}

/// The result of a photometric alignment.
#[derive(Clone, Debug)]
pub struct PhotometricAlignment {
    /// Estimated pose.
    pub world_from_camera: Se3,
    /// Information matrix of the pose from the photometric residuals alone, without the prior,
    /// `[omega, v]`.
    pub information: Matrix6<f64>,
    /// Standard deviation of the residuals at the finest level, brightness from 0 to 1.
    pub noise: f64,
    /// Number of points used at the finest level.
    pub points: usize,
}

/// Points and pose of a keyframe.
#[derive(Clone, Copy)]
pub struct PosedReference<'a> {
    /// Points of the keyframe.
    pub reference: &'a Reference,
    /// Pose of the keyframe.
    pub world_from_reference: Se3,
}

/// Aligns an image with keyframes, over the pyramid levels from the coarsest to `finest`, starting
/// at the pose of the prior. Levels with fewer than 50 visible points are skipped; `None` if all
/// are.
pub fn align_with_keyframes(
    image: &IntensityPyramid,
    references: &[PosedReference],
    prior: &PosePrior,
    finest: usize,
) -> Option<PhotometricAlignment> {
    let mut exposures = vec![Exposure::default(); references.len()];
    let mut pose = prior.world_from_camera;
    let mut result = None;
    for level in (finest..image.levels.len()).rev() {
        let pairs: Vec<Pair> = references
            .iter()
            .filter_map(|posed| {
                Some(Pair {
                    points: posed.reference.levels.get(level)?,
                    world_from_reference: posed.world_from_reference,
                })
            })
            .collect();
        if pairs.len() < references.len() {
            continue;
        }
        let image = &image.levels[level];
        for _ in 0..MAX_ITERATIONS {
            let Some(noise) = noise(image, &pairs, &pose, &exposures) else {
                break;
            };
            let system = System::new(image, &pairs, &pose, &exposures, noise);
            let off = (prior.world_from_camera.inverse() * pose).log();
            let hessian = system.information + prior.information;
            let step = -(hessian
                .cholesky()?
                .solve(&(system.gradient + prior.information * off)));
            pose = (pose * Se3::exp(&step)).renormalized();
            for (exposure, solved) in exposures.iter_mut().zip(&system.exposures) {
                exposure.update(solved, &step);
            }
            result = Some(PhotometricAlignment {
                world_from_camera: pose,
                information: system.information,
                noise,
                points: system.points,
            });
            if step.fixed_rows::<3>(0).norm() < ROTATION_EPSILON_RAD
                && step.fixed_rows::<3>(3).norm() < TRANSLATION_EPSILON_M
            {
                break;
            }
        }
    }
    result
}

struct Pair<'a> {
    points: &'a [ReferencePoint],
    world_from_reference: Se3,
}

/// Brightness in the image is `gain * brightness in the reference + offset`.
#[derive(Clone, Copy, Debug)]
struct Exposure {
    gain: f64,
    offset: f64,
}

impl Default for Exposure {
    fn default() -> Self {
        Self {
            gain: 1.0,
            offset: 0.0,
        }
    }
}

/// Normal equations of gain and offset. They are solved by back-substitution once the step of the
/// pose is known.
struct ExposureSystem {
    inverse_hessian: Matrix2<f64>,
    gradient: Vector2<f64>,
    by_pose: Matrix2x6<f64>,
}

impl Exposure {
    fn update(&mut self, solved: &ExposureSystem, step: &Vector6<f64>) {
        let change = -solved.inverse_hessian * (solved.gradient + solved.by_pose * step);
        self.gain += change.x;
        self.offset += change.y;
    }
}

/// Calls `visit` for each visible point with its brightness in the reference, its brightness in the
/// image, and the derivative of the latter with respect to the pose.
fn for_each_point(
    image: &IntensityImage,
    pair: &Pair,
    pose: &Se3,
    mut visit: impl FnMut(f64, f64, &Vector6<f64>),
) {
    let camera_from_reference = pose.inverse() * pair.world_from_reference;
    let rotation = camera_from_reference.rotation.to_rotation_matrix();
    for point in pair.points {
        let position = rotation * point.position + camera_from_reference.translation;
        if let Some((value, jacobian)) = brightness(image, &position) {
            visit(point.intensity.into(), value, &jacobian);
        }
    }
}

/// Standard deviation of the residuals, from their median absolute value.
fn noise(
    image: &IntensityImage,
    pairs: &[Pair],
    pose: &Se3,
    exposures: &[Exposure],
) -> Option<f64> {
    let mut sizes = Vec::new();
    for (pair, exposure) in pairs.iter().zip(exposures) {
        for_each_point(image, pair, pose, |there, here, _| {
            sizes.push((here - exposure.gain * there - exposure.offset).abs());
        });
    }
    if sizes.len() < MIN_POINTS {
        return None;
    }
    let middle = sizes.len() / 2;
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f64::total_cmp);
    Some((1.4826 * *median).max(MIN_NOISE))
}

/// Normal equations of the pose, with gains and offsets eliminated (Schur complement).
struct System {
    information: Matrix6<f64>,
    gradient: Vector6<f64>,
    exposures: Vec<ExposureSystem>,
    points: usize,
}

impl System {
    fn new(
        image: &IntensityImage,
        pairs: &[Pair],
        pose: &Se3,
        exposures: &[Exposure],
        noise: f64,
    ) -> Self {
        let mut system = Self {
            information: Matrix6::zeros(),
            gradient: Vector6::zeros(),
            exposures: Vec::new(),
            points: 0,
        };
        for (pair, exposure) in pairs.iter().zip(exposures) {
            // The prior on gain and offset.
            let mut by_exposure =
                Matrix2::from_diagonal(&Vector2::new(GAIN_SIGMA.powi(-2), OFFSET_SIGMA.powi(-2)));
            let mut gradient = by_exposure * Vector2::new(exposure.gain - 1.0, exposure.offset);
            let mut by_pose = Matrix2x6::zeros();
            for_each_point(image, pair, pose, |there, here, jacobian| {
                let residual = here - exposure.gain * there - exposure.offset;
                let weight =
                    (STUDENT_T + 1.0) / (STUDENT_T + (residual / noise).powi(2)) / (noise * noise);
                let weighted = weight * jacobian;
                system.information += weighted * jacobian.transpose();
                system.gradient += residual * weighted;
                let affine = Vector2::new(-there, -1.0);
                by_exposure += weight * affine * affine.transpose();
                gradient += weight * residual * affine;
                by_pose += affine * weighted.transpose();
                system.points += 1;
            });
            // The prior makes the matrix invertible.
            let inverse_hessian = by_exposure.try_inverse().unwrap_or_else(Matrix2::zeros);
            let eliminated = by_pose.transpose() * inverse_hessian;
            system.information -= eliminated * by_pose;
            system.gradient -= eliminated * gradient;
            system.exposures.push(ExposureSystem {
                inverse_hessian,
                gradient,
                by_pose,
            });
        }
        system
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::Scene;

    const LEVELS: usize = 3;

    fn offset() -> Se3 {
        Se3::exp(&Vector6::new(0.01, -0.015, 0.008, 0.02, -0.01, 0.015))
    }

    /// The alignment of a frame at [`offset`] with a keyframe at the origin.
    fn found(scene: &Scene, gain: f64, brighter: f64, prior: &PosePrior) -> PhotometricAlignment {
        let keyframe = scene.frame(&Se3::identity(), 1.0, 0.0);
        let pyramid = IntensityPyramid::of_frame(&keyframe, LEVELS);
        let reference = Reference::new(&pyramid, &keyframe.depth_m);
        let frame = scene.frame(&offset(), gain, brighter);
        let pyramid = IntensityPyramid::of_frame(&frame, LEVELS);
        let posed = PosedReference {
            reference: &reference,
            world_from_reference: Se3::identity(),
        };
        align_with_keyframes(&pyramid, &[posed], prior, 0).unwrap()
    }

    fn unknown() -> PosePrior {
        PosePrior {
            world_from_camera: Se3::identity(),
            information: Matrix6::identity() * 1e-3,
        }
    }

    fn error(pose: &Se3) -> f64 {
        (pose.inverse() * offset()).log().amax()
    }

    #[test]
    fn a_painted_wall_holds_all_six_directions() {
        // Geometry alone leaves three directions of the bare wall unconstrained. A pixel covers 15
        // mm at 2 m.
        for with_floor in [false, true] {
            let alignment = found(&Scene::new(3, with_floor), 1.0, 0.0, &unknown());
            let error = error(&alignment.world_from_camera);
            assert!(error <= 1.5e-3, "{error}");
            assert!(alignment.points >= 200);
        }
        assert!(error(&Se3::identity()) >= 1e-2);
    }

    #[test]
    fn a_change_of_exposure_does_not_matter() {
        let scene = Scene::new(4, true);
        let alignment = found(&scene, 0.85, 0.06, &unknown());
        let error = error(&alignment.world_from_camera);
        assert!(error <= 1.5e-3, "{error}");
    }

    #[test]
    fn a_certain_prior_is_kept_and_an_uncertain_one_is_not() {
        let scene = Scene::new(5, true);
        let certain = PosePrior {
            information: Matrix6::identity() * 1e12,
            ..unknown()
        };
        let alignment = found(&scene, 1.0, 0.0, &certain);
        assert!(alignment.world_from_camera.log().amax() <= 1e-5);
        // Rotation known, translation not.
        let mut information = Matrix6::identity() * 1e-3;
        for i in 0..3 {
            information[(i, i)] = 1e12;
        }
        let mixed = PosePrior {
            world_from_camera: Se3::new(offset().rotation, nalgebra::Vector3::zeros()),
            information,
        };
        let alignment = found(&scene, 1.0, 0.0, &mixed);
        assert!(error(&alignment.world_from_camera) <= 1.5e-3);
    }

    #[test]
    fn the_information_predicts_the_error() {
        // The image noise is known: rounding to bytes. The errors of 30 scenes are compared with
        // it.
        let mut normalized = 0.0;
        for seed in 0..30 {
            let alignment = found(&Scene::new(20 + seed, true), 1.0, 0.0, &unknown());
            let error = (alignment.world_from_camera.inverse() * offset()).log();
            normalized += (error.transpose() * alignment.information * error)[0] / 6.0;
        }
        // Bilinear interpolation of a curved texture adds systematic errors.
        assert!(
            (0.05..20.0).contains(&(normalized / 30.0)),
            "{}",
            normalized / 30.0
        );
    }

    #[test]
    fn without_paint_or_keyframes_there_is_no_alignment() {
        let scene = Scene::new(6, true);
        let blank = scene.frame(&Se3::identity(), 0.0, 0.5);
        let pyramid = IntensityPyramid::of_frame(&blank, LEVELS);
        let reference = Reference::new(&pyramid, &blank.depth_m);
        let posed = PosedReference {
            reference: &reference,
            world_from_reference: Se3::identity(),
        };
        assert!(align_with_keyframes(&pyramid, &[posed], &unknown(), 0).is_none());
        assert!(align_with_keyframes(&pyramid, &[], &unknown(), 0).is_none());
    }
}
