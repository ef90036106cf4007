//! Ray tracing against the asset's triangles: one ray to its closest hit, and packets of shadow rays that share an origin.
//!
//! Small meshes are tested whole, LANES triangles at a time; no tree beats that below about a hundred triangles. Larger
//! ones go through obvhs: a compressed wide BVH (Ylitie, Karras, Laine, *Efficient Incoherent Ray Traversal on GPUs Through
//! Compressed Wide BVHs*, 2017) for single rays, and the binary BVH for shadow packets.
//!
//! A triangle is hit where the signed volumes that the ray spans with its three edges agree in sign. Triangles that share
//! an edge compute the same volume for it, so no ray slips between them.

use glam::Vec3;
use obvhs::bvh2::Bvh2;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::bvh2_to_cwbvh::bvh2_to_cwbvh;
use obvhs::ray::{Ray, RayHit};
use obvhs::triangle::Triangle;
use obvhs::{BvhBuildParams, bvh2::builder::build_bvh2_from_tris};

use super::{Aabb, Asset, Hit, Surface};
use crate::math::LANES;

/// Meshes of at most this many triangles are tested whole. Measured by `benches/trace.rs`: single rays and shadow packets for
/// 128 lights break even with the trees between 120 and 250 triangles, one shadow packet an origin at about 60.
const BRUTE_FORCE_LIMIT: usize = 128;

/// [`Tracer::offset`] over [`Tracer::extent`]. Positions carry a rounding error of about 1e-7 of the extent; this stays well
/// above it and well below a texel.
pub const RELATIVE_OFFSET: f32 = 1e-5;

/// Vectors from a point to LANES lights, structure of arrays.
pub type Segments = [[f32; LANES]; 3];

/// Traces rays against one asset.
pub struct Tracer<'a> {
    asset: &'a Asset,
    triangles: Vec<Corners>,
    /// Whether each triangle's material cuts out where alpha is low.
    masked: Vec<bool>,
    any_masked: bool,
    structure: Structure,
    /// Metres by which a ray's origin is moved off its surface.
    pub offset: f32,
    /// Metres: no segment between two points of the asset is longer.
    pub extent: f32,
}

type Corners = [Vec3; 3];

/// How a tracer searches its triangles; the answers are the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Search {
    /// All of them, LANES at a time.
    Brute,
    /// Through bounding volume hierarchies.
    Tree,
}

enum Structure {
    Brute(Vec<TriangleBlock>),
    Tree { wide: Wide, binary: Box<Bvh2> },
}

/// LANES triangles, structure of arrays: `[corner][axis][lane]`.
#[repr(align(64))]
struct TriangleBlock {
    corners: [[[f32; LANES]; 3]; 3],
}

impl<'a> Tracer<'a> {
    pub fn new(asset: &'a Asset) -> Self {
        let small = asset.mesh.triangles.len() <= BRUTE_FORCE_LIMIT;
        Self::with_search(asset, if small { Search::Brute } else { Search::Tree })
    }

    /// A tracer that searches as told; [`Self::new`] takes the faster way.
    pub fn with_search(asset: &'a Asset, search: Search) -> Self {
        let mesh = &asset.mesh;
        let triangles: Vec<Corners> = (0..mesh.triangles.len()).map(|t| mesh.triangle_positions(t)).collect();
        let masked: Vec<bool> =
            mesh.triangle_materials.iter().map(|&m| asset.materials[m as usize].alpha_cutoff.is_some()).collect();
        let extent = mesh.bounds().diagonal();
        let structure = match search {
            Search::Brute => Structure::Brute(triangles.chunks(LANES).map(TriangleBlock::new).collect()),
            Search::Tree => build_tree(&triangles, extent),
        };
        Self {
            asset,
            any_masked: masked.contains(&true),
            triangles,
            masked,
            structure,
            offset: extent * RELATIVE_OFFSET,
            extent,
        }
    }

