//! The order in which keyframes are eliminated, so that the Cholesky factor stays sparse: greedy
//! minimum degree. Eliminating a node connects all its neighbours, so those with few come first.

use std::collections::BTreeSet;

/// An order of `count` nodes that are connected by `edges`; of equal ones, the smaller node first.
pub fn minimum_degree(count: usize, edges: impl Iterator<Item = (usize, usize)>) -> Vec<usize> {
    let mut neighbors = vec![BTreeSet::new(); count];
    for (a, b) in edges.filter(|(a, b)| a != b) {
        neighbors[a].insert(b);
        neighbors[b].insert(a);
    }
    let by_degree = |neighbors: &[BTreeSet<usize>], node: usize| (neighbors[node].len(), node);
    let mut queue: BTreeSet<(usize, usize)> =
        (0..count).map(|node| by_degree(&neighbors, node)).collect();
    let mut order = Vec::with_capacity(count);
    while let Some((_, node)) = queue.pop_first() {
        order.push(node);
        let clique = std::mem::take(&mut neighbors[node]);
        for &member in &clique {
            queue.remove(&by_degree(&neighbors, member));
            neighbors[member].remove(&node);
            let others = clique.iter().filter(|other| **other != member);
            neighbors[member].extend(others);
            queue.insert(by_degree(&neighbors, member));
        }
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hub_of_a_star_comes_after_all_rays_but_one() {
        let order = minimum_degree(6, (1..6).map(|ray| (0, ray)));
        assert_eq!(order, [1, 2, 3, 4, 0, 5]);
    }

    #[test]
    fn every_node_comes_once() {
        let edges = [(0, 3), (3, 1), (1, 4), (4, 0), (2, 2), (5, 3), (3, 5)];
        let mut order = minimum_degree(7, edges.into_iter());
        order.sort_unstable();
        assert_eq!(order, [0, 1, 2, 3, 4, 5, 6]);
    }
}
