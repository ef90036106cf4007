//! Pictures on the CPU: the reference that the GPU's shading is held against.
//!
//! Each sample sends one ray; what it meets is lit directly by every light behind a shadow ray, and indirectly by the
//! reconstruction Σⱼ uⱼ Uⱼ (METHOD eq. 8). GPU twin: `shaders/shade.wgsl`.

use std::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::{Model, Picture, Shown, View, ViewError};
use crate::light::{EmissionFacets, Light, LightGather, LightTable};
use crate::math::Rgb;
use crate::scene::{Hit, Surface, Tracer, lanes};

impl Model {
    /// Relights the asset and takes its picture: measure, transfer, reconstruct, shade.
    ///
    /// # Errors
    /// A [`ViewError`] that says what is wrong with the view.
    pub fn render(&self, tracer: &Tracer, view: &View, lights: &[Light], shown: Shown) -> Result<Picture, ViewError> {
        let table = LightTable::new(lights, &EmissionFacets::of(tracer.asset()));
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
        let irradiance = self.basis.reconstruct(coefficients);
        render(tracer, view, lights, shown, &|uv| irradiance.sample(uv))
    }
}

/// Takes a picture whose indirect irradiance comes from `indirect_irradiance`, a function of the lightmap coordinates. Values
/// below zero, which a truncated basis may give, count as zero.
///
/// # Errors
/// A [`ViewError`] that says what is wrong with the view.
pub fn render(
    tracer: &Tracer,
    view: &View,
    lights: &LightTable,
    shown: Shown,
    indirect_irradiance: &(dyn Fn(Vec2) -> Rgb + Sync),
) -> Result<Picture, ViewError> {
    let pinhole = view.pinhole()?;
    let mesh = &tracer.asset().mesh;
    let (width, grid) = (view.width as usize, view.samples_per_axis);
    let radiance = |gather: &mut LightGather, hit: &Hit, to_view: Vec3| {
        let surface = tracer.surface(hit, -to_view);
        // The lightmap holds the light of the front: the back of a two-sided surface has none.
        let irradiance = || {
            if surface.back {
                return Rgb::ZERO;
            }
            let uv = mesh.interpolate(&mesh.lightmap_uvs, hit.triangle as usize, hit.u, hit.v);
            indirect_irradiance(uv).max(Vec3::ZERO)
        };
        let mut direct = || direct_radiance(gather, &surface, to_view, lights) + surface.emitted;
        let indirect = || irradiance() * surface.bsdf.albedo() * FRAC_1_PI;
        match shown {
            Shown::Full => direct() + indirect(),
            Shown::Direct => direct(),
            Shown::Indirect => indirect(),
            Shown::IndirectOnWhite => irradiance() * FRAC_1_PI,
        }
    };
    let mut pixels = vec![Rgb::ZERO; width * view.height as usize];
    pixels.par_chunks_mut(width).enumerate().for_each_init(
        || LightGather::new(lights, tracer),
        |gather, (y, row)| {
            for (x, pixel) in row.iter_mut().enumerate() {
                let (first_x, first_y) = (x as u32 * grid, y as u32 * grid);
                let mut sum = Rgb::ZERO;
                for sample in 0..grid * grid {
                    let to_scene = pinhole.direction(first_x + sample % grid, first_y + sample / grid);
                    if let Some(hit) = first_visible(tracer, pinhole.eye, to_scene) {
                        sum += radiance(gather, &hit, -to_scene);
                    }
                }
                *pixel = sum / (grid * grid) as f32;
            }
        },
    );
    Ok(Picture { width: view.width, height: view.height, pixels })
}

/// What the lights send to `surface`, behind shadows, and it reflects along `to_view`.
fn direct_radiance(gather: &mut LightGather, surface: &Surface, to_view: Vec3, lights: &LightTable) -> Rgb {
    let mut sum = Rgb::ZERO;
    gather.gather(surface, |a| {
        for i in lanes(a.open) {
            let to_light = Vec3::from_array(a.direction.map(|axis| axis[i]));
            let reflected = surface.bsdf.evaluate(surface.normal, to_view, to_light);
            sum += reflected * lights.colour(a.light[i] as usize) * a.irradiance[i];
        }
    });
    sum
}

/// The nearest surface that is drawn: back faces of one-sided materials are looked through.
pub fn first_visible(tracer: &Tracer, eye: Vec3, direction: Vec3) -> Option<Hit> {
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
