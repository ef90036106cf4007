//! Triangles tested eight at a time.
//!
//! A triangle is hit where the signed volumes that the ray spans with its three edges agree in sign; in the ray's sheared
//! space they are areas. Each has the sign that it has in exact arithmetic on the sheared corners, which triangles share: no
//! ray slips between them, through an edge or a vertex, and none hits a sliver that it passes by.

use glam::Vec3;

use super::lanes::lanes;
use super::ray::ShearedRay;
use super::simd::{F32x8, WIDTH};
use crate::scene::Hit;

/// The nearest hit so far. Of hits at the same distance the triangle of the smallest index is kept, so that the order in which
/// triangles are met makes no difference.
pub struct Nearest {
    pub hit: Hit,
}

impl Nearest {
    /// None yet; hits count up to `t_max`.
    pub fn below(t_max: f32) -> Self {
        // No index is below zero: a hit at t_max itself is none.
        Self { hit: Hit { t: t_max, triangle: 0, u: 0.0, v: 0.0 } }
    }
}

impl Nearest {
    /// Takes a hit that is nearer, if it is `solid`.
    #[inline(always)]
    pub fn update(&mut self, hit: Hit, solid: impl Fn(&Hit) -> bool) {
        let old = &self.hit;
        if (hit.t < old.t || (hit.t == old.t && hit.triangle < old.triangle)) && solid(&hit) {
            self.hit = hit;
        }
    }
}

/// A corner of WIDTH triangles in the ray's space, in the plane that the ray is normal to.
#[derive(Clone, Copy)]
pub struct Corner {
    pub x: F32x8,
    pub y: F32x8,
}

/// Areas of the edges' triangles with the ray, twice.
pub struct Areas {
    pub a: F32x8,
    pub b: F32x8,
    pub c: F32x8,
    pub sum: F32x8,
}

impl Areas {
    #[inline(always)]
    pub fn new(a: Corner, b: Corner, c: Corner) -> Self {
        let wa = F32x8::determinant(c.x, b.y, c.y, b.x);
        let wb = F32x8::determinant(a.x, c.y, a.y, c.x);
        let wc = F32x8::determinant(b.x, a.y, b.y, a.x);
        Self { a: wa, b: wb, c: wc, sum: wa + wb + wc }
    }

    /// Not negative in the lanes in which no two differ in sign.
    #[inline(always)]
    pub fn agreement(&self) -> F32x8 {
        let agree = |part: F32x8| part.negate_where_negative(self.sum);
        agree(self.a).min(agree(self.b)).min(agree(self.c))
    }

    /// Where along the ray the triangles of these corners' depths are. A triangle seen edge-on has no area, and no number here.
    #[inline(always)]
    pub fn distance(&self, ray: &ShearedRay, depths: [F32x8; 3]) -> F32x8 {
        let [a, b, c] = depths;
        self.c.mul_add(c, self.b.mul_add(b, self.a * a)) * ray.scale / self.sum
    }
}

/// Up to WIDTH triangles that share their vertices: two cache lines.
#[repr(C, align(64))]
pub struct TriangleBlock {
    /// `[axis][vertex]`, metres.
    vertices: [[f32; WIDTH]; 3],
    /// `[corner][triangle]`: a vertex.
    corners: [[u8; WIDTH]; 3],
    /// Bit i is set where there is a triangle i.
    present: u16,
    /// Bit i is set where the material of triangle i cuts out where alpha is low.
    masked: u16,
}

