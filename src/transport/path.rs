//! One path from a receiver into the scene (Kajiya, *The Rendering Equation*, 1986; Veach 1997).
//!
//! The walk itself knows no lighting condition: it tells a [`Collector`] where it met a surface or left the scene, and
//! with what throughput, so that the cost of the geometry is paid once for all that is collected.

use glam::{Vec2, Vec3};

use crate::light::Emitters;
use crate::math::{Frame, Rgb, Sampler, warp};
use crate::scene::{Surface, Tracer};

/// Receives what a path finds. Throughputs are those of the receiver's irradiance: π for the first direction, which is drawn
/// with density cos θ / π.
pub trait Collector {
    /// The path met `surface`, `bounces` reflections after leaving the receiver (0: the surface that the receiver sees).
    /// `to_previous` is the unit vector back along the path; `lights` draws samples of lights.
    fn vertex(
        &mut self,
        surface: &Surface,
        to_previous: Vec3,
        throughput: Rgb,
        bounces: u32,
        lights: impl FnOnce() -> Sampler,
    );

    /// The path left the scene along `direction`, drawn with density `pdf` per steradian.
    fn escaped(&mut self, _direction: Vec3, _throughput: Rgb, _pdf: f32, _bounces: u32) {}

    /// The path leaves a glossy surface: it goes `ray.reach` metres before it meets anything.
    fn glossy(&mut self, _ray: &GlossyRay) {}

    /// Light of the asset's own emissive surfaces arrived: `irradiance` at the receiver, after `bounces` reflections
    /// (0: direct light).
    fn emission(&mut self, _irradiance: Rgb, _bounces: u32) {}
}

/// A ray that left a glossy surface.
#[derive(Clone, Copy, Debug)]
pub struct GlossyRay {
    pub origin: Vec3,
    pub direction: Vec3,
    /// Metres, infinite for a ray that leaves the scene.
    pub reach: f32,
    pub throughput: Rgb,
    /// Per steradian.
    pub pdf: f32,
    /// Reflections up to its start.
    pub bounces: u32,
}

/// How paths are walked.
#[derive(Clone, Copy)]
pub struct Walk<'t, 'a> {
    pub tracer: &'t Tracer<'a>,
    /// The asset's emissive surfaces, if their light is asked for.
    pub emitters: Option<&'t Emitters<'a>>,
    /// Reflections after which a path ends whatever its throughput.
    pub max_bounces: u32,
}

/// Reflections that every path may take; later ones pass Russian roulette.
const ROULETTE_FREE_BOUNCES: u32 = 2;

/// What numbers are drawn for beside the path ([`Sampler::aside`]), at a receiver and at the surfaces that the path meets.
const RECEIVER_EMISSION: u32 = 0;
const SURFACE_EMISSION: u32 = 1;
pub(super) const RECEIVER_LIGHTS: u32 = 2;
const SURFACE_LIGHTS: u32 = 3;

impl Walk<'_, '_> {
    /// Follows the path that leaves the point `from` in a cosine-distributed direction made of `u`.
    pub fn from_receiver(&self, from: &Surface, u: Vec2, sampler: &mut Sampler, collector: &mut impl Collector) {
        let direction = Frame::from_normal(from.normal).world_from_local(warp::sample_cosine_hemisphere(u));
        let throughput = Vec3::splat(std::f32::consts::PI);
        if let Some(emitters) = self.emitters
            && let Some(to_light) = emitters.sample(self.tracer, from, sampler.aside(RECEIVER_EMISSION).next_4d())
        {
            let cos = to_light.direction.dot(from.normal).max(0.0);
            let weight = to_light.weight_against(warp::pdf_cosine_hemisphere(cos));
            collector.emission(to_light.radiance_over_pdf * cos * weight, 0);
        }
        // A shading normal opens its hemisphere below the surface, too; there is nothing to see there.
        if direction.dot(from.geometric_normal) <= 0.0 {
            return;
        }
        let pdf = warp::pdf_cosine_hemisphere(direction.dot(from.normal));
        // A receiver is white and diffuse, whatever its surface is.
        self.follow(from, (direction, throughput, pdf), false, sampler, collector);
    }

