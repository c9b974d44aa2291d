//! Photometric alignment: the pose at which an image shows the points of some keyframes as bright as
//! the keyframes do.
//!
//! Residual of a point: `I(pi(p)) - gain I_ref - offset`; gain and offset belong to the pair of
//! images, since exposure changes. Gauss-Newton over the pose with iteratively reweighted squares
//! (Student's t), from the coarsest level to the finest. What is known of the pose from elsewhere,
//! geometry, enters as a Gaussian: `e^T information e`, `e = log(prior^-1 pose)`.

use fgs_geom::Se3;
use nalgebra::{Matrix2, Matrix2x6, Matrix6, Rotation3, Vector2, Vector3, Vector6};

use crate::residual::{brightness, by_pose, noise_of};
use crate::{IntensityImage, IntensityPyramid, Reference, ReferencePoint};

/// Degrees of freedom of the residuals' distribution, as measured on RGB-D cameras (Kerl, Sturm and
/// Cremers, ICRA 2013).
const STUDENT_T: f64 = 5.0;

/// Quantisation to 8 bits alone gives residuals of this size.
const MIN_NOISE: f64 = 1.0 / 255.0;

/// Per level.
const MAX_ITERATIONS: usize = 8;

/// Steps below these are not worth another look at the points.
const ROTATION_EPSILON_RAD: f64 = 1e-5;
const TRANSLATION_EPSILON_M: f64 = 1e-5;

/// With fewer points the noise of the residuals cannot be told.
const MIN_POINTS: usize = 50;

/// How sure it is, before looking, that two images are of one exposure: standard deviations.
const GAIN_SIGMA: f64 = 0.2;
const OFFSET_SIGMA: f64 = 0.1;

/// A pose whose squared Mahalanobis distance from the prior is larger contradicts it. Twenty standard
/// deviations: depth errors of consumer sensors are systematic, so that the poses that colour finds
/// lie far outside of what noise alone would allow, and are right by motion capture. Chosen on
/// recordings: without a limit, tracking followed false minima on a fast one; limits from 7 to 20
/// prevented that, and the tighter ones made maps less sharp.
const MAX_CONTRADICTION: f64 = 400.0;

/// What is known of the pose from elsewhere.
#[derive(Clone, Copy, Debug)]
pub struct PosePrior {
    /// The most likely pose.
    pub world_from_camera: Se3,
    /// Inverse covariance under perturbations from the right, `[omega, v]`.
    pub information: Matrix6<f64>,
}

/// The result of a photometric alignment.
#[derive(Clone, Debug)]
pub struct PhotometricAlignment {
    /// The pose.
    pub world_from_camera: Se3,
    /// Inverse covariance of the pose by the points' brightness alone, `[omega, v]`: of what both images
    /// show. Noise has gradients too, but not the same in both.
    pub information: Matrix6<f64>,
    /// Standard deviation of a residual at the finest level, brightness from 0 to 1.
    pub noise: f64,
    /// Number of points compared at the finest level.
    pub points: usize,
    /// Whether it is too far from the prior: then one of the two is wrong.
    pub contradicts_prior: bool,
}

/// A keyframe's points and its pose.
#[derive(Clone, Copy)]
pub struct PosedReference<'a> {
    /// The points.
    pub reference: &'a Reference,
    /// Where the keyframe was taken.
    pub world_from_reference: Se3,
}

