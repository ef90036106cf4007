//! Whether a fit ever blows up: every scene, kind of light, seed, number of conditions and number of points. Prints for each
//! scene and kind the worst fit of each method; exit status 1 if a mean error of `linear` or `local` is over 100 % or not a
//! number. `linear` and `local` are fitted as a training does by default, with what paths tell beforehand. The paper's baseline as
//! published stands beside them.
//!
//!     cargo bench --bench robustness [-- SCENE ... KIND ...] [--seeds 10] [--first-seed 0]
//!         [--fewest-conditions 16] [--most-points 1024]
//!
//! Lightmaps are small and baked with few paths: it is the fit that is tried, with more noise than it is ever given. The most
//! conditions are tried mono and without the baseline, whose worst are elsewhere.

use std::process::ExitCode;

use glam::Vec3;
use relight::dataset::{Dataset, Draw, Indirect, Measured, OF_SCENARIO, Unbaked};
use relight::light::{EmissionFacets, Kind, KindWeights, LightTable, Scenario, ScenarioError};
use relight::measure::MeasurementPoints;
use relight::model::Channels;
use relight::progress::Silent;
use relight::scene::{Lightmap, Tracer, UvPolicy, generate, lay_out};
use relight::transfer::{
    Fit, Gram, HeldOutErrors, Lambda, LocalFit, Method, PUBLISHED_LAMBDA, Precision, Prior, PriorSums, Spectrum, Terms,
    TrainSettings, TransferError,
};
use relight::transport::{Adjoint, BakeSettings, Integrator, bake};

/// Scenes, and sides of their lightmaps.
const SCENES: [(&str, u32); 3] = [("cornell", 32), ("interior", 64), ("statue", 32)];
const CONDITIONS: [usize; 5] = [16, 32, 64, 256, 1024];
/// Beyond these only ours are tried, mono.
const ALL_FITS: usize = 256;
const HELD_OUT: usize = 64;
const POINTS: [usize; 4] = [16, 64, 256, 1024];
/// The methods, with their λ and basis elements or channels a texel.
const METHODS: [(Method, Lambda, usize); 3] = [
    (Method::Linear, Lambda::LeaveOneOut, 16),
    (Method::Local, Lambda::LeaveOneOut, 4),
    (Method::Belcour, PUBLISHED_LAMBDA, 16),
];
/// Of `local`: as many texels an anchor as a lightmap of 128² has with the default.
const ANCHORS: usize = 16;
const PATHS: u32 = 16;
/// Of all points together, a quarter of what a training has by default, so that direct light is noisier, too.
const SUB_POINTS: usize = 1024;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let option = |name: &str, default: u64| -> u64 {
        arguments.iter().position(|a| a == name).map_or(default, |i| arguments[i + 1].parse().expect("a number"))
    };
    let (first, seeds) = (option("--first-seed", 0), option("--seeds", 10));
    let (fewest, most_points) = (option("--fewest-conditions", 16) as usize, option("--most-points", 1024) as usize);
    // Names of scenes and of kinds of light; of each, all where none is named.
    let chosen = |name: &str, all: &[&str]| {
        !all.iter().any(|other| arguments.iter().any(|a| a == other)) || arguments.iter().any(|a| a == name)
    };
    let kinds: Vec<Kind> = KindWeights::default().all().into_iter().map(|(kind, _)| kind).collect();
    let kind_names: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
    let mut worst: [Worst; METHODS.len()] = Default::default();
    for (scene, size) in SCENES.into_iter().filter(|(scene, _)| chosen(scene, &SCENES.map(|(name, _)| name))) {
        let mut asset = generate(scene).expect("a scene of our own");
        lay_out(&mut asset, size, UvPolicy::Auto).expect("it unwraps");
        let tracer = Tracer::new(&asset);
        let lightmap = Lightmap::open(&tracer, size as usize);
        for &kind in kinds.iter().filter(|kind| chosen(kind.name(), &kind_names)) {
            let scenario = Scenario { kinds: KindWeights::only(kind), ..Scenario::default() };
            let mut here: [Worst; METHODS.len()] = Default::default();
            for seed in first..first + seeds {
                match Case::new(&tracer, &lightmap, scenario.clone(), seed) {
                    Ok(case) => case.fits(fewest, most_points, &mut here),
                    // Environments need images, and nothing of these scenes emits but what the Cornell box does.
                    Err(
                        ScenarioError::Environment(_) | ScenarioError::Setting { .. } | ScenarioError::NothingEmits,
                    ) => break,
                    Err(error) => println!("{scene} {}: {error}", kind.name()),
                }
            }
            for ((here, worst), (method, ..)) in here.into_iter().zip(&mut worst).zip(METHODS) {
                if here.fits > 0 {
                    println!("{scene:>9} {:<12} {:<8} {}", kind.name(), method.name(), here.line());
                }
                worst.merge(here, &format!("{scene} {}", kind.name()));
            }
        }
    }
    println!("\nworst of all");
    for (worst, (method, ..)) in worst.iter().zip(METHODS) {
        println!("{:<8} {}", method.name(), worst.line());
    }
    let own = worst.iter().zip(METHODS).filter(|(_, (method, ..))| *method != Method::Belcour);
    if own.map(|(worst, _)| worst.bad).sum::<usize>() == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// A bake that many fits are made from.
