//! Bakes a dataset: draws the conditions, measures D, path traces I.

use super::{Dataset, Indirect};
use crate::light::{EmissionFacets, LightTable, LightingCondition, Scenario, ScenarioError};
use crate::math::sampler::mix64;
use crate::measure::MeasurementPoints;
use crate::progress::Progress;
use crate::scene::{Lightmap, Tracer};
use crate::transport::{self, BakeError, BakeSettings};

/// Separates the held-out conditions' random numbers from the training conditions', so that more of either leaves the other
/// as they are.
const HELD_OUT_STREAM: u64 = 0x6865_6c64_5f6f_7574;

/// Conditions that [`Dataset::measured_at`] measures at once.
const AT_ONCE: usize = 64;

/// How many conditions of which scenario.
#[derive(Clone, Copy, Debug)]
pub struct Draw<'s> {
    pub scenario: &'s Scenario,
    pub training: usize,
    pub held_out: usize,
}

impl Draw<'_> {
    /// The conditions, training first; the k-th of each depends on (seed, k) alone.
    pub fn conditions(&self, tracer: &Tracer, seed: u64) -> Result<Vec<LightingCondition>, ScenarioError> {
        let sampler = self.scenario.sampler(tracer)?;
        let mut conditions = sampler.conditions(seed, self.training as u32)?;
        conditions.extend(sampler.conditions(mix64(seed ^ HELD_OUT_STREAM), self.held_out as u32)?);
        Ok(conditions)
    }
}

impl Dataset {
    /// Measures and bakes `conditions` in memory, the first `training` of which are to train on.
    ///
    /// # Errors
    /// When `progress` cancels.
    pub fn bake(
        tracer: &Tracer,
        lightmap: &Lightmap,
        points: &MeasurementPoints,
        conditions: Vec<LightingCondition>,
        training: usize,
        settings: &BakeSettings,
        progress: &dyn Progress,
    ) -> Result<Self, BakeError> {
        let emission = EmissionFacets::of(tracer.asset());
        let direct = points.direct_matrix(tracer, &LightTable::from_conditions(&conditions, &emission));
        let baked = transport::bake(tracer, lightmap, &conditions, settings, progress)?;
        Ok(Self {
            training,
            direct,
            indirect: Indirect::Memory(baked.indirect),
            texel_areas: lightmap.texels.iter().map(|t| t.area).collect(),
            noise: baked.noise,
            conditions,
        })
    }

    /// The same light, measured at other points. Some conditions at a time, since every sub-point has a value for each.
    pub fn measured_at(&self, tracer: &Tracer, points: &MeasurementPoints) -> Self {
        let emission = EmissionFacets::of(tracer.asset());
        let n = self.conditions.len();
        let mut direct = vec![0f32; points.points.len() * 3 * n];
        for (part, conditions) in self.conditions.chunks(AT_ONCE).enumerate() {
            let measured = points.direct_matrix(tracer, &LightTable::from_conditions(conditions, &emission));
            let columns = part * AT_ONCE..part * AT_ONCE + conditions.len();
            let rows = direct.chunks_exact_mut(n).zip(measured.chunks_exact(conditions.len()));
            rows.for_each(|(row, measured)| row[columns.clone()].copy_from_slice(measured));
        }
        Self { direct, ..self.clone() }
    }
}
