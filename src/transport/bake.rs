//! The bake: indirect irradiance of every lightmap texel under every lighting condition (the matrix I; METHOD eq. 3).

use rayon::prelude::*;

use super::conditions::LightSums;
use super::{Emitters, Walk};
use crate::light::{Light, LightTable, LightingCondition};
use crate::math::{Rgb, Sampler};
use crate::progress::Progress;
use crate::scene::{Lightmap, Tracer};

/// How the bake samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BakeSettings {
    /// Paths per texel, shared by all conditions.
    pub paths: u32,
    /// Reflections after which a path ends whatever it carries.
    pub max_bounces: u32,
    pub seed: u64,
    /// Whether the light that arrives without reflection is wanted, too.
    pub direct: bool,
}

/// Irradiance of T texels under N conditions.
pub struct Baked {
    /// N.
    pub conditions: usize,
    /// `[texel][channel][condition]`: irradiance that arrives after at least one reflection, in the lights' unit (lux).
    pub indirect: Vec<f32>,
    /// The same without reflection; empty unless asked for.
    pub direct: Vec<f32>,
    /// Per condition, the relative RMSE that is the estimate's own noise, from the difference between the two halves of the
    /// paths (area weighted, over texels and channels).
    pub noise: Vec<f32>,
}

#[derive(Debug, thiserror::Error)]
pub enum BakeError {
    #[error("stopped")]
    Cancelled,
}

/// Texels handed to a thread at a time.
const CHUNK: usize = 16;

/// Path traces all `conditions` at once: every path is traced once, and the direct light of all conditions is gathered at
/// each of its vertices.
///
/// The result depends on the seed alone, not on the number of threads.
///
/// # Errors
/// [`BakeError::Cancelled`] when `progress` says so.
pub fn bake(
    tracer: &Tracer,
    lightmap: &Lightmap,
    conditions: &[LightingCondition],
    settings: &BakeSettings,
    progress: &dyn Progress,
) -> Result<Baked, BakeError> {
    let table = LightTable::from_conditions(conditions);
    let wants_emission = conditions.iter().flat_map(|c| &c.lights).any(|l| matches!(l, Light::Emissive { .. }));
    let emitters = if wants_emission { Emitters::new(tracer.asset()) } else { None };
    let walk = Walk { tracer, emitters: emitters.as_ref(), max_bounces: settings.max_bounces };
    let n = conditions.len();
    let row = 3 * n;
    let mixer = Mixer::new(conditions, &table);

    let mut indirect = vec![0f32; lightmap.texels.len() * row];
    let mut direct = vec![0f32; if settings.direct { indirect.len() } else { 0 }];
    progress.begin("bake", lightmap.texels.len() as u64, "texels");
    let direct_chunks: Vec<&mut [f32]> = if settings.direct {
        direct.chunks_mut(CHUNK * row).collect()
    } else {
        (0..lightmap.texels.len().div_ceil(CHUNK)).map(|_| &mut [][..]).collect()
    };
    // Each chunk's share of the noise is kept apart and summed in order, so that rounding does not depend on the threads.
    let shares: Vec<Noise> = indirect
        .par_chunks_mut(CHUNK * row)
        .zip(direct_chunks)
        .enumerate()
        .map_init(
            || (LightSums::new(&table, tracer), vec![0f32; row]),
            |(sums, first_half), (chunk, (rows, direct_rows))| {
                let mut noise = Noise::new(n);
                for (i, out) in rows.chunks_mut(row).enumerate() {
                    if progress.cancelled() {
                        return noise;
                    }
                    let texel = chunk * CHUNK + i;
                    let points = lightmap.sampler(&tracer.asset().mesh, texel);
                    let index = lightmap.texels[texel].index as u64;
                    let surface_of = |u: [f32; 2]| {
                        let point = points.sample(u);
                        tracer.asset().surface(point.triangle as usize, point.u, point.v, glam::Vec3::ZERO)
                    };
                    sums.clear();
                    for path in 0..settings.paths {
                        let mut sampler = Sampler::new(settings.seed, index, path);
                        let [u0, u1, u2, u3] = sampler.next_4d();
                        walk.from_receiver(&surface_of([u0, u1]), glam::Vec2::new(u2, u3), &mut sampler, sums);
                        if path + 1 == settings.paths / 2 {
                            mixer.mix(sums.sums(), sums.emission, 1.0 / (path + 1) as f32, first_half);
                        }
                    }
                    mixer.mix(sums.sums(), sums.emission, 1.0 / settings.paths as f32, out);
                    noise.add(out, first_half, settings.paths, lightmap.texels[texel].area);
                    if settings.direct {
                        let emission = sums.direct_emission / settings.paths as f32;
                        sums.clear();
                        let samples = settings.paths.min(MAX_DIRECT_SAMPLES);
                        for sample in 0..samples {
                            let [u0, u1, ..] = Sampler::new(settings.seed, index, sample).next_4d();
                            sums.add_direct(&surface_of([u0, u1]), 1.0 / samples as f32);
                        }
                        mixer.mix(sums.sums(), emission, 1.0, &mut direct_rows[i * row..(i + 1) * row]);
                    }
                    progress.advance(1);
                }
                noise
            },
        )
        .collect();
    progress.end();
    if progress.cancelled() {
        return Err(BakeError::Cancelled);
    }
    let mut noise = Noise::new(n);
    shares.iter().for_each(|share| noise.merge(share));
    Ok(Baked { conditions: n, indirect, direct, noise: noise.relative_rmse() })
}

