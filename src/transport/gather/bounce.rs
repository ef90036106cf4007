//! Indirect light between patches: E = b + G E, where b is what the patches reflect to each other of the direct light, and
//! G gathers what they reflect of the indirect light (Goral et al., *Modeling the Interaction of Light Between Diffuse
//! Surfaces*, 1984; G sampled by rays instead of integrated). Solved by Jacobi iterations for all lights at once.
//!
//! A ray may meet near hits before it reads a patch, each of which is a bounce. Where bounces end before light has faded, what
//! rays tell is kept apart by their number: E_m = Σ_k (b_k + G_k E_(m−1−k)) is light that has bounced m times at most.

use rayon::prelude::*;

use super::direct::Direct;
use super::patches::Patches;
use super::rays::{ByNearHits, Found, MOST_NEAR_HITS, Rays};
use super::receivers::Receivers;
use super::rows::{BLOCK, Block, Line, Rows, Term, lines, narrow};
use super::samples::SampleTable;
use crate::light::LightSet;
use crate::math::sampler::mix64;
use crate::math::{LANES, Rgb};
use crate::memory::Spares;
use crate::progress::Progress;
use crate::scene::Lightmap;
use crate::transport::{BakeError, BakeSettings, Walk};

/// The light of patches after any number of bounces.
pub struct Bounced {
    /// A row per patch, columns as in [`Direct`]: irradiance, direct and indirect together. `light[k]` has bounced k times fewer:
    /// for rays that have met k near hits. One serves all where light has faded before its bounces end.
    pub light: Vec<Rows>,
    pub rays: u64,
}

/// What a patch receives.
struct Received {
    /// Of other patches: a row of the operator.
    patches: ByNearHits,
    /// The same as some of the rays tell it, for light that has bounced before.
    patches_later: ByNearHits,
    /// Of texels' direct light.
    texels: ByNearHits,
    /// What was path traced, `[near hits before]`, each `[channel][column]`.
    traced: [Option<Vec<f32>>; MOST_NEAR_HITS + 1],
}

/// Separates these samples from those of the final gather.
const PATCH_STREAM: u64 = 0x0070_6174_6368;

/// Paths of a texel for each ray of a patch: what patches send each other meets in many texels. On the Cornell box the error
/// with 2 is that with 1; with 4 it is 1 % of itself higher.
const PATHS_PER_RAY: u32 = 2;

/// Rays of a patch for each that carries light which has bounced before: it is a smaller part of all, and smoother.
const RAYS_PER_LATER_RAY: usize = 4;

/// Light that has faded to this share of the first bounce's is not bounced on.
const FADED: f32 = 1e-3;

/// Where the last bounce brings less than this share of all bounced light, near hits are not counted among the bounces of a ray:
/// it would cost the Cornell box with 8 bounces a seventh of its time, and take a mean of 0.3 % off the light.
const WORTH_TELLING: f64 = 0.01;

/// With so many bounces the last is taken not to bring as much.
const MANY_BOUNCES: u32 = 32;

/// Patches whose rays a thread sends together.
const PATCHES_AT_A_TIME: usize = 16;

