//! What `relight compare` bakes beside the model's own dataset, all at once: training sets of other seeds, lights of other kinds,
//! lights that move.

use super::pipeline::{Prepared, Trained};
use super::storage::Place;
use super::{Failure, Reporter};
use crate::dataset::{Dataset, Draw};
use crate::light::scenario::Sky;
use crate::light::{EmissionFacets, Kind, KindWeights, LightTable, LightingCondition, Scenario, ScenarioError};
use crate::math::sampler::mix64;
use crate::measure::MeasurementPoints;
use crate::progress::Progress;
use crate::report::assemble::KindSet;
use crate::report::temporal::Moving;
use crate::scene::Tracer;

/// Most conditions of distant light to train on, and held out.
const DISTANT: (usize, usize) = (192, 96);

/// Most conditions of each kind of light to train on, and held out, where kinds are compared.
const OF_KIND: (usize, usize) = (128, 64);

/// Kinds of light that are compared with each other.
const KINDS: [Kind; 4] = [Kind::Spot, Kind::Point, Kind::Directional, Kind::Rect];

/// Share of directional conditions that must light the asset for distant light to be compared.
const LEAST_LIT: f64 = 0.25;

/// Paths of moving lights, and the frames of each.
const PATHS: usize = 3;
const FRAMES: usize = 64;

/// The folder, in that of the model's dataset.
const FOLDER: &str = "compare";

/// A training set and the points that its direct light is measured at.
pub struct Set {
    pub dataset: Dataset,
    pub points: MeasurementPoints,
}

/// All that is compared beside the model's own training set.
#[derive(Default)]
pub struct Study {
    /// Training sets of other seeds, with the model's held-out conditions.
    pub others: Vec<Set>,
    /// Training sets of distant lights with the same held-out conditions, the model's seed first; none where they hardly reach
    /// the asset.
    pub distant: Vec<Set>,
    pub moving: Option<Moving>,
    /// The model's own lights first; none where they are not compared with others.
    pub kinds: Vec<KindSet>,
}

/// Conditions to be baked, each of them once.
#[derive(Default)]
struct Pool(Vec<LightingCondition>);

impl Pool {
    /// Where the conditions are among those that are baked.
    fn add(&mut self, conditions: Vec<LightingCondition>) -> Vec<usize> {
        let place = |condition| {
            let known = self.0.iter().position(|c| *c == condition);
            known.unwrap_or_else(|| {
                self.0.push(condition);
                self.0.len() - 1
            })
        };
        conditions.into_iter().map(place).collect()
    }
}

/// Seed `index` of a run; that of the model is 0.
fn seed_of(seed: u64, index: usize) -> u64 {
    if index == 0 { seed } else { mix64(seed.wrapping_add(index as u64)) }
}

impl Study {
    /// Bakes `seeds` training sets in all, and what figures need; with `quick` only distant and moving light.
    pub fn bake(
        prepared: &Prepared,
        trained: &Trained,
        place: &Place,
        tracer: &Tracer,
        (seeds, quick): (usize, bool),
        reporter: &Reporter,
    ) -> Result<Self, Failure> {
        let (scene, own) = (&prepared.scene, &trained.dataset);
        let seed = scene.bake.seed;
        let rendered = place.rendered.is_some();
        let placed = (0..seeds).map(|s| match s {
            0 => Ok(trained.model.points.clone()),
            _ => {
                let (count, sub_points) = (scene.points.count, scene.points.sub_points());
                MeasurementPoints::place(&prepared.asset, count, sub_points, seed_of(seed, s))
            }
        });
        let points: Vec<MeasurementPoints> = placed.collect::<Result<_, _>>()?;
        let drawn = |scenario: &Scenario, training: usize, held_out: usize, seed: u64| {
            Draw { scenario, training, held_out }.conditions(tracer, seed)
        };

        let mut pool = Pool::default();
        let (mut others, mut moving, mut kinds) = (Vec::new(), None, Vec::new());
        // Where the model's lightmaps come from another renderer, ours are not to be mixed with them.
        if rendered {
            reporter.note("lightmaps of another renderer: only distant lights are baked to compare, all other figures need no bake");
        } else {
            for s in 1..seeds {
                others.push(pool.add(drawn(&scene.scenario, own.training, 0, seed_of(seed, s))?));
            }
            let paths = scene.scenario.paths(tracer, seed, PATHS, FRAMES)?;
            if !paths.is_empty() {
                moving = Some(pool.add(paths.concat()));
            }
            let count = (own.training.min(OF_KIND.0), own.held_out().len().min(OF_KIND.1));
            for kind in KINDS.into_iter().filter(|_| !quick) {
                let scenario = Scenario {
                    kinds: KindWeights::only(kind),
                    sky: Sky::Everywhere,
                    lights_per_condition: [1, 1],
                    ..scene.scenario.clone()
                };
                if scenario.kinds == scene.scenario.kinds {
                    continue;
                }
                match drawn(&scenario, count.0, count.1, seed) {
                    Ok(conditions) => kinds.extend(lit(&trained.model.points, tracer, conditions, count.0).map(
                        |(conditions, training)| {
                            (kind.name().to_owned(), scenario.clone(), pool.add(conditions), training)
                        },
                    )),
                    Err(ScenarioError::NoRoom { .. }) => {}
                    Err(error) => return Err(error.into()),
                }
            }
        }
        let distant = distant(prepared, trained, tracer, &mut pool, if rendered { 1 } else { seeds }, reporter)?;
        if pool.0.is_empty() {
            return Ok(Self::default());
        }

        let place = Place { folder: place.folder.join(FOLDER), memory: place.memory, rendered: None };
        let all = pool.0.len();
        let baked = prepared.bake(scene, tracer, &points[0], pool.0, all, &place, reporter)?;
        let held_out = || (own, own.held_out().collect());
        let of_set = |s: usize, dataset: Dataset| Set {
            dataset: dataset.measured_at(tracer, &points[s]),
            points: points[s].clone(),
        };
        let mut study = Self::default();
        for (s, picks) in (1..).zip(others) {
            let set = Dataset::gather(&[(&baked, picks), held_out()], own.training, reporter)?;
            study.others.push(of_set(s, set));
        }
        if let Some((held_out, sets)) = distant {
            for (s, picks) in sets.into_iter().enumerate() {
                let training = picks.len();
                let picks = picks.into_iter().chain(held_out.iter().copied()).collect();
                study.distant.push(of_set(s, Dataset::gather(&[(&baked, picks)], training, reporter)?));
            }
        }
        if let Some(picks) = moving {
            let dataset = Dataset::gather(&[(&baked, picks)], 0, reporter)?;
            study.moving = Some(Moving { dataset, frames: FRAMES });
        }
        if !kinds.is_empty() {
            let training = own.training.min(OF_KIND.0);
            let tested = own.held_out().take(OF_KIND.1);
            let some = Dataset::gather(&[(own, (0..training).chain(tested).collect())], training, reporter)?;
            let (name, scenario) = ("the model's lights".to_owned(), scene.scenario.clone());
            study.kinds.push(KindSet { name, scenario, dataset: some });
            for (name, scenario, picks, training) in kinds {
                let dataset = Dataset::gather(&[(&baked, picks)], training, reporter)?;
                study.kinds.push(KindSet { name, scenario, dataset });
            }
        }
        Ok(study)
    }
}

