//! Pictures on the CPU: the reference that the GPU's shading is held against.
//!
//! Each sample sends one ray; what it meets is lit directly by every light behind a shadow ray, and indirectly by the
//! reconstruction Σⱼ uⱼ Uⱼ (METHOD eq. 8). GPU twin: `shaders/shade.wgsl`.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;
use rayon::prelude::*;

use super::{Model, Picture, Shown, View, ViewError};
use crate::light::{Light, LightGather, LightTable};
use crate::math::Rgb;
use crate::scene::{Hit, Surface, Tracer, lanes};

impl Model {
    /// Relights the asset and takes its picture: measure, transfer, reconstruct, shade.
    ///
    /// # Errors
    /// A [`ViewError`] that says what is wrong with the view.
    pub fn render(&self, tracer: &Tracer, view: &View, lights: &[Light], shown: Shown) -> Result<Picture, ViewError> {
        let coefficients = self.transfer.coefficients(&self.points.direct(tracer, lights));
        self.render_with(tracer, view, lights, &coefficients, shown)
    }

    /// The same with given coefficients u, one RGB an element.
    pub fn render_with(
        &self,
        tracer: &Tracer,
        view: &View,
        lights: &[Light],
        coefficients: &[Rgb],
        shown: Shown,
    ) -> Result<Picture, ViewError> {
        let pinhole = view.pinhole()?;
        let table = LightTable::new(lights);
        let (width, grid) = (view.width as usize, view.samples_per_axis);
        let mut pixels = vec![Rgb::ZERO; width * view.height as usize];
        let rows = pixels.par_chunks_mut(width).enumerate();
        rows.for_each_init(
            || Shader {
                model: self,
                tracer,
                table: &table,
                gather: LightGather::new(&table, tracer),
                coefficients,
                shown,
            },
            |shader, (y, row)| {
                for (x, pixel) in row.iter_mut().enumerate() {
                    let (first_x, first_y) = (x as u32 * grid, y as u32 * grid);
                    let mut sum = Rgb::ZERO;
                    for sample in 0..grid * grid {
                        let direction = pinhole.direction(first_x + sample % grid, first_y + sample / grid);
                        if let Some(hit) = first_visible(tracer, pinhole.eye, direction) {
                            sum += shader.radiance(hit, -direction);
                        }
                    }
                    *pixel = sum / (grid * grid) as f32;
                }
            },
        );
        Ok(Picture { width: view.width, height: view.height, pixels })
    }
}

/// Lights what rays hit.
struct Shader<'t, 'a> {
    model: &'t Model,
    tracer: &'t Tracer<'a>,
    table: &'t LightTable,
    gather: LightGather<'t, 'a>,
    coefficients: &'t [Rgb],
    shown: Shown,
}

impl Shader<'_, '_> {
    /// Radiance that leaves `hit` along `to_view`.
    fn radiance(&mut self, hit: Hit, to_view: Vec3) -> Rgb {
        let surface = self.tracer.surface(&hit, -to_view);
        match self.shown {
            Shown::Full => self.direct(&surface, to_view) + self.irradiance(hit) * surface.bsdf.albedo() * FRAC_1_PI,
            Shown::Direct => self.direct(&surface, to_view),
            Shown::Indirect => self.irradiance(hit) * surface.bsdf.albedo() * FRAC_1_PI,
            Shown::IndirectOnWhite => self.irradiance(hit) * FRAC_1_PI,
        }
    }

    /// Indirect irradiance at `hit`.
    fn irradiance(&self, hit: Hit) -> Rgb {
        let mesh = &self.model.asset.mesh;
        let uv = mesh.interpolate(&mesh.lightmap_uvs, hit.triangle as usize, hit.u, hit.v);
        // A truncated basis may ring below zero; light does not.
        self.model.basis.sample(uv, self.coefficients).max(Vec3::ZERO)
    }

    /// What `surface` emits, and what the lights send to it, behind shadows, and it reflects along `to_view`.
    fn direct(&mut self, surface: &Surface, to_view: Vec3) -> Rgb {
        let mut sum = surface.emitted;
        self.gather.gather(surface, |arrived| {
            for lane in lanes(arrived.open) {
                let to_light = Vec3::from_array(arrived.direction.map(|axis| axis[lane]));
                let reflected = surface.bsdf.evaluate(surface.normal, to_view, to_light);
                sum += reflected * self.table.colour(arrived.light[lane] as usize) * arrived.irradiance[lane];
            }
        });
        sum
    }
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
