//! The bake: indirect irradiance of every lightmap texel under every lighting condition (the matrix I; METHOD eq. 3).

use std::ops::Range;
use std::sync::Mutex;

use glam::Vec2;
use rayon::prelude::*;

use super::Walk;
use super::conditions::LightSums;
use super::gather::Gather;
use crate::light::{Emitters, LightSet, LightingCondition};
use crate::math::{Rgb, Sampler};
use crate::memory::{Spares, zeros};
use crate::progress::Progress;
use crate::scene::{Asset, Lightmap, Reflectance, Tracer};

/// How the bake samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BakeSettings {
    /// Paths per texel, shared by all conditions.
    pub paths: u32,
    /// Reflections after which a path ends whatever it carries.
    pub max_bounces: u32,
    pub seed: u64,
    pub integrator: Integrator,
}

/// How light is carried.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Integrator {
    /// `gather` where every material is diffuse, else `path`.
    #[default]
    Auto,
    /// Path tracing: unbiased, any material.
    Path,
    /// Radiosity between patches of texels, then a final gather: diffuse materials only, biased by the texels' size.
    Gather,
}

impl Integrator {
    /// [`Integrator::Path`] or [`Integrator::Gather`].
    ///
    /// # Errors
    /// [`BakeError::NotDiffuse`] when `Gather` is asked for and a material is not diffuse.
    pub fn for_asset(self, asset: &Asset) -> Result<Self, BakeError> {
        let glossy = asset.materials.iter().find(|m| m.reflectance != Reflectance::Lambert);
        match (self, glossy) {
            (Integrator::Path, _) | (Integrator::Auto, Some(_)) => Ok(Integrator::Path),
            (Integrator::Auto | Integrator::Gather, None) => Ok(Integrator::Gather),
            (Integrator::Gather, Some(material)) => Err(BakeError::NotDiffuse { material: material.name.clone() }),
        }
    }
}

impl BakeSettings {
    /// Bytes that a bake needs for each condition of a batch, from which the size of batches under a memory ceiling follows:
    /// what a [`Baker`] of a lightmap with `texels` texels holds, and what [`Baker::texels`] makes of `tile` of them.
    pub fn bytes_per_condition(&self, texels: usize, tile: usize, lights: usize, threads: usize) -> usize {
        let row = 3 * size_of::<f32>();
        // Light table, colours and their doubles; per thread the sums of each light and the first half's row.
        let lights_bytes = lights * (128 + threads * 4 * size_of::<Rgb>());
        let noise = (tile / CHUNK + 2 + threads) * 2 * size_of::<f64>();
        let gather = if self.integrator == Integrator::Path {
            0
        } else {
            lights * Gather::bytes_per_light(texels, self.max_bounces, threads)
        };
        tile * row + threads * row + lights_bytes + noise + gather
    }

    /// Bytes that a [`Baker`] holds however many conditions there are.
    pub fn bytes_fixed(&self, texels: usize) -> usize {
        if self.integrator == Integrator::Path { 0 } else { Gather::bytes_fixed(texels, self.paths as usize) }
    }
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

/// Irradiance of a range of texels under the conditions of a [`Baker`].
pub struct BakedTexels {
    /// `[texel][channel][condition]`, as [`Baked::indirect`].
    pub indirect: Vec<f32>,
    pub noise: NoiseSums,
    /// Segments of paths and shadow rays.
    pub rays: u64,
}

#[derive(Debug, thiserror::Error)]
pub enum BakeError {
    #[error("stopped")]
    Cancelled,
    #[error(
        "the gather integrator needs diffuse materials, and \"{material}\" is not; use the path integrator, or \
         materials = \"lambert\""
    )]
    NotDiffuse { material: String },
}

/// Paths after which a stop is asked for: some milliseconds.
pub(super) const PATHS_BETWEEN_CHECKS: u32 = 64;

/// Texels handed to a thread at a time.
const CHUNK: usize = 8;

/// Texels of the ranges that a whole lightmap is baked in: few enough that a thousand conditions of them fit in 50 MB, so
/// many that no thread waits for the last. Fixed, since the sums of the noise are made range by range.
pub const TILE: usize = 4096;

