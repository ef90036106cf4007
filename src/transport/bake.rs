//! The bake: indirect irradiance of every lightmap texel under every lighting condition (the matrix I; METHOD eq. 3).

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::conditions::LightSums;
use super::{Emitters, Walk};
use crate::light::{Light, LightTable, LightingCondition};
use crate::math::{Rgb, Sampler};
use crate::progress::Progress;
use crate::scene::{Asset, Lightmap, Surface, TexelSampler, Tracer};

/// How the bake samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BakeSettings {
    /// Paths per texel, shared by all conditions.
    pub paths: u32,
    /// Reflections after which a path ends whatever it carries.
    pub max_bounces: u32,
    pub seed: u64,
}

/// Irradiance of T texels under N conditions.
pub struct Baked {
    /// N.
    pub conditions: usize,
    /// `[texel][channel][condition]`: irradiance that arrives after at least one reflection, in the lights' unit (lux).
    pub indirect: Vec<f32>,
    /// Per condition, the relative RMSE that is the estimate's own noise, from the difference between the two halves of the
    /// paths (area weighted, over texels and channels).
    pub noise: Vec<f32>,
    /// Segments of paths and shadow rays.
    pub rays: u64,
}

#[derive(Debug, thiserror::Error)]
pub enum BakeError {
    #[error("stopped")]
    Cancelled,
}

/// Paths after which a stop is asked for: some milliseconds.
pub(super) const PATHS_BETWEEN_CHECKS: u32 = 64;

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
    let mixer = Mixer::new(conditions, &table);
    let emitters = if mixer.wants_emission() { Emitters::new(tracer.asset()) } else { None };
    let walk = Walk { tracer, emitters: emitters.as_ref(), max_bounces: settings.max_bounces };
    let n = conditions.len();
    let row = 3 * n;

    let mut indirect = vec![0f32; lightmap.texels.len() * row];
    progress.begin("bake", lightmap.texels.len() as u64, "texels");
    // Each chunk's share of the noise is kept apart and summed in order, so that rounding does not depend on the threads.
    let shares: Vec<(Noise, u64)> = indirect
        .par_chunks_mut((CHUNK * row).max(1))
        .enumerate()
        .map_init(
            || (LightSums::new(&table, tracer), vec![0f32; row]),
            |(sums, first_half), (chunk, rows)| {
                let mut noise = Noise::new(n);
                let rays_before = sums.rays();
                for (i, out) in rows.chunks_mut(row).enumerate() {
                    let texel = chunk * CHUNK + i;
                    let receivers = Receivers::new(tracer, lightmap, texel);
                    let index = lightmap.texels[texel].index as u64;
                    sums.clear();
                    for path in 0..settings.paths {
                        if path % PATHS_BETWEEN_CHECKS == 0 && progress.cancelled() {
                            return (noise, sums.rays() - rays_before);
                        }
                        let mut sampler = Sampler::new(settings.seed, index, path);
                        let [u0, u1, u2, u3] = sampler.next_4d();
                        walk.from_receiver(&receivers.at([u0, u1]), Vec2::new(u2, u3), &mut sampler, sums);
                        if path + 1 == settings.paths / 2 {
                            mixer.mix(sums.sums(), sums.emission, 1.0 / (path + 1) as f32, first_half);
                        }
                    }
                    mixer.mix(sums.sums(), sums.emission, 1.0 / settings.paths as f32, out);
                    noise.add(out, first_half, settings.paths, lightmap.texels[texel].area);
                    progress.advance(1);
                }
                (noise, sums.rays() - rays_before)
            },
        )
        .collect();
    progress.end();
    if progress.cancelled() {
        return Err(BakeError::Cancelled);
    }
    let mut noise = Noise::new(n);
    shares.iter().for_each(|(share, _)| noise.merge(share));
    let rays = shares.iter().map(|(_, rays)| rays).sum();
    Ok(Baked { conditions: n, indirect, noise: noise.relative_rmse(), rays })
}

/// Positions per texel at which its direct light is evaluated: enough to smooth a shadow's edge inside it.
const DIRECT_SAMPLES: u32 = 64;

/// Irradiance that arrives without reflection at every texel: `[texel][channel][condition]`, deterministic like [`bake`].
///
/// # Errors
/// [`BakeError::Cancelled`] when `progress` says so.
pub fn bake_direct(
    tracer: &Tracer,
    lightmap: &Lightmap,
    conditions: &[LightingCondition],
    seed: u64,
    progress: &dyn Progress,
) -> Result<Vec<f32>, BakeError> {
    let table = LightTable::from_conditions(conditions);
    let mixer = Mixer::new(conditions, &table);
    let emitters = if mixer.wants_emission() { Emitters::new(tracer.asset()) } else { None };
    let walk = Walk { tracer, emitters: emitters.as_ref(), max_bounces: 0 };
    let row = 3 * conditions.len();
    let mut direct = vec![0f32; lightmap.texels.len() * row];
    progress.begin("direct", lightmap.texels.len() as u64, "texels");
    direct.par_chunks_mut(row.max(1)).enumerate().for_each_init(
        || LightSums::new(&table, tracer),
        |sums, (texel, out)| {
            if progress.cancelled() {
                return;
            }
            let receivers = Receivers::new(tracer, lightmap, texel);
            sums.clear();
            for sample in 0..DIRECT_SAMPLES {
                let mut sampler = Sampler::new(seed, lightmap.texels[texel].index as u64, sample);
                let [u0, u1, u2, u3] = sampler.next_4d();
                let receiver = receivers.at([u0, u1]);
                sums.add_direct(&receiver);
                if emitters.is_some() {
                    walk.from_receiver(&receiver, Vec2::new(u2, u3), &mut sampler, sums);
                }
            }
            mixer.mix(sums.sums(), sums.direct_emission, 1.0 / DIRECT_SAMPLES as f32, out);
            progress.advance(1);
        },
    );
    progress.end();
    if progress.cancelled() { Err(BakeError::Cancelled) } else { Ok(direct) }
}

/// Surface points inside one texel.
struct Receivers<'a> {
    asset: &'a Asset,
    points: TexelSampler,
}

impl<'a> Receivers<'a> {
    fn new(tracer: &Tracer<'a>, lightmap: &Lightmap, texel: usize) -> Self {
        Self { asset: tracer.asset(), points: lightmap.sampler(&tracer.asset().mesh, texel) }
    }

    /// The front of the surface at a point uniform by area.
    fn at(&self, u: [f32; 2]) -> Surface {
        let point = self.points.sample(u);
        self.asset.surface(point.triangle as usize, point.u, point.v, Vec3::ZERO)
    }
}

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

    /// Whether any condition has the asset's own emission.
    fn wants_emission(&self) -> bool {
        self.emission.iter().any(|&scale| scale != 0.0)
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