/// Aligns an image with keyframes, over the pyramid's levels from the coarsest to the finest. Starts at
/// the prior's pose. Levels where fewer than 50 points can be compared are left out. `None` if none
/// is left. Far alignments, which contradict the prior, are mostly false minima.
pub fn align_with_keyframes(
    image: &IntensityPyramid,
    references: &[PosedReference],
    prior: &PosePrior,
) -> Option<PhotometricAlignment> {
    let mut exposures = vec![Exposure::default(); references.len()];
    let mut pose = prior.world_from_camera;
    let mut settled = None;
    for (level, image) in image.levels.iter().enumerate().rev() {
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
        let mut residuals_noise = None;
        for _ in 0..MAX_ITERATIONS {
            let rows: Vec<Vec<Row>> = pairs.iter().map(|pair| pair.rows(image, &pose)).collect();
            let Some(noise) = noise(&rows, &exposures) else {
                break;
            };
            let system = System::new(&rows, &exposures, noise);
            let off = (prior.world_from_camera.inverse() * pose).log();
            let hessian = system.information + prior.information;
            let step = -(hessian
                .cholesky()?
                .solve(&(system.gradient + prior.information * off)));
            pose = (pose * Se3::exp(&step)).renormalized();
            for (exposure, solved) in exposures.iter_mut().zip(&system.exposures) {
                exposure.update(solved, &step);
            }
            residuals_noise = Some(noise);
            if step.fixed_rows::<3>(0).norm() < ROTATION_EPSILON_RAD
                && step.fixed_rows::<3>(3).norm() < TRANSLATION_EPSILON_M
            {
                break;
            }
        }
        if let Some(noise) = residuals_noise {
            settled = Some((image, pairs, noise));
        }
    }
    let (image, pairs, noise) = settled?;
    let seen: Vec<Vec<Seen>> = pairs.iter().map(|pair| pair.seen(image, &pose)).collect();
    let off = (prior.world_from_camera.inverse() * pose).log();
    let contradiction = (off.transpose() * prior.information * off)[0];
    Some(PhotometricAlignment {
        world_from_camera: pose,
        information: information(&seen, &exposures, noise),
        noise,
        points: seen.iter().map(Vec::len).sum(),
        contradicts_prior: contradiction > MAX_CONTRADICTION,
    })
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

/// The normal equations of gain and offset, given the pose's step.
struct ExposureSystem {
    inverse_hessian: Matrix2<f64>,
    gradient: Vector2<f64>,
    by_pose: Matrix2x6<f64>,
}

impl Exposure {
    fn residual(&self, row: &Row) -> f64 {
        row.here - self.gain * row.there - self.offset
    }

    fn update(&mut self, solved: &ExposureSystem, step: &Vector6<f64>) {
        let change = -solved.inverse_hessian * (solved.gradient + solved.by_pose * step);
        self.gain += change.x;
        self.offset += change.y;
    }
}

/// A point's brightness in the reference and in the image, and the latter's derivative by the pose.
struct Row {
    there: f64,
    here: f64,
    by_here: Vector6<f64>,
}

/// The same, and the derivative that the reference's brightness would have there.
struct Seen {
    row: Row,
    by_there: Vector6<f64>,
}

impl Pair<'_> {
    /// Of the points that the image shows.
    fn rows(&self, image: &IntensityImage, pose: &Se3) -> Vec<Row> {
        self.map_shown(image, pose, |_, _, _, row| row)
    }

    /// The same, with what the reference shows there.
    fn seen(&self, image: &IntensityImage, pose: &Se3) -> Vec<Seen> {
        self.map_shown(image, pose, |point, position, rotation, row| {
            // Along the ray nothing changes.
            let gradient = rotation * point.gradient.cast::<f64>();
            let along = gradient.dot(position) / position.norm_squared();
            Seen {
                row,
                by_there: by_pose(&(gradient - along * position), position),
            }
        })
    }

    /// What a function makes of each point that the image shows, of its position in the camera frame and the
    /// rotation `camera_from_reference`.
    fn map_shown<T>(
        &self,
        image: &IntensityImage,
        pose: &Se3,
        make: impl Fn(&ReferencePoint, &Vector3<f64>, &Rotation3<f64>, Row) -> T,
    ) -> Vec<T> {
        let camera_from_reference = pose.inverse() * self.world_from_reference;
        let rotation = camera_from_reference.rotation.to_rotation_matrix();
        let shown = |point: &ReferencePoint| {
            let position = rotation * point.position + camera_from_reference.translation;
            let (here, by_here) = brightness(image, &position)?;
            let row = Row {
                there: point.intensity.into(),
                here,
                by_here,
            };
            Some(make(point, &position, &rotation, row))
        };
        self.points.iter().filter_map(shown).collect()
    }
}

