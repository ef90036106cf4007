//! The gather integrator, for diffuse scenes: radiosity of all conditions at once, then a final gather.
//!
//! 1. *Direct* (`direct.rs`): the direct light of every light at every texel.
//! 2. *Bounce* (`bounce.rs`): indirect light between patches of texels, by Jacobi iterations.
//! 3. *Final gather* (here, its rays in `rays.rs`): rays from every texel, which read at their hits the whole light of the
//!    patch there. A hit so near that its patch would show reads the direct light of its texel instead, and the ray goes on
//!    (Reichert, *A Two-Pass Radiosity Method Driven by Lights and Viewer Position*, 1992), twice at most.
//!
//! Steps 2 and 3 cost little more than a ray and a row of vector operations for all conditions together. Lookups are
//! interpolated between texels and between patches; what is left is a bias that shrinks with the texels. What the lightmap
//! cannot tell, the back of a surface, is path traced.

mod bounce;
mod direct;
mod patches;
mod rays;
mod receivers;
mod rows;
mod samples;

use std::ops::Range;

use self::bounce::Bounced;
use self::direct::Direct;
use self::patches::Patches;
use self::rays::Rays;
use self::receivers::Receivers;
use self::rows::{BLOCK, Block};
use self::samples::SampleTable;
use super::bake::NoiseSums;
use super::conditions::Collected;
use super::{BakeError, BakeSettings, Walk};
use crate::light::LightSet;
use crate::math::Rgb;
use crate::progress::Progress;
use crate::scene::Lightmap;

/// Everything that the final gather of a texel reads.
pub struct Gather<'t, 'a> {
    lightmap: &'t Lightmap,
    patches: Patches<'t, 'a>,
    direct: Direct,
    bounced: Bounced,
    samples: SampleTable,
    seed: u64,
    /// Whether light i is all that condition i has.
    one_each: bool,
    /// Per light and channel.
    colours: [Vec<f32>; 3],
    /// Rays that went into it.
    pub rays: u64,
}

/// Gathers the light of some texels on one thread.
pub struct Gatherer<'w, 'a> {
    rays: Rays<'w, 'a>,
    set: &'w LightSet,
    receivers: Receivers,
    /// Where conditions have several lights, `[texel][half][channel][column]`: sums over half of the rays, and over all.
    sums: Vec<f32>,
}

/// Texels that are gathered together, at least and at most: their rays go on together, and read a block of columns after the
/// other.
const TEXELS: [usize; 2] = [64, 256];

/// The same for each block: where there are many, the rows of one are far when it is read again. On the Cornell box 1,024
/// conditions take 6 % less time in 256 texels than in 64, and 128 conditions 8 % more, since threads wait for each other longer.
const TEXELS_PER_BLOCK: usize = 16;

/// Rays that more than the least texels may send: what they find is read block after block.
const RAYS_TOGETHER: usize = 1 << 15;

impl<'t, 'a> Gather<'t, 'a> {
    /// Measures the direct light of `set` and bounces it between patches.
    ///
    /// # Errors
    /// [`BakeError::Cancelled`] when `progress` says so.
    pub fn new(
        walk: &Walk<'_, 'a>,
        lightmap: &'t Lightmap,
        set: &LightSet,
        settings: &BakeSettings,
        progress: &dyn Progress,
    ) -> Result<Self, BakeError> {
        let patches = Patches::new(walk.tracer.asset(), lightmap);
        let direct = Direct::new(walk, lightmap, set, settings, progress)?;
        let bounced = Bounced::new(walk, lightmap, set, &patches, &direct, settings, progress)?;
        let samples = SampleTable::new(settings.seed, settings.paths);
        let rays = direct.rays + bounced.rays;
        let lights = 0..set.len();
        let one_each = walk.emitters.is_none()
            && set.len() == set.condition_count()
            && lights.clone().all(|light| set.condition(light) == light);
        let colours = [0, 1, 2].map(|channel| lights.clone().map(|light| set.colour(light)[channel]).collect());
        Ok(Self { lightmap, patches, direct, bounced, samples, seed: settings.seed, one_each, colours, rays })
    }