    pub fn asset(&self) -> &'a Asset {
        self.asset
    }

    /// The nearest hit with 0 < t < `t_max`.
    pub fn closest_hit(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<Hit> {
        let mut hit = Hit { t: t_max, triangle: u32::MAX, u: 0.0, v: 0.0 };
        match &self.structure {
            Structure::Brute(blocks) => {
                for (i, block) in blocks.iter().enumerate() {
                    block.closest(i * LANES, origin, direction, &mut hit, |h| self.solid(h));
                }
            }
            Structure::Tree { wide, .. } => {
                let (ray, unit) = wide.ray(origin, direction, t_max);
                wide.bvh.ray_traverse(ray, &mut RayHit::none(), |ray, slot| {
                    let triangle = wide.bvh.primitive_indices[slot];
                    let candidate = intersect(&self.triangles[triangle as usize], origin, direction)
                        .map(|(t, u, v)| Hit { t, triangle, u, v })
                        .filter(|h| h.t < hit.t && h.t * unit < ray.tmax && self.solid(h));
                    candidate.map_or(f32::INFINITY, |h| {
                        hit = h;
                        h.t * unit
                    })
                });
            }
        }
        (hit.triangle != u32::MAX).then_some(hit)
    }

    /// Whether anything lies on the open segment from `origin` along `segment`.
    pub fn occluded(&self, origin: Vec3, segment: Vec3) -> bool {
        match &self.structure {
            Structure::Brute(_) => self.closest_hit(origin, segment, SEGMENT_END).is_some(),
            Structure::Tree { wide, .. } => {
                let (ray, unit) = wide.ray(origin, segment, SEGMENT_END);
                !wide.bvh.ray_traverse_miss(ray, |_, slot| {
                    let triangle = wide.bvh.primitive_indices[slot];
                    intersect(&self.triangles[triangle as usize], origin, segment)
                        .map(|(t, u, v)| Hit { t, triangle, u, v })
                        .filter(|h| h.t < SEGMENT_END && self.solid(h))
                        .map_or(f32::INFINITY, |h| h.t * unit)
                })
            }
        }
    }

    /// The surface at a hit of a ray along `direction`.
    pub fn surface(&self, hit: &Hit, direction: Vec3) -> Surface {
        self.asset.surface(hit.triangle as usize, hit.u, hit.v, direction)
    }

    /// Where a ray that leaves `surface` along `direction` starts: just off the surface, on the side that it leaves to.
    pub fn leave(&self, surface: &Surface, direction: Vec3) -> Vec3 {
        surface.position + surface.geometric_normal * self.offset.copysign(surface.geometric_normal.dot(direction))
    }

    /// Shadow rays against this asset, to be aimed from one point after another. `targets` bounds the lights that they go
    /// to, `None` where some are infinitely far.
    pub fn shadow_rays(&self, targets: Option<Aabb>) -> ShadowRays<'_, 'a> {
        ShadowRays { tracer: self, targets, origin: Vec3::ZERO, fans: Vec::new() }
    }

    /// Whether the material is present at a hit.
    fn solid(&self, hit: &Hit) -> bool {
        !self.masked[hit.triangle as usize] || !self.asset.is_cut_out(hit.triangle as usize, hit.u, hit.v)
    }
}

/// A segment ends just before the light, so that a light on a surface is not hidden by it.
const SEGMENT_END: f32 = 1.0 - 1e-4;

/// The wide BVH, in units of its own: obvhs skips boxes that end within 1e-4 of a ray's start, so it is given coordinates in
/// which that is far below the offset of any ray.
struct Wide {
    bvh: Box<CwBvh>,
    /// Its units per metre.
    scale: f32,
}

impl Wide {
    /// The ray in the tree's coordinates, and the tree's units per unit of t.
    fn ray(&self, origin: Vec3, direction: Vec3, t_max: f32) -> (Ray, f32) {
        let length = direction.length().max(f32::MIN_POSITIVE);
        let unit = self.scale * length;
        (Ray::new((origin * self.scale).into(), (direction / length).into(), 0.0, t_max * unit), unit)
    }
}

/// The asset's extent in the wide BVH's units.
const WIDE_EXTENT: f32 = 1e5;