/// Direct light varies inside a texel only with its position; this many positions are plenty.
const MAX_DIRECT_SAMPLES: u32 = 64;

/// From sums per light of unit colour to values per condition.
struct Mixer<'t> {
    table: &'t LightTable,
    /// Per condition, the scale of the asset's own emission.
    emission: Vec<f32>,
    /// Indices of the lights that are gathered.
    punctual: Vec<usize>,
}

impl<'t> Mixer<'t> {
    fn new(conditions: &[LightingCondition], table: &'t LightTable) -> Self {
        let scale = |light: &Light| if let Light::Emissive { scale } = light { *scale } else { 0.0 };
        let emission = conditions.iter().map(|c| c.lights.iter().map(scale).sum()).collect();
        let lights = conditions.iter().flat_map(|c| &c.lights).enumerate();
        let punctual = lights.filter(|(_, l)| !matches!(l, Light::Emissive { .. })).map(|(i, _)| i).collect();
        Self { table, emission, punctual }
    }

    /// Writes `[channel][condition]`.
    fn mix(&self, sums: &[Rgb], emission: Rgb, weight: f32, out: &mut [f32]) {
        let n = self.emission.len();
        for channel in 0..3 {
            for c in 0..n {
                out[channel * n + c] = self.emission[c] * emission[channel] * weight;
            }
        }
        for &light in &self.punctual {
            let value = sums[light] * self.table.colour(light) * weight;
            for channel in 0..3 {
                out[channel * n + self.table.condition(light)] += value[channel];
            }
        }
    }
}

/// Squared noise and squared signal per condition, area weighted.
struct Noise {
    squared_noise: Vec<f64>,
    squared_signal: Vec<f64>,
}

impl Noise {
    fn new(n: usize) -> Self {
        Self { squared_noise: vec![0.0; n], squared_signal: vec![0.0; n] }
    }

    /// From the mean over all paths and the mean over the first half: with halves A and B the mean is (A + B)/2 and its
    /// variance estimate ((A − B)/2)², which is (A − mean)².
    fn add(&mut self, mean: &[f32], first_half: &[f32], paths: u32, area: f32) {
        let n = self.squared_noise.len();
        for channel in 0..3 {
            for c in 0..n {
                let m = mean[channel * n + c] as f64;
                let d = if paths < 2 { m } else { first_half[channel * n + c] as f64 - m };
                self.squared_noise[c] += area as f64 * d * d;
                self.squared_signal[c] += area as f64 * m * m;
            }
        }
    }

    fn merge(&mut self, other: &Self) {
        for c in 0..self.squared_noise.len() {
            self.squared_noise[c] += other.squared_noise[c];
            self.squared_signal[c] += other.squared_signal[c];
        }
    }

    fn relative_rmse(&self) -> Vec<f32> {
        let ratio = |(&e, &s): (&f64, &f64)| if s > 0.0 { (e / s).sqrt() as f32 } else { 0.0 };
        self.squared_noise.iter().zip(&self.squared_signal).map(ratio).collect()
    }
}
