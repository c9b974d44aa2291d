//! Pose-graph optimisation: Levenberg-Marquardt on the edges' weighted squares, the weights of
//! robust edges by graduated non-convexity.

use std::collections::BTreeMap;

use fgs_geom::{KeyframeId, Se3};
use nalgebra::Vector6;

use crate::block_system::BlockSystem;
use crate::edge::is_finite;
use crate::elimination::Elimination;
use crate::residual::{linearize, residual};
use crate::robust::Truncation;
use crate::{Edge, GraphError, Kernel};

/// Share by which diagonal entries are raised at first, and at least.
const FIRST_DAMPING: f64 = 1e-6;
const MIN_DAMPING: f64 = 1e-12;
const DAMPING_FACTOR: f64 = 10.0;

/// Steps of plain least squares, with all robust edges: false ones need more.
const MAX_PLAIN_STEPS: usize = 10;

/// Poses need not be exact while weights still change.
const STEPS_PER_SURROGATE: usize = 1;

/// When to stop and what to reject.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OptimizeSettings {
    /// Number of linear solves after which the search ends.
    pub max_iterations: usize,
    /// Converged when no keyframe turns more than this ...
    pub rotation_epsilon_rad: f64,
    /// ... or moves more than this in a step.
    pub translation_epsilon_m: f64,
    /// Robust edges with a squared error `r^T information r` above this are rejected.
    pub max_squared_error: f64,
}

impl Default for OptimizeSettings {
    /// The squared error that one in a hundred true edges exceeds (chi-squared, six degrees of
    /// freedom).
    fn default() -> Self {
        Self {
            max_iterations: 200,
            rotation_epsilon_rad: 1e-6,
            translation_epsilon_m: 1e-6,
            max_squared_error: 16.81,
        }
    }
}

/// The result of an optimisation.
#[derive(Clone, Debug, PartialEq)]
pub struct Optimized {
    /// `new_world_from_old_world` of each keyframe, ascending by id; the identity for those that
    /// are held.
    pub corrections: Vec<(KeyframeId, Se3)>,
    /// Number of linear solves.
    pub iterations: usize,
    /// Whether the last step was below the settings' epsilons.
    pub converged: bool,
    /// Sum of the edges' squared errors before, of robust ones at most the settings'
    /// `max_squared_error` each.
    pub cost_before: f64,
    /// The same after.
    pub cost_after: f64,
    /// Rejected edges, as indices into [`KeyframeGraph::edges`](crate::KeyframeGraph::edges).
    pub rejected: Vec<usize>,
}

pub fn optimize(
    poses: &BTreeMap<KeyframeId, Se3>,
    edges: &[Edge],
    settings: &OptimizeSettings,
) -> Result<Optimized, GraphError> {
    check(poses, settings)?;
    let mut problem = Problem::new(poses, edges);
    let start = problem.poses.clone();
    let cost_before = problem.truncated_cost(settings);
    if !cost_before.is_finite() {
        return Err(GraphError::CostOverflow { edges: edges.len() });
    }
    let (mut weights, mut iterations) = (vec![1.0; edges.len()], 0);
    let mut converged = problem.minimize(
        &weights,
        settings,
        settings.max_iterations.min(MAX_PLAIN_STEPS),
        &mut iterations,
    );
    let contradicted = problem
        .robust_errors()
        .any(|squared| squared > settings.max_squared_error);
    if contradicted || (!converged && problem.robust_errors().next().is_some()) {
        // What false loops bent is a worse start than the one that was given.
        problem.poses.clone_from(&start);
        converged = problem.minimize_truncated(settings, &mut weights, &mut iterations);
    } else if !converged {
        converged = problem.minimize(&weights, settings, settings.max_iterations, &mut iterations);
    }
    let corrections = poses.iter().zip(problem.corrections(poses));
    Ok(Optimized {
        corrections: corrections
            .map(|((id, _), correction)| (*id, correction))
            .collect(),
        iterations,
        converged,
        cost_before,
        cost_after: problem.truncated_cost(settings),
        rejected: (0..edges.len()).filter(|&i| weights[i] < 0.5).collect(),
    })
}

