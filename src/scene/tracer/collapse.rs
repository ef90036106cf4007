//! The wide tree made of a binary one.
//!
//! obvhs builds a binary tree of single triangles; the nodes and leaves made of it are those of the least expected cost,
//! found by dynamic programming (Ylitie, Karras, Laine, *Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide
//! BVHs*, 2017, section 4).

use glam::Vec3;
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::triangle::Triangle;

use super::block::TriangleBlock;
use super::simd::WIDTH;
use super::wide::{Child, Node, WideBvh};

/// Expected costs of a box test of eight children and of a block of triangles.
const NODE_COST: f32 = 1.0;
const BLOCK_COST: f32 = 1.0;

impl WideBvh {
    /// `masked`: per triangle, whether its material cuts out.
    pub fn new(triangles: &[[Vec3; 3]], masked: &[bool]) -> Self {
        let corners: Vec<Triangle> =
            triangles.iter().map(|&[a, b, c]| Triangle { v0: a.into(), v1: b.into(), v2: c.into() }).collect();
        let params = BvhBuildParams { max_prims_per_leaf: 1, ..BvhBuildParams::medium_build() };
        let binary = build_bvh2_from_tris(&corners, params, &mut Default::default());
        Collapse::new(&binary, triangles, masked).run()
    }
}

/// The least costs of a binary tree's subtrees as parts of a wide tree.
struct Collapse<'b> {
    binary: &'b Bvh2,
    triangles: &'b [[Vec3; 3]],
    masked: &'b [bool],
    /// Per binary node, triangles below it, and their area.
    count: Vec<u32>,
    surface: Vec<f32>,
    /// Per binary node, whether it is a block where it is one child.
    block: Vec<bool>,
    /// Per binary node and k: least cost as at most k + 1 children of one wide node.
    cost: Vec<[f32; WIDTH]>,
    /// Per binary node and k: how many of the k + 1 children its first child is given; 0 where the node is one child itself.
    split: Vec<[u8; WIDTH]>,
}

impl<'b> Collapse<'b> {
    fn new(binary: &'b Bvh2, triangles: &'b [[Vec3; 3]], masked: &'b [bool]) -> Self {
        let nodes = &binary.nodes;
        let mut this = Self {
            binary,
            triangles,
            masked,
            count: vec![0; nodes.len()],
            surface: vec![0.0; nodes.len()],
            block: vec![false; nodes.len()],
            cost: vec![[0.0; WIDTH]; nodes.len()],
            split: vec![[0; WIDTH]; nodes.len()],
        };
        // Parents before children; backwards, children before parents.
        let mut order: Vec<u32> = if nodes.is_empty() { vec![] } else { vec![0] };
        let mut at = 0;
        while at < order.len() {
            let node = &nodes[order[at] as usize];
            if node.prim_count == 0 {
                order.extend([node.first_index, node.first_index + 1]);
            }
            at += 1;
        }
        order.iter().rev().for_each(|&n| this.weigh(n as usize));
        this
    }

    fn weigh(&mut self, n: usize) {
        let node = &self.binary.nodes[n];
        let area = node.aabb.half_area();
        if node.prim_count > 0 {
            self.count[n] = node.prim_count;
            self.surface[n] = (node.first_index..node.first_index + node.prim_count)
                .map(|i| {
                    let [a, b, c] = self.triangles[self.binary.primitive_indices[i as usize] as usize];
                    (b - a).cross(c - a).length()
                })
                .sum();
            self.block[n] = true;
            self.cost[n] = [area * BLOCK_COST; WIDTH];
            return;
        }
        let [left, right] = [node.first_index as usize, node.first_index as usize + 1];
        self.count[n] = self.count[left] + self.count[right];
        self.surface[n] = self.surface[left] + self.surface[right];
        // k + 1 children, shared out between the two subtrees in the best way.
        let shared: [(f32, u8); WIDTH] = std::array::from_fn(|k| {
            (0..k)
                .map(|i| (self.cost[left][i] + self.cost[right][k - 1 - i], i as u8 + 1))
                .min_by(|a, b| a.0.total_cmp(&b.0))
                .unwrap_or((f32::INFINITY, 0))
        });
        let as_node = shared[WIDTH - 1].0 + area * NODE_COST;
        let as_block = if self.block_of(n).is_some() { area * BLOCK_COST } else { f32::INFINITY };
        self.block[n] = as_block <= as_node;
        self.cost[n][0] = as_node.min(as_block);
        for k in 1..WIDTH {
            let before = self.cost[n][k - 1];
            // What is cheapest for fewer children stays so; the second subtree may use up what is left.
            (self.cost[n][k], self.split[n][k]) =
                if shared[k].0 <= before { shared[k] } else { (before, self.split[n][k - 1]) };
        }
    }

