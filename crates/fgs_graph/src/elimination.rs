//! The order in which unknowns are eliminated: minimum degree (Tinney and Walker 1967), ties by the
//! lower index. Playing the elimination also gives the pattern of the Cholesky factor.

use std::collections::BTreeSet;

/// An order of elimination and the factor's pattern in it.
#[derive(Clone, Debug)]
pub struct Elimination {
    /// Position of each unknown in the order.
    pub position: Vec<usize>,
    /// For each position the rows below the diagonal that its column has, ascending.
    pub rows: Vec<Vec<usize>>,
}

impl Elimination {
    /// Of `unknowns` unknowns, coupled in pairs.
    pub fn minimum_degree(unknowns: usize, pairs: impl Iterator<Item = (usize, usize)>) -> Self {
        let mut neighbors = vec![BTreeSet::new(); unknowns];
        for (a, b) in pairs {
            neighbors[a].insert(b);
            neighbors[b].insert(a);
        }
        let mut queue: BTreeSet<(usize, usize)> = neighbors
            .iter()
            .enumerate()
            .map(|(unknown, neighbors)| (neighbors.len(), unknown))
            .collect();
        let mut position = vec![0; unknowns];
        let mut columns = Vec::with_capacity(unknowns);
        while let Some((_, eliminated)) = queue.pop_first() {
            position[eliminated] = columns.len();
            let clique = std::mem::take(&mut neighbors[eliminated]);
            for &a in &clique {
                queue.remove(&(neighbors[a].len(), a));
                neighbors[a].remove(&eliminated);
                neighbors[a].extend(clique.iter().filter(|&&b| b != a));
                queue.insert((neighbors[a].len(), a));
            }
            columns.push(clique);
        }
        let rows = columns
            .into_iter()
            .map(|clique| {
                let mut rows: Vec<usize> = clique.iter().map(|&a| position[a]).collect();
                rows.sort_unstable();
                rows
            })
            .collect();
        Self { position, rows }
    }
}