impl Bounced {
    pub fn new(
        walk: &Walk,
        lightmap: &Lightmap,
        set: &LightSet,
        patches: &Patches,
        direct: &Direct,
        settings: &BakeSettings,
        progress: &dyn Progress,
    ) -> Result<Self, BakeError> {
        progress.begin("bounce", patches.len() as u64, "patches");
        let samples = SampleTable::new(settings.seed ^ PATCH_STREAM, (settings.paths / PATHS_PER_RAY).max(1));
        // A path that has used its bounces up to here still takes the one to the texel.
        let walk = Walk { max_bounces: settings.max_bounces.saturating_sub(1), ..*walk };
        let starts: Vec<usize> = (0..patches.len()).step_by(PATCHES_AT_A_TIME).collect();
        let told = near_hits_told(settings.max_bounces);
        let rays = Spares::new(|| Rays::new(&walk, set, direct.light.columns(), told > 1));
        let received: Vec<(Vec<Received>, u64)> = starts
            .par_iter()
            .map(|&start| {
                if progress.cancelled() {
                    return (Vec::new(), 0);
                }
                let some = start..(start + PATCHES_AT_A_TIME).min(patches.len());
                progress.advance(some.len() as u64);
                rays.lend(|rays| {
                    let before = rays.sent();
                    (receive(&walk, lightmap, patches, &samples, settings, some, rays), rays.sent() - before)
                })
            })
            .collect();
        progress.end();
        if progress.cancelled() {
            return Err(BakeError::Cancelled);
        }
        let rays = received.iter().map(|(_, rays)| rays).sum();
        let mut received: Vec<Received> = received.into_iter().flat_map(|(received, _)| received).collect();
        // The last bounce is the final gather's.
        let most = settings.max_bounces.saturating_sub(1).max(1);
        let tells = told > 1 && share_of_last_bounce(&received, most) > WORTH_TELLING;
        if !tells {
            received.par_iter_mut().for_each(Received::forget_near_hits);
        }
        let (told, bounces) = if tells { (told, most) } else { (1, bounces_until_faded(&received, most)) };
        let mut light: Vec<Rows> = (0..told).map(|_| Rows::new(patches.len(), 3, direct.light.columns())).collect();
        let mut solver = Solver::new(&received, patches, bounces, told);
        let mut outs: Vec<Vec<&mut [Line]>> = light.iter_mut().map(Rows::blocks_mut).collect();
        for (block, columns) in direct.light.blocks().enumerate() {
            if progress.cancelled() {
                return Err(BakeError::Cancelled);
            }
            solver.solve(direct.light.block(&columns), columns.start);
            for (ago, out) in outs.iter_mut().enumerate() {
                solver.write(ago, out[block]);
            }
        }
        Ok(Self { light, rays })
    }
}

/// How many numbers of near hits are told apart, at most; 1 where none are.
pub fn near_hits_told(max_bounces: u32) -> usize {
    if max_bounces >= MANY_BOUNCES { 1 } else { MOST_NEAR_HITS + 1 }
}

/// Bytes of what `patches` patches receive where a texel has `paths` paths.
pub fn operator_bytes(patches: usize, paths: usize) -> usize {
    let rays = (paths / PATHS_PER_RAY as usize).max(1);
    // A ray of a patch ends in a patch, and may have read a texel before; some are noted twice.
    patches * (size_of::<Received>() + (2 * rays + later_rays(rays)) * size_of::<Term>())
}

/// Of `count` rays of a patch, how many carry light that has bounced before: whole lanes.
fn later_rays(count: usize) -> usize {
    (count / RAYS_PER_LATER_RAY).next_multiple_of(LANES).min(count)
}

/// Sends all rays of some patches, from points uniform by area.
fn receive<'a>(
    walk: &Walk<'_, 'a>,
    lightmap: &Lightmap,
    patches: &Patches,
    samples: &SampleTable,
    settings: &BakeSettings,
    some: std::ops::Range<usize>,
    rays: &mut Rays<'_, 'a>,
) -> Vec<Received> {
    let mesh = &walk.tracer.asset().mesh;
    let samples_of = |patch: usize| {
        let first = patches.texels(patch)[0].0;
        samples.of(settings.seed ^ mix64(PATCH_STREAM), lightmap.texels[first as usize].index as u64)
    };
    let count = samples.count();
    let later = later_rays(count);
    let mut receivers = Receivers::default();
    // Two accounts a patch: the rays that carry all light, and those that do not carry it later.
    rays.open(2 * some.len());
    for patch in some.clone() {
        receivers.clear();
        let mut start = 0.0;
        for &(texel, end) in patches.texels(patch) {
            receivers.add(mesh, &lightmap.sampler(mesh, texel as usize), start, end);
            start = end;
        }
        let account = |point: usize| 2 * (patch - some.start) + usize::from(point >= later);
        rays.send(walk, patches, &receivers, &samples_of(patch), count, account);
    }
    rays.finish(walk, patches, |account| samples_of(some.start + account / 2));
    let of_patch = |patch: usize| {
        let accounts = [2 * patch, 2 * patch + 1];
        let terms = |accounts: &[usize], of: fn(&Found) -> &ByNearHits, rays_sent: usize| -> ByNearHits {
            std::array::from_fn(|k| {
                let terms = accounts.iter().flat_map(|&account| &of(&rays.found[account])[k]);
                merged(terms.map(|t| Term { weight: t.weight / rays_sent as f32, ..*t }).collect())
            })
        };
        let traced = |near_hits: usize| {
            let of_accounts = accounts.iter().flat_map(|&account| rays.traced_for(account));
            let light = of_accounts.filter(|(k, _)| *k == near_hits).map(|(_, light)| light);
            light.map(|light| light.iter().map(|value| value / count as f32).collect()).reduce(sum)
        };
        Received {
            patches: terms(&accounts, |found| &found.patches, count),
            patches_later: terms(&accounts[..1], |found| &found.patches, later),
            texels: terms(&accounts, |found| &found.texels, count),
            traced: std::array::from_fn(traced),
        }
    };
    (0..some.len()).map(of_patch).collect()
}

