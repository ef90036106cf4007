//! A bounding volume hierarchy of eight children a node, whose leaves are blocks of triangles.
//!
//! Incoherent rays wait for memory more than they compute. So a leaf is two cache lines, and whatever a ray is going to visit
//! is asked for as soon as it is known.

use std::hint::select_unpredictable;

use glam::Vec3;

use super::block::{Nearest, TriangleBlock};
use super::lanes::lanes;
use super::ray::{SLACK, ShearedRay, Slabs};
use super::simd::{F32x8, WIDTH, prefetch};
use crate::scene::Hit;

/// The tree and its triangles.
pub struct WideBvh {
    pub nodes: Vec<Node>,
    pub blocks: Vec<TriangleBlock>,
    /// Per block, its triangles.
    pub triangles: Vec<[u32; WIDTH]>,
    /// Metres: the largest coordinate.
    pub size: f32,
    /// Entries that a traversal's stack can need.
    pub stack: usize,
}

/// Eight children's boxes, structure of arrays.
#[repr(align(64))]
pub struct Node {
    /// `[axis][low or high][child]`, metres; low above high where there is no child.
    pub bounds: [[[f32; WIDTH]; 2]; 3],
    pub children: [Child; WIDTH],
    /// Bit i is set where there is a child i.
    pub present: u32,
}

/// The index of a node, or of a block.
#[derive(Clone, Copy, Default)]
pub struct Child(pub u32);

impl Child {
    pub const BLOCK: u32 = 1 << 31;

    #[inline(always)]
    pub fn block(self) -> Option<usize> {
        (self.0 & Self::BLOCK != 0).then_some((self.0 & !Self::BLOCK) as usize)
    }
}

/// A child to be visited, and where its box begins.
#[derive(Clone, Copy, Default)]
struct Pending {
    near: f32,
    child: Child,
}

impl Node {
    pub const EMPTY: Self = Self {
        bounds: [[[f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]]; 3],
        children: [Child(0); WIDTH],
        present: 0,
    };

    /// The children's bounds relative to `origin`.
    #[inline(always)]
    pub fn planes_from(&self, origin: &[F32x8; 3]) -> [[[f32; WIDTH]; 2]; 3] {
        let relative = |axis: usize| {
            let [low, high] = &self.bounds[axis];
            [(F32x8::load(low) - origin[axis]).to_array(), (F32x8::load(high) - origin[axis]).to_array()]
        };
        [relative(0), relative(1), relative(2)]
    }

    /// The children whose boxes the ray enters before `reach`, and where.
    #[inline(always)]
    fn enter(&self, slabs: &Slabs, reach: f32) -> (u32, F32x8) {
        let crossing = |axis: usize, side: usize, offset: &[F32x8; 3]| {
            F32x8::load(&self.bounds[axis][side & 1]).mul_add(slabs.inverse[axis], offset[axis])
        };
        let [x, y, z] = slabs.backwards;
        let near_xy = crossing(0, x, &slabs.near).max(crossing(1, y, &slabs.near));
        let near = near_xy.max(crossing(2, z, &slabs.near).max(F32x8::splat(0.0)));
        let far_xy = crossing(0, 1 ^ x, &slabs.far).min(crossing(1, 1 ^ y, &slabs.far));
        let far = far_xy.min(crossing(2, 1 ^ z, &slabs.far).min(F32x8::splat(reach)));
        (near.at_most(far * F32x8::splat(SLACK)) & self.present, near)
    }
}

/// Stacks up to this size live on the call stack.
const USUAL_STACK: usize = 128;

impl WideBvh {
    /// Brings `nearest` up to date.
    #[inline(never)]
    pub fn closest(&self, origin: Vec3, direction: Vec3, nearest: &mut Nearest, solid: impl Fn(&Hit) -> bool + Copy) {
        if self.stack <= USUAL_STACK {
            self.closest_with(&mut [Pending::default(); USUAL_STACK], origin, direction, nearest, solid);
        } else {
            self.closest_with(&mut vec![Pending::default(); self.stack], origin, direction, nearest, solid);
        }
    }