fn build_tree(triangles: &[Corners], extent: f32) -> Structure {
    // obvhs converts only trees of one triangle a leaf.
    let params = BvhBuildParams { max_prims_per_leaf: 1, ..BvhBuildParams::medium_build() };
    let build = |scale: f32| {
        let scaled = |v: Vec3| (v * scale).into();
        let boxes: Vec<Triangle> =
            triangles.iter().map(|&[a, b, c]| Triangle { v0: scaled(a), v1: scaled(b), v2: scaled(c) }).collect();
        build_bvh2_from_tris(&boxes, params, &mut Default::default())
    };
    let scale = WIDE_EXTENT / extent;
    // A leaf of the wide BVH holds at most three triangles.
    let bvh = bvh2_to_cwbvh(&build(scale), 3, true, false);
    Structure::Tree { wide: Wide { bvh: Box::new(bvh), scale }, binary: Box::new(build(1.0)) }
}

/// Distance and barycentric coordinates (of the second and third corner) where the ray meets the triangle, if t > 0.
#[inline]
fn intersect(&[a, b, c]: &Corners, origin: Vec3, direction: Vec3) -> Option<(f32, f32, f32)> {
    let (a, b, c) = (a - origin, b - origin, c - origin);
    let wa = direction.dot(b.cross(c));
    let wb = direction.dot(c.cross(a));
    let wc = direction.dot(a.cross(b));
    let sum = wa + wb + wc;
    let inside = wa.min(wb).min(wc) >= 0.0 || wa.max(wb).max(wc) <= 0.0;
    if !inside || sum == 0.0 {
        return None;
    }
    let t = a.dot((b - a).cross(c - a)) / sum;
    (t > 0.0).then(|| (t, wb / sum, wc / sum))
}

impl TriangleBlock {
    fn new(triangles: &[Corners]) -> Self {
        // Padding triangles are points at the origin: no ray has a positive volume with them.
        let mut corners = [[[0.0; LANES]; 3]; 3];
        for (lane, triangle) in triangles.iter().enumerate() {
            for corner in 0..3 {
                for axis in 0..3 {
                    corners[corner][axis][lane] = triangle[corner][axis];
                }
            }
        }
        Self { corners }
    }

    /// Shortens `hit` to the nearest of these triangles for which `solid` holds.
    #[inline]
    fn closest(&self, first: usize, o: Vec3, d: Vec3, hit: &mut Hit, solid: impl Fn(&Hit) -> bool) {
        let mut t = [0f32; LANES];
        let (mut u, mut v) = ([0f32; LANES], [0f32; LANES]);
        let [ca, cb, cc] = &self.corners;
        for i in 0..LANES {
            let (ax, ay, az) = (ca[0][i] - o.x, ca[1][i] - o.y, ca[2][i] - o.z);
            let (bx, by, bz) = (cb[0][i] - o.x, cb[1][i] - o.y, cb[2][i] - o.z);
            let (cx, cy, cz) = (cc[0][i] - o.x, cc[1][i] - o.y, cc[2][i] - o.z);
            let wa = d.x * (by * cz - bz * cy) + d.y * (bz * cx - bx * cz) + d.z * (bx * cy - by * cx);
            let wb = d.x * (cy * az - cz * ay) + d.y * (cz * ax - cx * az) + d.z * (cx * ay - cy * ax);
            let wc = d.x * (ay * bz - az * by) + d.y * (az * bx - ax * bz) + d.z * (ax * by - ay * bx);
            let sum = wa + wb + wc;
            let (ex, ey, ez) = (bx - ax, by - ay, bz - az);
            let (fx, fy, fz) = (cx - ax, cy - ay, cz - az);
            let volume = ax * (ey * fz - ez * fy) + ay * (ez * fx - ex * fz) + az * (ex * fy - ey * fx);
            let inside = (wa >= 0.0) & (wb >= 0.0) & (wc >= 0.0) | (wa <= 0.0) & (wb <= 0.0) & (wc <= 0.0);
            let distance = volume / sum;
            t[i] = if inside & (sum != 0.0) & (distance > 0.0) { distance } else { f32::INFINITY };
            u[i] = wb / sum;
            v[i] = wc / sum;
        }
        // Ties go to the first triangle.
        for i in 0..LANES {
            if t[i] < hit.t {
                let candidate = Hit { t: t[i], triangle: (first + i) as u32, u: u[i], v: v[i] };
                if solid(&candidate) {
                    *hit = candidate;
                }
            }
        }
    }
}