impl Received {
    /// Lets all be of rays that met no near hit before.
    fn forget_near_hits(&mut self) {
        for terms in [&mut self.patches, &mut self.patches_later, &mut self.texels] {
            if terms[1..].iter().any(|of_more| !of_more.is_empty()) {
                terms[0] = merged(terms.iter_mut().flat_map(std::mem::take).collect());
            }
        }
        self.traced[0] = self.traced.iter_mut().filter_map(Option::take).reduce(sum);
    }
}

/// The sum of two rows of light.
fn sum(mut a: Vec<f32>, b: Vec<f32>) -> Vec<f32> {
    a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
    a
}

/// Terms of one row become one.
fn merged(mut terms: Vec<Term>) -> Vec<Term> {
    terms.sort_by_key(|t| t.row);
    terms.dedup_by(|next, kept| {
        let same = next.row == kept.row;
        if same {
            kept.weight += next.weight;
        }
        same
    });
    terms
}

/// What the last of `most` bounces brings of all bounced light, where all surfaces are lit alike. Like the next, a property of the
/// asset alone, so that every batch of lights is bounced in the same way.
fn share_of_last_bounce(operator: &[Received], most: u32) -> f64 {
    // Light that has bounced as often as that, [bounces less][patch].
    let mut light = vec![vec![Rgb::ONE; operator.len()]];
    let (mut last, mut all) = (0.0, 0.0);
    for bounce in 0..most as usize {
        let next: Vec<Rgb> = operator
            .par_iter()
            .map(|row| {
                let terms = light.iter().zip(&row.patches_later);
                let patches = terms.flat_map(|(light, terms)| terms.iter().map(|t| t.weight * light[t.row as usize]));
                patches.chain(row.texels.get(bounce).into_iter().flatten().map(|t| t.weight)).sum()
            })
            .collect();
        last = next.iter().map(|light| light.element_sum() as f64).sum();
        all += last;
        light.insert(0, next);
        light.truncate(MOST_NEAR_HITS + 1);
    }
    if all > 0.0 { last / all } else { 0.0 }
}

/// Bounces after which light that all patches send has faded, or `most`.
fn bounces_until_faded(operator: &[Received], most: u32) -> u32 {
    let mut light = vec![Rgb::ONE; operator.len()];
    for bounce in 1..most {
        let gather =
            |row: &Received| row.patches_later[0].iter().map(|t| t.weight * light[t.row as usize]).sum::<Rgb>();
        let next: Vec<Rgb> = operator.par_iter().map(gather).collect();
        light = next;
        if light.iter().all(|l| l.max_element() < FADED) {
            return bounce;
        }
    }
    most
}

/// Solves E = b + G E, a block of columns after the other. What is kept between them are buffers.
struct Solver<'s, 't, 'a> {
    received: &'s [Received],
    patches: &'s Patches<'t, 'a>,
    bounces: u32,
    /// The patches' own direct light, `[patch][plane][line]`.
    own: Vec<Line>,
    own_planes: usize,
    width: usize,
    /// b, `[patch][channel][column]`.
    once: Vec<f32>,
    /// E of the last bounces, `[bounces ago][patch][channel][line]`: of one more than near hits are told.
    light: Vec<Vec<Line>>,
}

