//! The shadow rays' BVH, flattened for traversal without a stack: nodes in depth-first order, each with the index behind
//! its subtree (Smits, *Efficiency Issues for Ray Tracing*, 1998). No tree is too deep for it.

use glam::Vec3;
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::triangle::Triangle;

use super::layout::Node;

/// The shader packs a leaf's count into three bits.
const TRIANGLES_PER_LEAF: u32 = 4;

/// Nodes, and the order in which leaves refer to triangles.
pub struct FlatBvh {
    pub nodes: Vec<Node>,
    pub triangle_order: Vec<u32>,
}

impl FlatBvh {
    pub fn new(triangles: &[[Vec3; 3]]) -> Self {
        if triangles.is_empty() {
            // A leaf of nothing, since a GPU buffer has at least one element.
            let nothing = Node { low: [0.0; 3], after: 1, high: [0.0; 3], primitives: 0 };
            return Self { nodes: vec![nothing], triangle_order: Vec::new() };
        }
        let corners: Vec<Triangle> =
            triangles.iter().map(|&[a, b, c]| Triangle { v0: a.into(), v1: b.into(), v2: c.into() }).collect();
        let params = BvhBuildParams { max_prims_per_leaf: TRIANGLES_PER_LEAF, ..BvhBuildParams::medium_build() };
        let tree = build_bvh2_from_tris(&corners, params, &mut Default::default());
        Self { nodes: flatten(&tree), triangle_order: tree.primitive_indices }
    }
}

fn flatten(tree: &Bvh2) -> Vec<Node> {
    enum Visit {
        Enter(u32),
        /// All of this flat node's subtree lies behind it now.
        Leave(usize),
    }
    let mut flat: Vec<Node> = Vec::with_capacity(tree.nodes.len());
    let mut pending = vec![Visit::Enter(0)];
    while let Some(visit) = pending.pop() {
        match visit {
            Visit::Leave(at) => flat[at].after = flat.len() as u32,
            Visit::Enter(index) => {
                let node = &tree.nodes[index as usize];
                let primitives = if node.prim_count > 0 { node.first_index * 8 + node.prim_count } else { 0 };
                pending.push(Visit::Leave(flat.len()));
                if node.prim_count == 0 {
                    pending.extend([Visit::Enter(node.first_index + 1), Visit::Enter(node.first_index)]);
                }
                flat.push(Node {
                    low: Vec3::from(node.aabb.min).to_array(),
                    after: 0,
                    high: Vec3::from(node.aabb.max).to_array(),
                    primitives,
                });
            }
        }
    }
    flat
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each triangle lies in one leaf, each child in its parent's box, and each `after` closes its subtree.
    #[test]
    fn flat_nodes_nest_and_hold_every_triangle_once() {
        for count in [1, 2, 5, 300] {
            let triangles: Vec<[Vec3; 3]> = (0..count)
                .map(|i| {
                    let at = Vec3::new((i * 37 % 101) as f32, (i * 53 % 97) as f32, (i * 71 % 89) as f32);
                    [at, at + Vec3::X, at + Vec3::Y]
                })
                .collect();
            let bvh = FlatBvh::new(&triangles);
            let mut seen = vec![0; count];
            for (at, node) in bvh.nodes.iter().enumerate() {
                assert!(node.after as usize > at && node.after as usize <= bvh.nodes.len());
                for child in &bvh.nodes[at..node.after as usize] {
                    assert!(child.after <= node.after);
                    assert!(Vec3::from(child.low).cmpge(Vec3::from(node.low)).all());
                    assert!(Vec3::from(child.high).cmple(Vec3::from(node.high)).all());
                }
                let first = node.primitives >> 3;
                for slot in first..first + (node.primitives & 7) {
                    seen[bvh.triangle_order[slot as usize] as usize] += 1;
                }
            }
            assert_eq!(seen, vec![1; count], "{count} triangles");
        }
    }
}