/// Bakes a lightmap range by range, all conditions at once: every path is traced once, and the direct light of all conditions
/// is gathered at each of its vertices.
///
/// What a texel receives under a condition depends on the seed alone: not on the other conditions, not on the ranges, not on
/// the number of threads.
pub struct Baker<'t, 'a> {
    tracer: &'t Tracer<'a>,
    lightmap: &'t Lightmap,
    settings: BakeSettings,
    set: LightSet,
    emitters: Option<Emitters<'a>>,
    /// Where that is the integrator.
    gather: Option<Gather<'t, 'a>>,
}

impl<'t, 'a> Baker<'t, 'a> {
    /// Prepares to bake `conditions`.
    ///
    /// # Errors
    /// [`BakeError::Cancelled`] when `progress` says so.
    pub fn new(
        tracer: &'t Tracer<'a>,
        lightmap: &'t Lightmap,
        conditions: &[LightingCondition],
        settings: &BakeSettings,
        progress: &dyn Progress,
    ) -> Result<Self, BakeError> {
        let set = LightSet::from_conditions(conditions);
        let emitters = if set.wants_emission() { Emitters::new(tracer.asset()) } else { None };
        let gather = match settings.integrator.for_asset(tracer.asset())? {
            Integrator::Gather => {
                let walk = Walk { tracer, emitters: emitters.as_ref(), max_bounces: settings.max_bounces };
                Some(Gather::new(&walk, lightmap, &set, settings, progress)?)
            }
            _ => None,
        };
        Ok(Self { tracer, lightmap, settings: *settings, set, emitters, gather })
    }

    /// Rays of the preparation.
    pub fn rays(&self) -> u64 {
        self.gather.as_ref().map_or(0, |gather| gather.rays)
    }

    /// N.
    pub fn conditions(&self) -> usize {
        self.set.condition_count()
    }

    /// Bakes a range of the lightmap's texels, each of which advances `progress` by one.
    ///
    /// # Errors
    /// [`BakeError::Cancelled`] when `progress` says so.
    pub fn texels(&self, range: Range<usize>, progress: &dyn Progress) -> Result<BakedTexels, BakeError> {
        let mut indirect = zeros(range.len() * 3 * self.conditions());
        let (noise, rays) = self.bake_into(&mut indirect, range, progress)?;
        Ok(BakedTexels { indirect, noise, rays })
    }

    /// Bakes a range into `out`; returns its noise and rays.
    fn bake_into(
        &self,
        out: &mut [f32],
        range: Range<usize>,
        progress: &dyn Progress,
    ) -> Result<(NoiseSums, u64), BakeError> {
        match &self.gather {
            Some(gather) => self.gathered(gather, out, range, progress),
            None => self.traced(out, range, progress),
        }
    }

    fn gathered(
        &self,
        gather: &Gather<'t, 'a>,
        out: &mut [f32],
        range: Range<usize>,
        progress: &dyn Progress,
    ) -> Result<(NoiseSums, u64), BakeError> {
        let walk = self.walk();
        let start = || gather.gatherer(&walk, &self.set);
        self.each_chunk(
            out,
            range,
            progress,
            start,
            |gatherer| gatherer.rays(),
            |gatherer, texels, out, noise| {
                gather.texels(&walk, texels, gatherer, out, noise, progress);
            },
        )
    }