/// A triangle as seen from one origin: the planes through the origin and each edge, facing inwards when the volume is positive.
struct Fan {
    planes: [Vec3; 3],
    /// Six times the volume of the tetrahedron that the origin spans with the triangle.
    volume: f32,
}

impl Fan {
    #[inline]
    fn new(&[a, b, c]: &Corners, origin: Vec3) -> Self {
        let (a, b, c) = (a - origin, b - origin, c - origin);
        Self { planes: [b.cross(c), c.cross(a), a.cross(b)], volume: a.dot((b - a).cross(c - a)) }
    }

    /// Whether the triangle's plane has any of `targets` on the far side from the origin; if not, it hides none of them.
    #[inline]
    fn parts(&self, &[a, b, c]: &Corners, origin: Vec3, targets: &Aabb) -> bool {
        let normal = (b - a).cross(c - a);
        let centre = targets.centre() - a;
        let reach = normal.abs().dot(targets.max - targets.min) * 0.5;
        // The plane's signed distance is −volume at the origin, within `reach` of normal·centre over the targets.
        let side = normal.dot(centre);
        let slack = 1e-5 * normal.abs().dot(centre.abs() + (origin - a).abs());
        if self.volume > 0.0 { side + reach + slack > 0.0 } else { side - reach - slack < 0.0 }
    }

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

/// Bit i is set where lane i is.
#[inline]
pub fn mask_of(lanes: &[bool; LANES]) -> u32 {
    // Eight bytes that are 0 or 1, times this, have their bits side by side in the top byte.
    const GATHER: u64 = 0x0102_0408_1020_4080;
    let bytes = lanes.map(|lane| lane as u8);
    bytes
        .as_chunks::<8>()
        .0
        .iter()
        .enumerate()
        .fold(0, |mask, (i, &eight)| mask | ((u64::from_le_bytes(eight).wrapping_mul(GATHER) >> 56) as u32) << (8 * i))
}

/// Shadow rays from one point, LANES at a time.
pub struct ShadowRays<'t, 'a> {
    tracer: &'t Tracer<'a>,
    targets: Option<Aabb>,
    origin: Vec3,
    /// The triangles that can lie between the origin and a target, for a mesh that is tested whole.
    fans: Vec<(u32, Fan)>,
}

impl ShadowRays<'_, '_> {
    /// Moves the common origin.
    pub fn start_from(&mut self, origin: Vec3) {
        self.origin = origin;
        if let Structure::Brute(_) = &self.tracer.structure {
            self.fans.clear();
            for (triangle, corners) in self.tracer.triangles.iter().enumerate() {
                let fan = Fan::new(corners, origin);
                if self.targets.is_none_or(|targets| fan.parts(corners, origin, &targets)) {
                    self.fans.push((triangle as u32, fan));
                }
            }
        }
    }

    /// The lanes of `active` whose segment nothing crosses.
    #[inline]
    pub fn unoccluded(&self, segments: &Segments, active: u32) -> u32 {
        let mut open = active;
        match &self.tracer.structure {
            Structure::Brute(_) if !self.tracer.any_masked => {
                let mut blocked = [false; LANES];
                self.fans.iter().for_each(|(_, fan)| fan.block(segments, &mut blocked));
                open &= !mask_of(&blocked);
            }
            Structure::Brute(_) => {
                for (triangle, fan) in &self.fans {
                    open &= !self.blocked_by(*triangle as usize, fan, segments, open);
                }
            }
            Structure::Tree { binary, .. } => {
                traverse_packet(binary, self.origin, segments, &mut open, |slot, open| {
                    let triangle = binary.primitive_indices[slot] as usize;
                    let fan = Fan::new(&self.tracer.triangles[triangle], self.origin);
                    self.blocked_by(triangle, &fan, segments, open)
                });
            }
        }
        open
    }

