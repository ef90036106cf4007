//! Indirect light between patches: E = b + G E, where b is what the patches reflect to each other of the direct light, and
//! G gathers what they reflect of the indirect light (Goral et al., *Modeling the Interaction of Light Between Diffuse
//! Surfaces*, 1984; G sampled by rays instead of integrated). Solved by Jacobi iterations for all lights at once.

use glam::Vec2;
use rayon::prelude::*;

use super::Rays;
use super::direct::Direct;
use super::patches::Patches;
use super::rows::{Rows, Term, narrowed, place};
use super::samples::SampleTable;
use crate::light::LightSet;
use crate::math::Rgb;
use crate::math::sampler::mix64;
use crate::progress::Progress;
use crate::scene::Lightmap;
use crate::transport::{BakeError, BakeSettings, Walk};

/// The light of patches after any number of bounces.
pub struct Bounced {
    /// A row per patch, columns as in [`Direct`]: irradiance, direct and indirect together.
    pub light: Rows,
    pub rays: u64,
}

/// Separates these samples from those of the final gather.
const PATCH_STREAM: u64 = 0x0070_6174_6368;

/// Paths of a texel for each ray of a patch: what patches send each other meets in many texels. On the Cornell box the error
/// with 2 is that with 1; with 4 it is 1 % of itself higher.
const PATHS_PER_RAY: u32 = 2;

/// Light that has faded to this share of the first bounce's is not bounced on.
const FADED: f32 = 1e-3;

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
        let columns = direct.light.columns();
        let width = 3 * columns;
        let own = patch_means(patches, &direct.light);
        progress.begin("bounce", patches.len() as u64, "patches");
        let samples = SampleTable::new(settings.seed ^ PATCH_STREAM, (settings.paths / PATHS_PER_RAY).max(1));
        // A path that has used its bounces up to here still takes the one to the texel.
        let walk = Walk { max_bounces: settings.max_bounces.saturating_sub(1), ..*walk };
        let mut once = vec![0f32; patches.len() * width];
        let gathered: Vec<(Vec<Term>, u64)> = once
            .par_chunks_mut(width)
            .enumerate()
            .map_init(
                || Rays::new(&walk, set),
                |rays, (patch, once)| {
                    if progress.cancelled() || walk.max_bounces == 0 {
                        return (Vec::new(), 0);
                    }
                    let before = rays.sent + rays.traced.rays();
                    send(&walk, lightmap, patches, &samples, settings, patch, rays);
                    let weight = 1.0 / samples.count() as f32;
                    let found = &mut rays.found;
                    found.patches.iter_mut().chain(&mut found.texels).for_each(|term| term.weight *= weight);
                    own.add(&found.patches, once);
                    direct.light.add(&found.texels, once);
                    let traced = &rays.traced.indirect;
                    for (column, &sum) in traced.lights.iter().chain([&traced.emission]).enumerate() {
                        for channel in 0..3 {
                            once[place(3, columns, channel, column)] += sum[channel] * weight;
                        }
                    }
                    progress.advance(1);
                    let terms = merged(rays.found.patches.clone());
                    (terms, rays.sent + rays.traced.rays() - before)
                },
            )
            .collect();
        progress.end();
        if progress.cancelled() {
            return Err(BakeError::Cancelled);
        }
        let operator: Vec<&[Term]> = gathered.iter().map(|(terms, _)| &terms[..]).collect();
        let rays = gathered.iter().map(|(_, rays)| rays).sum();
        let indirect = solve(&operator, &once, columns, settings.max_bounces, progress)?;
        Ok(Self { light: sum(&own, &indirect, columns), rays })
    }
}