    fn traced(
        &self,
        out: &mut [f32],
        range: Range<usize>,
        progress: &dyn Progress,
    ) -> Result<(NoiseSums, u64), BakeError> {
        let (walk, paths) = (self.walk(), self.settings.paths);
        let bake = |sums: &mut LightSums, texel: usize, [first_half, out]: [&mut [f32]; 2]| {
            let points = self.lightmap.sampler(&self.tracer.asset().mesh, texel);
            let index = self.lightmap.texels[texel].index as u64;
            sums.clear();
            for path in 0..paths {
                if path % PATHS_BETWEEN_CHECKS == 0 && progress.cancelled() {
                    return;
                }
                let mut sampler = Sampler::new(self.settings.seed, index, path);
                let [u0, u1, u2, u3] = sampler.next_4d();
                let receiver = self.tracer.asset().front(points.sample([u0, u1]));
                walk.from_receiver(&receiver, Vec2::new(u2, u3), &mut sampler, sums);
                if path + 1 == paths / 2 {
                    sums.indirect.mix(&self.set, 1.0 / (path + 1) as f32, first_half);
                }
            }
            sums.indirect.mix(&self.set, 1.0 / paths as f32, out);
        };
        let start = || (LightSums::new(&self.set, self.tracer), vec![0f32; 3 * self.conditions()]);
        self.each_chunk(
            out,
            range,
            progress,
            start,
            |(sums, _)| sums.rays(),
            |(sums, first_half), texels, rows, noise| {
                let n = self.conditions();
                for (texel, out) in texels.zip(rows.chunks_mut((3 * n).max(1))) {
                    bake(sums, texel, [first_half, out]);
                    for channel in 0..3 {
                        let values = channel * n..(channel + 1) * n;
                        noise.add(0..n, &out[values.clone()], &first_half[values], self.lightmap.texels[texel].area);
                    }
                }
            },
        )
    }

    fn walk(&self) -> Walk<'_, 'a> {
        Walk { tracer: self.tracer, emitters: self.emitters.as_ref(), max_bounces: self.settings.max_bounces }
    }

    /// Bakes a range, some texels at a time. `start` readies a thread, `rays` tells how many it has cast, and `bake` writes the
    /// rows of some texels and adds up their noise.
    fn each_chunk<S: Send>(
        &self,
        out: &mut [f32],
        range: Range<usize>,
        progress: &dyn Progress,
        start: impl Fn() -> S + Sync + Send,
        rays: impl Fn(&S) -> u64 + Sync + Send,
        bake: impl Fn(&mut S, Range<usize>, &mut [f32], &mut NoiseSums) + Sync + Send,
    ) -> Result<(NoiseSums, u64), BakeError> {
        let n = self.conditions();
        let row = 3 * n;
        let size = self.gather.as_ref().map_or(CHUNK, Gather::texels_together);
        let (so_far, states) = (NoiseSoFar::default(), Spares::new(start));
        // Each chunk's share of the noise is kept apart and summed in order, so that rounding does not depend on the threads.
        let shares: Vec<(NoiseSums, u64)> = out
            .par_chunks_mut((size * row).max(1))
            .enumerate()
            .map(|(chunk, rows)| {
                let mut noise = NoiseSums::new(n);
                let first = range.start + chunk * size;
                let texels = first..(first + size).min(range.end);
                let rays = states.lend(|state: &mut S| {
                    let rays_before = rays(state);
                    bake(state, texels.clone(), rows, &mut noise);
                    rays(state) - rays_before
                });
                progress.advance(texels.len() as u64);
                so_far.add(&noise, progress);
                (noise, rays)
            })
            .collect();
        if progress.cancelled() {
            return Err(BakeError::Cancelled);
        }
        let mut noise = NoiseSums::new(n);
        shares.iter().for_each(|(share, _)| noise.merge(share));
        Ok((noise, shares.iter().map(|(_, rays)| rays).sum()))
    }
}