impl<'s, 't, 'a> Solver<'s, 't, 'a> {
    fn new(received: &'s [Received], patches: &'s Patches<'t, 'a>, bounces: u32, near_hits_told: usize) -> Self {
        let light = vec![vec![]; near_hits_told + 1];
        Self { received, patches, bounces, own: vec![], own_planes: 1, width: 0, once: vec![], light }
    }

    /// Solves the block of columns that begins with `first`, all of whose arrays stay in the cache together.
    fn solve(&mut self, direct: Block, first: usize) {
        let (received, width) = (self.received, direct.width);
        let (row, size) = (3 * width, 3 * lines(width));
        self.own.resize(received.len() * direct.planes * lines(width), Line::default());
        self.once.resize(received.len() * row, 0.0);
        self.light.iter_mut().for_each(|light| light.resize(received.len() * size, Line::default()));
        (self.own_planes, self.width) = (direct.planes, width);
        patch_means(self.patches, direct, &mut self.own);
        let own = Block::new(&self.own, direct.planes, width);

        let told = self.light.len() - 1;
        for bounce in 0..self.bounces as usize {
            // A ray that has met k near hits reads what had bounced k times fewer. b, too, is whole after as many bounces.
            let (after, before) = self.light.split_at_mut(1);
            let before: Vec<Block> = before.iter().take(bounce).map(|light| Block::new(light, 3, width)).collect();
            let once = self.once.par_chunks_mut(row).zip(after[0].par_chunks_mut(size)).zip(received).enumerate();
            once.with_min_len(LEAST_PATCHES).for_each(|(patch, ((once, after), received))| {
                if bounce == 0 {
                    once.fill(0.0);
                }
                if bounce < told {
                    if let Some(traced) = &received.traced[bounce] {
                        for (sums, traced) in once.chunks_exact_mut(width).zip(traced.chunks_exact(traced.len() / 3)) {
                            sums.iter_mut().zip(&traced[first..]).for_each(|(sum, traced)| *sum += traced);
                        }
                    }
                    own.add(&received.patches[bounce], once);
                    direct.add(&received.texels[bounce], once);
                }
                let mut sums = [0f32; 3 * BLOCK];
                let sums = &mut sums[..row];
                sums.copy_from_slice(once);
                before.iter().zip(&received.patches_later).for_each(|(light, terms)| light.add(terms, sums));
                narrow(sums, patch, after);
            });
            self.light.rotate_right(1);
        }
    }

    /// Writes the patches' light, direct and indirect together, as it was `ago` bounces before the last: `[patch][channel][line]`.
    fn write(&self, ago: usize, out: &mut [Line]) {
        let own = Block::new(&self.own, self.own_planes, self.width);
        // The last is where the next bounce would go.
        let bounced = ago < self.bounces as usize;
        let indirect = Block::new(&self.light[ago + 1], 3, self.width);
        out.par_chunks_mut(3 * lines(self.width)).enumerate().with_min_len(LEAST_PATCHES).for_each(|(patch, out)| {
            let own = own.row(patch);
            for (i, (out, indirect)) in out.iter_mut().zip(indirect.row(patch)).enumerate() {
                let (own, indirect) = (own[i % own.len()].widened(), indirect.widened());
                let light = |k: usize| if bounced { own[k] + indirect[k] } else { own[k] };
                *out = Line::narrowed(&std::array::from_fn(light), patch);
            }
        });
    }
}

/// Patches worth handing to a thread.
const LEAST_PATCHES: usize = 16;

/// Area-weighted means over each patch's texels, `[patch][plane][line]`.
fn patch_means(patches: &Patches, texels: Block, means: &mut [Line]) {
    let size = texels.planes * lines(texels.width);
    means.par_chunks_mut(size).enumerate().with_min_len(LEAST_PATCHES).for_each(|(patch, out)| {
        for (i, out) in out.iter_mut().enumerate() {
            let mut start = 0.0;
            let mut sums = [0f32; 2 * LANES];
            for &(texel, end) in patches.texels(patch) {
                let light = texels.row(texel as usize)[i].widened();
                sums.iter_mut().zip(light).for_each(|(sum, light)| *sum += (end - start) * light);
                start = end;
            }
            *out = Line::narrowed(&sums, patch);
        }
    });
}
