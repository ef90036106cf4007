//! The steps that commands share: scene to dataset, dataset to model.

use std::path::Path;
use std::time::Instant;

use glam::Vec3;

use crate::dataset::{Contrast, Dataset, Job, OF_SCENARIO, Reading, Unbaked, contrast, identity};
use crate::light::LightingCondition;
use crate::math::Rgb;
use crate::measure::MeasurementPoints;
use crate::model::{Basis, Choice, HeldOut, Model, Separation, TrainingRecord, Transfer, negative_shares};
use crate::progress::Progress;
use crate::scene::{Asset, Finish, Lightmap, Tracer, lay_out};
use crate::scene_file::SceneFile;
use crate::transfer::gamma::{Judged, errors_of_global, errors_of_local};
use crate::transfer::{Fit, Gram, HeldOutErrors, LocalFit, Method, Prior, PriorSums, Terms, TransferError, fit_scope};
use crate::transport::{Adjoint, BakeSettings};

use super::choose::{Held, draw};
use super::storage::{Place, baked_settings};
use super::{Failure, Reporter};

/// An asset with its lightmap laid out.
pub struct Prepared {
    pub scene: SceneFile,
    pub asset: Asset,
    pub lightmap: Lightmap,
    /// Settings that were chosen for the user.
    pub choices: Vec<Choice>,
}

/// A dataset with what all fits need of it.
pub struct Ready {
    pub points: MeasurementPoints,
    pub dataset: Dataset,
    pub gram: Gram,
    pub bake_seconds: f64,
}

/// A trained model with what it was trained from.
pub struct Trained {
    pub model: Model,
    pub dataset: Dataset,
    pub gram: Gram,
    /// The global fit that a local basis was fitted to, if it is local.
    pub fit: Fit,
    pub errors: HeldOutErrors,
    /// Per texel; 0 where it is not known.
    pub paths: u32,
    pub bake_seconds: f64,
    pub train_seconds: f64,
}

/// Loads the asset and lays out its lightmap, telling what was chosen and what was repaired. `place` names the settings in an
/// error.
pub fn prepare(scene: SceneFile, place: &str, reporter: &Reporter) -> Result<Prepared, Failure> {
    let mut asset = scene.load_asset(place)?;
    let choice = lay_out(&mut asset, scene.lightmap.size, scene.lightmap.uv)?;
    for warning in &asset.warnings {
        reporter.note(&format!("warning: {}: {warning}", asset.name));
    }
    for reason in &choice.reasons {
        reporter.note(&format!("lightmap: {reason}"));
    }
    let lightmap = Lightmap::open(&Tracer::new(&asset), scene.lightmap.size as usize);
    if lightmap.astride > 0 {
        let astride = lightmap.astride;
        reporter.note(&format!(
            "lightmap: {astride} texels lie astride walls thinner than a texel, where light may leak; a larger \
             lightmap.size parts them, and lightmap.uv = \"unwrap\" cuts charts along walls"
        ));
    }
    Ok(Prepared { scene, asset, lightmap, choices: Vec::new() })
}

impl Prepared {
    /// Back from a model: the same asset, layout and settings that it was trained with.
    pub fn from_model(model: &Model, place: &Path) -> Result<Self, Failure> {
        let scene: SceneFile = toml::from_str(&model.record.scene).map_err(|e| {
            Failure::Input(format!("{}: damaged: its scene settings do not parse: {}", place.display(), e.message()))
        })?;
        scene.check(&place.display().to_string())?;
        let lightmap = Lightmap::open(&Tracer::new(&model.asset), scene.lightmap.size as usize);
        Ok(Self { scene, asset: model.asset.clone(), lightmap, choices: model.record.choices.clone() })
    }

    /// What lays this lightmap's values out over the page.
    pub fn finish(&self, tracer: &Tracer) -> Finish {
        Finish::new(tracer, &self.lightmap, self.scene.bake.denoises())
    }

    pub fn bake_settings(&self) -> BakeSettings {
        let bake = &self.scene.bake;
        BakeSettings { paths: bake.paths, max_bounces: bake.max_bounces, seed: bake.seed, integrator: bake.integrator }
    }

    /// Places points, draws conditions and bakes those that the dataset's folder does not have; or reads what another renderer
    /// rendered.
    pub(super) fn dataset(
        &self,
        tracer: &Tracer,
        place: &Place,
        reporter: &Reporter,
    ) -> Result<(MeasurementPoints, Dataset), Failure> {
        let (settings, bake) = (&self.scene.points, &self.scene.bake);
        let points = MeasurementPoints::place(&self.asset, settings.count, settings.sub_points(), bake.seed)?;
        if let Some(rendered) = &place.rendered {
            let (training, held_out) = (bake.conditions.first(), bake.held_out);
            let (lightmap, memory) = (&self.lightmap, place.memory);
            let reading = Reading { tracer, lightmap, points: &points, training, held_out, memory };
            reporter.keeps_in(&place.folder);
            let dataset = rendered.dataset(&reading, &place.folder, reporter)?;
            return Ok((points, dataset));
        }
        let draw = draw(&self.scene);
        let conditions = draw.conditions(tracer, bake.seed)?;
        let dataset = self.bake(&self.scene, tracer, &points, conditions, draw.training, place, reporter)?;
        Ok((points, dataset))
    }

