//! Whether a fit ever blows up: every scene, kind of light, seed, number of conditions and number of points. Prints for each
//! scene and kind the worst fit of `linear`, and beside it that of the paper's baseline as published; exit status 1 if a mean
//! error of `linear` is over 100 % or not a number.
//!
//!     cargo bench --bench robustness [-- SCENE ...] [--seeds 10]
//!
//! Lightmaps are small and baked with few paths: it is the fit that is tried, with more noise than it is ever given. All seeds
//! are tried with up to 256 conditions; the first with 1,024, too, mono.

use std::process::ExitCode;

use relight::dataset::{Dataset, Draw, Indirect};
use relight::light::{KindWeights, Scenario, ScenarioError};
use relight::measure::MeasurementPoints;
use relight::model::Channels;
use relight::progress::Silent;
use relight::scene::{Lightmap, Tracer, UvPolicy, generate, lay_out};
use relight::transfer::{Fit, Gram, HeldOutErrors, Lambda, Method, PUBLISHED_LAMBDA, TrainSettings, TransferError};
use relight::transport::{BakeSettings, Integrator, bake};

/// Scenes, and sides of their lightmaps.
const SCENES: [(&str, u32); 3] = [("cornell", 32), ("interior", 64), ("statue", 32)];
const CONDITIONS: [usize; 5] = [16, 32, 64, 256, 1024];
/// Seeds but the first stop here.
const ALL_SEEDS: usize = 256;
const HELD_OUT: usize = 64;
const POINTS: [usize; 4] = [16, 64, 256, 1024];
const ELEMENTS: usize = 16;
const PATHS: u32 = 16;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let seeds =
        arguments.iter().position(|a| a == "--seeds").map_or(10, |i| arguments[i + 1].parse().expect("a number"));
    let wanted = |scene: &str| {
        SCENES.iter().all(|(s, _)| !arguments.iter().any(|a| a == s)) || arguments.iter().any(|a| a == scene)
    };
    let (mut worst, mut worst_published) = (Worst::default(), Worst::default());
    for (scene, size) in SCENES.into_iter().filter(|(scene, _)| wanted(scene)) {
        let mut asset = generate(scene).expect("a scene of our own");
        lay_out(&mut asset, size, UvPolicy::Auto).expect("it unwraps");
        let tracer = Tracer::new(&asset);
        let lightmap = Lightmap::open(&tracer, size as usize);
        for (kind, _) in KindWeights::default().all() {
            let scenario = Scenario { kinds: KindWeights::only(kind), ..Scenario::default() };
            let (mut here, mut published) = (Worst::default(), Worst::default());
            for seed in 0..seeds {
                let training = if seed == 0 { CONDITIONS[CONDITIONS.len() - 1] } else { ALL_SEEDS };
                match Case::new(&tracer, &lightmap, &scenario, training, seed) {
                    Ok(case) => case.fits(&mut here, &mut published),
                    // Environments need images, and nothing of these scenes emits but what the Cornell box does.
                    Err(
                        ScenarioError::Environment(_) | ScenarioError::Setting { .. } | ScenarioError::NothingEmits,
                    ) => break,
                    Err(error) => println!("{scene} {}: {error}", kind.name()),
                }
            }
            if here.fits > 0 {
                println!("{scene:>9} {:<12} {}", kind.name(), here.line());
                println!("{:>9} {:<12} {}", "", "as published", published.line());
            }
            worst.merge(here, &format!("{scene} {}", kind.name()));
            worst_published.merge(published, &format!("{scene} {}", kind.name()));
        }
    }
    println!("\nworst of all: {}\nas published: {}", worst.line(), worst_published.line());
    if worst.bad == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// A bake that many fits are made from.
struct Case<'a> {
    tracer: &'a Tracer<'a>,
    dataset: Dataset,
    seed: u64,
}

impl<'a> Case<'a> {
    fn new(
        tracer: &'a Tracer<'a>,
        lightmap: &Lightmap,
        scenario: &Scenario,
        training: usize,
        seed: u64,
    ) -> Result<Self, ScenarioError> {
        let conditions = Draw { scenario, training, held_out: HELD_OUT }.conditions(tracer, seed)?;
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
        Ok(Self { tracer, dataset, seed })
    }

    /// Fits every method from every number of conditions and points.
    fn fits(&self, own: &mut Worst, published: &mut Worst) {
        let all = &self.dataset;
        for training in CONDITIONS.into_iter().filter(|&n| n <= all.training) {
            let mut dataset = self.part(training);
            let gram = Gram::of(&dataset, &Silent).expect("finite");
            for points in POINTS {
                let placed =
                    MeasurementPoints::place(self.tracer.asset(), points, 8, self.seed).expect("room for them");
                let emission = relight::light::EmissionFacets::of(self.tracer.asset());
                let table = relight::light::LightTable::from_conditions(&dataset.conditions, &emission);
                dataset.direct = placed.direct_matrix(self.tracer, &table);
                for (method, lambda) in [(Method::Linear, Lambda::LeaveOneOut), (Method::Belcour, PUBLISHED_LAMBDA)] {
                    let worst = if method == Method::Belcour { &mut *published } else { &mut *own };
                    let all_channels = [Channels::Mono, Channels::Multi];
                    for &channels in &all_channels[..if training > ALL_SEEDS { 1 } else { 2 }] {
                        let settings = TrainSettings { method, channels, elements: ELEMENTS, lambda };
                        let what = format!("{method:?} {channels:?}, N {training}, P {points}, seed {}", self.seed);
                        match Fit::train(&dataset, &gram, settings) {
                            Ok(fit) => worst.add(HeldOutErrors::of(&fit, &dataset, &gram).summary().mean, &what),
                            // Refused, with the reason: no blow-up.
                            Err(TransferError::TooFewConditions { .. }) => worst.refused += 1,
                            Err(error) => worst.add(f64::NAN, &format!("{what}: {error}")),
                        }
                    }
                }
            }
        }
    }

    /// The first `training` conditions, and those held out.
    fn part(&self, training: usize) -> Dataset {
        let all = &self.dataset;
        let n = all.conditions.len();
        let kept: Vec<usize> = (0..training).chain(all.held_out()).collect();
        let Indirect::Memory(values) = &all.indirect else { unreachable!("baked in memory") };
        Dataset {
            training,
            conditions: kept.iter().map(|&c| all.conditions[c].clone()).collect(),
            direct: Vec::new(),
            indirect: Indirect::Memory(values.chunks(n).flat_map(|row| kept.iter().map(|&c| row[c])).collect()),
            texel_areas: all.texel_areas.clone(),
            noise: kept.iter().map(|&c| all.noise[c]).collect(),
        }
    }
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
    fn add(&mut self, error: f64, what: &str) {
        self.fits += 1;
        // Written so that NaN is bad; it also is the greatest.
        let fine = error <= 1.0;
        self.bad += usize::from(!fine);
        if self.error.total_cmp(&error).is_lt() {
            (self.error, self.what) = (error, what.to_owned());
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
