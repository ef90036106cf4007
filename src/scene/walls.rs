//! Walls so thin that a lightmap's texels would mix the light of their two sides.
//!
//! Where a wall stands on a floor or passes through it, the floor goes on behind it. Texels, and bilinear lookups, that
//! reach from one side to the other show each side's light on the other one, so the lightmap must part the floor there.

use glam::Vec3;
use rayon::prelude::*;

use super::buried::comes_out;
use super::proximity::Proximity;
use super::{Aabb, Mesh, Surface, Tracer};

/// The line along which a face of a thin wall meets a triangle that it stands on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wall {
    pub triangle: u32,
    pub line: [Vec3; 2],
    /// Unit vector in the triangle's plane, square to the line, away from the wall.
    pub outwards: Vec3,
    /// From the line to the open surface behind the wall, metres.
    pub depth: f32,
}

/// Height above the surface at which it is asked what stands on it, in texels.
const HEIGHT: f32 = 1.0 / 12.0;

/// Cosine between two triangles' normals from which on one lies on the other rather than stands on it: 20°.
const FLAT: f32 = 0.94;

/// Distance from a wall's face at which it is asked what is in front of it, and behind it, in texels.
const BESIDE: f32 = 1.0 / 32.0;

/// The thickest wall that needs cutting, texels: [`super::Lightmap::open`] parts the rooms beside thicker ones than 2¼; the
/// size of a texel is an estimate here.
const THICKEST: f32 = 3.0;

/// Light goes around what ends within this distance on both sides, and over what is lower; texels.
const SMALL: f32 = 4.0;

/// Faces behind one another that a wall may have inside it.
const MAX_FACES: u32 = 4;

/// Share of paths from a point that come out into the open where light matters: less do from the inside of a solid that is
/// not closed.
const LIT: f32 = 0.4;

/// Places along a line that are looked at: texels from one to the next, and how many at most.
const APART: f32 = 2.0;
const MAX_PLACES: f32 = 8.0;

/// The thin walls of an asset whose lightmap has texels of about `texel` metres, in the order of the triangles that they
/// stand on.
pub(super) fn thin_walls(tracer: &Tracer, texel: f32) -> Vec<Wall> {
    let mesh = &tracer.asset().mesh;
    let height = (HEIGHT * texel).max(4.0 * tracer.offset);
    let finder = Finder { tracer, mesh, proximity: Proximity::new(mesh), texel, height };
    (0..mesh.triangles.len()).into_par_iter().flat_map_iter(|t| finder.on(t)).collect()
}

struct Finder<'t, 'a> {
    tracer: &'t Tracer<'a>,
    mesh: &'t Mesh,
    proximity: Proximity,
    /// Metres, both.
    texel: f32,
    height: f32,
}

impl Finder<'_, '_> {
    /// Those that stand on a triangle.
    fn on(&self, triangle: usize) -> Vec<Wall> {
        let corners = self.mesh.triangle_positions(triangle);
        let normal = self.mesh.triangle_cross(triangle).normalize_or_zero();
        let bounds = Aabb::from_points(&corners);
        let bounds = Aabb { min: bounds.min - self.height, max: bounds.max + self.height };
        let mut walls = Vec::new();
        self.proximity.for_each_near(&bounds, |face| {
            let face = face as usize;
            if face != triangle && !self.tracer.asset().may_be_cut_out(face) {
                walls.extend(self.wall(triangle, normal, &corners, face));
            }
        });
        walls
    }

