//! Pictures on the CPU: the reference that the GPU's shading is held against.
//!
//! Each sample sends one ray; what it meets is lit directly by every light behind a shadow ray, and indirectly by the
//! reconstruction Σⱼ uⱼ Uⱼ (METHOD eq. 8). GPU twin: `shaders/shade.wgsl`.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;
use rayon::prelude::*;

use super::{Model, Picture, Shown, View, ViewError};
use crate::light::{Light, LightTable};
use crate::math::{LANES, Rgb};
use crate::scene::tracer::lanes;
use crate::scene::{Hit, Surface, Tracer};

impl Model {
    /// Relights the asset and takes its picture: measure, transfer, reconstruct, shade.
    ///
    /// # Errors
    /// A [`ViewError`] that says what is wrong with the view.
    pub fn render(&self, tracer: &Tracer, view: &View, lights: &[Light], shown: Shown) -> Result<Picture, ViewError> {
        let table = LightTable::new(lights);
        let coefficients = self.transfer.coefficients(&self.points.direct(tracer, &table));
        self.render_with(tracer, view, &table, &coefficients, shown)
    }

    /// The same with given coefficients u, one RGB an element.
    pub fn render_with(
        &self,
        tracer: &Tracer,
        view: &View,
        lights: &LightTable,
        coefficients: &[Rgb],
        shown: Shown,
    ) -> Result<Picture, ViewError> {
        let pinhole = view.pinhole()?;
        let (width, grid) = (view.width as usize, view.samples_per_axis);
        let mut pixels = vec![Rgb::ZERO; width * view.height as usize];
        pixels.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (x, pixel) in row.iter_mut().enumerate() {
                let (first_x, first_y) = (x as u32 * grid, y as u32 * grid);
                let mut sum = Rgb::ZERO;
                for sample in 0..grid * grid {
                    let to_scene = pinhole.direction(first_x + sample % grid, first_y + sample / grid);
                    if let Some(hit) = first_visible(tracer, pinhole.eye, to_scene) {
                        sum += self.radiance(tracer, hit, -to_scene, lights, coefficients, shown);
                    }
                }
                *pixel = sum / (grid * grid) as f32;
            }
        });
        Ok(Picture { width: view.width, height: view.height, pixels })
    }

    /// Radiance that leaves `hit` along `to_view`.
    fn radiance(
        &self,
        tracer: &Tracer,
        hit: Hit,
        to_view: Vec3,
        lights: &LightTable,
        coefficients: &[Rgb],
        shown: Shown,
    ) -> Rgb {
        let asset = &self.asset;
        let (triangle, u, v) = (hit.triangle as usize, hit.u, hit.v);
        let surface = asset.surface(triangle, u, v, -to_view);
        let indirect_irradiance = || {
            let uv = asset.mesh.interpolate(&asset.mesh.lightmap_uvs, triangle, u, v);
            // A truncated basis may ring below zero; light does not.
            self.basis.sample(uv, coefficients).max(Vec3::ZERO)
        };
        let direct = || direct_radiance(tracer, &surface, to_view, lights) + surface.emitted;
        let indirect = || indirect_irradiance() * surface.bsdf.albedo() * FRAC_1_PI;
        match shown {
            Shown::Full => direct() + indirect(),
            Shown::Direct => direct(),
            Shown::Indirect => indirect(),
            Shown::IndirectOnWhite => indirect_irradiance() * FRAC_1_PI,
        }
    }
}

/// What the lights send to `surface`, behind shadows, and it reflects along `to_view`.
fn direct_radiance(tracer: &Tracer, surface: &Surface, to_view: Vec3, lights: &LightTable) -> Rgb {
    let origin = surface.position + surface.geometric_normal * tracer.offset;
    let rays = tracer.shadow_rays(origin);
    let mut sum = Rgb::ZERO;
    for block in 0..lights.block_count() {
        let arrival = lights.arrive(block, origin, surface.normal, tracer.extent);
        let reached = (0..LANES).fold(0, |mask, i| mask | ((arrival.irradiance[i] > 0.0) as u32) << i);
        if reached == 0 {
            continue;
        }
        for lane in lanes(rays.unoccluded(&arrival.segment, reached)) {
            let to_light = Vec3::from_array(arrival.direction.map(|axis| axis[lane]));
            let reflected = surface.bsdf.evaluate(surface.normal, to_view, to_light);
            sum += reflected * lights.colour(block * LANES + lane) * arrival.irradiance[lane];
        }
    }
    sum
}

/// The nearest surface that is drawn: back faces of one-sided materials are looked through.
fn first_visible(tracer: &Tracer, eye: Vec3, direction: Vec3) -> Option<Hit> {
    let asset = tracer.asset();
    let mut origin = eye;
    // Rounding may stop a ray from a very distant eye where it is: a ray meets no more faces than there are.
    for _ in 0..asset.mesh.triangles.len() {
        let hit = tracer.closest_hit(origin, direction, f32::INFINITY)?;
        let triangle = hit.triangle as usize;
        let back = asset.mesh.triangle_cross(triangle).dot(direction) > 0.0;
        if !back || asset.materials[asset.mesh.triangle_materials[triangle] as usize].double_sided {
            return Some(hit);
        }
        origin += direction * (hit.t + tracer.offset);
    }
    None
}