    /// Opens or bakes the dataset of `scene`'s settings in the folder of `place`.
    #[expect(clippy::too_many_arguments, reason = "one of each kind")]
    pub fn bake(
        &self,
        scene: &SceneFile,
        tracer: &Tracer,
        points: &MeasurementPoints,
        conditions: Vec<LightingCondition>,
        training: usize,
        place: &Place,
        reporter: &Reporter,
    ) -> Result<Dataset, Failure> {
        let settings = self.bake_settings();
        let job = Job {
            tracer,
            lightmap: &self.lightmap,
            points,
            settings: &settings,
            identity: &identity(baked_settings(scene), &self.asset.hash(), &self.lightmap),
            memory: place.memory,
        };
        reporter.keeps_in(&place.folder);
        Ok(Dataset::in_folder(&place.folder, &job, conditions, training, reporter)?)
    }

    /// Chooses what is to be chosen, bakes and trains.
    pub fn choose_and_train(&mut self, place: &Place, held: Held, reporter: &Reporter) -> Result<Trained, Failure> {
        self.check_counts()?;
        let ready = self.choose(place, held, reporter)?;
        self.train_from(ready, place, reporter)
    }

    /// Bakes and trains.
    pub fn train(&self, place: &Place, reporter: &Reporter) -> Result<Trained, Failure> {
        self.train_from(None, place, reporter)
    }

    /// Refuses more elements than conditions before anything is baked.
    fn check_counts(&self) -> Result<(), Failure> {
        let (all, elements) = (self.scene.bake.conditions.first(), self.scene.train.elements());
        if all < elements {
            return Err(TransferError::TooFewConditions { kept: all, all, elements }.into());
        }
        Ok(())
    }

    fn train_from(&self, ready: Option<Ready>, place: &Place, reporter: &Reporter) -> Result<Trained, Failure> {
        if ready.is_none() {
            self.check_counts()?;
            place.check_training(&self.scene, self.lightmap.texels.len())?;
        }
        let tracer = Tracer::new(&self.asset);
        let ready = ready.map_or_else(|| self.ready(&tracer, place, reporter), Ok)?;
        let Ready { points, dataset, gram, bake_seconds } = ready;
        let start = Instant::now();
        let settings = self.train_settings();
        let gamma = self.scene.train.gamma();
        // In gamma space the fit has the roots of everything.
        let raised = if gamma == 1.0 {
            None
        } else {
            let roots = dataset.roots(gamma);
            let gram = Gram::of(&roots, reporter)?;
            Some((roots, gram))
        };
        let (fitted, fitted_gram) = raised.as_ref().map_or((&dataset, &gram), |(roots, gram)| (roots, gram));
        let fit = Fit::train(fitted, fitted_gram, settings)?;
        if fit.dropped > 0 {
            reporter
                .note(&format!("{} of {} conditions light nothing and were dropped", fit.dropped, dataset.training));
        }
        let told = self.is_told().then_some(&fit);
        let (prior, contrast) = self.of_unbaked(told, &tracer, &points, &dataset, reporter)?;
        let scope = fit_scope(&contrast, self.scene.bake.seed)?;
        drop(contrast);
        let fit = match &prior {
            Some(prior) => fit.with_prior(&dataset, prior)?,
            None => fit,
        };
        let finish = self.finish(&tracer);
        let lit: Vec<usize> = dataset.held_out().filter(|&h| gram.is_lit(h)).collect();
        let judged = Judged { gamma, conditions: &lit };
        let (mut basis, mut transfer, errors) = match settings.method {
            Method::Local => self.train_local(&finish, &fit, fitted, fitted_gram, judged, reporter)?,
            Method::Belcour | Method::Linear => {
                let errors = match gamma {
                    1.0 => HeldOutErrors::of(&fit, fitted, fitted_gram),
                    _ => errors_of_global(&fit, fitted, fitted_gram, judged, reporter)?,
                };
                let (values, transfer) = fit.expand(fitted, reporter)?;
                (Basis::from_texels(&finish, transfer.elements, &values), transfer, errors)
            }
        };
        (basis.gamma, transfer.gamma) = (gamma, gamma);
        // As files and GPUs have it.
        let transfer = transfer.rounded();
        drop(raised);
        let negative = self.negative(&basis, &transfer, &dataset);
        let (scope, separation) = scope.unzip();
        let mut record = self.record(&dataset, &fit, &errors, negative, separation.unwrap_or_default());
        if gamma == 1.0 {
            record.shortages = self.shortages(&tracer, place, (&fit, prior.as_ref(), &errors), (&dataset, &gram))?;
        }
        let model = Model { asset: self.asset.clone(), points, basis, transfer, scope, record };
        let train_seconds = start.elapsed().as_secs_f64();
        let paths = place.rendered.as_ref().map_or(self.scene.bake.paths, |r| r.samples().unwrap_or(0));
        Ok(Trained { model, dataset, gram, fit, errors, paths, bake_seconds, train_seconds })
    }

