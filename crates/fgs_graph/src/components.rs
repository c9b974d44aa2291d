//! Which keyframes hang together.

/// For each of `count` nodes, the smallest node that it is connected to by `edges`, itself
/// included. By union-find.
pub fn smallest_connected(count: usize, edges: impl Iterator<Item = (usize, usize)>) -> Vec<usize> {
    let mut parents: Vec<usize> = (0..count).collect();
    for (a, b) in edges {
        let (a, b) = (root(&mut parents, a), root(&mut parents, b));
        parents[a.max(b)] = a.min(b);
    }
    (0..count).map(|node| root(&mut parents, node)).collect()
}

fn root(parents: &mut [usize], mut node: usize) -> usize {
    while parents[node] != node {
        parents[node] = parents[parents[node]];
        node = parents[node];
    }
    node
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn components_are_known_by_their_smallest_node() {
        let edges = [(5, 2), (3, 6), (6, 2), (4, 1)];
        assert_eq!(
            smallest_connected(8, edges.into_iter()),
            [0, 1, 2, 2, 1, 2, 2, 7]
        );
        assert!(smallest_connected(0, [].into_iter()).is_empty());
    }
}
