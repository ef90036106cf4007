//! What all lights of N conditions send to a receiver along shared paths.
//!
//! Lights are gathered one by one with unit colour; colours and the sum over a condition's lights come after the last path.
//!
//! Environments are found by sampling them and by paths that leave the scene, area lights by sampling them and, from glossy
//! surfaces, by paths that meet them: both ways are combined by the balance heuristic (Veach, *Robust Monte Carlo Methods for
//! Light Transport Simulation*, 1997). A diffuse surface samples area lights alone.

use std::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3};

use super::path::{Collector, GlossyRay, RECEIVER_LIGHTS, Walk};
use crate::light::{LightGather, LightSet, Sampled, SampledGather};
use crate::math::{Rgb, Sampler, warp};
use crate::scene::{Surface, Tracer, lanes};

/// Irradiance that each light, with unit colour, causes at a receiver through its paths: a [`Collector`].
pub struct LightSums<'t, 'a> {
    punctual: LightGather<'t, 'a>,
    sampled: Option<SampledGather<'t, 'a>>,
    /// What arrived without reflection.
    pub direct: Collected,
    /// What was reflected at least once.
    pub indirect: Collected,
    path_rays: u64,
}

/// Sums of light.
#[derive(Clone, Debug, PartialEq)]
pub struct Collected {
    /// Per number of the [`LightSet`], with unit colour.
    pub lights: Vec<Rgb>,
    /// Light of the asset's own emission, for `Light::Emissive` of unit scale.
    pub emission: Rgb,
}

impl Collected {
    /// No light.
    pub fn new(set: &LightSet) -> Self {
        Self { lights: vec![Rgb::ZERO; set.len()], emission: Rgb::ZERO }
    }

    fn clear(&mut self) {
        self.lights.fill(Rgb::ZERO);
        self.emission = Rgb::ZERO;
    }

    /// Values per condition, `[channel][condition]`, times `weight`.
    pub fn mix(&self, set: &LightSet, weight: f32, out: &mut [f32]) {
        let n = set.condition_count();
        for channel in 0..3 {
            for (c, scale) in set.emission().iter().enumerate() {
                out[channel * n + c] = scale * self.emission[channel] * weight;
            }
        }
        for (light, &sum) in self.lights.iter().enumerate() {
            let value = sum * set.colour(light) * weight;
            for channel in 0..3 {
                out[channel * n + set.condition(light)] += value[channel];
            }
        }
    }
}

/// How a surface shows light to what lies along the path before it.
#[derive(Clone, Copy)]
enum Response {
    /// A receiver: irradiance.
    Receiver,
    /// Reflection towards this unit vector, times a throughput.
    Reflection { to_previous: Vec3, throughput: Rgb },
}

impl<'t, 'a> LightSums<'t, 'a> {
    pub fn new(set: &'t LightSet, tracer: &'t Tracer<'a>) -> Self {
        Self {
            punctual: LightGather::new(&set.punctual, tracer),
            sampled: SampledGather::new(set, tracer),
            direct: Collected::new(set),
            indirect: Collected::new(set),
            path_rays: 0,
        }
    }

    /// Rays so far: segments of paths and shadow rays to the lights of the set. [`Self::clear`] does not reset it.
    pub fn rays(&self) -> u64 {
        self.path_rays + self.punctual.rays + self.sampled.as_ref().map_or(0, |s| s.rays)
    }

    pub fn clear(&mut self) {
        self.direct.clear();
        self.indirect.clear();
    }

    /// Adds one estimate of all the light that arrives at the receiver without reflection, of every kind of light and the
    /// asset's own emission where `walk` has it, to [`Self::direct`]. `u` is for a direction.
    pub fn add_direct(&mut self, walk: &Walk, receiver: &Surface, u: Vec2, sampler: &mut Sampler) {
        let lights = || sampler.aside(RECEIVER_LIGHTS);
        add_lights(&mut self.punctual, &mut self.sampled, receiver, Response::Receiver, lights, &mut self.direct);
        if walk.emitters.is_some() || self.sampled.as_ref().is_some_and(SampledGather::has_environments) {
            Walk { max_bounces: 0, ..*walk }.from_receiver(receiver, u, sampler, self);
        }
    }