    /// Whether the fit is told a prior. Paths carry light, not its roots.
    pub(super) fn is_told(&self) -> bool {
        let train = &self.scene.train;
        train.prior && train.method != Method::Belcour && train.gamma() == 1.0
    }

    /// What lights that are not baked tell: the transfer of `fit`, if it is asked for, by paths from the texels, and what the
    /// scenario's light looks like beside other light.
    pub(super) fn of_unbaked(
        &self,
        fit: Option<&Fit>,
        tracer: &Tracer,
        points: &MeasurementPoints,
        dataset: &Dataset,
        reporter: &Reporter,
    ) -> Result<(Option<Prior>, Contrast), Failure> {
        let adjoint = || Adjoint::new(tracer, &self.lightmap, points, self.bake_settings());
        let mut sums = fit.map(|fit| PriorSums::new(fit, dataset, &adjoint(), reporter)).transpose()?;
        let mut contrast = Contrast::new(dataset.held_out().map(|h| dataset.direct(h)).collect());
        let own = if sums.is_some() { OF_SCENARIO } else { contrast::OWN };
        let unbaked = Unbaked { tracer, points, scenario: &self.scene.scenario, seed: self.scene.bake.seed, own };
        unbaked.for_each(&mut |measured| {
            if let Some(sums) = &mut sums {
                sums.add(measured);
            }
            contrast.add(measured);
        })?;
        Ok((sums.map(PriorSums::finish).transpose()?, contrast))
    }

    /// A local basis from the global `fit`.
    fn train_local(
        &self,
        finish: &Finish,
        fit: &Fit,
        dataset: &Dataset,
        gram: &Gram,
        judged: Judged,
        reporter: &Reporter,
    ) -> Result<(Basis, Transfer, HeldOutErrors), Failure> {
        let train = &self.scene.train;
        let terms = Terms::new(fit, dataset, &self.places(), train.anchors, reporter)?;
        let local = LocalFit::train(&terms, train.elements(), train.precision());
        let errors = match judged.gamma {
            1.0 => HeldOutErrors::of_local(&local, &terms, train.channels, dataset, gram, reporter)?,
            _ => errors_of_local(&local, &terms, train.channels, dataset, gram, judged, reporter)?,
        };
        let basis = local.page(&terms, finish.sources(), &|planes| finish.path_traced_pages(planes));
        Ok((basis, local.transfer(&terms, train.channels), errors))
    }

    /// Position and normal of each texel.
    pub fn places(&self) -> Vec<(Vec3, Vec3)> {
        self.lightmap.spots(&self.asset.mesh).into_iter().map(|spot| (spot.centre, spot.normal)).collect()
    }

    /// Mean share of negative light under the held-out conditions.
    fn negative(&self, basis: &Basis, transfer: &Transfer, dataset: &Dataset) -> f64 {
        let texels: Vec<(usize, f32)> = self.lightmap.texels.iter().map(|t| (t.index as usize, t.area)).collect();
        let held_out: Vec<Vec<Rgb>> = dataset.held_out().map(|h| dataset.direct(h)).collect();
        let shares = negative_shares(basis, transfer, &texels, &held_out);
        shares.iter().sum::<f64>() / shares.len().max(1) as f64
    }

    /// How the model was trained and how good it is.
    fn record(
        &self,
        dataset: &Dataset,
        fit: &Fit,
        errors: &HeldOutErrors,
        negative: f64,
        separation: Vec<Separation>,
    ) -> TrainingRecord {
        let summary = errors.summary();
        let noise = &dataset.noise[dataset.held_out()];
        let noise = noise.iter().map(|&n| n as f64).sum::<f64>() / noise.len().max(1) as f64;
        TrainingRecord {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            scene: toml::to_string(&self.scene).expect("settings hold nothing that TOML cannot"),
            asset_hash: self.asset.hash(),
            conditions: dataset.training,
            dropped: fit.dropped,
            lambda: fit.lambda,
            prior: fit.prior,
            held_out: HeldOut {
                conditions: errors.transfer.len(),
                mean: summary.mean,
                median: summary.median,
                worst: summary.worst,
                oracle_mean: summary.oracle_mean,
                noise: noise.is_finite().then_some(noise),
                negative,
            },
            separation,
            choices: self.choices.clone(),
            shortages: Vec::new(),
        }
    }
}