/// Path traces all `conditions` over the whole lightmap into memory.
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
    let baker = Baker::new(tracer, lightmap, conditions, settings, progress)?;
    let texels = lightmap.texels.len();
    let row = 3 * conditions.len();
    let mut indirect = zeros(texels * row);
    let (mut noise, mut rays) = (NoiseSums::new(conditions.len()), baker.rays());
    progress.begin("bake", texels as u64, "texels");
    progress.made_of(settings.paths as u64, "paths");
    for start in (0..texels).step_by(TILE) {
        let range = start..(start + TILE).min(texels);
        let baked = baker.bake_into(&mut indirect[range.start * row..range.end * row], range, progress);
        if baked.is_err() {
            progress.end();
        }
        let (noise_here, rays_here) = baked?;
        noise.merge(&noise_here);
        rays += rays_here;
    }
    progress.end();
    Ok(Baked { conditions: conditions.len(), indirect, noise: noise.relative_rmse(), rays })
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
    let set = LightSet::from_conditions(conditions);
    let emitters = if set.wants_emission() { Emitters::new(tracer.asset()) } else { None };
    let walk = Walk { tracer, emitters: emitters.as_ref(), max_bounces: 0 };
    let row = 3 * conditions.len();
    let mut direct = zeros(lightmap.texels.len() * row);
    progress.begin("direct", lightmap.texels.len() as u64, "texels");
    direct.par_chunks_mut(row.max(1)).enumerate().for_each_init(
        || LightSums::new(&set, tracer),
        |sums, (texel, out)| {
            if progress.cancelled() {
                return;
            }
            let points = lightmap.sampler(&tracer.asset().mesh, texel);
            sums.clear();
            for sample in 0..DIRECT_SAMPLES {
                let mut sampler = Sampler::new(seed, lightmap.texels[texel].index as u64, sample);
                let [u0, u1, u2, u3] = sampler.next_4d();
                let receiver = tracer.asset().front(points.sample([u0, u1]));
                sums.add_direct(&walk, &receiver, Vec2::new(u2, u3), &mut sampler);
            }
            sums.direct.mix(&set, 1.0 / DIRECT_SAMPLES as f32, out);
            progress.advance(1);
        },
    );
    progress.end();
    if progress.cancelled() { Err(BakeError::Cancelled) } else { Ok(direct) }
}

/// The noise of the texels that are done, for the one who waits: of all conditions together, in the order in which threads end.
#[derive(Default)]
struct NoiseSoFar(Mutex<(f64, f64)>);

impl NoiseSoFar {
    fn add(&self, noise: &NoiseSums, progress: &dyn Progress) {
        let mut sums = self.0.lock().unwrap_or_else(|e| e.into_inner());
        sums.0 += noise.squared_noise.iter().sum::<f64>();
        sums.1 += noise.squared_signal.iter().sum::<f64>();
        if sums.1 > 0.0 {
            progress.noise((sums.0 / sums.1).sqrt());
        }
    }
}

/// Squared noise and squared signal per condition, area weighted, summed over texels and channels.
#[derive(Clone, Debug, PartialEq)]
pub struct NoiseSums {
    pub squared_noise: Vec<f64>,
    pub squared_signal: Vec<f64>,
}

impl NoiseSums {
    /// Of `n` conditions and no texel.
    pub fn new(n: usize) -> Self {
        Self { squared_noise: vec![0.0; n], squared_signal: vec![0.0; n] }
    }

    /// Adds one channel of a texel under the conditions `of`: from the mean over all paths and the mean over the first half, which is
    /// zero where there is but one path. With halves A and B the mean is (A + B)/2 and its variance estimate ((A − B)/2)², which is
    /// (A − mean)².
    pub(super) fn add(&mut self, of: Range<usize>, mean: &[f32], first_half: &[f32], area: f32) {
        let sums = self.squared_noise[of.clone()].iter_mut().zip(&mut self.squared_signal[of]);
        for ((noise, signal), (&mean, &half)) in sums.zip(mean.iter().zip(first_half)) {
            let (m, d) = (mean as f64, half as f64 - mean as f64);
            *noise += area as f64 * d * d;
            *signal += area as f64 * m * m;
        }
    }

    /// Values that a texel has under these conditions.
    pub(super) fn row(&self) -> usize {
        3 * self.squared_noise.len()
    }

    /// Adds the sums of other texels.
    pub fn merge(&mut self, other: &Self) {
        for c in 0..self.squared_noise.len() {
            self.squared_noise[c] += other.squared_noise[c];
            self.squared_signal[c] += other.squared_signal[c];
        }
    }

    /// Per condition, noise over signal; 0 where there is no signal.
    pub fn relative_rmse(&self) -> Vec<f32> {
        let ratio = |(&e, &s): (&f64, &f64)| if s > 0.0 { (e / s).sqrt() as f32 } else { 0.0 };
        self.squared_noise.iter().zip(&self.squared_signal).map(ratio).collect()
    }
}
