//! Where the surface in a texel is, as one place.

use glam::{DVec2, Vec3};
use rayon::prelude::*;

use super::{Lightmap, Mesh};

/// Where a texel's surface is, and how it faces.
#[derive(Clone, Copy, Debug)]
pub struct Spot {
    pub centre: Vec3,
    /// Mean of the shading normals; zero where they cancel.
    pub normal: Vec3,
    /// m².
    pub area: f32,
}

impl Lightmap {
    /// The place of each texel. `mesh` is the one that the lightmap was built from.
    pub fn spots(&self, mesh: &Mesh) -> Vec<Spot> {
        (0..self.texels.len()).into_par_iter().map(|t| Spot::new(mesh, self, t)).collect()
    }
}

impl Spot {
    fn new(mesh: &Mesh, lightmap: &Lightmap, texel: usize) -> Self {
        let (mut centre, mut normal, mut area) = (Vec3::ZERO, Vec3::ZERO, 0.0);
        for fragment in lightmap.fragments(mesh, texel) {
            let polygon = fragment.polygon();
            let b = (polygon.iter().sum::<DVec2>() / polygon.len() as f64).as_vec2();
            let (triangle, weight) = (fragment.triangle as usize, fragment.area_m2 as f32);
            centre += mesh.interpolate(&mesh.positions, triangle, b.x, b.y) * weight;
            normal += mesh.interpolate(&mesh.normals, triangle, b.x, b.y) * weight;
            area += weight;
        }
        Self { centre: centre / area, normal: normal.normalize_or_zero(), area }
    }
}
