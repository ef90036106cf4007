//! The direct light of every light at every texel: the source of all that is gathered.

use glam::Vec2;
use rayon::prelude::*;

use super::rows::{Rows, padded};
use crate::light::LightSet;
use crate::math::Sampler;
use crate::memory::Spares;
use crate::progress::Progress;
use crate::scene::Lightmap;
use crate::transport::conditions::LightSums;
use crate::transport::{BakeError, BakeSettings, Walk};

/// Direct irradiance.
pub struct Direct {
    /// A row per texel, a column per light of the set with unit colour, then one for the asset's own emission if it has any.
    pub light: Rows,
    pub rays: u64,
}

/// Rays of the final gather for each sample of a texel's direct light: hits average over many texels. On the Cornell box the
/// error is 0.2 % of itself lower with 16, and 0.3 % higher with 64.
const PATHS_PER_SAMPLE: u32 = 32;

/// Separates these samples from those of the final gather.
const DIRECT_STREAM: u64 = 0x6469_7265_6374;

/// Texels handed to a thread at a time.
const TEXELS_AT_A_TIME: usize = 16;

impl Direct {
    pub fn new(
        walk: &Walk,
        lightmap: &Lightmap,
        set: &LightSet,
        settings: &BakeSettings,
        progress: &dyn Progress,
    ) -> Result<Self, BakeError> {
        let samples = (settings.paths / PATHS_PER_SAMPLE).max(1);
        let lights = set.len();
        let coloured = walk.emitters.is_some() || set.first_environment() < lights;
        // Where nothing emits, no column is spent on it.
        let columns = lights + usize::from(walk.emitters.is_some());
        let mut light = Rows::new(lightmap.texels.len(), if coloured { 3 } else { 1 }, padded(columns));
        progress.begin("direct", lightmap.texels.len() as u64, "texels");
        let parts = light.parts_mut(TEXELS_AT_A_TIME);
        let sums = Spares::new(|| LightSums::new(set, walk.tracer));
        let rays = parts.into_par_iter().map(|mut part| {
            sums.lend(|sums| {
                let before = sums.rays();
                let texels = part.first..(part.first + TEXELS_AT_A_TIME).min(lightmap.texels.len());
                for texel in texels {
                    if progress.cancelled() {
                        return 0;
                    }
                    let points = lightmap.sampler(&walk.tracer.asset().mesh, texel);
                    sums.clear();
                    for sample in 0..samples {
                        let stream = lightmap.texels[texel].index as u64;
                        let mut sampler = Sampler::new(settings.seed ^ DIRECT_STREAM, stream, sample);
                        let [u0, u1, u2, u3] = sampler.next_4d();
                        let receiver = walk.tracer.asset().front(points.sample([u0, u1]));
                        sums.add_direct(walk, &receiver, Vec2::new(u2, u3), &mut sampler);
                    }
                    let weight = 1.0 / samples as f32;
                    part.write(texel - part.first, |plane, column| match sums.direct.lights.get(column) {
                        Some(sum) => sum[plane] * weight,
                        None if column == lights => sums.direct.emission[plane] * weight,
                        None => 0.0,
                    });
                    progress.advance(1);
                }
                sums.rays() - before
            })
        });
        let rays = rays.sum();
        progress.end();
        if progress.cancelled() { Err(BakeError::Cancelled) } else { Ok(Self { light, rays }) }
    }
}
