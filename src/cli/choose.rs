//! What is chosen for the user before training: the number of conditions (`--conditions auto`), and sizes from a budget
//! (`--max-error`, `--max-bytes`). Held-out lights have no part in it.

use std::collections::BTreeSet;
use std::time::Instant;

use super::pipeline::{Prepared, Ready};
use super::storage::Place;
use super::{Failure, Reporter};
use crate::dataset::{Bytes, Dataset, Draw};
use crate::measure::MeasurementPoints;
use crate::model::{Choice, Shortage};
use crate::progress::Progress;
use crate::scene::Tracer;
use crate::scene_file::{Conditions, MOST_CONDITIONS as MOST_SETTING, SceneFile};
use crate::transfer::budget::{self, Residuals, Storage, candidates, cross_validate, trial_settings};
use crate::transfer::enough::{self, LEAST_GAIN, More};
use crate::transfer::gamma::{Contest, GAMMA};
use crate::transfer::{Budget, Candidate, Fit, Gram, HeldOutErrors, Method, Prior, Size, TrainSettings};

/// Most conditions that `auto` goes to: the decomposition of so many takes as long as their bake.
const MOST_CONDITIONS: usize = 1024;

/// Shadow rays that trying more points may cost: some seconds.
const MOST_RAYS: usize = 16 << 20;

/// Values that are not to be chosen, since they were given on the command line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Held {
    pub basis: bool,
    pub anchors: bool,
    pub points: bool,
}

impl Prepared {
    /// Chooses what is to be chosen and takes it over into the settings; bakes what that takes. `None` where nothing is to be
    /// chosen.
    pub fn choose(&mut self, place: &Place, held: Held, reporter: &Reporter) -> Result<Option<Ready>, Failure> {
        self.check_bytes(held)?;
        let mut ready = match self.scene.bake.conditions {
            Conditions::Count(_) => None,
            Conditions::Auto => Some(self.grow(place, reporter)?),
        };
        let train = &self.scene.train;
        let (sized, raised) = (train.budget().is_given(), train.gamma.is_none() && train.method != Method::Belcour);
        if sized || raised {
            let bake = || -> Result<Ready, Failure> {
                place.check_training(&self.scene, self.lightmap.texels.len())?;
                self.ready(&Tracer::new(&self.asset), place, reporter)
            };
            let from = ready.map_or_else(bake, Ok)?;
            // Sizes are chosen by errors in linear light.
            ready =
                Some(if sized { self.size(from, place, held, reporter)? } else { self.space(from, place, reporter)? });
        }
        Ok(ready)
    }

    /// Takes the γ that a trial tells to be better.
    fn space(&mut self, ready: Ready, place: &Place, reporter: &Reporter) -> Result<Ready, Failure> {
        let contest = Contest::of(&ready.dataset, self.scene.train.channels, reporter)?;
        let mut gamma = if contest.is_some_and(|c| c.gamma_wins) { GAMMA } else { 1.0 };
        self.scene.train.gamma = Some(gamma);
        if gamma != 1.0 && place.check_training(&self.scene, self.lightmap.texels.len()).is_err() {
            reporter.note(&format!("gamma {GAMMA} would be better, but --memory has no room for its fit"));
            gamma = 1.0;
            self.scene.train.gamma = Some(gamma);
        }
        if let Some(Contest { linear, gamma: raised, .. }) = contest {
            let (linear, raised) = (100.0 * linear, 100.0 * raised);
            let why = format!("on trial an error of {linear:.1} % in linear light, {raised:.1} % with gamma {GAMMA}");
            self.choices.push(Choice { setting: "train.gamma".to_owned(), value: gamma.to_string(), why });
        }
        Ok(ready)
    }