    /// Bytes held for each light while a lightmap of `texels` texels is gathered on `threads` threads.
    pub fn bytes_per_light(texels: usize, max_bounces: u32, threads: usize) -> usize {
        // A bfloat16 a texel, three where the light is coloured; per patch three of all its light, for each number of near hits
        // that is told, and while the block of the light is bounced the direct light, three channels of what has bounced once,
        // and the rows of the iteration.
        let told = bounce::near_hits_told(max_bounces);
        let light = 3 * 2 * texels + (told * 3 * 2 + 3 * 2 + 3 * 4 + (told + 1) * 3 * 2) * Patches::most(texels);
        // The sums of some texels.
        light + threads * TEXELS[1] * 2 * 3 * size_of::<f32>()
    }

    /// Bytes held however many lights there are: sample tables, the patches' operator, where texels and patches lie.
    pub fn bytes_fixed(texels: usize, paths: usize) -> usize {
        2 * SampleTable::bytes(paths) + bounce::operator_bytes(Patches::most(texels), paths) + 32 * texels
    }

    /// How many texels to gather together.
    pub fn texels_together(&self) -> usize {
        let [least, most] = TEXELS;
        let most = (RAYS_TOGETHER / self.samples.count().max(1)).clamp(least, most);
        (TEXELS_PER_BLOCK * self.direct.light.blocks().count()).clamp(least, most)
    }