fn check(poses: &BTreeMap<KeyframeId, Se3>, settings: &OptimizeSettings) -> Result<(), GraphError> {
    for (setting, value) in [
        ("rotation_epsilon_rad", settings.rotation_epsilon_rad),
        ("translation_epsilon_m", settings.translation_epsilon_m),
        ("max_squared_error", settings.max_squared_error),
    ] {
        if !(value > 0.0 && value.is_finite()) {
            return Err(GraphError::InvalidSetting { setting, value });
        }
    }
    match poses.iter().find(|(_, pose)| !is_finite(pose)) {
        Some((&id, _)) => Err(GraphError::NonFinitePose { id }),
        None => Ok(()),
    }
}

/// An edge between places in the list of poses.
struct PlacedEdge<'a> {
    edge: &'a Edge,
    from: usize,
    to: usize,
}

struct Problem<'a> {
    poses: Vec<Se3>,
    edges: Vec<PlacedEdge<'a>>,
    /// The unknown of each pose; none if it is held.
    unknown: Vec<Option<usize>>,
    elimination: Elimination,
}

impl<'a> Problem<'a> {
    fn new(poses: &BTreeMap<KeyframeId, Se3>, edges: &'a [Edge]) -> Self {
        let place: BTreeMap<KeyframeId, usize> = poses.keys().copied().zip(0..).collect();
        let edges: Vec<PlacedEdge> = edges
            .iter()
            .filter_map(|edge| {
                let (&from, &to) = (place.get(&edge.from)?, place.get(&edge.to)?);
                Some(PlacedEdge { edge, from, to })
            })
            .collect();
        let mut unknowns = 0;
        let unknown: Vec<Option<usize>> = is_first_of_part(poses.len(), &edges)
            .into_iter()
            .map(|held| {
                (!held).then(|| {
                    unknowns += 1;
                    unknowns - 1
                })
            })
            .collect();
        let pairs = edges
            .iter()
            .filter_map(|edge| unknown[edge.from].zip(unknown[edge.to]));
        Self {
            poses: poses.values().map(Se3::renormalized).collect(),
            elimination: Elimination::minimum_degree(unknowns, pairs),
            edges,
            unknown,
        }
    }

    /// Graduated non-convexity: weights and poses by turns. Whether both settled.
    fn minimize_truncated(
        &mut self,
        settings: &OptimizeSettings,
        weights: &mut Vec<f64>,
        iterations: &mut usize,
    ) -> bool {
        let largest = self.robust_errors().fold(0.0, f64::max);
        let mut surrogate = Truncation::convex(largest, settings.max_squared_error);
        let mut converged = false;
        loop {
            let before = weights.clone();
            for (placed, weight) in self.edges.iter().zip(&mut *weights) {
                if placed.edge.kernel == Kernel::TruncatedQuadratic {
                    *weight = surrogate.weight(self.squared_error(placed, &self.poses));
                }
            }
            let decided = weights.iter().all(|&weight| weight == 0.0 || weight == 1.0);
            let settled = decided && *weights == before && converged;
            if settled || *iterations >= settings.max_iterations {
                return settled;
            }
            let steps = if decided {
                settings.max_iterations
            } else {
                STEPS_PER_SURROGATE
            };
            converged = self.minimize(weights, settings, steps, iterations);
            surrogate = surrogate.sharper();
        }
    }

    /// Levenberg-Marquardt with fixed weights, of at most `steps` steps. Whether it converged.
    fn minimize(
        &mut self,
        weights: &[f64],
        settings: &OptimizeSettings,
        steps: usize,
        iterations: &mut usize,
    ) -> bool {
        let mut damping = FIRST_DAMPING;
        let mut cost = self.weighted_cost(weights, &self.poses);
        let last = (*iterations + steps).min(settings.max_iterations);
        while *iterations < last {
            *iterations += 1;
            let Some(steps) = self.linearize(weights).solve(damping) else {
                damping *= DAMPING_FACTOR;
                continue;
            };
            let moved = self.moved(&steps);
            let moved_cost = self.weighted_cost(weights, &moved);
            if moved_cost <= cost {
                (self.poses, cost) = (moved, moved_cost);
                damping = (damping / DAMPING_FACTOR).max(MIN_DAMPING);
            } else {
                damping *= DAMPING_FACTOR;
            }
            let converged = steps.iter().all(|step| {
                step.fixed_rows::<3>(0).norm() <= settings.rotation_epsilon_rad
                    && step.fixed_rows::<3>(3).norm() <= settings.translation_epsilon_m
            });
            if converged {
                return true;
            }
        }
        false
    }

