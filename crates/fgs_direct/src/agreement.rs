//! Whether an image and a keyframe show the same thing, given their relative pose: the keyframe's
//! points should look alike in the image, up to its exposure, and the image must not see through
//! them.

use fgs_geom::{Image, Se3, has_depth};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::{IntensityImage, ReferencePoint};

/// A depth image sees through a point, or is hidden from it, if it measures another depth than the
/// point's by more than this share of it.
const MAX_DEPTH_DIFFERENCE: f64 = 0.05;

/// An image of less contrast is dark or blank; its noise is no difference.
const MIN_CONTRAST: f64 = 0.02 * 0.02;

/// How well an image agrees with a keyframe.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Agreement {
    /// The keyframe's points that the image shows: in view, and not hidden by something nearer.
    pub points: usize,
    /// The share of all the keyframe's points that this is.
    pub share: f64,
    /// How alike they look: 1 less the part of the image's contrast by which they differ, after the gain
    /// and offset that fit best (variances). About 1 at the right pose; at a wrong one 0 or less. Where
    /// the keyframe shows hardly any contrast, nothing can differ, and it is about 1 too.
    pub likeness: f64,
    /// The share of those with measured depth where the image sees something farther: nothing of the
    /// keyframe is there.
    pub seen_through: f64,
}

impl Agreement {
    /// What the keyframe says of the pose, up to 1: the likeness less the share seen through.
    pub fn support(&self) -> f64 {
        self.likeness - self.seen_through
    }
}

/// The variance of an image's brightness, its contrast.
pub fn contrast(image: &IntensityImage) -> f64 {
    let mut moments = Moments::default();
    for value in image
        .pixels()
        .data()
        .iter()
        .filter(|value| value.is_finite())
    {
        moments.add(0.0, f64::from(*value));
    }
    moments.residual_variance()
}

/// Compares an image of a `contrast` with points of a keyframe. `depth_m` belongs to the image's camera, at any
/// resolution of the same field of view.
pub fn agreement(
    image: &IntensityImage,
    depth_m: &Image<f32>,
    contrast: f64,
    points: &[ReferencePoint],
    camera_from_reference: &Se3,
) -> Agreement {
    let rotation = camera_from_reference.rotation.to_rotation_matrix();
    let mut moments = Moments::default();
    let (mut measured, mut seen_through) = (0, 0);
    for point in points {
        let position = rotation * point.position + camera_from_reference.translation;
        let Some((value, depth)) = look(image, depth_m, &position) else {
            continue;
        };
        let farther = depth.map(|depth| depth / position.z - 1.0);
        match farther {
            Some(farther) if farther < -MAX_DEPTH_DIFFERENCE => continue,
            Some(farther) => {
                measured += 1;
                seen_through += usize::from(farther > MAX_DEPTH_DIFFERENCE);
            }
            None => {}
        }
        moments.add(point.intensity.into(), value);
    }
    let share_of = |count: usize, all: usize| count as f64 / all.max(1) as f64;
    Agreement {
        points: moments.count,
        share: share_of(moments.count, points.len()),
        likeness: 1.0 - moments.residual_variance() / contrast.max(MIN_CONTRAST),
        seen_through: share_of(seen_through, measured),
    }
}

/// The brightness at a point and, if there is one, the depth measured there; `None` out of view.
fn look(
    image: &IntensityImage,
    depth_m: &Image<f32>,
    position: &Vector3<f64>,
) -> Option<(f64, Option<f64>)> {
    let pixel = image.camera.project(position)?;
    let [value, ..] = image.sample(pixel.x, pixel.y)?;
    // Pixel centres lie at integers, so that edges of images lie at -0.5.
    let scale = depth_m.width() as f64 / image.camera.width as f64;
    let at = |x: f64, size: usize| (((x + 0.5) * scale) as usize).min(size.saturating_sub(1));
    let (u, v) = (at(pixel.x, depth_m.width()), at(pixel.y, depth_m.height()));
    let depth = depth_m.at(u, v);
    Some((value.into(), has_depth(depth).then_some(depth.into())))
}

#[derive(Default)]
struct Moments {
    count: usize,
    a: f64,
    b: f64,
    aa: f64,
    ab: f64,
    bb: f64,
}

impl Moments {
    fn add(&mut self, a: f64, b: f64) {
        self.count += 1;
        self.a += a;
        self.b += b;
        self.aa += a * a;
        self.ab += a * b;
        self.bb += b * b;
    }

    /// The variance of `b` that no positive gain and offset of `a` explain.
    fn residual_variance(&self) -> f64 {
        let n = self.count.max(1) as f64;
        let (mean_a, mean_b) = (self.a / n, self.b / n);
        let variance_a = self.aa / n - mean_a * mean_a;
        let covariance = self.ab / n - mean_a * mean_b;
        let variance_b = (self.bb / n - mean_b * mean_b).max(0.0);
        if covariance > 0.0 && variance_a > 0.0 {
            (variance_b - covariance * covariance / variance_a).max(0.0)
        } else {
            variance_b
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector6;

    use super::*;
    use crate::test_scene::Scene;
    use crate::{IntensityPyramid, Reference};

    fn compared(scene: &Scene, true_pose: &Se3, said: &Se3, gain: f64) -> Agreement {
        let keyframe = scene.frame(&Se3::identity(), 1.0, 0.0);
        let pyramid = IntensityPyramid::of_frame(&keyframe, 2);
        let reference = Reference::new(&pyramid, &keyframe.depth_m, &keyframe.camera);
        let frame = scene.frame(true_pose, gain, 0.05);
        let image = &IntensityPyramid::of_frame(&frame, 2).levels[1];
        let points = &reference.levels[1];
        agreement(
            image,
            &frame.depth_m,
            contrast(image),
            points,
            &said.inverse(),
        )
    }

    fn moved(by: f64) -> Se3 {
        Se3::exp(&(by * Vector6::new(0.2, -0.3, 0.1, 0.1, 0.2, -0.1)))
    }

    #[test]
    fn at_the_true_pose_images_agree_whatever_the_exposure() {
        let scene = Scene::new(3, true);
        let agreement = compared(&scene, &moved(0.3), &moved(0.3), 0.7);
        assert!(agreement.likeness >= 0.9, "{agreement:?}");
        assert!(
            agreement.seen_through <= 0.02 && agreement.share >= 0.5,
            "{agreement:?}"
        );
    }

    #[test]
    fn at_a_wrong_pose_they_do_not() {
        let scene = Scene::new(3, true);
        let agreement = compared(&scene, &moved(0.3), &moved(1.0), 1.0);
        assert!(agreement.likeness <= 0.3, "{agreement:?}");
        // Said to be half a metre farther back than it is.
        let back = Se3::new(
            nalgebra::UnitQuaternion::identity(),
            Vector3::new(0.0, 0.0, 0.5),
        );
        let agreement = compared(&scene, &Se3::identity(), &back, 1.0);
        assert!(agreement.seen_through >= 0.9, "{agreement:?}");
    }

    #[test]
    fn without_contrast_or_view_nothing_is_said() {
        let scene = Scene::new(3, true);
        let dark = compared(&scene, &Se3::identity(), &Se3::identity(), 0.0);
        assert!(dark.likeness >= 0.9, "{dark:?}");
        let behind = Se3::new(
            nalgebra::UnitQuaternion::from_euler_angles(0.0, 3.1, 0.0),
            Vector3::zeros(),
        );
        let away = compared(&scene, &Se3::identity(), &behind, 1.0);
        assert_eq!((away.points, away.share), (0, 0.0));
    }
}
