//! SIMD version of [`Factor`](super::Factor) and [`LinearSystem::add`]: accumulates the normal
//! equations of several correspondences at once, one per lane. Tested against the scalar version.
//!
//! Invariant: lanes are summed in a fixed order and without fused multiply-add. Results therefore
//! do not depend on the number of threads, and depend on the instruction set only through the order
//! of summation.

use nalgebra::{Matrix3, Vector3, Vector6};

use super::{Kernel, LinearSystem};
use crate::Point;

/// Correspondences at one pose, collected until they fill the lanes, and the sums over the previous
/// ones. A register should hold `LANES` numbers.
pub(super) struct PairBatch<const LANES: usize> {
    /// Row-major.
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
    kernel: Kernel,
    /// Number of lanes in use. The others have zero covariances and contribute nothing.
    filled: usize,
    p: [[f64; LANES]; 3],
    q: [[f64; LANES]; 3],
    source_covariance: [[f64; LANES]; 6],
    target_covariance: [[f64; LANES]; 6],
    sums: Sums<LANES>,
}

/// Symmetric matrices as xx, xy, xz, yy, yz, zz; the mixed block is row-major.
struct Sums<const LANES: usize> {
    rotation: [[f64; LANES]; 6],
    mixed: [[f64; LANES]; 9],
    translation: [[f64; LANES]; 6],
    gradient: [[f64; LANES]; 6],
    pairs: [f64; LANES],
    weight: [f64; LANES],
    squared_residual: [f64; LANES],
    cost: [f64; LANES],
}

impl<const LANES: usize> Sums<LANES> {
    const ZERO: Self = Self {
        rotation: [[0.0; LANES]; 6],
        mixed: [[0.0; LANES]; 9],
        translation: [[0.0; LANES]; 6],
        gradient: [[0.0; LANES]; 6],
        pairs: [0.0; LANES],
        weight: [0.0; LANES],
        squared_residual: [0.0; LANES],
        cost: [0.0; LANES],
    };
}

impl<const LANES: usize> PairBatch<LANES> {
    const ZERO: [f64; LANES] = [0.0; LANES];

    pub fn new(rotation: &Matrix3<f64>, translation: &Vector3<f64>, kernel: Kernel) -> Self {
        Self {
            rotation: std::array::from_fn(|row| {
                std::array::from_fn(|column| rotation[(row, column)])
            }),
            translation: (*translation).into(),
            kernel,
            filled: 0,
            p: [Self::ZERO; 3],
            q: [Self::ZERO; 3],
            source_covariance: [Self::ZERO; 6],
            target_covariance: [Self::ZERO; 6],
            sums: Sums::ZERO,
        }
    }

    #[inline(always)]
    pub fn push(&mut self, source: &Point, target: &Point) {
        let lane = self.filled;
        for axis in 0..3 {
            self.p[axis][lane] = source.position[axis].into();
            self.q[axis][lane] = target.position[axis].into();
        }
        let (source, target) = (source.covariance.upper(), target.covariance.upper());
        for i in 0..6 {
            self.source_covariance[i][lane] = source[i].into();
            self.target_covariance[i][lane] = target[i].into();
        }
        self.filled += 1;
        if self.filled == LANES {
            self.add_lanes();
        }
    }

    /// The sums over all correspondences.
    #[inline(always)]
    pub fn finish(mut self) -> LinearSystem {
        if self.filled > 0 {
            self.add_lanes();
        }
        let sum = |lanes: &[f64; LANES]| lanes.iter().sum::<f64>();
        let symmetric = |parts: &[[f64; LANES]; 6]| {
            let [xx, xy, xz, yy, yz, zz] = parts.each_ref().map(sum);
            Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
        };
        let sums = &self.sums;
        LinearSystem {
            rotation_block: symmetric(&sums.rotation),
            mixed_block: Matrix3::from_row_slice(&sums.mixed.each_ref().map(sum)),
            translation_block: symmetric(&sums.translation),
            gradient: Vector6::from(sums.gradient.each_ref().map(sum)),
            pairs: sum(&sums.pairs) as usize,
            weight: sum(&sums.weight),
            squared_residual: sum(&sums.squared_residual),
            cost: sum(&sums.cost),
        }
    }

