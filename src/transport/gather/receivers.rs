//! Where the rays of a texel or a patch leave from, LANES points at a time.

use glam::Vec3;

use super::patches::is_flat;
use crate::math::{Frame, LANES, warp};
use crate::scene::{Mesh, TexelSampler};

/// LANES vectors: `[axis][lane]`.
pub type Vectors = [[f32; LANES]; 3];

/// Points of a surface, uniform by area.
#[derive(Default)]
pub struct Receivers {
    /// In the order of their shares.
    parts: Vec<Part>,
    /// Whether shading normals are those of the triangles everywhere.
    flat: bool,
}

/// A triangle of it.
struct Part {
    /// Its share of the unit interval: where that starts, and 1 over its width.
    start: f32,
    per_width: f32,
    corners: [Vec3; 3],
    /// Shading normals there, not of unit length.
    normals: [Vec3; 3],
    /// Unit, of the front.
    geometric_normal: Vec3,
}

/// LANES points from which rays leave, and where to.
#[repr(align(64))]
pub struct Departure {
    pub position: Vectors,
    pub geometric_normal: Vectors,
    pub direction: Vectors,
    /// Cosine to the shading normal, which the direction is drawn around.
    pub cos: [f32; LANES],
}

impl Receivers {
    /// Empties it for another surface.
    pub fn clear(&mut self) {
        self.parts.clear();
        self.flat = true;
    }

    /// Adds the surface of a texel, which has the share `start..end` of the whole.
    pub fn add(&mut self, mesh: &Mesh, texel: &TexelSampler, start: f32, end: f32) {
        let mut from = start;
        for (triangle, corners, share) in texel.fans() {
            let to = start + (end - start) * share;
            let triangle = triangle as usize;
            let [a, b, c] = mesh.triangle_positions(triangle);
            let geometric_normal = (b - a).cross(c - a).normalize_or(Vec3::Y);
            self.flat &= is_flat(mesh, triangle);
            self.parts.push(Part {
                start: from,
                per_width: 1.0 / (to - from).max(f32::MIN_POSITIVE),
                corners: corners.map(|at| a * (1.0 - at.x - at.y) + b * at.x + c * at.y),
                normals: corners.map(|at| mesh.interpolate(&mesh.normals, triangle, at.x, at.y)),
                geometric_normal,
            });
            from = to;
        }
    }

    /// Points made of `u` and cosine-distributed directions made of `v`, each `[coordinate][lane]` in [0, 1).
    #[inline]
    pub fn depart(&self, u: &[[f32; LANES]; 2], v: &[[f32; LANES]; 2]) -> Departure {
        let mut position = [[0.0; LANES]; 3];
        let mut geometric_normal = [[0.0; LANES]; 3];
        let mut normal = [[0.0; LANES]; 3];
        for part in &self.parts {
            let [p, q, r] = part.corners;
            let [np, nq, nr] = part.normals;
            let (pq, pr, npq, npr) = (q - p, r - p, nq - np, nr - np);
            for i in 0..LANES {
                let here = u[0][i] >= part.start;
                // What is left of u inside the part's share serves again (as in `warp::sample_uniform_triangle`).
                let rest = ((u[0][i] - part.start) * part.per_width).clamp(0.0, 1.0);
                let (low, high) = (rest.min(u[1][i]), rest.max(u[1][i]));
                let (b, c) = if rest < u[1][i] { (0.5 * low, high - 0.5 * low) } else { (high - 0.5 * low, 0.5 * low) };
                for axis in 0..3 {
                    let at = p[axis] + pq[axis] * b + pr[axis] * c;
                    position[axis][i] = if here { at } else { position[axis][i] };
                    let g = part.geometric_normal[axis];
                    geometric_normal[axis][i] = if here { g } else { geometric_normal[axis][i] };
                    if !self.flat {
                        let at = np[axis] + npq[axis] * b + npr[axis] * c;
                        normal[axis][i] = if here { at } else { normal[axis][i] };
                    }
                }
            }
        }
        if self.flat {
            normal = geometric_normal;
        } else {
            usable(&mut normal, &geometric_normal);
        }
        Departure::new(position, geometric_normal, &normal, v)
    }
}

/// Normalises shading normals; those that point below the surface are replaced by its own.
fn usable(normal: &mut Vectors, geometric_normal: &Vectors) {
    for i in 0..LANES {
        let (n, g) = ([0, 1, 2].map(|axis| normal[axis][i]), [0, 1, 2].map(|axis| geometric_normal[axis][i]));
        let square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
        let above = n[0] * g[0] + n[1] * g[1] + n[2] * g[2] > 0.0 && square > 0.0;
        let scale = 1.0 / square.sqrt();
        (0..3).for_each(|axis| normal[axis][i] = if above { n[axis] * scale } else { g[axis] });
    }
}

impl Departure {
    /// Directions about the shading normal made of `v`.
    #[inline]
    pub fn new(position: Vectors, geometric_normal: Vectors, normal: &Vectors, v: &[[f32; LANES]; 2]) -> Self {
        let local = warp::sample_cosine_hemispheres(v);
        let mut direction = [[0.0; LANES]; 3];
        for i in 0..LANES {
            let frame = Frame::from_normal(Vec3::new(normal[0][i], normal[1][i], normal[2][i]));
            let way = frame.world_from_local(Vec3::new(local[0][i], local[1][i], local[2][i]));
            (direction[0][i], direction[1][i], direction[2][i]) = (way.x, way.y, way.z);
        }
        Self { position, geometric_normal, direction, cos: local[2] }
    }

    /// The lanes whose direction is not below the surface.
    #[inline]
    pub fn above(&self) -> u32 {
        let mut above = [false; LANES];
        for i in 0..LANES {
            let cos = (0..3).map(|axis| self.direction[axis][i] * self.geometric_normal[axis][i]).sum::<f32>();
            above[i] = cos > 0.0;
        }
        crate::scene::mask_of(&above)
    }

    /// Where the rays start: `offset` metres off the surface.
    #[inline]
    pub fn origins(&self, offset: f32) -> Vectors {
        let mut origins = self.position;
        for axis in 0..3 {
            for i in 0..LANES {
                origins[axis][i] += self.geometric_normal[axis][i] * offset;
            }
        }
        origins
    }

    pub fn position(&self, lane: usize) -> Vec3 {
        self.position.map(|axis| axis[lane]).into()
    }

    pub fn geometric_normal(&self, lane: usize) -> Vec3 {
        self.geometric_normal.map(|axis| axis[lane]).into()
    }

    #[inline(always)]
    pub fn direction(&self, lane: usize) -> Vec3 {
        Vec3::new(self.direction[0][lane], self.direction[1][lane], self.direction[2][lane])
    }
}
