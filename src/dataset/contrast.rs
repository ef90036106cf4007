//! Direct vectors of a scenario and of lights that it does not have: what tells at run time how far light is from what a model
//! was trained on. They cost no bake.

use super::Draw;
use crate::light::scenario::Sky;
use crate::light::{EmissionFacets, Kind, KindWeights, LightTable, LightingCondition, Scenario, ScenarioError};
use crate::math::Rgb;
use crate::math::sampler::mix64;
use crate::measure::MeasurementPoints;
use crate::scene::Tracer;

/// A direct vector: one colour per measurement point.
pub type DirectVector = Vec<Rgb>;

/// Direct vectors of lights.
pub struct Contrast {
    /// Of the scenario, beside those that are trained and tested on.
    pub own: Vec<DirectVector>,
    /// Of the scenario, held out.
    pub held_out: Vec<DirectVector>,
    /// Per kind of light that the scenario does not have, by its name in scene files.
    pub others: Vec<(String, Vec<DirectVector>)>,
}

/// Conditions of the scenario. With 512 for the fit the AUC is 0.5 to 1 % better than with 128.
const OWN: usize = 640;

/// Conditions of a kind: fewer where one light casts many shadow rays.
pub(super) fn conditions_of(kind: Kind) -> usize {
    match kind {
        Kind::Point | Kind::Spot | Kind::Directional => 640,
        Kind::Rect | Kind::Disk | Kind::Sphere => 192,
        Kind::Environment | Kind::Sky | Kind::Emissive => 128,
    }
}

/// The kinds of light that `scenario` does not have, but for environments, which need images: each drawn as the scenario draws its
/// own, one light at a time, and directional lights from everywhere.
pub(super) fn foreign(scenario: &Scenario) -> impl Iterator<Item = (Kind, Scenario)> {
    let lacks = |&(kind, weight): &(Kind, f32)| weight <= 0.0 && kind != Kind::Environment;
    scenario.kinds.all().into_iter().filter(lacks).map(|(kind, _)| {
        let kinds = KindWeights::only(kind);
        (kind, Scenario { kinds, sky: Sky::Everywhere, lights_per_condition: [1, 1], ..scenario.clone() })
    })
}

/// Conditions measured at once: every sub-point has a value for each.
pub(super) const AT_ONCE: usize = 64;

/// Separates these conditions' random numbers from those of the dataset.
const STREAM: u64 = 0x636f_6e74_7261_7374;

impl Contrast {
    /// Draws and measures conditions of `scenario`, and of every kind of light that it does not have: drawn as it draws them
    /// but for directional lights, which come from everywhere. Environments are left out, and so are kinds for which the
    /// scenario leaves no room. `held_out` are the vectors to calibrate with.
    ///
    /// # Errors
    /// When the scenario cannot be drawn from.
    pub fn draw(
        tracer: &Tracer,
        points: &MeasurementPoints,
        scenario: &Scenario,
        held_out: Vec<DirectVector>,
        seed: u64,
    ) -> Result<Self, ScenarioError> {
        let seed = mix64(seed ^ STREAM);
        let emission = EmissionFacets::of(tracer.asset());
        let measured = |conditions: &[LightingCondition]| {
            let n = conditions.len();
            let direct = points.direct_matrix(tracer, &LightTable::from_conditions(conditions, &emission));
            let value = |row: &[f32], c: usize| Rgb::new(row[c], row[n + c], row[2 * n + c]);
            (0..n).map(|c| direct.chunks_exact(3 * n).map(|row| value(row, c)).collect()).collect::<Vec<DirectVector>>()
        };
        let of = |scenario: &Scenario, count: usize| -> Result<Vec<DirectVector>, ScenarioError> {
            let conditions = Draw { scenario, training: count, held_out: 0 }.conditions(tracer, seed)?;
            Ok(conditions.chunks(AT_ONCE).flat_map(measured).collect())
        };
        let own = of(scenario, OWN)?;
        let mut others = Vec::new();
        for (kind, foreign) in foreign(scenario) {
            match of(&foreign, conditions_of(kind)) {
                Ok(vectors) => others.push((kind.name().to_owned(), vectors)),
                Err(ScenarioError::NoRoom { .. } | ScenarioError::NothingEmits) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(Self { own, held_out, others })
    }
}
