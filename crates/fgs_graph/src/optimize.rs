//! The poses that fit all edges best: Levenberg-Marquardt on SE(3), robust kernels by iteratively
//! reweighted least squares. One thread: the same graph gives the same bits.

use fgs_geom::{KeyframeId, Se3};
use nalgebra::Vector6;

use crate::components::smallest_connected;
use crate::edge::Edge;
use crate::graph::{GraphError, KeyframeGraph};
use crate::normal_equations::NormalEquations;

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OptimizeSettings {
    /// Steps at most.
    pub max_iterations: usize,
    /// Converged when no pose turns (rad) or moves (m) by more than this in a step.
    pub min_step: f64,
}

impl Default for OptimizeSettings {
    /// A hundredth of a millimetre is below what any depth camera measures.
    fn default() -> Self {
        Self {
            max_iterations: 100,
            min_step: 1e-6,
        }
    }
}

/// What an optimisation found.
#[derive(Clone, Debug, PartialEq)]
pub struct Optimized {
    /// The motion `new_world_from_old_world` of each keyframe that moved, ascending by id; what
    /// [`KeyframeGraph::move_keyframes`] takes.
    pub corrections: Vec<(KeyframeId, Se3)>,
    /// The weight of each edge at the result, 0 to 1, in the order of [`KeyframeGraph::edges`]. An
    /// edge far below 1 contradicts the others.
    pub weights: Vec<f64>,
    /// The sum of all edges' costs before.
    pub initial_cost: f64,
    /// The sum of all edges' costs at the result.
    pub cost: f64,
    /// Steps taken.
    pub iterations: usize,
    /// Whether the last step was smaller than asked for.
    pub converged: bool,
}

/// Damping of the first step: next to none, since odometry is a good start.
const INITIAL_DAMPING: f64 = 1e-6;
/// How damping falls after a good step, and rises after a bad one.
const DAMPING_FACTOR: f64 = 10.0;
/// With more damping a step is too small to find anything.
const MAX_DAMPING: f64 = 1e12;

impl KeyframeGraph {
    /// The poses of least total cost. The keyframe with the smallest id of each connected part stays
    /// where it is. Nothing is changed: [`Optimized::corrections`] says how keyframes should move.
    ///
    /// # Errors
    /// If the poses' errors are not finite.
    pub fn optimize(&self, settings: &OptimizeSettings) -> Result<Optimized, GraphError> {
        let ids: Vec<KeyframeId> = self.poses.keys().copied().collect();
        let ends: Vec<(usize, usize)> = self
            .edges
            .iter()
            .filter_map(|edge| {
                Some((
                    ids.binary_search(&edge.from).ok()?,
                    ids.binary_search(&edge.to).ok()?,
                ))
            })
            .collect();
        let problem = Problem::new(&self.edges, ends, ids.len());
        let initial: Vec<Se3> = self.poses.values().copied().collect();
        let mut poses = initial.clone();
        let mut result = Optimized {
            corrections: Vec::new(),
            weights: Vec::new(),
            initial_cost: problem.cost(&poses),
            cost: problem.cost(&poses),
            iterations: 0,
            converged: true,
        };
        if !result.cost.is_finite() {
            return Err(GraphError::NotFinite);
        }
        problem.minimize(&mut poses, settings, &mut result);
        result.weights = problem.weights(&poses);
        result.corrections = (ids.iter().zip(&problem.variable_of))
            .zip(initial.iter().zip(&poses))
            .filter(|((_, variable), _)| variable.is_some())
            .map(|((id, _), (old, new))| (*id, *new * old.inverse()))
            .collect();
        Ok(result)
    }
}

/// The edges over poses by position.
struct Problem<'a> {
    edges: &'a [Edge],
    /// The two ends of each edge.
    ends: Vec<(usize, usize)>,
    /// Each pose's place among those that may move.
    variable_of: Vec<Option<usize>>,
}