    #[inline(always)]
    fn add_lanes(&mut self) {
        let r = &self.rotation;
        let (mut e, mut m) = ([Self::ZERO; 3], [Self::ZERO; 6]);
        let (mut counts, mut squared) = (Self::ZERO, Self::ZERO);
        for lane in 0..LANES {
            // e = R^T (q - t) - p
            let d: [f64; 3] =
                std::array::from_fn(|axis| self.q[axis][lane] - self.translation[axis]);
            let residual: [f64; 3] = std::array::from_fn(|i| {
                r[0][i] * d[0] + r[1][i] * d[1] + r[2][i] * d[2] - self.p[i][lane]
            });
            // C = R^T C_q R + C_p
            let [xx, xy, xz, yy, yz, zz]: [f64; 6] =
                std::array::from_fn(|i| self.target_covariance[i][lane]);
            let c_r: [[f64; 3]; 3] = std::array::from_fn(|j| {
                let [a, b, c] = [r[0][j], r[1][j], r[2][j]];
                [
                    xx * a + xy * b + xz * c,
                    xy * a + yy * b + yz * c,
                    xz * a + yz * b + zz * c,
                ]
            });
            let rotated = |i: usize, j: usize| {
                r[0][i] * c_r[j][0] + r[1][i] * c_r[j][1] + r[2][i] * c_r[j][2]
            };
            let own = |i: usize| self.source_covariance[i][lane];
            let [xx, xy, xz] = [
                rotated(0, 0) + own(0),
                rotated(0, 1) + own(1),
                rotated(0, 2) + own(2),
            ];
            let [yy, yz, zz] = [
                rotated(1, 1) + own(3),
                rotated(1, 2) + own(4),
                rotated(2, 2) + own(5),
            ];
            // M = C^-1 by cofactors
            let c_xx = yy * zz - yz * yz;
            let c_xy = xz * yz - xy * zz;
            let c_xz = xy * yz - xz * yy;
            let determinant = xx * c_xx + xy * c_xy + xz * c_xz;
            let valid = determinant > 0.0 && determinant < f64::INFINITY;
            let inverse = if valid { 1.0 / determinant } else { 0.0 };
            let cofactors = [
                c_xx,
                c_xy,
                c_xz,
                xx * zz - xz * xz,
                xy * xz - xx * yz,
                xx * yy - xy * xy,
            ];
            let information = cofactors.map(|c| if valid { c * inverse } else { 0.0 });
            let [xx, xy, xz, yy, yz, zz] = information;
            let [x, y, z] = residual;
            let cost = x * (xx * x + xy * y + xz * z)
                + y * (xy * x + yy * y + yz * z)
                + z * (xz * x + yz * y + zz * z);
            squared[lane] = if valid { cost / (xx + yy + zz) } else { 0.0 };
            counts[lane] = if valid { 1.0 } else { 0.0 };
            for i in 0..3 {
                e[i][lane] = residual[i];
            }
            for i in 0..6 {
                m[i][lane] = information[i];
            }
        }
        let weights = squared.map(|squared| self.kernel.weight(squared));
        let sums = &mut self.sums;
        for lane in 0..LANES {
            let weight = weights[lane] * counts[lane];
            let [xx, xy, xz, yy, yz, zz]: [f64; 6] = std::array::from_fn(|i| weight * m[i][lane]);
            let [ex, ey, ez] = [e[0][lane], e[1][lane], e[2][lane]];
            let [px, py, pz] = [self.p[0][lane], self.p[1][lane], self.p[2][lane]];
            // J = [skew(p), -I]. Each column of skew(p) M is p x (column of M) ...
            let cross = |[x, y, z]: [f64; 3]| [py * z - pz * y, pz * x - px * z, px * y - py * x];
            let columns = [
                cross([xx, xy, xz]),
                cross([xy, yy, yz]),
                cross([xz, yz, zz]),
            ];
            let row = |i: usize| [columns[0][i], columns[1][i], columns[2][i]];
            // ... and crossing its rows gives skew(p) M skew(p)^T.
            let rotated = [cross(row(0)), cross(row(1)), cross(row(2))];
            let turn = [
                rotated[0][0],
                rotated[0][1],
                rotated[0][2],
                rotated[1][1],
                rotated[1][2],
                rotated[2][2],
            ];
            let me = [
                xx * ex + xy * ey + xz * ez,
                xy * ex + yy * ey + yz * ez,
                xz * ex + yz * ey + zz * ez,
            ];
            let [tx, ty, tz] = cross(me).map(|x| -x);
            let gradient = [tx, ty, tz, -me[0], -me[1], -me[2]];
            for i in 0..6 {
                sums.rotation[i][lane] += turn[i];
                sums.gradient[i][lane] += gradient[i];
            }
            for (i, value) in [xx, xy, xz, yy, yz, zz].into_iter().enumerate() {
                sums.translation[i][lane] += value;
            }
            for i in 0..3 {
                for (j, column) in columns.iter().enumerate() {
                    sums.mixed[3 * i + j][lane] += column[i];
                }
            }
            sums.pairs[lane] += counts[lane];
            sums.weight[lane] += weight;
            sums.squared_residual[lane] += weight * squared[lane];
            sums.cost[lane] += (xx + yy + zz) * squared[lane];
        }
        self.filled = 0;
        // Zero covariances give zero information, so stale positions in unused lanes do no harm.
        (self.source_covariance, self.target_covariance) = ([Self::ZERO; 6], [Self::ZERO; 6]);
    }
}