    pub fn gatherer<'w>(&self, walk: &Walk<'w, 'a>, set: &'w LightSet) -> Gatherer<'w, 'a> {
        Gatherer {
            rays: Rays::new(walk, set, self.direct.light.columns(), self.bounced.light.len() > 1),
            set,
            receivers: Receivers::default(),
            sums: Vec::new(),
        }
    }

    /// Gathers the light of some texels into `out`, `[texel][channel][condition]`, and adds their noise to `noise`. Returns early
    /// where `progress` says so.
    pub fn texels(
        &self,
        walk: &Walk<'_, 'a>,
        texels: Range<usize>,
        gatherer: &mut Gatherer<'_, 'a>,
        out: &mut [f32],
        noise: &mut NoiseSums,
        progress: &dyn Progress,
    ) {
        let Gatherer { rays, receivers, .. } = gatherer;
        let mesh = &walk.tracer.asset().mesh;
        let samples_of = |texel: usize| self.samples.of(self.seed, self.lightmap.texels[texel].index as u64);
        let half = self.samples.count() / 2;
        rays.open(2 * texels.len());
        for texel in texels.clone() {
            if progress.cancelled() {
                return;
            }
            receivers.clear();
            receivers.add(mesh, &self.lightmap.sampler(mesh, texel), 0.0, 1.0);
            let account = |point: usize| 2 * (texel - texels.start) + usize::from(point >= half);
            rays.send(walk, &self.patches, receivers, &samples_of(texel), self.samples.count(), account);
        }
        rays.finish(walk, &self.patches, |account| samples_of(texels.start + account / 2));
        if self.one_each {
            self.read(gatherer, &texels, |texel, columns, [first_half, all]| {
                self.mix(texel, columns, first_half, all, &mut out[(texel - texels.start) * noise.row()..], noise);
            });
        } else {
            self.mix_several(gatherer, &texels, out, noise);
        }
    }

    /// Adds up what the rays of `texels` found: hands each texel and block of columns to `visit` with the sums over the first half
    /// of the rays and over all, `[channel][column of the block]`.
    fn read(
        &self,
        gatherer: &Gatherer,
        texels: &Range<usize>,
        mut visit: impl FnMut(usize, &Range<usize>, [&[f32]; 2]),
    ) {
        for columns in self.direct.light.blocks() {
            let direct = self.direct.light.block(&columns);
            let patches: Vec<Block> = self.bounced.light.iter().map(|light| light.block(&columns)).collect();
            let width = columns.len();
            for texel in texels.clone() {
                let (mut all, mut first_half) = ([0f32; 3 * BLOCK], [0f32; 3 * BLOCK]);
                let all = &mut all[..3 * width];
                for half in 0..2 {
                    let account = 2 * (texel - texels.start) + half;
                    let found = &gatherer.rays.found[account];
                    patches.iter().zip(&found.patches).for_each(|(patches, terms)| patches.add(terms, all));
                    found.texels.iter().for_each(|terms| direct.add(terms, all));
                    for (_, traced) in gatherer.rays.traced_for(account) {
                        for (sums, traced) in all.chunks_exact_mut(width).zip(traced.chunks_exact(traced.len() / 3)) {
                            sums.iter_mut().zip(&traced[columns.start..]).for_each(|(sum, traced)| *sum += traced);
                        }
                    }
                    if half == 0 {
                        first_half[..3 * width].copy_from_slice(all);
                    }
                }
                visit(texel, &columns, [&first_half[..3 * width], all]);
            }
        }
    }

    /// Means over rays of lights that are conditions, and their noise.
    fn mix(
        &self,
        texel: usize,
        columns: &Range<usize>,
        first_half: &[f32],
        all: &[f32],
        out: &mut [f32],
        noise: &mut NoiseSums,
    ) {
        let n = noise.squared_noise.len();
        let conditions = columns.start..columns.end.min(n);
        let paths = self.samples.count();
        let (of_half, of_all) = (1.0 / (paths / 2).max(1) as f32, 1.0 / paths.max(1) as f32);
        let mut half_mean = [0f32; BLOCK];
        let width = columns.len();
        for channel in 0..3 {
            let colours = &self.colours[channel][conditions.clone()];
            let out = &mut out[channel * n..][conditions.clone()];
            let sums = first_half[channel * width..].iter().zip(&all[channel * width..]);
            for (((out, half_mean), colour), (first_half, all)) in
                out.iter_mut().zip(&mut half_mean).zip(colours).zip(sums)
            {
                *half_mean = first_half * (colour * of_half);
                *out = all * (colour * of_all);
            }
            noise.add(conditions.clone(), out, &half_mean[..conditions.len()], self.lightmap.texels[texel].area);
        }
    }

    /// The same where lights are not conditions.
    fn mix_several(&self, gatherer: &mut Gatherer, texels: &Range<usize>, out: &mut [f32], noise: &mut NoiseSums) {
        let (row, columns) = (noise.row(), self.direct.light.columns());
        let mut sums = std::mem::take(&mut gatherer.sums);
        sums.resize(texels.len() * 6 * columns, 0.0);
        self.read(gatherer, texels, |texel, block, halves| {
            let sums = &mut sums[(texel - texels.start) * 6 * columns..][..6 * columns];
            for (sums, of_block) in sums.chunks_exact_mut(3 * columns).zip(halves) {
                for (sums, of_block) in sums.chunks_exact_mut(columns).zip(of_block.chunks_exact(block.len())) {
                    sums[block.clone()].copy_from_slice(of_block);
                }
            }
        });
        let paths = self.samples.count();
        let (mut first_half, mut collected) = (vec![0f32; row], Collected::new(gatherer.set));
        for ((texel, sums), out) in texels.clone().zip(sums.chunks_exact(6 * columns)).zip(out.chunks_exact_mut(row)) {
            let halves = [(paths / 2, &mut first_half[..]), (paths, &mut *out)];
            for (sums, (rays, out)) in sums.chunks_exact(3 * columns).zip(halves) {
                let light = |column: usize| Rgb::from_array([0, 1, 2].map(|channel| sums[channel * columns + column]));
                collected.lights.iter_mut().enumerate().for_each(|(column, sum)| *sum = light(column));
                collected.emission =
                    if columns > collected.lights.len() { light(collected.lights.len()) } else { Rgb::ZERO };
                collected.mix(gatherer.set, 1.0 / rays.max(1) as f32, out);
            }
            let area = self.lightmap.texels[texel].area;
            for channel in 0..3 {
                let of_channel = channel * row / 3..(channel + 1) * row / 3;
                noise.add(0..row / 3, &out[of_channel.clone()], &first_half[of_channel], area);
            }
        }
        gatherer.sums = sums;
    }
}

impl Gatherer<'_, '_> {
    /// Rays so far.
    pub fn rays(&self) -> u64 {
        self.rays.sent()
    }
}
