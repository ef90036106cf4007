//! The asset's emissive triangles as one light, sampled in proportion to emitted power; and the fixed points that stand for
//! it where light is measured.

use glam::{Vec2, Vec3};

use crate::math::{Rgb, colour, warp};
use crate::scene::{Asset, Hit, Surface, Tracer};

/// Emissive triangles with the cumulative distribution of their power.
pub struct Emitters<'a> {
    asset: &'a Asset,
    triangles: Vec<u32>,
    /// `cumulative[i]`: share of the power in triangles 0..=i.
    cumulative: Vec<f32>,
    /// Per triangle of the mesh, probability per square metre; zero where it does not emit.
    area_density: Vec<f32>,
}

/// A direction towards an emitter, drawn by [`Emitters::sample`], that nothing hides.
pub struct ToEmitter {
    pub direction: Vec3,
    /// Emitted radiance over the density per steradian.
    pub radiance_over_pdf: Rgb,
    /// Per steradian.
    pdf: f32,
}

impl ToEmitter {
    /// Balance heuristic against another way to draw the same direction with density `other` (Veach 1997).
    pub fn weight_against(&self, other: f32) -> f32 {
        self.pdf / (self.pdf + other)
    }
}

impl<'a> Emitters<'a> {
    /// The emissive triangles of `asset`, or `None` when it has none.
    pub fn new(asset: &'a Asset) -> Option<Self> {
        let mesh = &asset.mesh;
        let mut triangles = Vec::new();
        let mut weights = Vec::new();
        for (triangle, &material) in mesh.triangle_materials.iter().enumerate() {
            let material = &asset.materials[material as usize];
            if material.emissive == Vec3::ZERO {
                continue;
            }
            // A textured emitter counts with its mean over seven points, and never with nothing, so that it can be drawn.
            let mean = SEVEN_POINTS.iter().map(|&[u, v]| asset.emitted(material, triangle, u, v)).sum::<Vec3>() / 7.0;
            let area = mesh.triangle_cross(triangle).length() * 0.5;
            if area > 0.0 {
                let floor = 0.01 * colour::luminance(material.emissive);
                triangles.push(triangle as u32);
                weights.push((colour::luminance(mean).max(floor), area));
            }
        }
        let total: f64 = weights.iter().map(|&(l, a)| l as f64 * a as f64).sum();
        if total <= 0.0 {
            return None;
        }
        let mut area_density = vec![0.0; mesh.triangles.len()];
        let mut sum = 0.0;
        let cumulative = triangles
            .iter()
            .zip(&weights)
            .map(|(&triangle, &(radiance, area))| {
                area_density[triangle as usize] = (radiance as f64 / total) as f32;
                sum += radiance as f64 * area as f64 / total;
                sum as f32
            })
            .collect();
        Some(Self { asset, triangles, cumulative, area_density })
    }

    /// The triangle at this share of the power, in [0, 1).
    fn at_share(&self, u: f32) -> usize {
        let last = self.triangles.len() - 1;
        self.triangles[self.cumulative.partition_point(|&c| c <= u).min(last)] as usize
    }

    /// Draws a direction from `from` towards an emitter; `None` where it faces away or something hides it.
    pub fn sample(&self, tracer: &Tracer, from: &Surface, u: [f32; 4]) -> Option<ToEmitter> {
        let triangle = self.at_share(u[0]);
        let b = warp::sample_uniform_triangle(Vec2::new(u[1], u[2]));
        let [p0, p1, p2] = self.asset.mesh.triangle_positions(triangle);
        let target = p0 * (1.0 - b.x - b.y) + p1 * b.x + p2 * b.y;
        let to_light = target - from.position;
        let (distance2, direction) = (to_light.length_squared(), to_light.normalize_or_zero());
        let material = &self.asset.materials[self.asset.mesh.triangle_materials[triangle] as usize];
        let cos_front = -direction.dot((p1 - p0).cross(p2 - p0).normalize());
        let cos_light = if material.double_sided { cos_front.abs() } else { cos_front };
        if cos_light <= 0.0 || direction.dot(from.geometric_normal) <= 0.0 || direction.dot(from.normal) <= 0.0 {
            return None;
        }
        let pdf = self.area_density[triangle] * distance2 / cos_light;
        let radiance = self.asset.emitted(material, triangle, b.x, b.y);
        let origin = tracer.leave(from, direction);
        let open = pdf.is_finite() && pdf > 0.0 && !tracer.occluded(origin, target - origin);
        open.then(|| ToEmitter { direction, radiance_over_pdf: radiance / pdf, pdf })
    }