impl TriangleBlock {
    /// A block of these triangles, if they are at most WIDTH and have at most WIDTH vertices, and whether they are masked.
    pub fn new(triangles: impl IntoIterator<Item = ([Vec3; 3], bool)>) -> Option<Self> {
        let mut block = Self { vertices: [[0.0; WIDTH]; 3], corners: [[0; WIDTH]; 3], present: 0, masked: 0 };
        let mut vertices = [Vec3::ZERO; WIDTH];
        let mut vertex_count = 0;
        for (lane, (triangle, masked)) in triangles.into_iter().enumerate() {
            if lane == WIDTH {
                return None;
            }
            block.present |= 1 << lane;
            block.masked |= u16::from(masked) << lane;
            for (corner, position) in triangle.into_iter().enumerate() {
                // Bits, not values: the sign of a zero is kept.
                let same = |v: &Vec3| v.to_array().map(f32::to_bits) == position.to_array().map(f32::to_bits);
                let vertex = match vertices[..vertex_count].iter().position(same) {
                    Some(vertex) => vertex,
                    None if vertex_count == WIDTH => return None,
                    None => {
                        vertices[vertex_count] = position;
                        (0..3).for_each(|axis| block.vertices[axis][vertex_count] = position[axis]);
                        vertex_count += 1;
                        vertex_count - 1
                    }
                };
                block.corners[corner][lane] = vertex as u8;
            }
        }
        Some(block)
    }

    /// The triangles that the ray hits with 0 < t ≤ `t_max`, where, and their areas.
    #[inline(always)]
    fn crossed(&self, ray: &ShearedRay, t_max: f32) -> Option<(u32, F32x8, Areas)> {
        let [i, j, k] = ray.axes;
        let depths = F32x8::load(&self.vertices[k]) - ray.origin[2];
        let x = depths.neg_mul_add(ray.shear[0], F32x8::load(&self.vertices[i]) - ray.origin[0]);
        let y = depths.neg_mul_add(ray.shear[1], F32x8::load(&self.vertices[j]) - ray.origin[1]);
        let [a, b, c] = &self.corners;
        let areas = Areas::new(
            Corner { x: x.pick(a), y: y.pick(a) },
            Corner { x: x.pick(b), y: y.pick(b) },
            Corner { x: x.pick(c), y: y.pick(c) },
        );
        let inside = F32x8::splat(0.0).at_most(areas.agreement()) & u32::from(self.present);
        if inside == 0 {
            return None;
        }
        let t = areas.distance(ray, [depths.pick(a), depths.pick(b), depths.pick(c)]);
        let inside = inside & F32x8::splat(0.0).below(t) & t.at_most(F32x8::splat(t_max));
        (inside != 0).then_some((inside, t, areas))
    }

    /// Brings `nearest` up to date. `indices` are the triangles'; masked ones must be `solid` where they are hit.
    #[inline(always)]
    pub fn closest(
        &self,
        indices: &[u32; WIDTH],
        ray: &ShearedRay,
        nearest: &mut Nearest,
        solid: impl Fn(&Hit) -> bool,
    ) {
        let Some((inside, t, areas)) = self.crossed(ray, nearest.hit.t) else { return };
        let (t, u, v) = (t.to_array(), (areas.b / areas.sum).to_array(), (areas.c / areas.sum).to_array());
        for i in lanes(inside) {
            let opaque = self.masked >> i & 1 == 0;
            nearest.update(Hit { t: t[i], triangle: indices[i], u: u[i], v: v[i] }, |hit| opaque || solid(hit));
        }
    }

    /// Whether the ray hits anything with 0 < t < `t_max`; masked triangles must be `solid` where they are hit.
    #[inline(always)]
    pub fn occludes(&self, indices: &[u32; WIDTH], ray: &ShearedRay, t_max: f32, solid: impl Fn(&Hit) -> bool) -> bool {
        let Some((inside, t, areas)) = self.crossed(ray, t_max) else { return false };
        let inside = inside & t.below(F32x8::splat(t_max));
        if inside & !u32::from(self.masked) != 0 || inside == 0 {
            return inside != 0;
        }
        let (t, u, v) = (t.to_array(), (areas.b / areas.sum).to_array(), (areas.c / areas.sum).to_array());
        lanes(inside).any(|i| solid(&Hit { t: t[i], triangle: indices[i], u: u[i], v: v[i] }))
    }
}
