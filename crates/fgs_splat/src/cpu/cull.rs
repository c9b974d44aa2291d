//! Frustum culling by a gaussian's centre and longest axis: most of a map is out of view.
//! Conservative; `bounds` decides exactly.

use super::project::ScreenCamera;
use super::real::Real;
use crate::Gaussians;
use crate::kernel::mul_add;
use crate::rendering::{ALPHA_MIN, LOW_PASS_PX2, NEAR_M};

/// Gaussians that are tested together.
const LANES: usize = 16;
/// Margin around the image for rounding, pixels.
const SLACK_PX: f64 = 1.0;

/// A view's frustum in camera axes: along x and y a gaussian is in view if
/// `|x - middle z| <= half z + reach scale`, with `scale` the length of its longest axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frustum<T> {
    pub middle: [T; 2],
    pub half: [T; 2],
    pub reach: [T; 2],
}

impl<T: Real> Frustum<T> {
    pub fn new(camera: &ScreenCamera<T>) -> Self {
        // Beyond so many standard deviations even an opaque gaussian is under `ALPHA_MIN`.
        let deviations = (2.0 * (1.0 / ALPHA_MIN).ln()).sqrt();
        let size = [camera.width, camera.height];
        let by_axis = |value: &dyn Fn(usize, f64, f64) -> f64| {
            std::array::from_fn(|axis| {
                let focal = camera.focal[axis].to_f64();
                T::from_f64(value(axis, focal, 0.5 * (size[axis] as f64 - 1.0)))
            })
        };
        Self {
            middle: by_axis(&|axis, focal, half_px| {
                (half_px - camera.center[axis].to_f64()) / focal
            }),
            // sqrt(variance + low pass) is at most the sum of the two deviations.
            half: by_axis(&|_, focal, half_px| {
                (half_px + deviations * LOW_PASS_PX2.sqrt() + SLACK_PX) / focal
            }),
            // A row (1, 0, -tangent) focal / z of the projection lengthens at most by its norm.
            reach: by_axis(&|axis, _, _| {
                let (min, max) = (camera.tangent_min[axis], camera.tangent_max[axis]);
                let tangent = min.abs().max(max.abs()).to_f64();
                deviations * (1.0 + tangent * tangent).sqrt()
            }),
        }
    }

    /// Appends the indices of gaussians in `first..end` that may be in view.
    #[inline(always)]
    pub fn push_in_view<const FUSED: bool>(
        &self,
        camera: &ScreenCamera<T>,
        gaussians: &Gaussians<T>,
        first: usize,
        end: usize,
        in_view: &mut Vec<u32>,
    ) {
        let means = gaussians.means[first..end].chunks(LANES);
        let log_scales = gaussians.log_scales[first..end].chunks(LANES);
        for (start, (means, log_scales)) in (first..).step_by(LANES).zip(means.zip(log_scales)) {
            let mut seen = [0_u32; LANES];
            for ((seen, mean), log_scales) in seen.iter_mut().zip(means).zip(log_scales) {
                let [x, y, z] = camera.camera_axes::<FUSED>(mean);
                let longest = log_scales[0].max(log_scales[1]).max(log_scales[2]);
                let scale = longest.exp::<FUSED>();
                let inside = |x: T, axis: usize| {
                    let off = x - self.middle[axis] * z;
                    off.abs() <= mul_add::<FUSED, T>(self.half[axis], z, self.reach[axis] * scale)
                };
                let in_front = z >= T::from_f64(NEAR_M);
                *seen = u32::from(in_front & inside(x, 0) & inside(y, 1));
            }
            if seen != [0; LANES] {
                let indices = start as u32..;
                in_view.extend(
                    indices
                        .zip(seen)
                        .filter(|(_, seen)| *seen != 0)
                        .map(|(i, _)| i),
                );
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::tests::scenes::{random_gaussians, random_view, rng};

    #[test]
    fn leaves_out_what_is_behind_or_beside_the_view() {
        let mut rng = rng(1);
        let view = random_view(&mut rng, 40, 30);
        let camera = ScreenCamera::<f64>::new(&view);
        let frustum = Frustum::new(&camera);
        let mut gaussians = random_gaussians(&mut rng, &view, 50);
        let pose = view.world_from_camera;
        // Behind the camera, and a quarter turn to each of four sides.
        for point in [[0, 0, -2], [9, 0, 1], [-9, 0, 1], [0, 9, 1], [0, -9, 1]] {
            gaussians
                .means
                .push(pose.transform(&point.map(f64::from).into()).into());
            gaussians.log_scales.push([-3.0; 3]);
        }
        let mut in_view = Vec::new();
        frustum.push_in_view::<true>(&camera, &gaussians, 0, 55, &mut in_view);
        assert!(
            in_view.len() > 20 && in_view.iter().all(|&i| i < 50),
            "{in_view:?}"
        );
    }
}
