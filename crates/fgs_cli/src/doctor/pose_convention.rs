//! Conventions other than `world_from_camera` with x right, y down and z forward: the common mistakes
//! of programs that write poses.

use std::fmt;

use fgs_geom::Se3;
use nalgebra::{Matrix3, Matrix4, Vector3};

/// One way to interpret a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Convention {
    /// What the file's numbers stand for.
    stored: Stored,
    /// `ours_from_theirs`: maps the file's camera axes to ours; a signed permutation.
    axes: Matrix3<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stored {
    WorldFromCamera,
    CameraFromWorld,
    /// The quaternion's real part comes first, but was read as if last.
    QuaternionWxyz,
    /// The rotation is inverted, the position is not.
    RotationTransposed,
}

impl Convention {
    /// The convention that recordings should have.
    pub fn expected() -> Self {
        Self {
            stored: Stored::WorldFromCamera,
            axes: Matrix3::identity(),
        }
    }

    /// All other conventions, simpler ones first.
    pub fn mistakes() -> Vec<Self> {
        let with = |stored, axes| Self { stored, axes };
        let expected_axes = Matrix3::identity();
        let mut mistakes = vec![
            with(Stored::CameraFromWorld, expected_axes),
            with(Stored::QuaternionWxyz, expected_axes),
            with(Stored::RotationTransposed, expected_axes),
        ];
        let others = signed_permutations();
        for stored in [Stored::WorldFromCamera, Stored::CameraFromWorld] {
            mistakes.extend(others.iter().map(|axes| with(stored, *axes)));
        }
        mistakes
    }

    /// `first_from_second` in our camera axes, from two poses as read.
    pub fn motion(&self, first: &Se3, second: &Se3) -> Option<Se3> {
        let [first, second] = [first, second].map(|pose| match self.stored {
            Stored::WorldFromCamera => Some(*pose),
            Stored::CameraFromWorld => Some(pose.inverse()),
            Stored::QuaternionWxyz => {
                let read = pose.rotation.coords;
                Se3::from_wxyz([read.x, read.y, read.z, read.w], pose.translation.into())
            }
            Stored::RotationTransposed => Some(Se3::new(pose.rotation.inverse(), pose.translation)),
        });
        let motion = (first?.inverse() * second?).matrix();
        let axes = self.axes.to_homogeneous();
        let turned: Matrix4<f64> = axes * motion * axes.transpose();
        Se3::from_matrix(&turned)
    }

    /// How to correct the poses.
    pub fn advice(&self) -> String {
        let stored = match self.stored {
            Stored::WorldFromCamera => None,
            Stored::CameraFromWorld => Some("invert every pose"),
            Stored::QuaternionWxyz => Some("write the quaternion as qx qy qz qw, qw last"),
            Stored::RotationTransposed => Some("transpose the rotation, keep the position"),
        };
        let m = self.axes;
        let is_expected = m == Matrix3::identity();
        let axes = (!is_expected && m.determinant() > 0.0).then(|| {
            format!(
                "multiply every pose on the right by the rotation {}",
                Rows(m.transpose())
            )
        });
        let mirror = (m.determinant() < 0.0).then(|| {
            let m_transposed = Rows(m.transpose());
            format!("left-handed axes: replace every pose P by M P M', M' = {m_transposed} and M its transpose")
        });
        let steps: Vec<String> = stored
            .map(str::to_owned)
            .into_iter()
            .chain(axes)
            .chain(mirror)
            .collect();
        steps.join(", then ")
    }
}

impl fmt::Display for Convention {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.stored {
            Stored::WorldFromCamera => "camera to world",
            Stored::CameraFromWorld => "world to camera",
            Stored::QuaternionWxyz => "camera to world with quaternions w x y z",
            Stored::RotationTransposed => "camera to world with the rotation transposed",
        })?;
        let name = |axis: usize| {
            let direction: Vector3<f64> = self.axes.column(axis).into_owned();
            let names = [["left", "right"], ["up", "down"], ["backward", "forward"]];
            names[direction.iamax()][usize::from(direction.sum() > 0.0)]
        };
        write!(f, ", camera axes x {} y {} z {}", name(0), name(1), name(2))
    }
}

/// A matrix on one line.
struct Rows(Matrix3<f64>);

impl fmt::Display for Rows {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let row = |i: usize| {
            let m = &self.0;
            format!("{} {} {}", m[(i, 0)], m[(i, 1)], m[(i, 2)])
        };
        write!(f, "[{}; {}; {}]", row(0), row(1), row(2))
    }
}

