//! Maps from the unit square to the domains that paths are drawn from, each beside its density.

use std::f32::consts::{FRAC_1_PI, PI, TAU};

use glam::{Vec2, Vec3};

/// Uniform on the unit disk, area preserving and continuous (Shirley and Chiu 1997).
pub fn sample_concentric_disk(u: Vec2) -> Vec2 {
    let p = u * 2.0 - 1.0;
    if p == Vec2::ZERO {
        return Vec2::ZERO;
    }
    let (radius, phi) =
        if p.x.abs() > p.y.abs() { (p.x, PI / 4.0 * (p.y / p.x)) } else { (p.y, PI / 2.0 - PI / 4.0 * (p.x / p.y)) };
    radius * Vec2::new(phi.cos(), phi.sin())
}

/// Direction about +z with density cos θ / π.
pub fn sample_cosine_hemisphere(u: Vec2) -> Vec3 {
    let d = sample_concentric_disk(u);
    d.extend((1.0 - d.length_squared()).max(0.0).sqrt())
}

/// Per steradian.
pub fn pdf_cosine_hemisphere(cos_theta: f32) -> f32 {
    cos_theta.max(0.0) * FRAC_1_PI
}

/// Direction with uniform density on the sphere.
pub fn sample_uniform_sphere(u: Vec2) -> Vec3 {
    let z = 1.0 - 2.0 * u.x;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let phi = TAU * u.y;
    Vec3::new(r * phi.cos(), r * phi.sin(), z)
}

/// Per steradian.
pub fn pdf_uniform_sphere() -> f32 {
    FRAC_1_PI / 4.0
}

/// Direction about +z with uniform density within the cone of half-angle acos(`cos_max`).
pub fn sample_uniform_cone(u: Vec2, cos_max: f32) -> Vec3 {
    let z = 1.0 - u.x * (1.0 - cos_max);
    let r = (1.0 - z * z).max(0.0).sqrt();
    let phi = TAU * u.y;
    Vec3::new(r * phi.cos(), r * phi.sin(), z)
}

/// Per steradian, inside the cone.
pub fn pdf_uniform_cone(cos_max: f32) -> f32 {
    1.0 / (TAU * (1.0 - cos_max))
}

/// Barycentric coordinates of the second and third vertex, uniform by area (Heitz 2019, low distortion).
pub fn sample_uniform_triangle(u: Vec2) -> Vec2 {
    if u.x < u.y {
        let b0 = u.x * 0.5;
        Vec2::new(b0, u.y - b0)
    } else {
        let b1 = u.y * 0.5;
        Vec2::new(u.x - b1, b1)
    }
}

/// Half vector about +z as seen from `view` (both local), with the density of [`pdf_ggx_visible_normal`]
/// (Dupuy and Benyoub, *Sampling Visible GGX Normals with Spherical Caps*, 2023).
pub fn sample_ggx_visible_normal(u: Vec2, view: Vec3, alpha: f32) -> Vec3 {
    let stretched = Vec3::new(view.x * alpha, view.y * alpha, view.z).normalize();
    let phi = TAU * u.x;
    let z = (1.0 - u.y) * (1.0 + stretched.z) - stretched.z;
    let r = (1.0 - z * z).clamp(0.0, 1.0).sqrt();
    let h = Vec3::new(r * phi.cos(), r * phi.sin(), z) + stretched;
    Vec3::new(h.x * alpha, h.y * alpha, h.z.max(0.0)).normalize()
}

/// Per steradian of half vectors: D(h) G₁(v) max(v·h, 0) / v_z.
pub fn pdf_ggx_visible_normal(view: Vec3, half: Vec3, alpha: f32) -> f32 {
    ggx_distribution(half.z, alpha) * smith_g1(view.z, alpha) * view.dot(half).max(0.0) / view.z.max(1e-6)
}

/// Trowbridge–Reitz microfacet density D(h), per steradian.
pub fn ggx_distribution(cos_half: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let d = cos_half * cos_half * (a2 - 1.0) + 1.0;
    a2 * FRAC_1_PI / (d * d).max(1e-20)
}

/// Smith's masking function for one direction.
pub fn smith_g1(cos: f32, alpha: f32) -> f32 {
    let cos = cos.max(1e-6);
    2.0 * cos / (cos + (alpha * alpha + (1.0 - alpha * alpha) * cos * cos).sqrt())
}