/// Sends all rays of a patch, from points uniform by area.
fn send<'a>(
    walk: &Walk<'_, 'a>,
    lightmap: &Lightmap,
    patches: &Patches,
    samples: &SampleTable,
    settings: &BakeSettings,
    patch: usize,
    rays: &mut Rays<'_, 'a>,
) {
    let texels = patches.texels(patch);
    let stream = lightmap.texels[texels[0].0 as usize].index as u64;
    let samples_here = samples.of(settings.seed ^ mix64(PATCH_STREAM), stream);
    let points: Vec<_> =
        texels.iter().map(|&(texel, _)| lightmap.sampler(&walk.tracer.asset().mesh, texel as usize)).collect();
    rays.found.clear();
    rays.traced.clear();
    for i in 0..samples.count() {
        let [u0, u1, u2, u3] = samples_here.point(i);
        // What is left of u0 inside its texel's share serves again.
        let t = texels.partition_point(|&(_, end)| end <= u0).min(texels.len() - 1);
        let start = if t == 0 { 0.0 } else { texels[t - 1].1 };
        let rest = ((u0 - start) / (texels[t].1 - start).max(f32::MIN_POSITIVE)).clamp(0.0, 1.0 - f32::EPSILON);
        let receiver = patches.front(points[t].sample([rest, u1]));
        rays.send(walk, patches, receiver, Vec2::new(u2, u3), &samples_here, i);
    }
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

/// Area-weighted means over each patch's texels.
fn patch_means(patches: &Patches, texels: &Rows) -> Rows {
    let mut means = texels.like(patches.len());
    let stride = means.stride();
    means.values_mut().par_chunks_mut(stride).enumerate().for_each_init(
        || (vec![0f32; stride], vec![0f32; stride]),
        |(sum, row), (patch, out)| {
            sum.fill(0.0);
            let mut start = 0.0;
            for &(texel, end) in patches.texels(patch) {
                texels.widen(texel as usize, row);
                sum.iter_mut().zip(&*row).for_each(|(sum, light)| *sum += (end - start) * light);
                start = end;
            }
            out.iter_mut().zip(&*sum).for_each(|(out, &sum)| *out = narrowed(sum, patch));
        },
    );
    means
}

/// Bounces after which light has faded, counted from the first: a property of the asset alone, so that every batch of lights
/// takes as many.
fn bounces_until_faded(operator: &[&[Term]], most: u32) -> u32 {
    let mut light = vec![Rgb::ONE; operator.len()];
    for bounce in 0..most {
        let gather = |terms: &&[Term]| terms.iter().map(|t| t.weight * light[t.row as usize]).sum::<Rgb>();
        let next: Vec<Rgb> = operator.par_iter().map(gather).collect();
        light = next;
        if light.iter().all(|l| l.max_element() < FADED) {
            return bounce;
        }
    }
    most
}

/// Solves E = b + G E; `once` holds a row of three planes a patch.
fn solve(
    operator: &[&[Term]],
    once: &[f32],
    columns: usize,
    max_bounces: u32,
    progress: &dyn Progress,
) -> Result<Rows, BakeError> {
    let width = 3 * columns;
    let mut light = Rows::new(operator.len(), 3, columns);
    light.values_mut().par_chunks_mut(width).enumerate().for_each(|(patch, out)| {
        out.iter_mut().zip(&once[patch * width..]).for_each(|(out, &value)| *out = narrowed(value, patch));
    });
    // b itself has bounced once, and the last bounce is the final gather's.
    for _ in 0..bounces_until_faded(operator, max_bounces.saturating_sub(2)) {
        if progress.cancelled() {
            return Err(BakeError::Cancelled);
        }
        let mut next = Rows::new(operator.len(), 3, columns);
        next.values_mut().par_chunks_mut(width).enumerate().for_each_init(
            || vec![0f32; width],
            |sum, (patch, out)| {
                sum.copy_from_slice(&once[patch * width..(patch + 1) * width]);
                light.add(operator[patch], sum);
                out.iter_mut().zip(&*sum).for_each(|(out, &sum)| *out = narrowed(sum, patch));
            },
        );
        light = next;
    }
    Ok(light)
}

/// Direct and indirect light together.
fn sum(direct: &Rows, indirect: &Rows, columns: usize) -> Rows {
    let (width, planes) = (3 * columns, direct.stride() / columns);
    let mut rows = indirect.like(indirect.count());
    rows.values_mut().par_chunks_mut(width).enumerate().for_each_init(
        || (vec![0f32; direct.stride()], vec![0f32; width]),
        |(own, reflected), (patch, total)| {
            direct.widen(patch, own);
            indirect.widen(patch, reflected);
            for (channel, column) in (0..3).flat_map(|channel| (0..columns).map(move |column| (channel, column))) {
                let at = place(3, columns, channel, column);
                let own = own[place(planes, columns, channel.min(planes - 1), column)];
                total[at] = narrowed(own + reflected[at], patch);
            }
        },
    );
    rows
}
