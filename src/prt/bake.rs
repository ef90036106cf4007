//! Transfer vectors by path tracing: t_j = ∫ Yⱼ(ω) V(ω) cos θ dω for direct light; a path that is reflected before it
//! escapes along ω adds Yⱼ(ω) times its throughput to the indirect part.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::receivers::{Receivers, TexelReceivers, VertexReceivers, VertexWeights};
use super::{ShPrt, Storage};
use crate::math::{Rgb, Sampler, sh};
use crate::progress::Progress;
use crate::scene::{Lightmap, Surface, Tracer};
use crate::transport::{Collector, Walk};

/// How transfer is baked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrtSettings {
    /// Order of the spherical harmonics, 1 to [`sh::MAX_ORDER`].
    pub order: usize,
    /// Paths per receiver.
    pub paths: u32,
    /// Reflections after which a path ends whatever it carries.
    pub max_bounces: u32,
    pub seed: u64,
}

#[derive(Debug, thiserror::Error)]
pub enum PrtError {
    #[error("spherical harmonics of order {0} are not supported; orders 1 to {max} are", max = sh::MAX_ORDER)]
    Order(usize),
    #[error("stopped")]
    Cancelled,
}

/// Transfer to the mesh's vertices, read at the texels of `lightmap` by interpolation. Depends on the seed alone, not on
/// the number of threads.
///
/// # Errors
/// [`PrtError::Order`]; [`PrtError::Cancelled`] when `progress` says so.
pub fn bake_vertices(
    tracer: &Tracer,
    lightmap: &Lightmap,
    settings: &PrtSettings,
    progress: &dyn Progress,
) -> Result<ShPrt, PrtError> {
    let weights = VertexWeights::new(&tracer.asset().mesh, lightmap);
    let receivers = VertexReceivers::new(tracer.asset());
    bake(tracer, &receivers, Storage::Vertices(weights), settings, progress)
}

/// Transfer to the texels of `lightmap`, as [`bake_vertices`].
///
/// # Errors
/// As [`bake_vertices`].
pub fn bake_texels(
    tracer: &Tracer,
    lightmap: &Lightmap,
    settings: &PrtSettings,
    progress: &dyn Progress,
) -> Result<ShPrt, PrtError> {
    bake(tracer, &TexelReceivers { asset: tracer.asset(), lightmap }, Storage::Texels, settings, progress)
}

fn bake(
    tracer: &Tracer,
    receivers: &impl Receivers,
    storage: Storage,
    settings: &PrtSettings,
    progress: &dyn Progress,
) -> Result<ShPrt, PrtError> {
    if !(1..=sh::MAX_ORDER).contains(&settings.order) {
        return Err(PrtError::Order(settings.order));
    }
    let functions = sh::count(settings.order);
    let walk = Walk { tracer, emitters: None, max_bounces: settings.max_bounces };
    let mut direct = vec![0f32; receivers.count() * functions];
    let mut indirect = vec![Rgb::ZERO; receivers.count() * functions];
    progress.begin("transfer", receivers.count() as u64, "receivers");
    let vectors = direct.par_chunks_exact_mut(functions).zip(indirect.par_chunks_exact_mut(functions));
    vectors.enumerate().for_each(|(receiver, (direct, indirect))| {
        if progress.cancelled() {
            return;
        }
        let point = receivers.points(receiver);
        let weight = 1.0 / settings.paths.max(1) as f32;
        let mut transfer = Transfer { order: settings.order, weight, direct, indirect };
        for path in 0..settings.paths {
            let mut sampler = Sampler::new(settings.seed, receiver as u64, path);
            let [u0, u1, u2, u3] = sampler.next_4d();
            if let Some(from) = point([u0, u1]) {
                walk.from_receiver(&from, Vec2::new(u2, u3), &mut sampler, &mut transfer);
            }
        }
        progress.advance(1);
    });
    progress.end();
    if progress.cancelled() {
        return Err(PrtError::Cancelled);
    }
    Ok(ShPrt { order: settings.order, storage, direct, indirect })
}

/// Gathers one receiver's transfer vectors.
struct Transfer<'v> {
    order: usize,
    /// One over the number of paths.
    weight: f32,
    direct: &'v mut [f32],
    indirect: &'v mut [Rgb],
}

impl Collector for Transfer<'_> {
    fn vertex(&mut self, _: &Surface, _: Vec3, _: Rgb, _: u32, _: impl FnOnce() -> Sampler) {}

    fn escaped(&mut self, direction: Vec3, throughput: Rgb, _: f32, bounces: u32) {
        let y = sh::evaluate(self.order, direction);
        let throughput = throughput * self.weight;
        if bounces == 0 {
            // Light that was not reflected has no colour.
            self.direct.iter_mut().zip(y).for_each(|(t, y)| *t += throughput.x * y);
        } else {
            self.indirect.iter_mut().zip(y).for_each(|(t, y)| *t += throughput * y);
        }
    }
}