    /// Refuses a budget that no size keeps, before anything is baked.
    fn check_bytes(&self, held: Held) -> Result<(), Failure> {
        let train = &self.scene.train;
        let Some(most) = train.max_bytes else { return Ok(()) };
        let or = |held: bool, given: usize, least: usize| if held { given } else { least };
        let is_local = train.method == Method::Local;
        let points = or(held.points, self.scene.points.count, budget::POINTS[0].min(self.scene.points.count));
        let least = Size {
            elements: or(held.basis, train.elements(), if is_local { budget::CHANNELS[0] } else { 1 }),
            anchors: if is_local { or(held.anchors, train.anchors, budget::ANCHORS[0]) } else { 0 },
            points,
            sub_points: self.scene.points.sub_points_at(points),
        };
        let least = Bytes(least.bytes(&self.storage()));
        if least <= most {
            return Ok(());
        }
        Err(Failure::Input(format!(
            "train.max_bytes = {most} is too little: the smallest model takes {least}; give as much, or lower --size"
        )))
    }

    /// What bytes are counted by.
    fn storage(&self) -> Storage {
        let train = &self.scene.train;
        Storage {
            lightmap_size: self.scene.lightmap.size as usize,
            channels: train.channels,
            value: if train.method == Method::Local { train.bits as usize / 8 } else { 2 },
        }
    }

    /// Doubles the conditions until another doubling would gain little.
    fn grow(&mut self, place: &Place, reporter: &Reporter) -> Result<Ready, Failure> {
        let mut count = self.scene.bake.conditions.first();
        if place.rendered.is_some() {
            return Err(Failure::Input(
                "bake.conditions = auto bakes what it needs; lightmaps of another renderer are as many as there are: leave \
                 --conditions out"
                    .to_owned(),
            ));
        }
        let (ready, why) = loop {
            self.scene.bake.conditions = Conditions::Count(count);
            place.check_training(&self.scene, self.lightmap.texels.len())?;
            let tracer = Tracer::new(&self.asset);
            let ready = self.ready(&tracer, place, reporter)?;
            let (dataset, settings) = (&ready.dataset, self.train_settings());
            let tell = |fit: &Fit| self.tell(fit, &tracer, &ready, reporter);
            let curve = enough::curve_of_training(dataset, &ready.gram, settings, tell)?;
            drop(tracer);
            let gain = curve.map(|c| c.gain());
            match gain {
                Some(gain) => reporter.note(&format!(
                    "conditions: with {count} twice as many would lower the error by about {:.1} %",
                    100.0 * gain
                )),
                None => reporter.note(&format!("conditions: {count} are too few to tell what more would bring")),
            }
            if gain.is_some_and(|gain| gain < LEAST_GAIN) {
                break (ready, format!("twice as many would lower the error by {:.1} %", 100.0 * gain.unwrap_or(0.0)));
            }
            if 2 * count > MOST_CONDITIONS {
                break (ready, format!("the most that auto goes to; give a number above {count} for more"));
            }
            let more = SceneFile { bake: self.scene.bake.with_conditions(2 * count), ..self.scene.clone() };
            if place.check_training(&more, self.lightmap.texels.len()).is_err() {
                break (ready, "twice as many need more memory than --memory allows".to_owned());
            }
            count *= 2;
        };
        self.choices.push(Choice { setting: "bake.conditions".to_owned(), value: count.to_string(), why });
        Ok(ready)
    }

