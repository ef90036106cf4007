//! Shadow rays that share an origin.
//!
//! Of a small mesh, a triangle seen from there is three planes and a volume, which serve all rays; those that cannot part the
//! origin from any light are left out. Planes that share an edge differ in sign alone, so no ray slips between two triangles,
//! but for one that meets a vertex to within rounding. In a large mesh, rays visit nodes together.

use glam::Vec3;

use super::brute::Brute;
use super::lanes::{lanes, mask_of};
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
    /// The triangles that can lie between the origin and a target, for a mesh that is tested whole; `None` until they are
    /// asked for.
    fans: Option<Vec<(u32, Fan)>>,
    spare: Vec<(u32, Fan)>,
    stack: Vec<(Child, u32)>,
}

/// For so few rays nothing is prepared for more.
const FEW: u32 = 2;

impl<'t, 'a> ShadowRays<'t, 'a> {
    pub(super) fn new(tracer: &'t Tracer<'a>, targets: Option<Aabb>) -> Self {
        Self { tracer, targets, origin: Vec3::ZERO, fans: None, spare: Vec::new(), stack: Vec::new() }
    }

    /// Moves the common origin.
    pub fn start_from(&mut self, origin: Vec3) {
        self.origin = origin;
        if let Some(fans) = self.fans.take() {
            self.spare = fans;
        }
    }

    /// The lanes of `active` whose segment nothing crosses.
    #[inline]
    pub fn unoccluded(&mut self, segments: &Segments, active: u32) -> u32 {
        match &self.tracer.structure {
            Structure::Brute(brute) if self.fans.is_none() && active.count_ones() <= FEW => {
                self.unoccluded_at_once(brute, segments, active)
            }
            Structure::Brute(_) => self.unoccluded_by_all(segments, active),
            Structure::Tree(tree) => {
                tree.unoccluded(&mut self.stack, self.origin, segments, active, |hit| self.tracer.solid(hit))
            }
        }
    }

    /// Sees each triangle once, and says the same.
    fn unoccluded_at_once(&self, brute: &Brute, segments: &Segments, active: u32) -> u32 {
        let origin = self.origin.to_array().map(F32x8::splat);
        let mut open = active;
        for (i, block) in brute.blocks().iter().enumerate() {
            let fan = WideFan::new(&block.from(&origin));
            for ray in lanes(open) {
                let segment = Vec3::new(segments[0][ray], segments[1][ray], segments[2][ray]);
                let solid = |lane: usize| {
                    let triangle = (i * WIDTH + lane) as u32;
                    !self.tracer.masked[triangle as usize]
                        || self.tracer.present_at(triangle, &fan.narrow(lane).planes, segment)
                };
                if lanes(fan.block(&segment.to_array().map(F32x8::splat))).any(solid) {
                    open &= !(1 << ray);
                }
            }
        }
        open
    }

    fn unoccluded_by_all(&mut self, segments: &Segments, active: u32) -> u32 {
        let fans = match self.fans.take() {
            Some(fans) => fans,
            None => self.see_all(),
        };
        let open = if self.tracer.any_masked {
            fans.iter().fold(active, |open, (triangle, fan)| {
                let mut blocked = [false; LANES];
                fan.block(segments, &mut blocked);
                let solid = |&lane: &usize| {
                    let segment = Vec3::new(segments[0][lane], segments[1][lane], segments[2][lane]);
                    !self.tracer.masked[*triangle as usize] || self.tracer.present_at(*triangle, &fan.planes, segment)
                };
                open & !lanes(mask_of(&blocked) & open).filter(solid).fold(0, |mask, lane| mask | 1 << lane)
            })
        } else {
            let mut blocked = [false; LANES];
            fans.iter().for_each(|(_, fan)| fan.block(segments, &mut blocked));
            active & !mask_of(&blocked)
        };
        self.fans = Some(fans);
        open
    }

    /// The fans of all triangles that can hide a target from the origin.
    fn see_all(&mut self) -> Vec<(u32, Fan)> {
        let mut fans = std::mem::take(&mut self.spare);
        fans.clear();
        let Structure::Brute(brute) = &self.tracer.structure else { return fans };
        let origin = self.origin.to_array().map(F32x8::splat);
        for (i, block) in brute.blocks().iter().enumerate() {
            let corners = block.from(&origin);
            let wide = WideFan::new(&corners);
            let parting = match &self.targets {
                Some(targets) => wide.parts(&corners, self.origin, targets),
                None => (1 << WIDTH) - 1,
            };
            let count = (self.tracer.masked.len() - i * WIDTH).min(WIDTH);
            for lane in lanes(parting & ((1 << count) - 1)) {
                fans.push(((i * WIDTH + lane) as u32, wide.narrow(lane)));
            }
        }
        fans
    }
}

impl Tracer<'_> {
    /// Whether a masked triangle is there where `segment` crosses it.
    fn present_at(&self, triangle: u32, planes: &[Vec3; 3], segment: Vec3) -> bool {
        let [a, b, c] = planes.map(|plane| plane.dot(segment));
        let sum = a + b + c;
        !self.asset.is_cut_out(triangle as usize, b / sum, c / sum)
    }
}