    /// Follows a path on from the surface `from` along `direction`, which its BSDF drew with density `pdf` per steradian.
    pub fn continue_along(
        &self,
        from: &Surface,
        direction: Vec3,
        throughput: Rgb,
        pdf: f32,
        sampler: &mut Sampler,
        collector: &mut impl Collector,
    ) {
        self.follow(from, (direction, throughput, pdf), from.bsdf.specular, sampler, collector);
    }

    fn follow(
        &self,
        from: &Surface,
        (mut direction, mut throughput, mut pdf): (Vec3, Rgb, f32),
        mut glossy: bool,
        sampler: &mut Sampler,
        collector: &mut impl Collector,
    ) {
        let mut origin = self.tracer.leave(from, direction);
        for bounces in 0.. {
            let hit = self.tracer.closest_hit(origin, direction, f32::INFINITY);
            if glossy {
                let reach = hit.map_or(f32::INFINITY, |hit| hit.t);
                collector.glossy(&GlossyRay { origin, direction, reach, throughput, pdf, bounces });
            }
            let Some(hit) = hit else {
                collector.escaped(direction, throughput, pdf, bounces);
                return;
            };
            let surface = self.tracer.surface(&hit, direction);
            if let Some(emitters) = self.emitters
                && surface.emitted != Vec3::ZERO
            {
                let radiance = emitters.met(&hit, &surface, origin, direction, pdf);
                collector.emission(throughput * radiance, bounces);
            }
            if bounces >= self.max_bounces {
                return;
            }
            self.light(&surface, -direction, throughput, bounces, sampler, collector);

            let u = sampler.next_4d();
            let Some(sampled) = surface.bsdf.sample(surface.normal, -direction, u) else { return };
            if sampled.direction.dot(surface.geometric_normal) <= 0.0 {
                return;
            }
            throughput *= sampled.weight;
            if bounces >= ROULETTE_FREE_BOUNCES {
                // Survive in proportion to what the path still carries, relative to the π that it started with.
                let survival = (throughput.max_element() / std::f32::consts::PI).min(1.0);
                if u[3] >= survival {
                    return;
                }
                throughput /= survival;
            }
            if throughput == Vec3::ZERO {
                return;
            }
            origin = self.tracer.leave(&surface, sampled.direction);
            (direction, pdf, glossy) = (sampled.direction, sampled.pdf, surface.bsdf.specular);
        }
    }

    /// Next-event estimation of all light at a vertex of a path, met `bounces` reflections after it left the receiver.
    pub fn light(
        &self,
        surface: &Surface,
        to_previous: Vec3,
        throughput: Rgb,
        bounces: u32,
        sampler: &Sampler,
        collector: &mut impl Collector,
    ) {
        collector.vertex(surface, to_previous, throughput, bounces, || sampler.aside(SURFACE_LIGHTS));
        self.reflect_emission(surface, to_previous, throughput, bounces + 1, sampler, collector);
    }

    /// Next-event estimation of the asset's emission: what a random emitter sends to `surface` and it reflects towards
    /// `to_previous`, times `throughput`, is told as light after `bounces` reflections.
    pub fn reflect_emission(
        &self,
        surface: &Surface,
        to_previous: Vec3,
        throughput: Rgb,
        bounces: u32,
        sampler: &Sampler,
        collector: &mut impl Collector,
    ) {
        if let Some(emitters) = self.emitters
            && let Some(to_light) = emitters.sample(self.tracer, surface, sampler.aside(SURFACE_EMISSION).next_4d())
        {
            let cos = to_light.direction.dot(surface.normal).max(0.0);
            let reflected = surface.bsdf.evaluate(surface.normal, to_previous, to_light.direction) * cos;
            let weight = to_light.weight_against(surface.bsdf.pdf(surface.normal, to_previous, to_light.direction));
            collector.emission(throughput * reflected * to_light.radiance_over_pdf * weight, bounces);
        }
    }
}
