//! The sparse normal equations of 6x6 blocks and their Cholesky factorisation.
//!
//! Our own, because what there is does not fit: nalgebra-sparse's Cholesky has no fill-reducing
//! order and advises against itself, faer would double the build for this one solve, and the
//! factor-graph crates either stand on faer (factrs) or need a newer compiler (apex-solver).
//! Elimination by blocks is short, and what it does to each block is nalgebra's.

use nalgebra::{Matrix6, Vector6};

use crate::elimination::Elimination;

/// `H x = -g`: the lower triangle of H in the order of elimination, with room for the fill-in.
pub struct BlockSystem<'a> {
    elimination: &'a Elimination,
    diagonal: Vec<Matrix6<f64>>,
    /// Beside `elimination.rows`.
    below: Vec<Vec<Matrix6<f64>>>,
    gradient: Vec<Vector6<f64>>,
}

impl<'a> BlockSystem<'a> {
    /// All zero.
    pub fn zero(elimination: &'a Elimination) -> Self {
        let rows = &elimination.rows;
        Self {
            elimination,
            diagonal: vec![Matrix6::zeros(); rows.len()],
            below: rows
                .iter()
                .map(|rows| vec![Matrix6::zeros(); rows.len()])
                .collect(),
            gradient: vec![Vector6::zeros(); rows.len()],
        }
    }

    /// Adds to an unknown's own block and its gradient.
    pub fn add_own(&mut self, unknown: usize, hessian: &Matrix6<f64>, gradient: &Vector6<f64>) {
        let position = self.elimination.position[unknown];
        self.diagonal[position] += hessian;
        self.gradient[position] += gradient;
    }

    /// Adds to the block in the row of unknown `a` and the column of unknown `b`, which differ and
    /// are coupled.
    pub fn add_coupling(&mut self, a: usize, b: usize, hessian: &Matrix6<f64>) {
        let [a, b] = [a, b].map(|unknown| self.elimination.position[unknown]);
        let (row, column) = (a.max(b), a.min(b));
        if let Ok(slot) = self.elimination.rows[column].binary_search(&row) {
            if a > b {
                self.below[column][slot] += hessian;
            } else {
                self.below[column][slot] += hessian.transpose();
            }
        }
    }

    /// The step of each unknown with every diagonal entry of H raised by the share `damping`. An
    /// unknown without any information stays. `None` if H is not positive definite.
    pub fn solve(mut self, damping: f64) -> Option<Vec<Vector6<f64>>> {
        for diagonal in &mut self.diagonal {
            for i in 0..6 {
                let entry = &mut diagonal[(i, i)];
                *entry = if *entry > 0.0 {
                    *entry * (1.0 + damping)
                } else {
                    1.0
                };
            }
        }
        let steps = self.factorize()?.substitute();
        let finite = steps.iter().all(|step| step.iter().all(|x| x.is_finite()));
        finite.then_some(steps)
    }

    /// Replaces H by its factor L: right-looking, column by column.
    fn factorize(mut self) -> Option<Self> {
        for k in 0..self.diagonal.len() {
            let rows = &self.elimination.rows[k];
            let l_kk = self.diagonal[k].cholesky()?.unpack();
            self.diagonal[k] = l_kk;
            let column = std::mem::take(&mut self.below[k]);
            let column: Vec<Matrix6<f64>> = column
                .into_iter()
                .map(|block| {
                    // X L_kk^T = block
                    let mut transposed = block.transpose();
                    l_kk.solve_lower_triangular_mut(&mut transposed)
                        .then_some(transposed.transpose())
                })
                .collect::<Option<_>>()?;
            for (j, (&row, l_jk)) in rows.iter().zip(&column).enumerate() {
                self.diagonal[row] -= l_jk * l_jk.transpose();
                // The column of `row` has all later rows of this one: see the elimination.
                let target_rows = &self.elimination.rows[row];
                let mut slot = 0;
                for (&below, l_ik) in rows[j + 1..].iter().zip(&column[j + 1..]) {
                    while target_rows[slot] != below {
                        slot += 1;
                    }
                    self.below[row][slot] -= l_ik * l_jk.transpose();
                }
            }
            self.below[k] = column;
        }
        Some(self)
    }

