//! The sparse linear system of a step: `(H + lambda diag(H)) x = -g`, in blocks of 6x6.
//!
//! The pattern, its order of elimination and its symbolic decomposition are made once; each step
//! only fills in numbers.

use std::collections::BTreeMap;

use nalgebra::{DVector, Matrix6, Vector6};
use nalgebra_sparse::CscMatrix;
use nalgebra_sparse::factorization::CscCholesky;
use nalgebra_sparse::pattern::SparsityPattern;

use crate::ordering::minimum_degree;

/// Degrees of freedom of a pose.
const DOF: usize = 6;

/// A system over `count` poses.
pub struct NormalEquations {
    /// Where each pose stands in the order of elimination.
    position: Vec<usize>,
    /// The offset of each block (row, column) among the values of its column of blocks.
    offsets: BTreeMap<(usize, usize), usize>,
    /// For each column of blocks, where its values start, and the number of its blocks.
    columns: Vec<(usize, usize)>,
    matrix: CscMatrix<f64>,
    gradient: DVector<f64>,
    cholesky: Option<CscCholesky<f64>>,
}

impl NormalEquations {
    /// For poses of which each pair in `edges` shares a measurement. `None` if there are none.
    pub fn new(count: usize, edges: &[(usize, usize)]) -> Option<Self> {
        let order = minimum_degree(count, edges.iter().copied());
        let mut position = vec![0; count];
        for (place, pose) in order.into_iter().enumerate() {
            position[pose] = place;
        }
        let mut blocks: Vec<Vec<usize>> = (0..count).map(|column| vec![column]).collect();
        for &(a, b) in edges {
            let (a, b) = (position[a], position[b]);
            blocks[a].push(b);
            blocks[b].push(a);
        }
        let (mut offsets, mut columns) = (BTreeMap::new(), Vec::with_capacity(count));
        let (mut starts, mut rows) = (vec![0], Vec::new());
        for (column, blocks) in blocks.iter_mut().enumerate() {
            blocks.sort_unstable();
            blocks.dedup();
            columns.push((rows.len(), blocks.len()));
            offsets.extend(
                blocks
                    .iter()
                    .enumerate()
                    .map(|(i, row)| ((*row, column), i)),
            );
            for _ in 0..DOF {
                rows.extend(blocks.iter().flat_map(|row| DOF * row..DOF * (row + 1)));
                starts.push(rows.len());
            }
        }
        let size = DOF * count;
        let values = vec![0.0; rows.len()];
        let pattern =
            SparsityPattern::try_from_offsets_and_indices(size, size, starts, rows).ok()?;
        Some(Self {
            position,
            offsets,
            columns,
            matrix: CscMatrix::try_from_pattern_and_values(pattern, values).ok()?,
            gradient: DVector::zeros(size),
            cholesky: None,
        })
    }

    /// Starts anew, with all numbers zero.
    pub fn clear(&mut self) {
        self.matrix.values_mut().fill(0.0);
        self.gradient.fill(0.0);
    }

    /// Adds to the block of a pair of poses, in this order; the caller adds the transpose.
    pub fn add_block(&mut self, row: usize, column: usize, block: &Matrix6<f64>) {
        let (row, column) = (self.position[row], self.position[column]);
        let Some(offset) = self.offsets.get(&(row, column)) else {
            return;
        };
        let (start, blocks) = self.columns[column];
        let values = self.matrix.values_mut();
        for j in 0..DOF {
            let first = start + DOF * (j * blocks + offset);
            for i in 0..DOF {
                values[first + i] += block[(i, j)];
            }
        }
    }

    /// Adds to a pose's gradient.
    pub fn add_gradient(&mut self, pose: usize, gradient: &Vector6<f64>) {
        let first = DOF * self.position[pose];
        let mut rows = self.gradient.fixed_rows_mut::<DOF>(first);
        rows += gradient;
    }

    /// The step of each pose with this damping; `None` if the matrix is not positive definite.
    pub fn solve(&mut self, damping: f64) -> Option<Vec<Vector6<f64>>> {
        let mut damped = self.matrix.values().to_vec();
        for (column, &(start, blocks)) in self.columns.iter().enumerate() {
            let offset = self.offsets[&(column, column)];
            for j in 0..DOF {
                damped[start + DOF * (j * blocks + offset) + j] *= 1.0 + damping;
            }
        }
        match &mut self.cholesky {
            Some(cholesky) => cholesky.refactor(&damped).ok()?,
            None => {
                let pattern = self.matrix.pattern().clone();
                let matrix = CscMatrix::try_from_pattern_and_values(pattern, damped).ok()?;
                self.cholesky = Some(CscCholesky::factor(&matrix).ok()?);
            }
        }
        let solution = self.cholesky.as_ref()?.solve(&-&self.gradient);
        let step = |&place: &usize| solution.fixed_view::<DOF, 1>(DOF * place, 0).into_owned();
        Some(self.position.iter().map(step).collect())
    }
}