#[cfg(test)]
mod tests {
    use fgs_geom::Se3;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::{Covariance, Factor};

    /// Covers every number of filled lanes, singular and NaN covariances, and several kernels.
    #[test]
    fn equals_one_pair_after_the_other() {
        equals::<4>();
        equals::<8>();
    }

    fn equals<const LANES: usize>() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let pose = Se3::exp(&Vector6::new(0.9, -0.4, 0.3, 0.5, -1.0, 2.0));
        let rotation = pose.rotation.to_rotation_matrix().into_inner();
        let kernels = [
            Kernel::None,
            Kernel::Cauchy { scale_m: 0.02 },
            Kernel::Huber { scale_m: 0.01 },
        ];
        for (count, kernel) in (1..=3 * LANES).zip(kernels.into_iter().cycle()) {
            let mut batch = PairBatch::<LANES>::new(&rotation, &pose.translation, kernel);
            let mut expected = LinearSystem::zero();
            for i in 0..count {
                let mut vector = || Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
                let mut disk = |position: Vector3<f64>| Point {
                    position: position.cast(),
                    covariance: match i % 7 {
                        5 => Covariance::from_matrix(&Matrix3::zeros()),
                        6 => Covariance::from_matrix(&Matrix3::from_element(f64::NAN)),
                        _ => Covariance::disk(&vector().normalize(), 1e-3),
                    },
                };
                let p = disk(Vector3::new(0.3 * i as f64, 1.0, 2.0));
                let q = disk(pose.transform(&p.position.cast()) + Vector3::new(0.01, -0.02, 0.015));
                batch.push(&p, &q);
                let (position, c_p) = (p.position.cast(), p.covariance.matrix());
                let c_q = q.covariance.matrix();
                let factor = Factor::new(
                    &position,
                    &c_p,
                    &q.position.cast(),
                    &c_q,
                    &rotation,
                    &pose.translation,
                );
                if let Some(factor) = factor {
                    let squared = factor.squared_residual();
                    expected.add(&position, &factor, kernel.weight(squared), squared);
                }
            }
            let system = batch.finish();
            assert_eq!(system.pairs, expected.pairs);
            let near = |a: f64, b: f64| (a - b).abs() <= 1e-9 * b.abs();
            assert!(near(system.weight, expected.weight));
            assert!(near(system.squared_residual, expected.squared_residual));
            assert!(near(system.cost, expected.cost));
            let hessian = expected.hessian();
            assert!((system.hessian() - hessian).amax() <= 1e-9 * hessian.amax());
            let gradient = &expected.gradient;
            assert!((system.gradient - gradient).amax() <= 1e-9 * gradient.amax());
        }
    }
}
