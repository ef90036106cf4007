//! Direct light of lights that are not baked, at every sub-point: thousands of them cost less than one bake.

use super::Draw;
use super::contrast::{conditions_of, foreign};
use crate::light::{EmissionFacets, Kind, LightTable, Scenario, ScenarioError};
use crate::math::sampler::mix64;
use crate::measure::MeasurementPoints;
use crate::scene::Tracer;

/// Lights of a scenario and of every other kind.
pub struct Unbaked<'a> {
    pub tracer: &'a Tracer<'a>,
    pub points: &'a MeasurementPoints,
    pub scenario: &'a Scenario,
    pub seed: u64,
    /// Conditions of the scenario.
    pub own: usize,
}

/// Conditions of the scenario that a prior takes.
pub const OF_SCENARIO: usize = 1024;

/// Some conditions of one kind, measured.
#[derive(Clone, Debug)]
pub struct Measured {
    pub conditions: usize,
    /// How many there are of their kind in all.
    pub of_kind: usize,
    /// The kind, where the scenario does not have it.
    pub foreign: Option<Kind>,
    /// Radiant exitance, `[sub-point][channel][condition]` and `[point][channel][condition]`.
    pub sub_points: Vec<f32>,
    pub points: Vec<f32>,
}

/// Conditions measured at once: every sub-point has a value for each.
const AT_ONCE: usize = 64;

/// Separates these conditions' random numbers from all others.
const STREAM: u64 = 0x756e_6261_6b65_6421;

impl Unbaked<'_> {
    /// Hands conditions of the scenario to `visit`, and then those of each kind of light that it does not have, drawn as it draws
    /// its own but for directional lights, which come from everywhere, some at a time. Environments are left out, and so are kinds for
    /// which the scenario leaves no room.
    ///
    /// # Errors
    /// When the scenario cannot be drawn from.
    pub fn for_each(&self, visit: &mut dyn FnMut(&Measured)) -> Result<(), ScenarioError> {
        let own = std::iter::once((None, self.scenario.clone(), self.own));
        let others = foreign(self.scenario).map(|(kind, scenario)| (Some(kind), scenario, conditions_of(kind)));
        let emission = EmissionFacets::of(self.tracer.asset());
        // Megabytes, that each measurement would fault in anew.
        let mut room = Vec::new();
        for (foreign, scenario, count) in own.chain(others) {
            let draw = Draw { scenario: &scenario, training: count, held_out: 0 };
            let conditions = match draw.conditions(self.tracer, mix64(self.seed ^ STREAM)) {
                Ok(conditions) => conditions,
                Err(ScenarioError::NoRoom { .. } | ScenarioError::NothingEmits) if foreign.is_some() => continue,
                Err(error) => return Err(error),
            };
            for some in conditions.chunks(AT_ONCE) {
                let table = LightTable::from_conditions(some, &emission);
                let (mut sub_points, of_kind) = (std::mem::take(&mut room), conditions.len());
                self.points.fill_sub_point_matrix(self.tracer, &table, &mut sub_points);
                let points = self.points.average_rows(&sub_points, 3 * some.len());
                let measured = Measured { conditions: some.len(), of_kind, foreign, sub_points, points };
                visit(&measured);
                room = measured.sub_points;
            }
        }
        Ok(())
    }
}