    /// Radiance that a ray from `origin` along `direction`, drawn with density `pdf` per steradian, met at `hit`, weighted
    /// against next-event estimation, which could have found it, too (balance heuristic; Veach 1997).
    pub fn met(&self, hit: &Hit, surface: &Surface, origin: Vec3, direction: Vec3, pdf: f32) -> Rgb {
        surface.emitted * (pdf / (pdf + self.pdf(hit, surface, origin, direction)))
    }

    /// Density per steradian with which [`Self::sample`] from `origin` draws the direction of travel that led to `hit`.
    pub fn pdf(&self, hit: &Hit, surface: &Surface, origin: Vec3, direction: Vec3) -> f32 {
        let cos_light = -direction.dot(surface.geometric_normal);
        let distance2 = surface.position.distance_squared(origin);
        self.area_density[hit.triangle as usize] * distance2 / cos_light.max(1e-6)
    }
}

/// Points that stand for an asset's emission where light is measured.
const FACETS: usize = 64;

/// A point of an emissive surface that stands for a part of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EmissionFacet {
    pub position: Vec3,
    /// Unit normal of the side that shines.
    pub normal: Vec3,
    /// Candela along the normal.
    pub intensity: Rgb,
}

/// What stands for an asset's own emission where light is measured, at unit scale.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EmissionFacets(pub Vec<EmissionFacet>);

impl EmissionFacets {
    /// Points that are evenly spread over the emitted power; none where nothing emits.
    pub fn of(asset: &Asset) -> Self {
        let Some(emitters) = Emitters::new(asset) else { return Self::default() };
        let mut facets = Vec::with_capacity(FACETS);
        for k in 0..FACETS {
            let triangle = emitters.at_share((k as f32 + 0.5) / FACETS as f32);
            // Points of the R2 sequence (Roberts 2018), the most even that grows one by one.
            let u = Vec2::new(0.5 + 0.754_877_7 * k as f32, 0.5 + 0.569_840_3 * k as f32).fract();
            let b = warp::sample_uniform_triangle(u);
            let [p0, p1, p2] = asset.mesh.triangle_positions(triangle);
            let material = &asset.materials[asset.mesh.triangle_materials[triangle] as usize];
            let area = 1.0 / (FACETS as f32 * emitters.area_density[triangle]);
            let facet = EmissionFacet {
                position: p0 * (1.0 - b.x - b.y) + p1 * b.x + p2 * b.y,
                normal: (p1 - p0).cross(p2 - p0).normalize(),
                intensity: asset.emitted(material, triangle, b.x, b.y) * area,
            };
            facets.push(facet);
            if material.double_sided {
                facets.push(EmissionFacet { normal: -facet.normal, ..facet });
            }
        }
        Self(facets)
    }
}

/// Degree-5 quadrature points of the triangle, without their weights (Dunavant 1985).
const SEVEN_POINTS: [[f32; 2]; 7] = [
    [1.0 / 3.0, 1.0 / 3.0],
    [0.470_142, 0.470_142],
    [0.470_142, 0.059_716],
    [0.059_716, 0.470_142],
    [0.101_287, 0.101_287],
    [0.101_287, 0.797_427],
    [0.797_427, 0.101_287],
];
