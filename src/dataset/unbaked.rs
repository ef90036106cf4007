//! Direct light of lights that are not baked, at every sub-point: thousands of them cost less than one bake.

use super::Draw;
use super::contrast::{AT_ONCE, conditions_of, foreign};
use crate::light::{EmissionFacets, LightTable, Scenario, ScenarioError};
use crate::math::sampler::mix64;
use crate::measure::MeasurementPoints;
use crate::scene::Tracer;

/// Lights of a scenario and of every other kind.
pub struct Unbaked<'a> {
    pub tracer: &'a Tracer<'a>,
    pub points: &'a MeasurementPoints,
    pub scenario: &'a Scenario,
    pub seed: u64,
}

/// Some conditions of one kind, measured.
pub struct Measured {
    pub conditions: usize,
    /// How many there are of their kind in all, and whether that is the scenario's own.
    pub of_kind: usize,
    pub own: bool,
    /// Radiant exitance, `[sub-point][channel][condition]` and `[point][channel][condition]`.
    pub sub_points: Vec<f32>,
    pub points: Vec<f32>,
}

/// Conditions of the scenario itself.
const OWN: usize = 1024;

/// Separates these conditions' random numbers from all others.
const STREAM: u64 = 0x756e_6261_6b65_6421;

impl Unbaked<'_> {
    /// Hands conditions of the scenario to `visit`, and then those of each kind of light that it does not have, some at a time. Kinds for which the scenario leaves no room are left out.
    ///
    /// # Errors
    /// When the scenario cannot be drawn from.
    pub fn for_each(&self, visit: &mut dyn FnMut(&Measured)) -> Result<(), ScenarioError> {
        let own = std::iter::once((self.scenario.clone(), OWN));
        let others = foreign(self.scenario).map(|(kind, scenario)| (scenario, conditions_of(kind)));
        let emission = EmissionFacets::of(self.tracer.asset());
        for (kind, (scenario, count)) in own.chain(others).enumerate() {
            let draw = Draw { scenario: &scenario, training: count, held_out: 0 };
            let conditions = match draw.conditions(self.tracer, mix64(self.seed ^ STREAM)) {
                Ok(conditions) => conditions,
                Err(ScenarioError::NoRoom { .. } | ScenarioError::NothingEmits) if kind > 0 => continue,
                Err(error) => return Err(error),
            };
            for some in conditions.chunks(AT_ONCE) {
                let table = LightTable::from_conditions(some, &emission);
                let sub_points = self.points.sub_point_matrix(self.tracer, &table);
                let points = self.points.average_rows(&sub_points, 3 * some.len());
                let (of_kind, own) = (conditions.len(), kind == 0);
                visit(&Measured { conditions: some.len(), of_kind, own, sub_points, points });
            }
        }
        Ok(())
    }
}
