//! How well given motions explain registered ones, up to an unknown scale.

use fgs_geom::Se3;
use nalgebra::Vector3;

/// A registered motion, and points to measure it by.
#[derive(Clone)]
pub struct Motion {
    /// The registered motion.
    pub first_from_second: Se3,
    /// Points of the scene, in the second frame's camera axes.
    pub points: Vec<Vector3<f64>>,
}

/// How given motions explain registered ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionFit {
    /// The share of the points' displacements that is left unexplained: 0 is a perfect fit, 1 no better
    /// than assuming no motion.
    pub misfit: f64,
    /// Length of the registered translations relative to the given ones; 0 if their directions
    /// disagree.
    pub scale: f64,
    /// Standard error of `scale`.
    pub scale_error: f64,
}

/// Least squares over all points of all motions. `None` if nothing moves.
pub fn fit(registered: &[Motion], given: &[Se3]) -> Option<MotionFit> {
    // Of each motion: what the given rotation leaves of its points' places.
    let rests: Vec<Vec<Vector3<f64>>> = registered
        .iter()
        .zip(given)
        .map(|(motion, given)| {
            let rest = |point: &Vector3<f64>| {
                motion.first_from_second.transform(point) - given.rotation * point
            };
            motion.points.iter().map(rest).collect()
        })
        .collect();
    let (mut along, mut length) = (0.0, 0.0);
    for (rest, given) in rests.iter().zip(given) {
        along += rest.iter().map(|r| r.dot(&given.translation)).sum::<f64>();
        length += rest.len() as f64 * given.translation.norm_squared();
    }
    let scale = if along > 0.0 { along / length } else { 0.0 };
    let (mut unexplained, mut scores) = (0.0, 0.0);
    for (rest, given) in rests.iter().zip(given) {
        let left = rest.iter().map(|r| r - scale * given.translation);
        unexplained += left.clone().map(|r| r.norm_squared()).sum::<f64>();
        // Motions are independent of one another, points of a motion are not.
        scores += left.map(|r| r.dot(&given.translation)).sum::<f64>().powi(2);
    }
    let displacement = |motion: &Motion| {
        let moved = |point| (motion.first_from_second.transform(point) - point).norm_squared();
        motion.points.iter().map(moved).sum::<f64>()
    };
    let total: f64 = registered.iter().map(displacement).sum();
    (total > 0.0).then(|| MotionFit {
        misfit: (unexplained / total).sqrt(),
        scale,
        scale_error: if length > 0.0 {
            scores.sqrt() / length
        } else {
            f64::INFINITY
        },
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector6;

    use super::*;

    fn motions() -> Vec<Motion> {
        let tangents = [
            [0.1, -0.05, 0.02, 0.1, 0.05, -0.2],
            [-0.02, 0.12, 0.1, -0.2, 0.1, 0.1],
            [0.03, 0.02, -0.15, 0.05, -0.15, 0.1],
        ];
        let motion = |tangent: [f64; 6]| Motion {
            first_from_second: Se3::exp(&Vector6::from(tangent)),
            points: vec![Vector3::new(0.5, 0.2, 2.0), Vector3::new(-0.7, -0.3, 1.5)],
        };
        tangents.map(motion).into()
    }

    #[test]
    fn another_unit_of_length_is_found() {
        let registered = motions();
        let scaled = |motion: &Motion| {
            let Se3 {
                rotation,
                translation,
            } = motion.first_from_second;
            Se3::new(rotation, translation / 1.3)
        };
        let given: Vec<Se3> = registered.iter().map(scaled).collect();
        let fit = fit(&registered, &given).unwrap();
        assert!(fit.misfit <= 1e-12);
        assert!((fit.scale - 1.3).abs() <= 1e-12);
        assert!(fit.scale_error <= 1e-12);
    }

    #[test]
    fn wrong_motions_are_not_explained() {
        let registered = motions();
        let inverse: Vec<Se3> = registered
            .iter()
            .map(|m| m.first_from_second.inverse())
            .collect();
        assert!(fit(&registered, &inverse).unwrap().misfit >= 1.0);
        let none = vec![Se3::identity(); 3];
        let fit_of_none = fit(&registered, &none).unwrap();
        assert!((fit_of_none.misfit - 1.0).abs() <= 1e-12);
        assert_eq!(fit_of_none.scale, 0.0);
        assert_eq!(fit(&[], &[]), None);
    }
}