struct Case<'a> {
    tracer: &'a Tracer<'a>,
    lightmap: &'a Lightmap,
    scenario: Scenario,
    settings: BakeSettings,
    /// Position and normal of each texel.
    spots: Vec<(Vec3, Vec3)>,
    dataset: Dataset,
    seed: u64,
}

impl<'a> Case<'a> {
    fn new(
        tracer: &'a Tracer<'a>,
        lightmap: &'a Lightmap,
        scenario: Scenario,
        seed: u64,
    ) -> Result<Self, ScenarioError> {
        let training = CONDITIONS[CONDITIONS.len() - 1];
        let conditions = Draw { scenario: &scenario, training, held_out: HELD_OUT }.conditions(tracer, seed)?;
        let settings = BakeSettings { paths: PATHS, max_bounces: 8, seed, integrator: Integrator::Auto };
        let baked = bake(tracer, lightmap, &conditions, &settings, &Silent).expect("nobody stops it");
        let dataset = Dataset {
            training,
            direct: Vec::new(),
            indirect: Indirect::Memory(baked.indirect),
            texel_areas: lightmap.texels.iter().map(|t| t.area).collect(),
            noise: baked.noise,
            conditions,
        };
        let spots = lightmap.spots(&tracer.asset().mesh).into_iter().map(|spot| (spot.centre, spot.normal)).collect();
        Ok(Self { tracer, lightmap, scenario, settings, spots, dataset, seed })
    }

    /// Fits every method from every number of conditions, from `fewest` on, and of points, up to `most_points`.
    fn fits(&self, fewest: usize, most_points: usize, worst: &mut [Worst; METHODS.len()]) {
        let tried = CONDITIONS.into_iter().filter(|&n| n >= fewest);
        let mut parts: Vec<(Dataset, Gram)> = tried.map(|training| self.part(training)).collect();
        for points in POINTS.into_iter().filter(|&p| p <= most_points) {
            let (asset, each) = (self.tracer.asset(), (SUB_POINTS / points).max(1));
            let placed = MeasurementPoints::place(asset, points, each, self.seed).expect("room");
            let emission = EmissionFacets::of(asset);
            let table = LightTable::from_conditions(&self.dataset.conditions, &emission);
            let direct = placed.direct_matrix(self.tracer, &table);
            let unbaked = self.unbaked(&placed);
            for (dataset, gram) in &mut parts {
                let training = dataset.training;
                dataset.direct = self.columns(&direct, training);
                let all_channels = [Channels::Mono, Channels::Multi];
                for &channels in &all_channels[..if training > ALL_FITS { 1 } else { 2 }] {
                    let what = format!("{channels:?}, N {training}, P {points}, seed {}", self.seed);
                    let settings = |method: usize| {
                        let (method, lambda, elements) = METHODS[method];
                        TrainSettings { method, channels, elements, lambda }
                    };
                    // `local`, and what paths tell, start from the same decompositions as `linear`.
                    let ours = decomposed(dataset, gram, settings(0)).and_then(|spectrum| {
                        let prior = self.prior(&spectrum.fit(settings(1))?, dataset, &placed, &unbaked)?;
                        Ok((spectrum, Some(prior)))
                    });
                    let published = (training <= ALL_FITS)
                        .then(|| decomposed(dataset, gram, settings(2)).map(|spectrum| (spectrum, None)));
                    for (method, from) in [Some(&ours), Some(&ours), published.as_ref()].into_iter().enumerate() {
                        match from {
                            Some(Ok((spectrum, prior))) => {
                                let error = self.error(spectrum, dataset, gram, settings(method), prior.as_ref());
                                worst[method].add(error.as_ref(), &what);
                            }
                            Some(Err(error)) => worst[method].add(Err(error), &what),
                            None => {}
                        }
                    }
                }
            }
        }
    }

