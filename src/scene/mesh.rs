//! The asset's geometry, flattened: one indexed triangle mesh in world space.

use glam::{Vec2, Vec3};

/// Axis-aligned bounding box, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    pub min: Vec3,
    pub max: Vec3,
}

impl Aabb {
    pub const EMPTY: Aabb = Aabb { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    pub fn from_points(points: &[Vec3]) -> Self {
        points.iter().fold(Self::EMPTY, |b, &p| Aabb { min: b.min.min(p), max: b.max.max(p) })
    }

    pub fn centre(&self) -> Vec3 {
        (self.min + self.max) * 0.5
    }

    /// Length of the diagonal; the scale that relative distances refer to.
    pub fn diagonal(&self) -> f32 {
        (self.max - self.min).length()
    }
}

/// An indexed triangle mesh in world space (metres, y up), all instances expanded. Triangles face counter-clockwise.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Per vertex.
    pub positions: Vec<Vec3>,
    /// Per vertex, unit shading normals.
    pub normals: Vec<Vec3>,
    /// Per vertex, TEXCOORD_0 and TEXCOORD_1; empty where no primitive of the asset has the set.
    pub uvs: [Vec<Vec2>; 2],
    /// Per vertex, linear RGB that multiplies the base colour; empty where no primitive has vertex colours.
    pub colours: Vec<Vec3>,
    /// Per vertex, the lightmap chart coordinates in [0, 1]²; empty until the lightmap is laid out.
    pub lightmap_uvs: Vec<Vec2>,
    /// Vertex indices.
    pub triangles: Vec<[u32; 3]>,
    /// Per triangle, index into the asset's materials.
    pub triangle_materials: Vec<u32>,
}

impl Mesh {
    pub fn bounds(&self) -> Aabb {
        Aabb::from_points(&self.positions)
    }

    pub fn triangle_positions(&self, triangle: usize) -> [Vec3; 3] {
        self.triangles[triangle].map(|v| self.positions[v as usize])
    }

    /// Twice the area times the unit normal.
    pub fn triangle_cross(&self, triangle: usize) -> Vec3 {
        let [a, b, c] = self.triangle_positions(triangle);
        (b - a).cross(c - a)
    }

    /// Interpolates a per-vertex attribute at barycentric coordinates (u, v) of the second and third vertex.
    pub fn interpolate<T>(&self, attribute: &[T], triangle: usize, u: f32, v: f32) -> T
    where
        T: Copy + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>,
    {
        let [a, b, c] = self.triangles[triangle].map(|i| attribute[i as usize]);
        a * (1.0 - u - v) + b * u + c * v
    }
}
