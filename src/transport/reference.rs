//! Path-traced pictures: the truth that relit ones are compared with.

use glam::Vec2;
use rayon::prelude::*;

use super::bake::PATHS_BETWEEN_CHECKS;
use super::{BakeError, Collected, LightSums, Walk};
use crate::light::{Emitters, Light, LightSet};
use crate::math::{Rgb, Sampler};
use crate::model::render::first_visible;
use crate::model::{Picture, View, ViewError};
use crate::progress::Progress;
use crate::scene::Tracer;

/// How a picture is path traced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceSettings {
    /// Paths per pixel.
    pub samples: u32,
    pub max_bounces: u32,
    pub seed: u64,
}

/// A picture in its two parts.
pub struct Reference {
    /// What the camera sees of the lights' own light, and of emitting surfaces.
    pub direct: Picture,
    /// The light that was reflected before it reached what the camera sees.
    pub indirect: Picture,
}

#[derive(Debug, thiserror::Error)]
pub enum ReferenceError {
    #[error(transparent)]
    View(#[from] ViewError),
    #[error(transparent)]
    Stopped(#[from] BakeError),
}

impl Reference {
    /// Path traces `view` under `lights`, deterministic in the seed.
    ///
    /// # Errors
    /// When the view cannot be rendered, or `progress` cancels.
    pub fn trace(
        tracer: &Tracer,
        view: &View,
        lights: &[Light],
        settings: &ReferenceSettings,
        progress: &dyn Progress,
    ) -> Result<Self, ReferenceError> {
        let pinhole = view.pinhole()?;
        let set = LightSet::new(lights);
        let emission_scale = set.emission()[0];
        let emitters = if set.wants_emission() { Emitters::new(tracer.asset()) } else { None };
        let walk = Walk { tracer, emitters: emitters.as_ref(), max_bounces: settings.max_bounces };
        let width = view.width as usize;
        let mut pixels = vec![(Rgb::ZERO, Rgb::ZERO); width * view.height as usize];
        progress.begin("trace", view.height as u64, "rows");
        pixels.par_chunks_mut(width).enumerate().for_each_init(
            || LightSums::new(&set, tracer),
            |sums, (y, row)| {
                for (x, pixel) in row.iter_mut().enumerate() {
                    sums.clear();
                    let mut emitted = Rgb::ZERO;
                    for sample in 0..settings.samples {
                        if sample % PATHS_BETWEEN_CHECKS == 0 && progress.cancelled() {
                            return;
                        }
                        let mut sampler = Sampler::new(settings.seed, (y * width + x) as u64, sample);
                        let [u0, u1, ..] = sampler.next_4d();
                        let to_scene = pinhole.through(Vec2::new(x as f32 + u0, y as f32 + u1));
                        let Some(hit) = first_visible(tracer, pinhole.eye, to_scene) else { continue };
                        let surface = tracer.surface(&hit, to_scene);
                        emitted += surface.emitted;
                        sums.add_seen(&surface, -to_scene, &sampler);
                        walk.reflect_emission(&surface, -to_scene, Rgb::ONE, 0, &sampler, sums);
                        let sampled = surface.bsdf.sample(surface.normal, -to_scene, sampler.next_4d());
                        if let Some(sampled) = sampled
                            && sampled.direction.dot(surface.geometric_normal) > 0.0
                        {
                            let (towards, weight, pdf) = (sampled.direction, sampled.weight, sampled.pdf);
                            walk.continue_along(&surface, towards, weight, pdf, &mut sampler, sums);
                        }
                    }
                    let share = 1.0 / settings.samples as f32;
                    let sum = |part: &Collected| {
                        let lights: Rgb = part.lights.iter().enumerate().map(|(l, &sum)| sum * set.colour(l)).sum();
                        lights + part.emission * emission_scale
                    };
                    pixel.0 = (sum(&sums.direct) + emitted) * share;
                    pixel.1 = sum(&sums.indirect) * share;
                }
                progress.advance(1);
            },
        );
        progress.end();
        if progress.cancelled() {
            return Err(BakeError::Cancelled.into());
        }
        let picture = |part: fn(&(Rgb, Rgb)) -> Rgb| Picture {
            width: view.width,
            height: view.height,
            pixels: pixels.iter().map(part).collect(),
        };
        Ok(Self { direct: picture(|p| p.0), indirect: picture(|p| p.1) })
    }
}
