//! A binary tree of boxes over receivers: halves by their number along the longest side, down to one each.

use std::ops::Range;

use glam::Vec3;

/// A node.
#[derive(Debug, Clone)]
pub(super) struct Node {
    /// Its run of [`Tree::order`].
    pub(super) run: Range<usize>,
    /// Mean of its receivers' positions.
    pub(super) mean: Vec3,
    /// Distance of the farthest of them from the mean.
    pub(super) radius: f32,
    /// Half the diagonal of the box of their positions.
    pub(super) half_diagonal: f32,
    /// The first of two children that follow each other; a receiver alone has none.
    pub(super) children: Option<usize>,
}

/// The tree; node 0 is the root, children come after their parents.
pub(super) struct Tree {
    /// Receivers, those of a node in a row.
    pub(super) order: Vec<u32>,
    pub(super) nodes: Vec<Node>,
}

impl Tree {
    /// Over some positions; without any there is no node.
    pub(super) fn new(positions: &[Vec3]) -> Self {
        let mut tree = Self { order: (0..positions.len() as u32).collect(), nodes: Vec::new() };
        if !positions.is_empty() {
            tree.nodes.reserve(2 * positions.len());
            let root = node(&tree.order, 0..positions.len(), positions);
            tree.nodes.push(root);
        }
        let mut at = 0;
        while at < tree.nodes.len() {
            let run = tree.nodes[at].run.clone();
            if run.len() > 1 {
                let middle = split(&mut tree.order[run.clone()], positions) + run.start;
                tree.nodes[at].children = Some(tree.nodes.len());
                let halves = [run.start..middle, middle..run.end];
                for half in halves {
                    let child = node(&tree.order, half, positions);
                    tree.nodes.push(child);
                }
            }
            at += 1;
        }
        tree
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&self.order[..]) + size_of_val(&self.nodes[..])
    }
}

/// Sorts about the median along the longest side, and gives its place.
fn split(order: &mut [u32], positions: &[Vec3]) -> usize {
    let at = |index: &u32| positions[*index as usize];
    let low = order.iter().map(at).fold(Vec3::INFINITY, Vec3::min);
    let high = order.iter().map(at).fold(Vec3::NEG_INFINITY, Vec3::max);
    let axis = (high - low).max_position();
    let middle = order.len() / 2;
    // By index where positions are the same: the same tree on every machine.
    order.select_nth_unstable_by(middle, |a, b| at(a)[axis].total_cmp(&at(b)[axis]).then(a.cmp(b)));
    middle
}

fn node(order: &[u32], run: Range<usize>, positions: &[Vec3]) -> Node {
    let own = || order[run.clone()].iter().map(|&index| positions[index as usize]);
    let sum: glam::DVec3 = own().map(Vec3::as_dvec3).sum();
    let mean = (sum / run.len() as f64).as_vec3();
    let radius = own().map(|position| position.distance(mean)).fold(0.0, f32::max);
    let (low, high) = own().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(a, b), p| (a.min(p), b.max(p)));
    Node { half_diagonal: low.distance(high) / 2.0, run, mean, radius, children: None }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_node_holds_its_receivers_and_children_part_them_in_halves() {
        let positions: Vec<Vec3> = (0..300)
            .map(|k| Vec3::new((k as f32 * 0.37).sin(), (k as f32 * 1.7).cos(), (k % 7) as f32))
            .collect();
        let tree = Tree::new(&positions);
        let mut sorted = tree.order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..300).collect::<Vec<u32>>());
        assert_eq!(tree.nodes.len(), 599);
        for node in &tree.nodes {
            for &index in &tree.order[node.run.clone()] {
                assert!(positions[index as usize].distance(node.mean) <= node.radius);
            }
            match node.children {
                Some(first) => {
                    let [a, b] = [&tree.nodes[first].run, &tree.nodes[first + 1].run];
                    assert_eq!((a.start, a.end, b.end), (node.run.start, b.start, node.run.end));
                    assert!(a.len().abs_diff(b.len()) <= 1);
                }
                None => assert_eq!((node.run.len(), node.radius), (1, 0.0)),
            }
        }
        assert!(Tree::new(&[]).nodes.is_empty());
        assert_eq!(Tree::new(&[Vec3::ONE; 5]).nodes.len(), 9);
    }
}