/// The 47 signed permutations of the axes other than the identity: rotations first, with OpenGL's
/// (x right, y up, z backward) at the front.
fn signed_permutations() -> Vec<Matrix3<f64>> {
    let orders = [
        [0, 1, 2],
        [0, 2, 1],
        [1, 0, 2],
        [1, 2, 0],
        [2, 0, 1],
        [2, 1, 0],
    ];
    let sign = |bits: usize, axis: usize| if bits >> axis & 1 == 1 { -1.0 } else { 1.0 };
    let matrix = |order: [usize; 3], bits: usize| {
        Matrix3::from_fn(|row, column| {
            if order[column] == row {
                sign(bits, column)
            } else {
                0.0
            }
        })
    };
    let opengl = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    let mut all: Vec<Matrix3<f64>> = orders
        .iter()
        .flat_map(|&order| (0..8).map(move |bits| matrix(order, bits)))
        .collect();
    all.retain(|m| *m != Matrix3::identity());
    all.sort_by_key(|m| (m.determinant() < 0.0, *m != opengl));
    all
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector6;

    use super::*;

    fn poses() -> [Se3; 2] {
        [
            [0.3, -0.2, 0.9, 1.0, 2.0, 3.0],
            [0.5, -0.1, 0.7, 1.2, 1.9, 3.3],
        ]
        .map(|tangent| Se3::exp(&Vector6::from(tangent)))
    }

    #[test]
    fn there_is_every_mistake_once() {
        let mistakes = Convention::mistakes();
        assert_eq!(mistakes.len(), 3 + 2 * 47);
        let [first, second] = poses();
        let expected = Convention::expected().motion(&first, &second).unwrap();
        assert!((expected.matrix() - (first.inverse() * second).matrix()).amax() <= 1e-12);
        let mut motions: Vec<Matrix4<f64>> = Vec::new();
        for mistake in std::iter::once(Convention::expected()).chain(mistakes) {
            let motion = mistake.motion(&first, &second).unwrap().matrix();
            assert!(
                motions.iter().all(|other| (other - motion).amax() >= 1e-3),
                "{mistake}"
            );
            motions.push(motion);
        }
    }

    /// Poses written the wrong way give the true motion when read that way.
    #[test]
    fn each_mistake_is_undone() {
        let [first, second] = poses();
        let truth = first.inverse() * second;
        let undone = |text: &str, write: &dyn Fn(&Se3) -> Se3| {
            let mistake = Convention::mistakes()
                .into_iter()
                .find(|m| m.to_string() == text);
            let mistake = mistake.unwrap_or_else(|| panic!("no {text}"));
            let motion = mistake.motion(&write(&first), &write(&second)).unwrap();
            assert!((motion.matrix() - truth.matrix()).amax() <= 1e-12, "{text}");
            mistake.advice()
        };
        let expected_axes = "camera axes x right y down z forward";
        let advice = undone(&format!("world to camera, {expected_axes}"), &|p| {
            p.inverse()
        });
        assert_eq!(advice, "invert every pose");
        undone(
            &format!("camera to world with quaternions w x y z, {expected_axes}"),
            &|p| {
                let q = p.rotation.coords;
                // qw qx qy qz in the columns of qx qy qz qw.
                Se3::from_wxyz([q.z, q.w, q.x, q.y], p.translation.into()).unwrap()
            },
        );
        undone(
            &format!("camera to world with the rotation transposed, {expected_axes}"),
            &|p| Se3::new(p.rotation.inverse(), p.translation),
        );
        let by = |axes: Matrix3<f64>| {
            move |p: &Se3| Se3::from_matrix(&(p.matrix() * axes.to_homogeneous())).unwrap()
        };
        let opengl = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
        let advice = undone(
            "camera to world, camera axes x right y up z backward",
            &by(opengl),
        );
        assert!(advice.ends_with("[1 0 0; 0 -1 0; 0 0 -1]"), "{advice}");
        // ROS's body axes: x forward, y left, z up.
        let ros = Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0);
        undone(
            "camera to world, camera axes x forward y left z up",
            &by(ros),
        );
        let mirror = Matrix4::from_diagonal(&nalgebra::Vector4::new(1.0, -1.0, 1.0, 1.0));
        undone(
            "camera to world, camera axes x right y up z forward",
            &|p| Se3::from_matrix(&(mirror * p.matrix() * mirror)).unwrap(),
        );
    }
}
