//! Direct vectors of a scenario and of lights that it does not have: what tells at run time how far light is from what a model
//! was trained on. They cost no bake ([`super::Unbaked`]).

use super::Measured;
use crate::light::scenario::Sky;
use crate::light::{Kind, KindWeights, Scenario};
use crate::math::Rgb;

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
pub const OWN: usize = 640;

/// Conditions of a kind: fewer where one light casts many shadow rays.
pub(super) fn conditions_of(kind: Kind) -> usize {
    match kind {
        Kind::Point | Kind::Spot | Kind::Directional => 640,
        Kind::Rect | Kind::Disk | Kind::Sphere => 192,
        Kind::Environment | Kind::Sky | Kind::Emissive => 64,
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

impl Contrast {
    /// With the vectors to calibrate with; others are to be added.
    pub fn new(held_out: Vec<DirectVector>) -> Self {
        Self { own: Vec::new(), held_out, others: Vec::new() }
    }

    /// Adds measured conditions, as far as they are needed.
    pub fn add(&mut self, measured: &Measured) {
        let n = measured.conditions;
        let value = |row: &[f32], c: usize| Rgb::new(row[c], row[n + c], row[2 * n + c]);
        let vector = |c: usize| measured.points.chunks_exact(3 * n).map(|row| value(row, c)).collect();
        let Some(kind) = measured.foreign else {
            self.own.extend((0..n.min(OWN - self.own.len())).map(vector));
            return;
        };
        if self.others.last().is_none_or(|(name, _)| name != kind.name()) {
            self.others.push((kind.name().to_owned(), Vec::new()));
        }
        if let Some((_, vectors)) = self.others.last_mut() {
            vectors.extend((0..n).map(vector));
        }
    }
}