    /// What paths tell of the transfer, for the basis of `local` and that of `linear`, which are the first of its elements.
    fn prior(
        &self,
        fit: &Fit,
        dataset: &Dataset,
        points: &MeasurementPoints,
        unbaked: &[Measured],
    ) -> Result<Prior, TransferError> {
        let adjoint = Adjoint::new(self.tracer, self.lightmap, points, self.settings);
        let mut sums = PriorSums::new(fit, dataset, &adjoint, &Silent)?;
        unbaked.iter().for_each(|measured| sums.add(measured));
        sums.finish()
    }

    /// Direct light that is not baked.
    fn unbaked(&self, points: &MeasurementPoints) -> Vec<Measured> {
        let (tracer, scenario) = (self.tracer, &self.scenario);
        let unbaked = Unbaked { tracer, points, scenario, seed: self.seed, own: OF_SCENARIO };
        let mut all = Vec::new();
        unbaked.for_each(&mut |measured| all.push(measured.clone())).expect("it was drawn from before");
        all
    }

    /// Mean held-out error of one fit.
    fn error(
        &self,
        spectrum: &Spectrum,
        dataset: &Dataset,
        gram: &Gram,
        settings: TrainSettings,
        prior: Option<&Prior>,
    ) -> Result<f64, TransferError> {
        let fit = spectrum.fit(settings)?;
        let fit = match prior {
            Some(prior) => fit.with_prior(dataset, prior)?,
            None => fit,
        };
        let errors = if settings.method == Method::Local {
            let terms = Terms::new(&fit, dataset, &self.spots, ANCHORS, &Silent)?;
            let local = LocalFit::train(&terms, settings.elements, Precision::Byte);
            HeldOutErrors::of_local(&local, &terms, settings.channels, dataset, gram, &Silent)?
        } else {
            HeldOutErrors::of(&fit, dataset, gram)
        };
        Ok(errors.summary().mean)
    }

    /// The first `training` conditions, and those held out.
    fn part(&self, training: usize) -> (Dataset, Gram) {
        let all = &self.dataset;
        let kept: Vec<usize> = (0..training).chain(all.held_out()).collect();
        let Indirect::Memory(values) = &all.indirect else { unreachable!("baked in memory") };
        let dataset = Dataset {
            training,
            conditions: kept.iter().map(|&c| all.conditions[c].clone()).collect(),
            direct: Vec::new(),
            indirect: Indirect::Memory(self.columns(values, training)),
            texel_areas: all.texel_areas.clone(),
            noise: kept.iter().map(|&c| all.noise[c]).collect(),
        };
        let gram = Gram::of(&dataset, &Silent).expect("finite");
        (dataset, gram)
    }

    /// Of rows over all conditions those over the first `training` and those held out.
    fn columns(&self, rows: &[f32], training: usize) -> Vec<f32> {
        let of_row = |row: &[f32]| [&row[..training], &row[self.dataset.training..]].concat();
        rows.chunks(self.dataset.conditions.len()).flat_map(of_row).collect()
    }
}

/// Decomposed for fits of any size.
fn decomposed(dataset: &Dataset, gram: &Gram, settings: TrainSettings) -> Result<Spectrum, TransferError> {
    Spectrum::of(dataset, gram, TrainSettings { elements: 1, ..settings })
}

/// The fit with the largest mean error.
#[derive(Default)]
struct Worst {
    fits: usize,
    refused: usize,
    /// Over 100 %, or not a number.
    bad: usize,
    error: f64,
    what: String,
}

impl Worst {
    fn add(&mut self, error: Result<&f64, &TransferError>, what: &str) {
        let (error, what) = match error {
            Ok(&error) => (error, what.to_owned()),
            // Refused, with the reason: no blow-up.
            Err(TransferError::TooFewConditions { .. }) => {
                self.refused += 1;
                return;
            }
            Err(error) => (f64::NAN, format!("{what}: {error}")),
        };
        self.fits += 1;
        // Written so that NaN is bad; it also is the greatest.
        let fine = error <= 1.0;
        self.bad += usize::from(!fine);
        if self.error.total_cmp(&error).is_lt() {
            (self.error, self.what) = (error, what);
        }
    }

    fn merge(&mut self, other: Worst, place: &str) {
        self.fits += other.fits;
        self.refused += other.refused;
        self.bad += other.bad;
        if self.error.total_cmp(&other.error).is_lt() {
            (self.error, self.what) = (other.error, format!("{place}, {}", other.what));
        }
    }

    fn line(&self) -> String {
        let Worst { fits, refused, bad, error, what } = self;
        format!("{fits:>5} fits, {refused} refused, {bad} over 100 %; worst {:.1} % ({what})", 100.0 * error)
    }
}