/// A triangle as seen from one origin: the planes through the origin and each edge, facing inwards when the volume is positive.
struct Fan {
    planes: [Vec3; 3],
    /// Six times the volume of the tetrahedron that the origin spans with the triangle.
    volume: f32,
}

impl Fan {
    /// Sets the lanes whose segment crosses the triangle.
    #[inline]
    fn block(&self, s: &Segments, blocked: &mut [bool; LANES]) {
        let [p, q, r] = &self.planes;
        for i in 0..LANES {
            let (x, y, z) = (s[0][i], s[1][i], s[2][i]);
            let wa = x * p.x + y * p.y + z * p.z;
            let wb = x * q.x + y * q.y + z * q.z;
            let wc = x * r.x + y * r.y + z * r.z;
            let sum = wa + wb + wc;
            let inside = (wa >= 0.0) & (wb >= 0.0) & (wc >= 0.0) | (wa <= 0.0) & (wb <= 0.0) & (wc <= 0.0);
            // 0 < volume / sum < SEGMENT_END without dividing.
            let near = (self.volume * sum > 0.0) & (self.volume.abs() < SEGMENT_END * sum.abs());
            blocked[i] |= inside & near;
        }
    }
}

/// WIDTH fans: `[edge][axis]`. The planes of triangles that share an edge differ in sign alone.
struct WideFan {
    planes: [[F32x8; 3]; 3],
    volume: F32x8,
}

#[inline(always)]
fn cross([ax, ay, az]: &[F32x8; 3], [bx, by, bz]: &[F32x8; 3]) -> [F32x8; 3] {
    [*ay * *bz - *az * *by, *az * *bx - *ax * *bz, *ax * *by - *ay * *bx]
}

/// In the order of [`Fan::block`], and rounded as often.
#[inline(always)]
fn dot([ax, ay, az]: &[F32x8; 3], [bx, by, bz]: &[F32x8; 3]) -> F32x8 {
    *ax * *bx + *ay * *by + *az * *bz
}

#[inline(always)]
fn difference([ax, ay, az]: &[F32x8; 3], [bx, by, bz]: &[F32x8; 3]) -> [F32x8; 3] {
    [*ax - *bx, *ay - *by, *az - *bz]
}

impl WideFan {
    /// Of triangles whose corners are given relative to the origin.
    #[inline(always)]
    fn new([a, b, c]: &[[F32x8; 3]; 3]) -> Self {
        Self {
            planes: [cross(b, c), cross(c, a), cross(a, b)],
            volume: dot(a, &cross(&difference(b, a), &difference(c, a))),
        }
    }

    /// The triangles whose planes have any of `targets` on the far side from the origin; others hide none of them.
    #[inline(always)]
    fn parts(&self, [a, b, c]: &[[F32x8; 3]; 3], origin: Vec3, targets: &Aabb) -> u32 {
        let splat = |v: Vec3| v.to_array().map(F32x8::splat);
        let absolute = |[x, y, z]: [F32x8; 3]| [x.abs(), y.abs(), z.abs()];
        let normal = cross(&difference(b, a), &difference(c, a));
        let size = absolute(normal);
        let centre = difference(&splat(targets.centre() - origin), a);
        let reach = dot(&size, &splat((targets.max - targets.min) * 0.5));
        // The plane's signed distance is −volume at the origin, within `reach` of normal·centre over the targets.
        let side = dot(&normal, &centre).negate_where_negative(self.volume);
        let slack = (dot(&size, &absolute(centre)) + dot(&size, &absolute(*a))) * F32x8::splat(1e-5);
        F32x8::splat(0.0).below(side + reach + slack)
    }

    #[inline(always)]
    fn narrow(&self, lane: usize) -> Fan {
        let planes = self.planes.map(|[x, y, z]| Vec3::new(x.to_array()[lane], y.to_array()[lane], z.to_array()[lane]));
        Fan { planes, volume: self.volume.to_array()[lane] }
    }

    /// The triangles that the segment crosses; see [`Fan::block`].
    #[inline(always)]
    fn block(&self, segment: &[F32x8; 3]) -> u32 {
        let [a, b, c] = [dot(segment, &self.planes[0]), dot(segment, &self.planes[1]), dot(segment, &self.planes[2])];
        let sum = a + b + c;
        let agree = |part: F32x8| part.negate_where_negative(sum);
        let zero = F32x8::splat(0.0);
        zero.at_most(agree(a).min(agree(b)).min(agree(c)))
            & zero.below(self.volume * sum)
            & self.volume.abs().below(sum.abs() * F32x8::splat(SEGMENT_END))
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
                let solid_hit = |hit: Hit| hit.t < SEGMENT_END && solid(&hit);
                if self.blocks[block].hits(&self.triangles[block], &sheared, SEGMENT_END, solid_hit) {
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