    #[inline]
    fn blocked_by(&self, triangle: usize, fan: &Fan, segments: &Segments, open: u32) -> u32 {
        let mut lanes_blocked = [false; LANES];
        fan.block(segments, &mut lanes_blocked);
        let mut blocked = mask_of(&lanes_blocked) & open;
        if self.tracer.any_masked && self.tracer.masked[triangle] && blocked != 0 {
            for lane in lanes(blocked) {
                let s = Vec3::new(segments[0][lane], segments[1][lane], segments[2][lane]);
                let [wa, wb, wc] = fan.planes.map(|plane| plane.dot(s));
                let sum = wa + wb + wc;
                if self.tracer.asset.is_cut_out(triangle, wb / sum, wc / sum) {
                    blocked &= !(1 << lane);
                }
            }
        }
        blocked
    }
}

/// The set lanes of a mask, in order.
#[inline]
pub fn lanes(mut mask: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        (mask != 0).then(|| {
            let lane = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            lane
        })
    })
}

/// Trees are rarely deeper; a balanced one over 2³² triangles has 32 levels.
const USUAL_DEPTH: usize = 96;

/// Visits the leaves that open lanes reach; `blocked` is given a primitive slot and the open lanes and returns those that
/// it blocks.
fn traverse_packet(bvh: &Bvh2, origin: Vec3, segments: &Segments, open: &mut u32, blocked: impl Fn(usize, u32) -> u32) {
    let mut inverse: Segments = [[0.0; LANES]; 3];
    for axis in 0..3 {
        for i in 0..LANES {
            let d = segments[axis][i];
            // A finite inverse, so that 0 · ∞ never makes a NaN.
            inverse[axis][i] = 1.0 / d.abs().max(1e-20).copysign(d);
        }
    }
    let enters = |node: usize, open: u32| -> u32 {
        let aabb = &bvh.nodes[node].aabb;
        let lo = Vec3::from(aabb.min) - origin;
        let hi = Vec3::from(aabb.max) - origin;
        let mut inside = [false; LANES];
        for i in 0..LANES {
            let (x0, x1) = (lo.x * inverse[0][i], hi.x * inverse[0][i]);
            let (y0, y1) = (lo.y * inverse[1][i], hi.y * inverse[1][i]);
            let (z0, z1) = (lo.z * inverse[2][i], hi.z * inverse[2][i]);
            let near = x0.min(x1).max(y0.min(y1)).max(z0.min(z1)).max(0.0);
            let far = x0.max(x1).min(y0.max(y1)).min(z0.max(z1)).min(1.0);
            // Two roundings a side (Ize, Robust BVH Ray Traversal, 2013).
            inside[i] = near <= far * 1.000_000_3;
        }
        mask_of(&inside) & open
    };
    let mut on_stack = [(0u32, 0u32); USUAL_DEPTH];
    let mut on_heap;
    let stack: &mut [(u32, u32)] = if bvh.max_depth <= USUAL_DEPTH {
        &mut on_stack
    } else {
        on_heap = vec![(0, 0); bvh.max_depth + 1];
        &mut on_heap
    };
    let mut depth = 0;
    let mut node = 0usize;
    let mut reach = enters(0, *open);
    loop {
        reach &= *open;
        if reach != 0 {
            let n = &bvh.nodes[node];
            if n.prim_count == 0 {
                let (left, right) = (n.first_index as usize, n.first_index as usize + 1);
                let (reach_left, reach_right) = (enters(left, reach), enters(right, reach));
                if reach_right != 0 {
                    stack[depth] = (right as u32, reach_right);
                    depth += 1;
                }
                (node, reach) = (left, reach_left);
                continue;
            }
            for slot in n.first_index..n.first_index + n.prim_count {
                *open &= !blocked(slot as usize, reach & *open);
            }
        }
        if depth == 0 || *open == 0 {
            return;
        }
        depth -= 1;
        node = stack[depth].0 as usize;
        reach = stack[depth].1;
    }
}
