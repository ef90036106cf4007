//! Shadow rays that share an origin.
//!
//! A small mesh is looked at from there once, for all rays ([`super::fans`]). In a large mesh, rays visit nodes together.

use glam::Vec3;

use super::fans::Fans;
use super::lanes::lanes;
use super::ray::{SLACK, ShearedRay, inverse_of};
use super::simd::{F32x8, WIDTH};
use super::wide::{Child, WideBvh};
use super::{SEGMENT_END, Segments, Structure, Tracer};
use crate::math::LANES;
use crate::scene::{Aabb, Hit};

/// Shadow rays from one point, LANES at a time.
pub struct ShadowRays<'t, 'a> {
    tracer: &'t Tracer<'a>,
    targets: Option<Aabb>,
    origin: Vec3,
    /// Of a mesh that is tested whole, as seen from the origin, once it has been asked for.
    fans: Fans,
    seen: bool,
    stack: Vec<(Child, u32)>,
}

/// For so few rays nothing is prepared for more.
const FEW: u32 = 2;

impl<'t, 'a> ShadowRays<'t, 'a> {
    pub(super) fn new(tracer: &'t Tracer<'a>, targets: Option<Aabb>) -> Self {
        Self { tracer, targets, origin: Vec3::ZERO, fans: Fans::default(), seen: false, stack: Vec::new() }
    }

    /// Moves the common origin.
    pub fn start_from(&mut self, origin: Vec3) {
        self.origin = origin;
        self.seen = false;
    }

    /// The lanes of `active` whose segment nothing crosses.
    #[inline]
    pub fn unoccluded(&mut self, segments: &Segments, active: u32) -> u32 {
        let segment = |ray: usize| Vec3::new(segments[0][ray], segments[1][ray], segments[2][ray]);
        match &self.tracer.structure {
            Structure::Brute(_) if !self.seen && active.count_ones() <= FEW => lanes(active)
                .filter(|&ray| !self.tracer.occluded(self.origin, segment(ray)))
                .fold(0, |m, ray| m | 1 << ray),
            Structure::Brute(brute) => {
                if !self.seen {
                    self.fans.see(&brute.pieces, self.origin, self.targets.as_ref());
                    self.seen = true;
                }
                let (hidden, near) = self.fans.hide(segments);
                let open = active & !hidden;
                let unsure = if brute.any_masked { open } else { open & near };
                let solid = |hit: Hit| self.tracer.solid(&hit);
                lanes(unsure)
                    .filter(|&ray| brute.any_exactly(self.origin, segment(ray), SEGMENT_END, solid))
                    .fold(open, |open, ray| open & !(1 << ray))
            }
            Structure::Tree(tree) => {
                tree.unoccluded(&mut self.stack, self.origin, segments, active, |hit| self.tracer.solid(hit))
            }
        }
    }
}

impl WideBvh {
    /// The lanes of `active` whose segment from `origin` crosses no triangle for which `solid` holds.
    ///
    /// A node's children are tested together, ray after ray, and visited by the rays that entered them.
    fn unoccluded(
        &self,
        stack: &mut Vec<(Child, u32)>,
        origin: Vec3,
        segments: &Segments,
        active: u32,
        solid: impl Fn(&Hit) -> bool,
    ) -> u32 {
        let rays = SharedOrigin::new(origin, segments, self.size);
        let mut open = active;
        stack.clear();
        stack.push((Child::default(), active));
        while let Some((child, rays_here)) = stack.pop() {
            let rays_here = rays_here & open;
            if rays_here == 0 {
                continue;
            }
            let Some(block) = child.block() else {
                let node = &self.nodes[child.0 as usize];
                let mut entering = [0u64; 2];
                let planes = node.planes_from(&rays.origin);
                for ray in lanes(rays_here) {
                    // Child c's bit goes to byte c, in which this ray has its bit.
                    entering[ray / 8] |= spread(rays.enter(&planes, ray) & node.present) << (ray % 8);
                }
                let [low, high] = entering.map(u64::to_le_bytes);
                let mut any = entering[0] | entering[1];
                while any != 0 {
                    let c = any.trailing_zeros() as usize / 8;
                    any &= !(0xff << (8 * c));
                    self.prefetch(node.children[c]);
                    stack.push((node.children[c], u32::from(low[c]) | u32::from(high[c]) << 8));
                }
                continue;
            };
            for ray in lanes(rays_here) {
                let segment = Vec3::new(segments[0][ray], segments[1][ray], segments[2][ray]);
                let sheared = ShearedRay::new(origin, segment);
                if self.blocks[block].occludes(&self.triangles[block], &sheared, SEGMENT_END, &solid) {
                    open &= !(1 << ray);
                }
            }
            if open == 0 {
                break;
            }
        }
        open
    }
}

/// What LANES segments from one origin need to meet boxes; see [`super::ray::Slabs`].
struct SharedOrigin {
    origin: [F32x8; 3],
    inverse: [[f32; LANES]; 3],
    /// By which planes are moved outwards.
    margin: [[f32; LANES]; 3],
}

impl SharedOrigin {
    fn new(origin: Vec3, segments: &Segments, size: f32) -> Self {
        let mut inverse = [[0.0; LANES]; 3];
        let mut margin = [[0.0; LANES]; 3];
        for i in 0..LANES {
            let largest = segments[0][i].abs().max(segments[1][i].abs()).max(segments[2][i].abs());
            for axis in 0..3 {
                inverse[axis][i] = inverse_of(segments[axis][i], largest);
                margin[axis][i] = (f32::EPSILON * size) * inverse[axis][i].abs();
            }
        }
        Self { origin: origin.to_array().map(F32x8::splat), inverse, margin }
    }

    /// The children that the segment enters, whose planes are given relative to the origin.
    #[inline(always)]
    fn enter(&self, planes: &[[[f32; WIDTH]; 2]; 3], ray: usize) -> u32 {
        let crossings = |axis: usize| {
            let (inverse, margin) = (self.inverse[axis][ray], F32x8::splat(self.margin[axis][ray]));
            let backwards = usize::from(inverse.is_sign_negative());
            let inverse = F32x8::splat(inverse);
            let near = F32x8::load(&planes[axis][backwards]).mul_sub(inverse, margin);
            let far = F32x8::load(&planes[axis][1 - backwards]).mul_add(inverse, margin);
            (near, far)
        };
        let [(near_x, far_x), (near_y, far_y), (near_z, far_z)] = [crossings(0), crossings(1), crossings(2)];
        let near = near_x.max(near_y).max(near_z.max(F32x8::splat(0.0)));
        let far = far_x.min(far_y).min(far_z.min(F32x8::splat(1.0)));
        near.at_most(far * F32x8::splat(SLACK))
    }
}

/// Bit i of a byte in the lowest bit of byte i.
#[inline(always)]
fn spread(bits: u32) -> u64 {
    // Byte i keeps bit i, which then carries into the byte's highest bit.
    let own = (u64::from(bits) * 0x0101_0101_0101_0101) & 0x8040_2010_0804_0201;
    (own + 0x7f7f_7f7f_7f7f_7f7f) >> 7 & 0x0101_0101_0101_0101
}