    #[inline(always)]
    fn closest_with(
        &self,
        stack: &mut [Pending],
        origin: Vec3,
        direction: Vec3,
        nearest: &mut Nearest,
        solid: impl Fn(&Hit) -> bool + Copy,
    ) {
        let sheared = ShearedRay::new(origin, direction);
        let slabs = Slabs::new(origin, direction, self.size);
        let mut depth = 0;
        let mut child = Child::default();
        loop {
            if let Some(block) = child.block() {
                self.blocks[block].closest(&self.triangles[block], &sheared, nearest, solid);
            } else {
                let node = &self.nodes[child.0 as usize];
                let (mut entered, near) = node.enter(&slabs, nearest.hit.t);
                if entered != 0 {
                    let near = near.to_array();
                    let first = entered.trailing_zeros() as usize;
                    entered &= entered - 1;
                    child = node.children[first];
                    self.prefetch(child);
                    if entered == 0 {
                        continue;
                    }
                    // The nearest is visited next; the others wait, sorted, the nearer on top.
                    let mut next = Pending { near: near[first], child };
                    let base = depth;
                    for i in lanes(entered) {
                        let mut other = Pending { near: near[i], child: node.children[i] };
                        self.prefetch(other.child);
                        if other.near < next.near {
                            std::mem::swap(&mut other, &mut next);
                        }
                        let mut at = depth;
                        while at > base && stack[at - 1].near < other.near {
                            stack[at] = stack[at - 1];
                            at -= 1;
                        }
                        stack[at] = other;
                        depth += 1;
                    }
                    child = next.child;
                    continue;
                }
            }
            loop {
                if depth == 0 {
                    return;
                }
                depth -= 1;
                if stack[depth].near <= nearest.hit.t * SLACK {
                    child = stack[depth].child;
                    break;
                }
            }
        }
    }

    /// Asks for a child that will be visited. Nobody can foretell whether it is a node or a block, so there is no branch; the two
    /// lines that follow a block are its sibling's.
    #[inline(always)]
    pub fn prefetch(&self, child: Child) {
        let index = (child.0 & !Child::BLOCK) as usize;
        let node = self.nodes.as_ptr().wrapping_add(index).cast::<u8>();
        let block = self.blocks.as_ptr().wrapping_add(index).cast::<u8>();
        prefetch::<{ size_of::<Node>() }>(select_unpredictable(child.block().is_some(), block, node));
    }

    /// Whether any hit with 0 < t < `t_max` is solid.
    #[inline(never)]
    pub fn occluded(&self, origin: Vec3, direction: Vec3, t_max: f32, solid: impl Fn(&Hit) -> bool + Copy) -> bool {
        if self.stack <= USUAL_STACK {
            self.occluded_with(&mut [Child::default(); USUAL_STACK], origin, direction, t_max, solid)
        } else {
            self.occluded_with(&mut vec![Child::default(); self.stack], origin, direction, t_max, solid)
        }
    }

    #[inline(always)]
    fn occluded_with(
        &self,
        stack: &mut [Child],
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        solid: impl Fn(&Hit) -> bool + Copy,
    ) -> bool {
        let sheared = ShearedRay::new(origin, direction);
        let slabs = Slabs::new(origin, direction, self.size);
        let mut depth = 1;
        stack[0] = Child::default();
        while depth > 0 {
            depth -= 1;
            let child = stack[depth];
            if let Some(block) = child.block() {
                if self.blocks[block].occludes(&self.triangles[block], &sheared, t_max, solid) {
                    return true;
                }
            } else {
                let node = &self.nodes[child.0 as usize];
                let (entered, _) = node.enter(&slabs, t_max);
                for i in lanes(entered) {
                    stack[depth] = node.children[i];
                    self.prefetch(node.children[i]);
                    depth += 1;
                }
            }
        }
        false
    }
}