    /// Solves `L L^T x = -g`, by unknown.
    fn substitute(self) -> Vec<Vector6<f64>> {
        let rows = &self.elimination.rows;
        let mut x: Vec<Vector6<f64>> = self.gradient.iter().map(|gradient| -gradient).collect();
        for k in 0..x.len() {
            self.diagonal[k].solve_lower_triangular_mut(&mut x[k]);
            let solved = x[k];
            for (&row, l) in rows[k].iter().zip(&self.below[k]) {
                x[row] -= l * solved;
            }
        }
        for k in (0..x.len()).rev() {
            for (&row, l) in rows[k].iter().zip(&self.below[k]) {
                let solved = x[row];
                x[k] -= l.transpose() * solved;
            }
            self.diagonal[k].tr_solve_lower_triangular_mut(&mut x[k]);
        }
        let position = &self.elimination.position;
        position.iter().map(|&position| x[position]).collect()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// A random sparse system beside the dense one.
    #[test]
    fn equals_the_dense_solve() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        for unknowns in [1, 2, 7, 30] {
            let mut pairs: Vec<(usize, usize)> = (1..unknowns).map(|i| (i - 1, i)).collect();
            for _ in 0..unknowns / 2 {
                let (a, b) = (rng.random_range(0..unknowns), rng.random_range(0..unknowns));
                if a != b {
                    pairs.push((a, b));
                }
            }
            let elimination = Elimination::minimum_degree(unknowns, pairs.iter().copied());
            let mut system = BlockSystem::zero(&elimination);
            let n = 6 * unknowns;
            let (mut dense, mut gradient) = (DMatrix::zeros(n, n), DVector::zeros(n));
            for i in 0..unknowns {
                let own = Matrix6::identity() * (i + 1) as f64;
                let g = Vector6::from_fn(|_, _| rng.random_range(-1.0..1.0));
                system.add_own(i, &own, &g);
                let mut view = dense.fixed_view_mut::<6, 6>(6 * i, 6 * i);
                view += own;
                gradient.fixed_rows_mut::<6>(6 * i).copy_from(&g);
            }
            for (a, b) in pairs {
                let mut random = || Matrix6::from_fn(|_, _| rng.random_range(-1.0..1.0));
                let (j_a, j_b) = (random(), random());
                let zero = Vector6::zeros();
                system.add_own(a, &(j_a.transpose() * j_a), &zero);
                system.add_own(b, &(j_b.transpose() * j_b), &zero);
                system.add_coupling(a, b, &(j_a.transpose() * j_b));
                for (i, j_i) in [(a, j_a), (b, j_b)] {
                    for (j, j_j) in [(a, j_a), (b, j_b)] {
                        let mut view = dense.fixed_view_mut::<6, 6>(6 * i, 6 * j);
                        view += j_i.transpose() * j_j;
                    }
                }
            }
            let damping = 0.125;
            for i in 0..n {
                dense[(i, i)] *= 1.0 + damping;
            }
            let expected = dense.cholesky().unwrap().solve(&-gradient);
            let steps = system.solve(damping).unwrap();
            for (i, step) in steps.iter().enumerate() {
                assert!((step - expected.fixed_rows::<6>(6 * i)).amax() <= 1e-11);
            }
        }
    }

    #[test]
    fn no_solution_of_an_indefinite_system() {
        let elimination = Elimination::minimum_degree(1, std::iter::empty());
        let mut system = BlockSystem::zero(&elimination);
        let mut indefinite = Matrix6::identity();
        indefinite[(0, 1)] = 2.0;
        indefinite[(1, 0)] = 2.0;
        system.add_own(0, &indefinite, &Vector6::zeros());
        assert!(system.solve(0.0).is_none());
        // Nothing known of it: it stays.
        let system = BlockSystem::zero(&elimination);
        assert_eq!(system.solve(0.0), Some(vec![Vector6::zeros()]));
    }
}
