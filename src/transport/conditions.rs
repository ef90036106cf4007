//! What all lights of N conditions send to a receiver along shared paths.
//!
//! Lights are gathered one by one with unit colour; colours and the sum over a condition's lights come after the last path.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;

use super::path::Collector;
use crate::light::{LightGather, LightTable};
use crate::math::{LANES, Rgb};
use crate::scene::{Surface, Tracer, lanes};

/// Irradiance that each light, with unit colour, causes at a receiver through its paths: a [`Collector`].
pub struct LightSums<'t, 'a> {
    gather: LightGather<'t, 'a>,
    /// Per light.
    sums: Vec<Rgb>,
    /// Light of the asset's own emission, for `Light::Emissive` of unit scale.
    pub emission: Rgb,
    /// The part of it that arrived without reflection.
    pub direct_emission: Rgb,
    path_rays: u64,
}

impl<'t, 'a> LightSums<'t, 'a> {
    pub fn new(table: &'t LightTable, tracer: &'t Tracer<'a>) -> Self {
        Self {
            gather: LightGather::new(table, tracer),
            sums: vec![Rgb::ZERO; table.block_count() * LANES],
            emission: Rgb::ZERO,
            direct_emission: Rgb::ZERO,
            path_rays: 0,
        }
    }

    pub fn sums(&self) -> &[Rgb] {
        &self.sums
    }

    /// Rays so far: segments of paths and shadow rays to the lights of the table. [`Self::clear`] does not reset it.
    pub fn rays(&self) -> u64 {
        self.path_rays + self.gather.rays
    }

    pub fn clear(&mut self) {
        self.sums.fill(Rgb::ZERO);
        (self.emission, self.direct_emission) = (Rgb::ZERO, Rgb::ZERO);
    }

    /// Adds the light that arrives at the receiver itself.
    pub fn add_direct(&mut self, receiver: &Surface) {
        let sums = &mut self.sums;
        self.gather.gather(receiver, |a| {
            for i in lanes(a.open) {
                sums[a.light[i] as usize] += a.irradiance[i];
            }
        });
    }

    /// Adds what `surface` reflects of the lights towards `to_previous`, times `throughput`.
    #[inline]
    pub fn reflect_lights(&mut self, surface: &Surface, to_previous: Vec3, throughput: Rgb) {
        let bsdf = surface.bsdf;
        let sums = &mut self.sums;
        if bsdf.specular {
            self.gather.gather(surface, |a| {
                for i in lanes(a.open) {
                    let to_light = Vec3::new(a.direction[0][i], a.direction[1][i], a.direction[2][i]);
                    let f = bsdf.evaluate(surface.normal, to_previous, to_light);
                    sums[a.light[i] as usize] += throughput * f * a.irradiance[i];
                }
            });
        } else {
            let factor = throughput * bsdf.diffuse * FRAC_1_PI;
            if factor == Rgb::ZERO {
                return;
            }
            self.gather.gather(surface, |a| {
                for i in lanes(a.open) {
                    sums[a.light[i] as usize] += factor * a.irradiance[i];
                }
            });
        }
    }
}

impl Collector for LightSums<'_, '_> {
    #[inline]
    fn vertex(&mut self, surface: &Surface, to_previous: Vec3, throughput: Rgb, _bounces: u32) {
        self.path_rays += 1;
        self.reflect_lights(surface, to_previous, throughput);
    }

    fn escaped(&mut self, _: Vec3, _: Rgb, _: u32) {
        self.path_rays += 1;
    }

    fn emission(&mut self, irradiance: Rgb, bounces: u32) {
        if bounces == 0 {
            self.direct_emission += irradiance;
        } else {
            self.emission += irradiance;
        }
    }
}
