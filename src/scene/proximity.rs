//! How near the asset's surface is to a point.

use glam::Vec3;
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::triangle::Triangle;

use super::{Aabb, Mesh};

/// Answers nearest-surface queries for one mesh.
pub struct Proximity {
    triangles: Vec<[Vec3; 3]>,
    bvh: Bvh2,
}

impl Proximity {
    pub fn new(mesh: &Mesh) -> Self {
        let triangles: Vec<[Vec3; 3]> = (0..mesh.triangles.len()).map(|t| mesh.triangle_positions(t)).collect();
        let boxes: Vec<Triangle> =
            triangles.iter().map(|&[a, b, c]| Triangle { v0: a.into(), v1: b.into(), v2: c.into() }).collect();
        let bvh = build_bvh2_from_tris(&boxes, BvhBuildParams::fast_build(), &mut Default::default());
        Self { triangles, bvh }
    }

    /// Visits the triangles whose bounding boxes may touch `bounds`, each once.
    pub fn for_each_near(&self, bounds: &Aabb, mut visit: impl FnMut(u32)) {
        let mut stack = vec![0u32];
        while let Some(index) = stack.pop().filter(|_| !self.triangles.is_empty()) {
            let node = &self.bvh.nodes[index as usize];
            let (min, max) = (Vec3::from(node.aabb.min), Vec3::from(node.aabb.max));
            if min.cmpgt(bounds.max).any() || max.cmplt(bounds.min).any() {
                continue;
            }
            if node.prim_count == 0 {
                stack.extend([node.first_index, node.first_index + 1]);
                continue;
            }
            let slots = node.first_index..node.first_index + node.prim_count;
            slots.for_each(|slot| visit(self.bvh.primitive_indices[slot as usize]));
        }
    }

    /// Distance from `point` to the surface where it is less than `limit`, otherwise `limit`; metres.
    pub fn distance(&self, point: Vec3, limit: f32) -> f32 {
        let mut nearest2 = limit * limit;
        let mut stack = vec![0u32];
        while let Some(index) = stack.pop().filter(|_| !self.triangles.is_empty()) {
            let node = &self.bvh.nodes[index as usize];
            let (min, max) = (Vec3::from(node.aabb.min), Vec3::from(node.aabb.max));
            if point.distance_squared(point.clamp(min, max)) >= nearest2 {
                continue;
            }
            if node.prim_count == 0 {
                stack.extend([node.first_index, node.first_index + 1]);
                continue;
            }
            for slot in node.first_index..node.first_index + node.prim_count {
                let corners = &self.triangles[self.bvh.primitive_indices[slot as usize] as usize];
                nearest2 = nearest2.min(point.distance_squared(nearest_on_triangle(point, corners)));
            }
        }
        nearest2.sqrt()
    }
}

/// The point of the triangle nearest to `p`, by the Voronoi regions of its corners and edges (Ericson, *Real-Time
/// Collision Detection*, 2005, section 5.1.5).
pub fn nearest_on_triangle(p: Vec3, &[a, b, c]: &[Vec3; 3]) -> Vec3 {
    let (ab, ac) = (b - a, c - a);
    let (d1, d2) = (ab.dot(p - a), ac.dot(p - a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let (d3, d4) = (ab.dot(p - b), ac.dot(p - b));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let (d5, d6) = (ab.dot(p - c), ac.dot(p - c));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    // A triangle without area has no inside; its corner is within rounding of the nearest point of its edges.
    if sum > 0.0 { a + ab * (vb / sum) + ac * (vc / sum) } else { a }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Sampler;
    use crate::math::warp::sample_uniform_triangle;
    use glam::Vec2;

    /// No point of the triangle is nearer, and the vector to the nearest point is normal to each edge or ends on a corner.
    #[test]
    fn nearest_point_is_nearest_of_all() {
        for case in 0..500 {
            let mut sampler = Sampler::new(3, case, 0);
            let mut next = || {
                let [x, y, z, _] = sampler.next_4d();
                Vec3::new(x, y, z) * 2.0 - 1.0
            };
            let (corners, p) = ([next(), next(), next()], next() * 2.0);
            let nearest = nearest_on_triangle(p, &corners).distance(p);
            let mut least = f32::INFINITY;
            for i in 0..2000 {
                let [u, v, ..] = Sampler::new(5, case, i).next_4d();
                let b = sample_uniform_triangle(Vec2::new(u, v));
                let q = corners[0] * (1.0 - b.x - b.y) + corners[1] * b.x + corners[2] * b.y;
                least = least.min(p.distance(q));
            }
            assert!(nearest <= least + 1e-5, "{nearest} against {least}");
            // 2000 points leave gaps of about the extent / √2000.
            assert!(least - nearest < 0.15, "{nearest} against {least}");
        }
    }

    #[test]
    fn tree_finds_the_nearest_of_all_triangles() {
        let mesh = crate::scene::generate::generate("statue").unwrap().mesh;
        let proximity = Proximity::new(&mesh);
        for i in 0..50 {
            let [x, y, z, _] = Sampler::new(1, 0, i).next_4d();
            let p = Vec3::new(2.0 * x - 1.0, 2.0 * y, 2.0 * z - 1.0);
            let all = (0..mesh.triangles.len())
                .map(|t| p.distance(nearest_on_triangle(p, &mesh.triangle_positions(t))))
                .fold(f32::INFINITY, f32::min);
            assert!((proximity.distance(p, 10.0) - all).abs() < 1e-5);
            assert_eq!(proximity.distance(p, 0.5 * all), 0.5 * all);
        }
    }
}