/// The residuals' standard deviation; `None` if they are too few to tell.
fn noise(rows: &[Vec<Row>], exposures: &[Exposure]) -> Option<f64> {
    let mut sizes: Vec<f64> = rows
        .iter()
        .zip(exposures)
        .flat_map(|(rows, exposure)| rows.iter().map(|row| exposure.residual(row).abs()))
        .collect();
    (sizes.len() >= MIN_POINTS).then(|| noise_of(&mut sizes).max(MIN_NOISE))
}

/// Weight of a residual: inverse variance, less for outliers.
fn weight(residual: f64, noise: f64) -> f64 {
    (STUDENT_T + 1.0) / (STUDENT_T + (residual / noise).powi(2)) / (noise * noise)
}

/// What points say of the pose, `[omega, v]`, gains and offsets eliminated. Products of a gradient with itself
/// would count noise as knowledge: before a bare wall that is all there is. The noise of two images is
/// independent, so that it vanishes from the products of their gradients.
fn information(seen: &[Vec<Seen>], exposures: &[Exposure], noise: f64) -> Matrix6<f64> {
    let mut information = Matrix6::zeros();
    for (seen, exposure) in seen.iter().zip(exposures) {
        let (mut by_exposure, mut mixed) = (exposure_prior(), Matrix2x6::zeros());
        for Seen { row, by_there } in seen {
            let weight = weight(exposure.residual(row), noise);
            let by_there = exposure.gain * by_there;
            information += weight * row.by_here * by_there.transpose();
            let affine = Vector2::new(-row.there, -1.0);
            by_exposure += weight * affine * affine.transpose();
            mixed += 0.5 * weight * affine * (row.by_here + by_there).transpose();
        }
        let inverse = by_exposure.try_inverse().unwrap_or_else(Matrix2::zeros);
        information -= mixed.transpose() * inverse * mixed;
    }
    if !information.iter().all(|value| value.is_finite()) {
        return Matrix6::zeros();
    }
    let eigen = (0.5 * (information + information.transpose())).symmetric_eigen();
    let known = eigen.eigenvalues.map(|known| known.max(0.0));
    eigen.eigenvectors * Matrix6::from_diagonal(&known) * eigen.eigenvectors.transpose()
}

/// The information on gain and offset before looking.
fn exposure_prior() -> Matrix2<f64> {
    Matrix2::from_diagonal(&Vector2::new(GAIN_SIGMA.powi(-2), OFFSET_SIGMA.powi(-2)))
}

/// The normal equations, gains and offsets eliminated (Schur complement).
struct System {
    information: Matrix6<f64>,
    gradient: Vector6<f64>,
    exposures: Vec<ExposureSystem>,
}