    fn linearize(&self, weights: &[f64]) -> BlockSystem<'_> {
        let mut system = BlockSystem::zero(&self.elimination);
        for (placed, &weight) in self.edges.iter().zip(weights) {
            let (from, to) = (&self.poses[placed.from], &self.poses[placed.to]);
            let linearized = linearize(&placed.edge.from_from_to, from, to);
            let information = weight * placed.edge.information;
            let from_information = linearized.d_from.transpose() * information;
            let to_information = linearized.d_to.transpose() * information;
            let (from, to) = (self.unknown[placed.from], self.unknown[placed.to]);
            if let Some(from) = from {
                let gradient = from_information * linearized.residual;
                system.add_own(from, &(from_information * linearized.d_from), &gradient);
            }
            if let Some(to) = to {
                let gradient = to_information * linearized.residual;
                system.add_own(to, &(to_information * linearized.d_to), &gradient);
            }
            if let Some((from, to)) = from.zip(to) {
                system.add_coupling(from, to, &(from_information * linearized.d_to));
            }
        }
        system
    }

    fn moved(&self, steps: &[Vector6<f64>]) -> Vec<Se3> {
        let poses = self.poses.iter().zip(&self.unknown);
        poses
            .map(|(pose, unknown)| match unknown {
                Some(unknown) => (*pose * Se3::exp(&steps[*unknown])).renormalized(),
                None => *pose,
            })
            .collect()
    }

    fn squared_error(&self, placed: &PlacedEdge, poses: &[Se3]) -> f64 {
        let (from, to) = (&poses[placed.from], &poses[placed.to]);
        let r = residual(&placed.edge.from_from_to, from, to);
        r.dot(&(placed.edge.information * r))
    }

    fn weighted_cost(&self, weights: &[f64], poses: &[Se3]) -> f64 {
        let edges = self.edges.iter().zip(weights);
        edges
            .map(|(edge, weight)| weight * self.squared_error(edge, poses))
            .sum()
    }

    fn truncated_cost(&self, settings: &OptimizeSettings) -> f64 {
        let costs = self.edges.iter().map(|placed| {
            let squared = self.squared_error(placed, &self.poses);
            match placed.edge.kernel {
                Kernel::Quadratic => squared,
                Kernel::TruncatedQuadratic => squared.min(settings.max_squared_error),
            }
        });
        costs.sum()
    }

    /// Squared errors of the robust edges.
    fn robust_errors(&self) -> impl Iterator<Item = f64> {
        let robust = |placed: &&PlacedEdge| placed.edge.kernel == Kernel::TruncatedQuadratic;
        let edges = self.edges.iter().filter(robust);
        edges.map(|placed| self.squared_error(placed, &self.poses))
    }

    fn corrections(&self, before: &BTreeMap<KeyframeId, Se3>) -> impl Iterator<Item = Se3> {
        let after = self.poses.iter().zip(&self.unknown);
        after
            .zip(before.values())
            .map(|((after, unknown), before)| match unknown {
                Some(_) => (*after * before.inverse()).renormalized(),
                None => Se3::identity(),
            })
    }
}

/// Whether each place is the lowest of the part of the graph that it is connected with.
fn is_first_of_part(places: usize, edges: &[PlacedEdge]) -> Vec<bool> {
    let mut neighbors = vec![Vec::new(); places];
    for edge in edges {
        neighbors[edge.from].push(edge.to);
        neighbors[edge.to].push(edge.from);
    }
    let mut seen = vec![false; places];
    let mut first = vec![false; places];
    for start in 0..places {
        first[start] = !seen[start];
        let mut waiting = vec![start];
        while let Some(place) = waiting.pop() {
            if !std::mem::replace(&mut seen[place], true) {
                waiting.extend(&neighbors[place]);
            }
        }
    }
    first
}