    fn run(&self) -> WideBvh {
        let mut nodes = vec![Node::EMPTY];
        let (mut blocks, mut triangles) = (Vec::new(), Vec::new());
        // Binary nodes that become wide ones, where to, and how deep.
        let mut pending = if self.count.is_empty() { vec![] } else { vec![(0, 0, 1)] };
        let mut deepest = 1;
        while let Some((from, to, depth)) = pending.pop() {
            deepest = deepest.max(depth);
            let mut children = self.children(from);
            // A segment visits the last first: there hits are the likeliest for what it costs to look (Nah, Manocha, *SATO:
            // Surface Area Traversal Order for Shadow Ray Tracing*, 2014).
            let worth = |n: usize| self.surface[n] / self.cost[n][0].max(f32::MIN_POSITIVE);
            children.sort_by(|&a, &b| worth(a).total_cmp(&worth(b)));
            for (slot, n) in children.into_iter().enumerate() {
                let aabb = &self.binary.nodes[n].aabb;
                let child = if self.block[n] {
                    let (block, indices) = self.block_of(n).expect("it was weighed as a block");
                    blocks.push(block);
                    triangles.push(indices);
                    Child::BLOCK | (blocks.len() - 1) as u32
                } else {
                    nodes.push(Node::EMPTY);
                    pending.push((n, nodes.len() - 1, depth + 1));
                    (nodes.len() - 1) as u32
                };
                let node = &mut nodes[to];
                node.children[slot] = Child(child);
                node.present |= 1 << slot;
                for axis in 0..3 {
                    node.bounds[axis][0][slot] = aabb.min[axis];
                    node.bounds[axis][1][slot] = aabb.max[axis];
                }
            }
        }
        // Each level leaves all children but one behind.
        let size = self.triangles.iter().flatten().fold(0f32, |size, v| size.max(v.abs().max_element()));
        WideBvh { nodes, blocks, triangles, size, stack: deepest * (WIDTH - 1) + 1 }
    }

    /// The binary nodes that are the children of the wide node made of `n`.
    fn children(&self, n: usize) -> Vec<usize> {
        if self.block[n] {
            // Only the root: a tree of one block.
            return vec![n];
        }
        let mut children = Vec::with_capacity(WIDTH);
        let mut pending = vec![(n, WIDTH - 1)];
        while let Some((n, k)) = pending.pop() {
            match self.split[n][k] as usize {
                0 => children.push(n),
                left => {
                    let first = self.binary.nodes[n].first_index as usize;
                    pending.extend([(first + 1, k - left), (first, left - 1)]);
                }
            }
        }
        children
    }

    /// The block of all triangles below `n` and their indices, if there is one for so many.
    fn block_of(&self, n: usize) -> Option<(TriangleBlock, [u32; WIDTH])> {
        if self.count[n] as usize > WIDTH {
            return None;
        }
        let mut indices = [0; WIDTH];
        let mut found = 0;
        let mut pending = vec![n];
        while let Some(n) = pending.pop() {
            let node = &self.binary.nodes[n];
            let first = node.first_index as usize;
            if node.prim_count == 0 {
                pending.extend([first + 1, first]);
            } else {
                indices[found] = self.binary.primitive_indices[first];
                found += 1;
            }
        }
        let of = |&t: &u32| (self.triangles[t as usize], self.masked[t as usize]);
        let block = TriangleBlock::new(indices[..found].iter().map(of))?;
        Some((block, indices))
    }
}