/// Directional lights from everywhere.
pub fn distant_scenario() -> Scenario {
    Scenario { kinds: KindWeights::only(Kind::Directional), sky: Sky::Everywhere, ..Scenario::default() }
}

/// Held-out conditions and those of each training set.
type Distant = (Vec<usize>, Vec<Vec<usize>>);

/// The same asset under directional lights from everywhere, trained and tested anew: what classical PRT is made for. Returns the
/// held-out conditions and those of each training set; none where distant light hardly reaches the asset, as in a closed room.
fn distant(
    prepared: &Prepared,
    trained: &Trained,
    tracer: &Tracer,
    pool: &mut Pool,
    seeds: usize,
    reporter: &Reporter,
) -> Result<Option<Distant>, Failure> {
    let scenario = distant_scenario();
    if prepared.scene.scenario.kinds == scenario.kinds {
        return Ok(None);
    }
    let bake = &prepared.scene.bake;
    let (training, held_out) = (bake.conditions.first().min(DISTANT.0), bake.held_out.min(DISTANT.1));
    let (mut tested, mut sets) = (None, Vec::new());
    for s in 0..seeds {
        let held_out = if s == 0 { held_out } else { 0 };
        let draw = Draw { scenario: &scenario, training, held_out };
        let conditions = draw.conditions(tracer, seed_of(bake.seed, s))?;
        let Some((mut conditions, training)) = lit(&trained.model.points, tracer, conditions, training) else {
            reporter.note(
                "distant light hardly reaches this asset: classical PRT is compared under the model's own scenario only",
            );
            return Ok(None);
        };
        let rest = conditions.split_off(training);
        sets.push(pool.add(conditions));
        if s == 0 {
            tested = Some(pool.add(rest));
        }
    }
    Ok(tested.map(|tested| (tested, sets)))
}

/// The conditions that some measurement point sees, and how many of the first `training` there are among them: the others would be
/// dropped after the bake. None where too few are left.
fn lit(
    points: &MeasurementPoints,
    tracer: &Tracer,
    conditions: Vec<LightingCondition>,
    training: usize,
) -> Option<(Vec<LightingCondition>, usize)> {
    let table = LightTable::from_conditions(&conditions, &EmissionFacets::of(tracer.asset()));
    let direct = points.direct_matrix(tracer, &table);
    let n = conditions.len();
    let is_lit = |c: usize| direct.chunks_exact(3 * n).any(|row| (0..3).any(|channel| row[channel * n + c] > 0.0));
    let lit: Vec<usize> = (0..n).filter(|&c| is_lit(c)).collect();
    let enough = lit.len() as f64 >= LEAST_LIT * n as f64;
    enough
        .then(|| (lit.iter().map(|&c| conditions[c].clone()).collect(), lit.iter().filter(|&&c| c < training).count()))
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::light::Light;

    #[test]
    fn a_condition_that_is_drawn_twice_is_baked_once() {
        let sun = |intensity| LightingCondition {
            lights: vec![Light::Directional { direction: Vec3::Z, color: Vec3::ONE, intensity }],
        };
        let mut pool = Pool::default();
        assert_eq!(pool.add(vec![sun(1.0), sun(2.0)]), [0, 1]);
        assert_eq!(pool.add(vec![sun(2.0), sun(3.0)]), [1, 2]);
        assert_eq!(pool.0.len(), 3);
    }
}