impl System {
    fn new(rows: &[Vec<Row>], exposures: &[Exposure], noise: f64) -> Self {
        let mut system = Self {
            information: Matrix6::zeros(),
            gradient: Vector6::zeros(),
            exposures: Vec::new(),
        };
        for (rows, exposure) in rows.iter().zip(exposures) {
            let mut by_exposure = exposure_prior();
            let mut gradient = by_exposure * Vector2::new(exposure.gain - 1.0, exposure.offset);
            let mut by_pose = Matrix2x6::zeros();
            for row in rows {
                let residual = exposure.residual(row);
                let weight = weight(residual, noise);
                let weighted = weight * row.by_here;
                system.information += weighted * row.by_here.transpose();
                system.gradient += residual * weighted;
                let affine = Vector2::new(-row.there, -1.0);
                by_exposure += weight * affine * affine.transpose();
                gradient += weight * residual * affine;
                by_pose += affine * weighted.transpose();
            }
            // The prior makes it invertible.
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
    use fgs_geom::RgbdFrame;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::test_scene::Scene;

    const LEVELS: usize = 3;

    fn offset() -> Se3 {
        Se3::exp(&Vector6::new(0.01, -0.015, 0.008, 0.02, -0.01, 0.015))
    }

    fn reference(keyframe: &RgbdFrame) -> Reference {
        let pyramid = IntensityPyramid::of_frame(keyframe, LEVELS);
        Reference::new(&pyramid, &keyframe.depth_m, &keyframe.camera)
    }

    fn at_origin(reference: &Reference) -> PosedReference<'_> {
        PosedReference {
            reference,
            world_from_reference: Se3::identity(),
        }
    }

    /// The pose found for a frame at [`offset`] from a keyframe at the origin.
    fn found(scene: &Scene, gain: f64, brighter: f64, prior: &PosePrior) -> PhotometricAlignment {
        let keyframe = scene.frame(&Se3::identity(), 1.0, 0.0);
        let reference = reference(&keyframe);
        let frame = scene.frame(&offset(), gain, brighter);
        let pyramid = IntensityPyramid::of_frame(&frame, LEVELS);
        align_with_keyframes(&pyramid, &[at_origin(&reference)], prior).unwrap()
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
        // Geometry alone says nothing of three of them. Pixels are 15 mm at 2 m.
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
        // Noise of the images is that of rounding to bytes, known: errors of 30 scenes against it.
        let mut normalized = 0.0;
        for seed in 0..30 {
            let alignment = found(&Scene::new(20 + seed, true), 1.0, 0.0, &unknown());
            let error = (alignment.world_from_camera.inverse() * offset()).log();
            normalized += (error.transpose() * alignment.information * error)[0] / 6.0;
        }
        // Bilinear interpolation of curved paint adds errors that are not noise.
        assert!(
            (0.05..20.0).contains(&(normalized / 30.0)),
            "{}",
            normalized / 30.0
        );
    }

    /// A keyframe at the origin shows paint, the image a bare wall: what gradients it has are the sensor's noise.
    #[test]
    fn noise_before_a_bare_wall_says_nothing() {
        let reference = reference(&Scene::new(8, false).frame(&Se3::identity(), 1.0, 0.0));
        let uncertainty_m = |gain: f64| {
            let scene = Scene::new(8, false);
            let mut frame = scene.frame(&Se3::identity(), gain, 0.4);
            let mut noise = Pcg64Mcg::seed_from_u64(3);
            for pixel in frame.color.data_mut() {
                let off: i16 = noise.random_range(-5..=5);
                *pixel =
                    pixel.map(|value| i16::from(value).saturating_add(off).clamp(0, 255) as u8);
            }
            let pyramid = IntensityPyramid::of_frame(&frame, LEVELS);
            let known = PosePrior {
                information: Matrix6::identity() * 1e4,
                ..unknown()
            };
            let aligned = align_with_keyframes(&pyramid, &[at_origin(&reference)], &known);
            let known: Matrix6<f64> = aligned.unwrap().information + 1e-3 * Matrix6::identity();
            known.try_inverse().unwrap()[(3, 3)].sqrt()
        };
        let (painted, bare) = (uncertainty_m(0.5), uncertainty_m(0.0));
        assert!(painted <= 0.005 && bare >= 0.02, "{painted} {bare}");
    }

    #[test]
    fn brightness_that_contradicts_the_prior_says_so() {
        let scene = Scene::new(7, true);
        let keyframe = scene.frame(&Se3::identity(), 1.0, 0.0);
        let reference = reference(&keyframe);
        let frame = IntensityPyramid::of_frame(&scene.frame(&offset(), 1.0, 0.0), LEVELS);
        let aligned = |sigma: f64| {
            let prior = PosePrior {
                information: Matrix6::identity() * sigma.powi(-2),
                ..unknown()
            };
            align_with_keyframes(&frame, &[at_origin(&reference)], &prior)
        };
        // The offset has a norm of 0.034: one standard deviation, and more than twenty.
        let contradicts = |sigma| aligned(sigma).unwrap().contradicts_prior;
        assert!(!contradicts(0.03) && contradicts(0.0013));
    }

    #[test]
    fn without_paint_or_keyframes_there_is_no_alignment() {
        let scene = Scene::new(6, true);
        let blank = scene.frame(&Se3::identity(), 0.0, 0.5);
        let pyramid = IntensityPyramid::of_frame(&blank, LEVELS);
        let reference = reference(&blank);
        assert!(align_with_keyframes(&pyramid, &[at_origin(&reference)], &unknown()).is_none());
        assert!(align_with_keyframes(&pyramid, &[], &unknown()).is_none());
    }
}