    /// Takes the sizes that the budget asks for, and measures at as many points.
    fn size(&mut self, ready: Ready, place: &Place, held: Held, reporter: &Reporter) -> Result<Ready, Failure> {
        let start = Instant::now();
        let train = self.scene.train.clone();
        let given = train.budget();
        let is_local = train.method == Method::Local;
        // What trying sizes takes is as much as the largest of those that are fitted in full here.
        let largest = SceneFile { train: train.with_sizes(4, 128), ..self.scene.clone() };
        place.check_training(&largest, self.lightmap.texels.len())?;

        let tracer = Tracer::new(&self.asset);
        let settings = trial_settings(self.train_settings(), ready.dataset.training);
        let n = ready.dataset.conditions.len();
        let own = self.scene.points.count;
        // Direct light that another program made is known at its own points only.
        let points: Vec<usize> = if held.points || place.rendered.is_some() {
            vec![own]
        } else {
            let affordable = |p: &usize| *p == own || p * self.scene.points.sub_points_at(*p) * n <= MOST_RAYS;
            let all: BTreeSet<usize> = budget::POINTS.into_iter().chain([own]).collect();
            all.into_iter().filter(affordable).collect()
        };
        reporter.note(&format!("sizes: trying {} numbers of points on the training conditions", points.len()));
        let measured: Vec<Dataset> =
            points.iter().map(|&p| self.measure(&ready.dataset, &tracer, p)).collect::<Result<_, _>>()?;
        let mut errors = cross_validate(&measured, &ready.gram, settings)?;
        drop(measured);
        let told =
            budget::told(&ready.dataset, &ready.gram, settings, |fit| self.tell(fit, &tracer, &ready, reporter))?;
        for errors in &mut errors {
            errors.iter_mut().zip(&told).for_each(|(error, told)| *error *= told);
        }
        let residuals = if is_local {
            let fit = Fit::train(&ready.dataset, &ready.gram, settings)?;
            Some(Residuals::estimate(&fit, &ready.dataset, &self.places(), reporter)?)
        } else {
            None
        };
        let points: Vec<(usize, usize)> = points.iter().map(|&p| (p, self.scene.points.sub_points_at(p))).collect();
        let mut all = candidates(&points, &errors, residuals.as_ref(), &self.storage());
        let (elements, anchors) = (train.elements(), train.anchors);
        all.retain(|c| (!held.basis || c.size.elements == elements) && (!held.anchors || c.size.anchors == anchors));
        if all.is_empty() {
            return Err(Failure::Input(format!(
                "train.max_error and train.max_bytes choose from channels {:?}, anchors {:?} of `local` and up to {} \
                 elements of `linear`; give one of these, or leave --basis and --anchors out",
                budget::CHANNELS,
                budget::ANCHORS,
                budget::MOST_ELEMENTS
            )));
        }
        let Some(chosen) = given.choose(&all) else {
            let least = Bytes(all.iter().map(|c| c.bytes).min().unwrap_or(0));
            return Err(Failure::Input(format!(
                "train.max_bytes: the smallest model takes {least}; give as much, or lower --size"
            )));
        };
        let points = self.place_points(chosen.size.points)?;
        let dataset = self.measure(&ready.dataset, &tracer, chosen.size.points)?;
        drop(tracer);
        self.take(chosen, &given);
        place.check_training(&self.scene, self.lightmap.texels.len())?;
        reporter.note(&format!("sizes: chosen in {:.1} s", start.elapsed().as_secs_f64()));
        Ok(Ready { points, dataset, ..ready })
    }

    /// Takes over a size, and says why.
    fn take(&mut self, chosen: Candidate, budget: &Budget) {
        let train = &mut self.scene.train;
        train.basis = Some(chosen.size.elements);
        if chosen.size.anchors > 0 {
            train.anchors = chosen.size.anchors;
        }
        self.scene.points.count = chosen.size.points;
        (train.max_error, train.max_bytes) = (None, None);
        let asked = [
            budget.max_error.map(|e| format!("max_error = {e}")),
            budget.max_bytes.map(|b| format!("max_bytes = {}", Bytes(b))),
        ];
        let asked = asked.into_iter().flatten().collect::<Vec<_>>().join(", ");
        let why = format!(
            "{asked}: {} and an error of about {:.1} % by cross-validation",
            Bytes(chosen.bytes),
            100.0 * chosen.error
        );
        let mut choice = |setting: &str, value: usize| {
            let (setting, value) = (setting.to_owned(), value.to_string());
            self.choices.push(Choice { setting, value, why: why.clone() });
        };
        choice("train.basis", chosen.size.elements);
        if chosen.size.anchors > 0 {
            choice("train.anchors", chosen.size.anchors);
        }
        choice("points.count", chosen.size.points);
    }