impl<'a> Problem<'a> {
    fn new(edges: &'a [Edge], ends: Vec<(usize, usize)>, count: usize) -> Self {
        let mut variables = 0;
        let variable_of = smallest_connected(count, ends.iter().copied())
            .into_iter()
            .enumerate()
            .map(|(pose, smallest)| {
                (pose != smallest).then(|| {
                    variables += 1;
                    variables - 1
                })
            })
            .collect();
        Self {
            edges,
            ends,
            variable_of,
        }
    }

    fn with_ends(&self) -> impl Iterator<Item = (&'a Edge, usize, usize)> {
        let ends = self.ends.iter();
        self.edges
            .iter()
            .zip(ends)
            .map(|(edge, (from, to))| (edge, *from, *to))
    }

    fn cost(&self, poses: &[Se3]) -> f64 {
        self.with_ends()
            .map(|(edge, from, to)| edge.kernel.cost(edge.chi2(&poses[from], &poses[to])))
            .sum()
    }

    fn weights(&self, poses: &[Se3]) -> Vec<f64> {
        self.with_ends()
            .map(|(edge, from, to)| edge.kernel.weight(edge.chi2(&poses[from], &poses[to])))
            .collect()
    }

    /// Moves the poses to a minimum and notes in `result` how it went.
    fn minimize(&self, poses: &mut Vec<Se3>, settings: &OptimizeSettings, result: &mut Optimized) {
        let variables = self.variable_of.iter().flatten().count();
        let coupled: Vec<(usize, usize)> = self
            .ends
            .iter()
            .filter_map(|(from, to)| Some((self.variable_of[*from]?, self.variable_of[*to]?)))
            .collect();
        let Some(mut system) = NormalEquations::new(variables, &coupled) else {
            return;
        };
        result.converged = variables == 0;
        let mut damping = INITIAL_DAMPING;
        while !result.converged && result.iterations < settings.max_iterations {
            self.linearize(poses, &mut system);
            result.iterations += 1;
            loop {
                let Some(step) = system.solve(damping) else {
                    damping *= DAMPING_FACTOR;
                    if damping > MAX_DAMPING {
                        return;
                    }
                    continue;
                };
                let moved = self.moved(poses, &step);
                let cost = self.cost(&moved);
                let largest = step.iter().map(Vector6::amax).fold(0.0, f64::max);
                if cost <= result.cost {
                    (*poses, result.cost) = (moved, cost);
                    damping /= DAMPING_FACTOR;
                    result.converged = largest <= settings.min_step;
                    break;
                }
                // Rounding alone can make the last, tiny step look bad.
                if largest <= settings.min_step {
                    result.converged = true;
                    break;
                }
                damping *= DAMPING_FACTOR;
                if damping > MAX_DAMPING {
                    return;
                }
            }
        }
    }

    fn linearize(&self, poses: &[Se3], system: &mut NormalEquations) {
        system.clear();
        for (edge, from, to) in self.with_ends() {
            let linearized = edge.linearize(&poses[from], &poses[to]);
            let residual = linearized.residual;
            let chi2 = residual.dot(&(edge.information * residual));
            let information = edge.kernel.weight(chi2) * edge.information;
            let ends = [
                (self.variable_of[from], linearized.by_from),
                (self.variable_of[to], linearized.by_to),
            ];
            for (row, by_row) in &ends {
                let Some(row) = row else { continue };
                let weighted = by_row.transpose() * information;
                system.add_gradient(*row, &(weighted * residual));
                for (column, by_column) in &ends {
                    if let Some(column) = column {
                        system.add_block(*row, *column, &(weighted * by_column));
                    }
                }
            }
        }
    }

    fn moved(&self, poses: &[Se3], step: &[Vector6<f64>]) -> Vec<Se3> {
        let poses = poses.iter().zip(&self.variable_of);
        poses
            .map(|(pose, variable)| variable.map_or(*pose, |i| *pose * Se3::exp(&step[i])))
            .collect()
    }
}
