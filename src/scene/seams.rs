//! Seams: edges that are one edge in space and two in the lightmap.

use std::collections::HashMap;

use glam::{Vec2, Vec3};

use super::{Lightmap, Mesh, Tracer};

/// A bilinear lookup: texels of the page, y · size + x, and their weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lookup {
    pub texels: [u32; 4],
    pub weights: [f32; 4],
}

impl Lookup {
    /// At lightmap coordinates in [0, 1]², as [`crate::model::Basis::sample`] reads a page of `size` × `size` texels.
    pub fn new(uv: Vec2, size: usize) -> Self {
        let p = uv * size as f32 - 0.5;
        let (base, f) = (p.floor(), p - p.floor());
        let clamp = |x: f32| (x as i64).clamp(0, size as i64 - 1) as u32;
        let texel = |dx: f32, dy: f32| clamp(base.y + dy) * size as u32 + clamp(base.x + dx);
        Self {
            texels: [texel(0.0, 0.0), texel(1.0, 0.0), texel(0.0, 1.0), texel(1.0, 1.0)],
            weights: [(1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y],
        }
    }
}

/// A point of a seam, as its two triangles see it.
#[derive(Clone, Copy, Debug)]
pub struct SeamPoint {
    pub triangles: [u32; 2],
    /// Barycentric coordinates of each triangle's second and third vertex.
    pub barycentric: [Vec2; 2],
    pub uvs: [Vec2; 2],
}

/// Cosine of the angle between the shading normals of an edge's two sides under which it is smooth, or flat: 8°. Across a
/// crease light is meant to jump.
const SMOOTH: f32 = 0.99;

/// Points per texel along a seam.
const POINTS_PER_TEXEL: f32 = 2.0;

/// How far from the seam, in texels, the surface of both sides must be in sight of each other, and how high above it.
const SIDEWAYS: f32 = 0.25;
const UPWARDS: f32 = 0.25;

/// Points along all seams over which the surface goes on smoothly and without a wall on it, [`POINTS_PER_TEXEL`] to a
/// texel, where light can reach both sides.
pub fn seam_points(tracer: &Tracer, lightmap: &Lightmap) -> Vec<SeamPoint> {
    let mesh = &tracer.asset().mesh;
    let size = lightmap.size as f32;
    let mut points = Vec::new();
    for [a, b] in seams(mesh) {
        let lengths = [a, b].map(|side| {
            let [p, q] = side.ends(mesh).map(|v| mesh.lightmap_uvs[v as usize]);
            p.distance(q) * size
        });
        let count = (lengths[0].max(lengths[1]) * POINTS_PER_TEXEL).ceil().max(1.0) as usize;
        for i in 0..count {
            let t = (i as f32 + 0.5) / count as f32;
            // The sides run along the edge in opposite directions.
            let sides = [(a, t), (b, 1.0 - t)];
            let inside = sides.map(|(side, t)| Inside::new(mesh, side, t, size));
            let open = inside.iter().all(|s| lightmap.is_open_at(s.uv));
            if open && !tracer.occluded(inside[0].above, inside[1].above - inside[0].above) {
                let barycentric = sides.map(|(side, t)| side.barycentric(t));
                let at = |i: usize| {
                    let triangle = sides[i].0.triangle as usize;
                    mesh.interpolate(&mesh.lightmap_uvs, triangle, barycentric[i].x, barycentric[i].y)
                };
                points.push(SeamPoint { triangles: [a.triangle, b.triangle], barycentric, uvs: [at(0), at(1)] });
            }
        }
    }
    points
}

/// An edge of a triangle: from its corner `edge` to the next.
#[derive(Clone, Copy)]
struct Side {
    triangle: u32,
    edge: u8,
}

impl Side {
    fn ends(self, mesh: &Mesh) -> [u32; 2] {
        let triangle = mesh.triangles[self.triangle as usize];
        [triangle[self.edge as usize], triangle[(self.edge as usize + 1) % 3]]
    }

    /// Barycentric coordinates of the point at share `t` of the way along the edge.
    fn barycentric(self, t: f32) -> Vec2 {
        let corners = [Vec2::ZERO, Vec2::X, Vec2::Y];
        corners[self.edge as usize].lerp(corners[(self.edge as usize + 1) % 3], t)
    }
}

/// A point a little inside a triangle's edge.
struct Inside {
    uv: Vec2,
    /// Moved off the surface.
    above: Vec3,
}

impl Inside {
    fn new(mesh: &Mesh, side: Side, t: f32, size: f32) -> Self {
        let triangle = side.triangle as usize;
        let on_edge = side.barycentric(t);
        let opposite = [Vec2::ZERO, Vec2::X, Vec2::Y][(side.edge as usize + 2) % 3];
        let uv = |b: Vec2| mesh.interpolate(&mesh.lightmap_uvs, triangle, b.x, b.y);
        let position = |b: Vec2| mesh.interpolate(&mesh.positions, triangle, b.x, b.y);
        let across = (uv(opposite) - uv(on_edge)).length() * size;
        let inwards = on_edge.lerp(opposite, (SIDEWAYS / across.max(f32::MIN_POSITIVE)).min(0.5));
        let metres_per_texel = position(opposite).distance(position(on_edge)) / across.max(f32::MIN_POSITIVE);
        let normal = mesh.triangle_cross(triangle).normalize_or_zero();
        let above = position(inwards) + normal * (UPWARDS * metres_per_texel.min(1e30));
        // Only just inside, so that a chart narrower than a texel has a texel here.
        Self { uv: uv(on_edge.lerp(inwards, 0.04)), above }
    }
}

/// The pairs of triangle edges that are one edge in space, run along it in opposite directions with nearly the same normals,
/// and lie apart in the lightmap; in the order of the mesh.
fn seams(mesh: &Mesh) -> Vec<[Side; 2]> {
    let bits = |v: u32| mesh.positions[v as usize].to_array().map(|x| (x + 0.0).to_bits());
    let mut open: HashMap<([u32; 3], [u32; 3]), Vec<Side>> = HashMap::new();
    let mut seams = Vec::new();
    let has_texels = |t: &u32| {
        let [a, b, c] = mesh.triangles[*t as usize].map(|v| mesh.lightmap_uvs[v as usize]);
        (b - a).perp_dot(c - a) != 0.0
    };
    for triangle in (0..mesh.triangles.len() as u32).filter(has_texels) {
        for edge in 0..3 {
            let side = Side { triangle, edge };
            let [from, to] = side.ends(mesh);
            // Of several the first that fits: an edge belongs to one seam.
            let partners = open.entry((bits(to), bits(from))).or_default();
            let fits = |other: &Side| {
                let [other_to, other_from] = other.ends(mesh);
                let normal = |v: u32| mesh.normals[v as usize];
                normal(from).dot(normal(other_from)) > SMOOTH && normal(to).dot(normal(other_to)) > SMOOTH
            };
            if let Some(at) = partners.iter().position(fits) {
                let other = partners.swap_remove(at);
                let [other_to, other_from] = other.ends(mesh);
                let uv = |v: u32| mesh.lightmap_uvs[v as usize];
                if uv(from) != uv(other_from) || uv(to) != uv(other_to) {
                    seams.push([other, side]);
                }
            } else {
                open.entry((bits(from), bits(to))).or_default().push(side);
            }
        }
    }
    seams
}