    /// The same lights, measured at so many points.
    fn measure(&self, dataset: &Dataset, tracer: &Tracer, count: usize) -> Result<Dataset, Failure> {
        if count == dataset.points() {
            return Ok(dataset.clone());
        }
        Ok(dataset.measured_at(tracer, &self.place_points(count)?))
    }

    fn place_points(&self, count: usize) -> Result<MeasurementPoints, Failure> {
        let (points, seed) = (&self.scene.points, self.scene.bake.seed);
        Ok(MeasurementPoints::place(&self.asset, count, points.sub_points_at(count), seed)?)
    }

    /// The prior of a fit on trial, if the model's fit is told one.
    fn tell(&self, fit: &Fit, tracer: &Tracer, ready: &Ready, reporter: &Reporter) -> Result<Option<Prior>, Failure> {
        if !self.is_told() {
            return Ok(None);
        }
        Ok(self.of_unbaked(Some(fit), tracer, &ready.points, &ready.dataset, reporter)?.0)
    }

    /// What the fit is asked for.
    pub fn train_settings(&self) -> TrainSettings {
        let train = &self.scene.train;
        TrainSettings {
            method: train.method,
            channels: train.channels,
            elements: train.elements(),
            lambda: train.lambda_for(train.method),
        }
    }

    /// What more of would lower the error of a trained model. Nothing is said of the baseline, which is as published.
    pub fn shortages(
        &self,
        tracer: &Tracer,
        place: &Place,
        (fit, prior, errors): (&Fit, Option<&Prior>, &HeldOutErrors),
        (dataset, gram): (&Dataset, &Gram),
    ) -> Result<Vec<Shortage>, Failure> {
        let mut shortages = Vec::new();
        if fit.has_mean() || errors.transfer.is_empty() {
            return Ok(shortages);
        }
        let summary = errors.summary();
        let mut add = |setting: &str, count: usize, more: Option<More>| {
            let shortage = |More { enough, error }| Shortage { setting: setting.to_owned(), count, enough, error };
            shortages.extend(more.map(shortage));
        };
        if place.rendered.is_none() {
            let (own, n) = (dataset.points(), dataset.conditions.len());
            let affordable = |p: &usize| p * self.scene.points.sub_points_at(*p) * n <= MOST_RAYS;
            let more: Vec<usize> = [2 * own, 4 * own].into_iter().filter(affordable).collect();
            let measure = |count: usize| self.measure(dataset, tracer, count);
            let means = (summary.mean, summary.oracle_mean);
            add("points.count", own, enough::points(fit, dataset, gram, means, &more, measure)?);
        }
        let curve = enough::curve(fit, prior, dataset, gram, summary.mean)?;
        // As far as the points are tried; a curve of two points does not tell of thousands.
        let most = (4 * dataset.training).min(MOST_SETTING);
        add("bake.conditions", dataset.training, curve.and_then(|c| c.shortage(most)));
        Ok(shortages)
    }

    /// The dataset with what all fits need of it.
    pub fn ready(&self, tracer: &Tracer, place: &Place, reporter: &Reporter) -> Result<Ready, Failure> {
        let start = Instant::now();
        let (points, dataset) = self.dataset(tracer, place, reporter)?;
        let bake_seconds = start.elapsed().as_secs_f64();
        let gram = Gram::of(&dataset, reporter)?;
        Ok(Ready { points, dataset, gram, bake_seconds })
    }
}

/// Draws as many conditions as the settings ask for.
pub fn draw(scene: &SceneFile) -> Draw<'_> {
    Draw { scenario: &scene.scenario, training: scene.bake.conditions.first(), held_out: scene.bake.held_out }
}
