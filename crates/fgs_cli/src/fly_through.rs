//! A smooth camera path: a recorded trajectory without the tremor of the hand.

use fgs_geom::Se3;
use nalgebra::{Vector3, Vector4};

/// Standard deviation of the smoothing, as a share of the path: turns stay, tremor goes.
const SMOOTHING_SHARE: f64 = 0.03;

/// `views` poses evenly spaced along the smoothed path, in order; none if there are no poses.
pub fn fly_through(poses: &[Se3], views: usize) -> Vec<Se3> {
    let sigma = (SMOOTHING_SHARE * poses.len() as f64).max(1.0);
    let last = poses.len().saturating_sub(1) as f64;
    let step = last / views.saturating_sub(1).max(1) as f64;
    (0..views)
        .filter_map(|i| mean_pose(poses, i as f64 * step, sigma))
        .collect()
}

/// The mean of the poses, weighted by a gaussian centred on a position in the list.
fn mean_pose(poses: &[Se3], center: f64, sigma: f64) -> Option<Se3> {
    // Beyond 3 sigma a weight is under 1 %.
    let first = (center - 3.0 * sigma).ceil().max(0.0) as usize;
    let end = ((center + 3.0 * sigma) as usize + 1).min(poses.len());
    let mut translation = Vector3::zeros();
    let mut quaternion = Vector4::zeros();
    let mut sum = 0.0;
    for (i, pose) in poses.iter().enumerate().take(end).skip(first) {
        let distance = (i as f64 - center) / sigma;
        let weight = (-0.5 * distance * distance).exp();
        sum += weight;
        translation += weight * pose.translation;
        // A quaternion and its negative are one rotation.
        let q = pose.rotation.coords;
        quaternion += if q.dot(&quaternion) < 0.0 {
            -weight * q
        } else {
            weight * q
        };
    }
    let [x, y, z, w] = quaternion.into();
    Se3::from_wxyz([w, x, y, z], (translation / sum).into())
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use nalgebra::UnitQuaternion;

    use super::*;

    /// A turn about an oblique axis along a line, with a tremor of `tremor` m and rad.
    fn walk(len: usize, tremor: f64) -> Vec<Se3> {
        let axis = Vector3::new(0.6, -0.48, 0.64);
        let shake = |i: usize| if i.is_multiple_of(2) { tremor } else { -tremor };
        (0..len)
            .map(|i| {
                let turn = 3.0 * PI * i as f64 / len as f64 + shake(i);
                let rotation = UnitQuaternion::from_scaled_axis(turn * axis);
                Se3::new(
                    rotation,
                    Vector3::new(0.01 * i as f64, 2.0 + shake(i), -1.0),
                )
            })
            .collect()
    }

    #[test]
    fn tremor_goes_and_the_way_stays() {
        let (steady, shaky) = (walk(300, 0.0), walk(300, 0.02));
        let path = fly_through(&shaky, 300);
        for i in 30..270 {
            let error = (steady[i].inverse() * path[i]).log().amax();
            assert!(error <= 1e-3, "{i}: {error}");
        }
    }

    #[test]
    fn any_number_of_views_of_any_path() {
        assert!(fly_through(&[], 5).is_empty());
        assert_eq!(fly_through(&walk(1, 0.0), 3).len(), 3);
        assert_eq!(fly_through(&walk(300, 0.0), 1).len(), 1);
        let path = fly_through(&walk(50, 0.0), 500);
        assert_eq!(path.len(), 500);
        let step = |i: usize| (path[i].inverse() * path[i + 1]).log().amax();
        assert!((0..499).all(|i| step(i) <= 0.05));
    }
}