    /// Adds what `surface` reflects of the lights towards `to_previous` to [`Self::direct`]: for a surface that a camera sees.
    pub fn add_seen(&mut self, surface: &Surface, to_previous: Vec3, sampler: &Sampler) {
        let lights = || sampler.aside(RECEIVER_LIGHTS);
        let response = Response::Reflection { to_previous, throughput: Rgb::ONE };
        add_lights(&mut self.punctual, &mut self.sampled, surface, response, lights, &mut self.direct);
    }
}

/// Next-event estimation: adds what `surface` shows of every light to `sums`.
#[inline]
fn add_lights(
    punctual: &mut LightGather,
    sampled: &mut Option<SampledGather>,
    surface: &Surface,
    response: Response,
    lights: impl FnOnce() -> Sampler,
    sums: &mut Collected,
) {
    let bsdf = surface.bsdf;
    let sums = &mut sums.lights;
    let (factor, glossy) = match response {
        Response::Receiver => (Rgb::ONE, None),
        Response::Reflection { to_previous, throughput } if bsdf.specular => (throughput, Some(to_previous)),
        Response::Reflection { throughput, .. } => (throughput * bsdf.diffuse * FRAC_1_PI, None),
    };
    if factor == Rgb::ZERO {
        return;
    }
    match glossy {
        Some(to_previous) => punctual.gather(surface, |a| {
            for i in lanes(a.open) {
                let to_light = Vec3::new(a.direction[0][i], a.direction[1][i], a.direction[2][i]);
                let f = bsdf.evaluate(surface.normal, to_previous, to_light);
                sums[a.light[i] as usize] += factor * f * a.irradiance[i];
            }
        }),
        None => punctual.gather(surface, |a| {
            for i in lanes(a.open) {
                sums[a.light[i] as usize] += factor * a.irradiance[i];
            }
        }),
    }
    let Some(sampled) = sampled else { return };
    sampled.gather(surface, &mut lights(), |s: Sampled| {
        let cos = s.direction.dot(surface.normal);
        let (f, pdf) = match glossy {
            Some(to_previous) => (
                bsdf.evaluate(surface.normal, to_previous, s.direction),
                bsdf.pdf(surface.normal, to_previous, s.direction),
            ),
            // Diffuse surfaces meet environments, but no area lights.
            None => (Rgb::ONE, if s.distant { warp::pdf_cosine_hemisphere(cos) } else { 0.0 }),
        };
        sums[s.light] += factor * f * s.radiance_over_pdf * (cos / (1.0 + pdf * s.inverse_pdf));
    });
}

impl Collector for LightSums<'_, '_> {
    #[inline]
    fn vertex(
        &mut self,
        surface: &Surface,
        to_previous: Vec3,
        throughput: Rgb,
        _bounces: u32,
        lights: impl FnOnce() -> Sampler,
    ) {
        self.path_rays += 1;
        let response = Response::Reflection { to_previous, throughput };
        add_lights(&mut self.punctual, &mut self.sampled, surface, response, lights, &mut self.indirect);
    }

    fn escaped(&mut self, direction: Vec3, throughput: Rgb, pdf: f32, bounces: u32) {
        self.path_rays += 1;
        let sums = if bounces == 0 { &mut self.direct } else { &mut self.indirect };
        if let Some(sampled) = &self.sampled {
            sampled.look(direction, |light, radiance, light_pdf| {
                sums.lights[light] += throughput * radiance * (pdf / (pdf + light_pdf));
            });
        }
    }

    fn glossy(&mut self, ray: &GlossyRay) {
        let sums = if ray.bounces == 0 { &mut self.direct } else { &mut self.indirect };
        if let Some(sampled) = &self.sampled {
            sampled.meet(ray.origin, ray.direction, ray.reach, |light, inverse_pdf| {
                let weighted = ray.pdf * inverse_pdf;
                sums.lights[light] += ray.throughput * (weighted / (1.0 + weighted));
            });
        }
    }

    fn emission(&mut self, irradiance: Rgb, bounces: u32) {
        let sums = if bounces == 0 { &mut self.direct } else { &mut self.indirect };
        sums.emission += irradiance;
    }
}
