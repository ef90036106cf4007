//! What a path meets at a surface point: normals, reflectance, emission.

use glam::{Vec2, Vec3, Vec4};

use super::{Asset, Material, Reflectance, TextureRef};
use crate::math::Rgb;

/// Where a ray meets the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in units of the ray's direction.
    pub t: f32,
    pub triangle: u32,
    /// Barycentric coordinates of the second and third vertex.
    pub u: f32,
    pub v: f32,
}

/// A point of the surface, as a triangle and barycentric coordinates of its second and third vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TexelPoint {
    pub triangle: u32,
    pub u: f32,
    pub v: f32,
}

/// Reflection parameters with textures applied; see [`Reflectance`] for the models.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bsdf {
    /// Lambertian reflectance: base colour, less its metallic part.
    pub diffuse: Rgb,
    /// Specular reflectance at normal incidence; zero for a Lambert surface.
    pub f0: Rgb,
    /// GGX roughness α = roughness², at least 0.001.
    pub alpha: f32,
    pub specular: bool,
}

impl Bsdf {
    /// Share of diffusely arriving light that leaves again, per channel: the albedo that measured and reconstructed light
    /// is multiplied with. Exact for Lambert surfaces; a metal counts with its specular colour.
    pub fn albedo(&self) -> Rgb {
        self.diffuse * (1.0 - self.f0) + self.f0
    }
}

/// The surface at a hit or at a chosen point. Both normals face the side that it was met from.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    pub position: Vec3,
    pub geometric_normal: Vec3,
    pub normal: Vec3,
    pub bsdf: Bsdf,
    /// Radiance emitted towards the side that it was met from; zero on the back of a one-sided material.
    pub emitted: Rgb,
    /// Whether it was met from the back.
    pub back: bool,
}

impl Surface {
    /// A black and dark front.
    #[inline(always)]
    pub fn front(position: Vec3, geometric_normal: Vec3, normal: Vec3) -> Self {
        let bsdf = Bsdf { diffuse: Rgb::ZERO, f0: Rgb::ZERO, alpha: 1.0, specular: false };
        Self { position, geometric_normal, normal, bsdf, emitted: Rgb::ZERO, back: false }
    }
}

impl Asset {
    /// The surface at barycentric (u, v) of `triangle`, met from `incoming` (the direction of travel); pass minus the
    /// triangle's normal, or zero, to meet the front.
    pub fn surface(&self, triangle: usize, u: f32, v: f32, incoming: Vec3) -> Surface {
        let front = self.front(TexelPoint { triangle: triangle as u32, u, v });
        let back = front.geometric_normal.dot(incoming) > 0.0;
        let side = if back { -1.0 } else { 1.0 };
        let material = &self.materials[self.mesh.triangle_materials[triangle] as usize];
        let base = self.base_colour(material, triangle, u, v);
        let bsdf = self.bsdf(material, base, triangle, u, v);
        // A two-sided emitter shines both ways (glTF 2.0, `doubleSided`).
        let dark = back && !material.double_sided;
        let emitted = if dark { Vec3::ZERO } else { self.emitted(material, triangle, u, v) };
        let (geometric_normal, normal) = (front.geometric_normal * side, front.normal * side);
        Surface { position: front.position, geometric_normal, normal, bsdf, emitted, back }
    }

    /// The front of the surface at a point that light only arrives at: black and dark, whatever its material.
    #[inline]
    pub fn front(&self, TexelPoint { triangle, u, v }: TexelPoint) -> Surface {
        let (mesh, triangle) = (&self.mesh, triangle as usize);
        let [a, b, c] = mesh.triangle_positions(triangle);
        let geometric_normal = (b - a).cross(c - a).normalize_or(Vec3::Y);
        let normal = mesh.interpolate(&mesh.normals, triangle, u, v).normalize_or(geometric_normal);
        // Shading normals that point below the surface are not usable as such.
        let normal = if normal.dot(geometric_normal) > 0.0 { normal } else { geometric_normal };
        Surface::front(a * (1.0 - u - v) + b * u + c * v, geometric_normal, normal)
    }

    /// Linear base colour and alpha with texture and vertex colour applied.
    pub fn base_colour(&self, material: &Material, triangle: usize, u: f32, v: f32) -> Vec4 {
        let mut base = material.base_colour;
        if let Some(texture) = &material.base_colour_texture {
            base *= self.sample(texture, triangle, u, v);
        }
        if !self.mesh.colours.is_empty() {
            base *= self.mesh.interpolate(&self.mesh.colours, triangle, u, v).extend(1.0);
        }
        base
    }

    /// Whether a triangle's material is cut out where alpha is low: foliage and fences part no rooms.
    #[cfg(feature = "train")]
    pub(super) fn may_be_cut_out(&self, triangle: usize) -> bool {
        self.materials[self.mesh.triangle_materials[triangle] as usize].alpha_cutoff.is_some()
    }

    /// Whether an alpha-masked triangle is absent at (u, v).
    pub fn is_cut_out(&self, triangle: usize, u: f32, v: f32) -> bool {
        let material = &self.materials[self.mesh.triangle_materials[triangle] as usize];
        material.alpha_cutoff.is_some_and(|cutoff| self.base_colour(material, triangle, u, v).w < cutoff)
    }

    /// Emitted radiance of the front with texture applied.
    pub fn emitted(&self, material: &Material, triangle: usize, u: f32, v: f32) -> Rgb {
        match &material.emissive_texture {
            Some(texture) if material.emissive != Vec3::ZERO => {
                material.emissive * self.sample(texture, triangle, u, v).truncate()
            }
            _ => material.emissive,
        }
    }

    fn bsdf(&self, material: &Material, base: Vec4, triangle: usize, u: f32, v: f32) -> Bsdf {
        let base = base.truncate().clamp(Vec3::ZERO, Vec3::ONE);
        if material.reflectance == Reflectance::Lambert {
            return Bsdf { diffuse: base, f0: Vec3::ZERO, alpha: 1.0, specular: false };
        }
        let (mut metallic, mut roughness) = (material.metallic, material.roughness);
        if let Some(texture) = &material.metallic_roughness_texture {
            let texel = self.sample(texture, triangle, u, v);
            metallic *= texel.z;
            roughness *= texel.y;
        }
        Bsdf {
            diffuse: base * (1.0 - metallic),
            // A dielectric of index 1.5 reflects 4 % (glTF 2.0, appendix B.2.4).
            f0: Vec3::splat(0.04).lerp(base, metallic),
            alpha: (roughness * roughness).max(1e-3),
            specular: true,
        }
    }

    fn sample(&self, reference: &TextureRef, triangle: usize, u: f32, v: f32) -> Vec4 {
        let uvs = &self.mesh.uvs[reference.uv_set as usize];
        let uv: Vec2 = if uvs.is_empty() { Vec2::ZERO } else { self.mesh.interpolate(uvs, triangle, u, v) };
        self.textures[reference.texture as usize].sample(reference.transform.transform_point2(uv))
    }
}
