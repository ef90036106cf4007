//! Indirect light between patches: E = b + G E, where b is what the patches reflect to each other of the direct light, and
//! G gathers what they reflect of the indirect light (Goral et al., *Modeling the Interaction of Light Between Diffuse
//! Surfaces*, 1984; G sampled by rays instead of integrated). Solved by Jacobi iterations for all lights at once.

use rayon::prelude::*;

use super::direct::Direct;
use super::patches::Patches;
use super::rays::{Found, Rays};
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
    /// A row per patch, columns as in [`Direct`]: irradiance, direct and indirect together.
    pub light: Rows,
    pub rays: u64,
}

/// What a patch receives.
struct Received {
    /// Of other patches: a row of the operator.
    patches: Vec<Term>,
    /// The same as some of the rays tell it, for light that has bounced before.
    patches_later: Vec<Term>,
    /// Of texels' direct light.
    texels: Vec<Term>,
    /// What was path traced, `[channel][column]`.
    traced: Option<Vec<f32>>,
}

/// Separates these samples from those of the final gather.
const PATCH_STREAM: u64 = 0x0070_6174_6368;

/// Paths of a texel for each ray of a patch: what patches send each other meets in many texels. On the Cornell box the error
/// with 2 is that with 1; with 4 it is 1 % of itself higher.
pub const PATHS_PER_RAY: u32 = 2;

/// Rays of a patch for each that carries light which has bounced before: it is a smaller part of all, and smoother.
const RAYS_PER_LATER_RAY: usize = 4;

/// Light that has faded to this share of the first bounce's is not bounced on.
const FADED: f32 = 1e-3;

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
        let rays = Spares::new(|| Rays::new(&walk, set, direct.light.columns()));
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
        let received: Vec<Received> = received.into_iter().flat_map(|(received, _)| received).collect();
        // b itself has bounced once, and the last bounce is the final gather's.
        let bounces = bounces_until_faded(&received, settings.max_bounces.saturating_sub(2));
        let mut light = Rows::new(patches.len(), 3, direct.light.columns());
        let mut solver = Solver::new(&received, patches, bounces);
        for (columns, out) in direct.light.blocks().zip(light.blocks_mut()) {
            if progress.cancelled() {
                return Err(BakeError::Cancelled);
            }
            solver.solve(direct.light.block(&columns), columns.start, out);
        }
        Ok(Self { light, rays })
    }
}

/// Of `count` rays of a patch, how many carry light that has bounced before: whole lanes.
pub fn later_rays(count: usize) -> usize {
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
        let terms = |accounts: &[usize], of: fn(&Found) -> &[Term], rays_sent: usize| {
            let terms = accounts.iter().flat_map(|&account| of(&rays.found[account]));
            merged(terms.map(|t| Term { weight: t.weight / rays_sent as f32, ..*t }).collect())
        };
        let traced = accounts.iter().filter_map(|&account| rays.traced_for(account));
        Received {
            patches: terms(&accounts, |found| &found.patches, count),
            patches_later: terms(&accounts[..1], |found| &found.patches, later),
            texels: terms(&accounts, |found| &found.texels, count),
            traced: traced.map(|light| light.iter().map(|value| value / count as f32).collect()).reduce(sum),
        }
    };
    (0..some.len()).map(of_patch).collect()
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

/// Bounces after which light has faded, counted from the first: a property of the asset alone, so that every batch of lights
/// takes as many.
fn bounces_until_faded(operator: &[Received], most: u32) -> u32 {
    let mut light = vec![Rgb::ONE; operator.len()];
    for bounce in 0..most {
        let gather = |row: &Received| row.patches_later.iter().map(|t| t.weight * light[t.row as usize]).sum::<Rgb>();
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
    /// Iterations.
    bounces: u32,
    /// The patches' own direct light, `[patch][plane][line]`.
    own: Vec<Line>,
    /// b, `[patch][channel][column]`.
    once: Vec<f32>,
    /// E before and after an iteration, `[patch][channel][line]`.
    light: [Vec<Line>; 2],
}

impl<'s, 't, 'a> Solver<'s, 't, 'a> {
    fn new(received: &'s [Received], patches: &'s Patches<'t, 'a>, bounces: u32) -> Self {
        Self { received, patches, bounces, own: vec![], once: vec![], light: Default::default() }
    }

    /// Solves the block of columns that begins with `first`, all of whose arrays stay in the cache together, and writes the
    /// patches' light, direct and indirect together, to `out`, `[patch][channel][column]`.
    fn solve(&mut self, direct: Block, first: usize, out: &mut [Line]) {
        let (received, width) = (self.received, direct.width);
        let (row, size) = (3 * width, 3 * lines(width));
        self.own.resize(received.len() * direct.planes * lines(width), Line::default());
        self.once.resize(received.len() * row, 0.0);
        self.light.iter_mut().for_each(|light| light.resize(out.len(), Line::default()));
        patch_means(self.patches, direct, &mut self.own);
        let own = Block::new(&self.own, direct.planes, width);

        let [before, after] = &mut self.light;
        let once = self.once.par_chunks_mut(row).zip(before.par_chunks_mut(size)).zip(received).enumerate();
        once.with_min_len(LEAST_PATCHES).for_each(|(patch, ((once, light), received))| {
            once.fill(0.0);
            own.add(&received.patches, once);
            direct.add(&received.texels, once);
            if let Some(traced) = &received.traced {
                for (sums, traced) in once.chunks_exact_mut(width).zip(traced.chunks_exact(traced.len() / 3)) {
                    sums.iter_mut().zip(&traced[first..]).for_each(|(sum, traced)| *sum += traced);
                }
            }
            narrow(once, patch, light);
        });
        let once = &self.once;
        for _ in 0..self.bounces {
            let light = Block::new(before, 3, width);
            after.par_chunks_mut(size).enumerate().with_min_len(LEAST_PATCHES).for_each(|(patch, after)| {
                let mut sums = [0f32; 3 * BLOCK];
                let sums = &mut sums[..row];
                sums.copy_from_slice(&once[patch * row..][..row]);
                light.add(&received[patch].patches_later, sums);
                narrow(sums, patch, after);
            });
            std::mem::swap(before, after);
        }
        let indirect = Block::new(before, 3, width);
        out.par_chunks_mut(size).enumerate().with_min_len(LEAST_PATCHES).for_each(|(patch, out)| {
            let own = own.row(patch);
            for (i, (out, indirect)) in out.iter_mut().zip(indirect.row(patch)).enumerate() {
                let (own, indirect) = (own[i % own.len()].widened(), indirect.widened());
                *out = Line::narrowed(&std::array::from_fn(|k| own[k] + indirect[k]), patch);
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