    fn wall(&self, triangle: usize, normal: Vec3, corners: &[Vec3; 3], face: usize) -> Option<Wall> {
        let of_face = self.mesh.triangle_positions(face);
        let heights = of_face.map(|p| normal.dot(p - corners[0]) - self.height);
        let below = heights.map(|h| h < 0.0);
        if below[0] == below[1] && below[1] == below[2] {
            return None;
        }
        let face_normal = self.mesh.triangle_cross(face).normalize_or_zero();
        let slope = normal.dot(face_normal);
        if slope.abs() > FLAT {
            return None;
        }
        // Its two edges that cross the raised plane do so at the ends of a line, which goes down along the face.
        let crossings: Vec<Vec3> = (0..3)
            .filter(|&i| below[i] != below[(i + 1) % 3])
            .map(|i| {
                let j = (i + 1) % 3;
                of_face[i].lerp(of_face[j], heights[i] / (heights[i] - heights[j]))
            })
            .collect();
        // Up along the face, by as much as is one along the normal: a wall that leans is looked at where it is.
        let rise = (normal - face_normal * slope) / (1.0 - slope * slope);
        let down = rise * self.height;
        let line = clipped([crossings[0] - down, crossings[1] - down], corners, normal, self.texel * 1e-3)?;
        let length = line[0].distance(line[1]);
        if length < BESIDE * self.texel {
            return None;
        }
        let along = (line[1] - line[0]) / length;
        let outwards = normal.cross(along);
        let outwards = if outwards.dot(face_normal) < 0.0 { -outwards } else { outwards };
        let places = (length / (APART * self.texel)).ceil().clamp(1.0, MAX_PLACES);
        let depth = (0..places as usize)
            .filter_map(|i| {
                let at = line[0].lerp(line[1], (i as f32 + 0.5) / places);
                self.depth(at, [normal, rise], along, outwards)
            })
            .min_by(f32::total_cmp)?;
        Some(Wall { triangle: triangle as u32, line, outwards, depth })
    }

    /// From a point at the foot of a wall's face to the open surface behind the wall, where that is near and the wall
    /// keeps light from going there.
    fn depth(&self, foot: Vec3, [normal, rise]: [Vec3; 2], along: Vec3, outwards: Vec3) -> Option<f32> {
        let beside = BESIDE * self.texel;
        let before = foot + outwards * beside;
        self.is_open(before, [normal, rise]).then_some(())?;
        let up = rise * self.height;
        let mut depth = 0.0;
        let mut faces = 0;
        while !self.is_open(foot - outwards * (depth + beside), [normal, rise]) {
            let from = foot - outwards * (depth + beside) + up;
            let next = self.tracer.closest_hit(from, -outwards, THICKEST * self.texel - depth)?;
            depth += beside + next.t;
            faces += 1;
            if faces > MAX_FACES || depth > THICKEST * self.texel {
                return None;
            }
        }
        let across = -outwards * (depth + 2.0 * beside);
        let small = SMALL * self.texel;
        let ceiling = self.tracer.closest_hit(before + up, rise.normalize(), small);
        let room = rise.normalize() * ceiling.map_or(small, |ceiling| 0.9 * ceiling.t);
        let is_high = self.tracer.occluded(before + up + room, across);
        let goes_on =
            |aside: Vec3| self.tracer.occluded(before + up, aside) || self.tracer.occluded(before + up + aside, across);
        (is_high && (goes_on(along * small) || goes_on(-along * small))).then_some(depth)
    }

    /// Whether there is surface at a point, facing along `normal`, that light can reach; looked at from along `rise`.
    fn is_open(&self, at: Vec3, [normal, rise]: [Vec3; 2]) -> bool {
        let reach = 2.0 * self.height * rise.length();
        let Some(hit) = self.tracer.closest_hit(at + rise * self.height, -rise.normalize(), reach) else {
            return false;
        };
        let surface: Surface = self.tracer.surface(&hit, -rise);
        let faces_along = !surface.back && surface.geometric_normal.dot(normal) > FLAT;
        faces_along && comes_out(self.tracer, u64::from(hit.triangle), LIT, |_| surface)
    }
}

/// The part of a line in the plane of a triangle that lies in it, or out of it by at most `tolerance`.
fn clipped(line: [Vec3; 2], corners: &[Vec3; 3], normal: Vec3, tolerance: f32) -> Option<[Vec3; 2]> {
    let (mut from, mut to) = (0.0f32, 1.0f32);
    for i in 0..3 {
        let edge = corners[(i + 1) % 3] - corners[i];
        let inwards = normal.cross(edge).normalize_or_zero();
        let [a, b] = line.map(|p| inwards.dot(p - corners[i]) + tolerance);
        if a < 0.0 && b < 0.0 {
            return None;
        }
        if a < 0.0 {
            from = from.max(a / (a - b));
        } else if b < 0.0 {
            to = to.min(a / (a - b));
        }
    }
    (from < to).then(|| [line[0].lerp(line[1], from), line[0].lerp(line[1], to)])
}
