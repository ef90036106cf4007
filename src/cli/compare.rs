//! `relight compare`: held-out error of this model, of the paper's baseline and of classical SH PRT, as a report.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::pipeline::{Prepared, Trained};
use super::storage::{Place, Storage};
use super::study::{Set, Study, distant_scenario};
use super::{Failure, Reporter};
use crate::model::Model;
use crate::progress::Progress;
use crate::report::Row;
use crate::report::assemble::{Inputs, Scenery};
use crate::report::fits::{LOCAL_SIZES, PriorSource, Recipe, SIZES};
use crate::report::page::method_label;
use crate::report::table::with_spread;
use crate::report::temporal::Measured;
use crate::scene::Tracer;
use crate::transfer::Gram;

/// Compare a model with the paper's baseline and with classical SH PRT
#[derive(Args)]
pub struct Compare {
    /// A model made by `relight train`
    pub model: PathBuf,
    /// The folder for report.html, errors.csv, comparison.json and images
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    #[command(flatten)]
    pub scope: Scope,
    #[command(flatten)]
    pub storage: Storage,
}

impl Compare {
    pub fn run(&self, json: Option<&Path>, reporter: &Reporter) -> Result<(), Failure> {
        let model = Model::load(&self.model)?;
        super::check_output(&self.output.join("report.html"))?;
        let prepared = Prepared::from_model(&model, &self.model)?;
        // The dataset is a function of the scene settings and the seed: where its folder is gone, it is baked anew.
        let place = self.storage.place(&self.model)?;
        let trained = prepared.train(&place, reporter)?;
        if trained.model.record != model.record {
            reporter.note(&format!(
                "warning: {}: this build trains to another error ({:.2} % instead of {:.2} %); figures are this build's",
                self.model.display(),
                100.0 * trained.model.record.held_out.mean,
                100.0 * model.record.held_out.mean
            ));
        }
        compare(&prepared, &trained, &place, &self.output, self.scope, json, reporter)
    }
}

/// What is compared, and how thoroughly.
#[derive(Args, Clone, Copy, Debug)]
pub struct Scope {
    /// Paths per pixel of the reference pictures
    #[arg(long, default_value_t = 48, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub reference_paths: u32,
    /// Training sets, each of lights and measurement points of its own, over which errors have a mean and a spread; lights
    /// beyond those of the model are baked and kept in its dataset's folder
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=64))]
    pub seeds: u16,
    /// One training set, and only those figures that take seconds
    #[arg(long)]
    pub quick: bool,
}

impl Scope {
    /// For the run without a command.
    pub const QUICK: Self = Self { reference_paths: 48, seeds: 1, quick: true };
}

/// Writes the report of `trained` to `folder` and prints the error table.
pub fn compare(
    prepared: &Prepared,
    trained: &Trained,
    place: &Place,
    folder: &Path,
    scope: Scope,
    json: Option<&Path>,
    reporter: &Reporter,
) -> Result<(), Failure> {
    let tracer = Tracer::new(&prepared.asset);
    let seeds = if scope.quick { 1 } else { scope.seeds as usize };
    let study = Study::bake(prepared, trained, place, &tracer, (seeds, scope.quick), reporter)?;
    let own = Measured { dataset: &trained.dataset, points: &trained.model.points, tracer: &tracer };
    let of_set = |set| measured(set, &tracer);
    let sets = std::iter::once(own).chain(study.others.iter().map(of_set)).collect();
    let mut scenarios =
        vec![Scenery { name: "as trained", sets, gram: &trained.gram, scenario: &prepared.scene.scenario }];
    let distant_lights = distant_scenario();
    let distant = study.distant.first().map(|set| Gram::of(&set.dataset, reporter)).transpose()?;
    if let Some(gram) = &distant {
        let sets = study.distant.iter().map(of_set).collect();
        scenarios.push(Scenery { name: "distant lights", sets, gram, scenario: &distant_lights });
    }
    let train = &prepared.scene.train;
    let inputs = Inputs {
        model: &trained.model,
        tracer: &tracer,
        lightmap: &prepared.lightmap,
        finish: &prepared.finish(&tracer),
        bake: prepared.bake_settings(),
        recipe: Recipe {
            channels: trained.fit.settings.channels,
            lambda: train.lambda,
            places: &prepared.places(),
            anchors: train.anchors,
            precision: train.precision(),
            sizes: &SIZES,
            // The largest takes as long as all others together.
            local_sizes: if scope.quick { &LOCAL_SIZES[..3] } else { &LOCAL_SIZES },
            better_baseline: true,
            lightmap_size: prepared.lightmap.size,
            memory: place.memory,
            prior: train.prior.then(|| PriorSource {
                scenario: &prepared.scene.scenario,
                lightmap: &prepared.lightmap,
                bake: prepared.bake_settings(),
            }),
        },
        reference_paths: scope.reference_paths,
        fit: &trained.fit,
        errors: &trained.errors,
        scenarios,
        moving: study.moving.as_ref(),
        kinds: &study.kinds,
        quick: scope.quick,
    };
    let report = inputs.assemble(reporter)?;
    let figures = json!({
        "rows": report.rows,
        "views": report.views,
        "temporal": study.moving.as_ref().map(|m| {
            json!({ "paths": m.paths().count(), "frames": m.frames, "noise": report.noise_of_change })
        }),
        "seeds": seeds,
        "files": report.files.iter().map(|(name, _)| name).collect::<Vec<_>>(),
        "bake": { "bias": report.bias },
    });
    super::write_file(&folder.join("report.html"), report.page.to_html().as_bytes())?;
    super::write_file(&folder.join("comparison.json"), format!("{figures:#}\n").as_bytes())?;
    for (name, bytes) in &report.files {
        super::write_file(&folder.join(name), bytes)?;
    }
    if let Some(bias) = report.bias {
        let (relative, at_most) = (100.0 * bias.relative, 100.0 * bias.at_most);
        say!("bias of the gather integrator against path tracing: {relative:.2} %, at most {at_most:.2} %");
    }
    print_table(&report.rows);
    say!("wrote {} with {} files beside it", folder.join("report.html").display(), report.files.len());
    super::write_json(json, &figures)
}

fn measured<'a>(set: &'a Set, tracer: &'a Tracer<'a>) -> Measured<'a> {
    Measured { dataset: &set.dataset, points: &set.points, tracer }
}

/// Mean held-out error, one line per method, one column per size.
fn print_table(rows: &[Row]) {
    let mut groups: Vec<(&str, &str, Option<&str>)> = Vec::new();
    for row in rows {
        let group = (row.scenario.as_str(), row.method, row.lambda_choice);
        if !groups.contains(&group) {
            groups.push(group);
        }
    }
    let mut scenario = "";
    for group in groups {
        if group.0 != scenario {
            scenario = group.0;
            say!("\nmean relative RMSE on held-out lights, {scenario}; in brackets the oracle");
        }
        let cells: Vec<String> = rows
            .iter()
            .filter(|r| (r.scenario.as_str(), r.method, r.lambda_choice) == group)
            .map(|r| {
                let oracle = r.oracle_mean.map_or(String::new(), |o| format!(" ({:.1})", 100.0 * o));
                format!("{}: {}{oracle}", r.coefficients, with_spread(r.mean, r.spread))
            })
            .collect();
        say!("  {:<34} {}", method_label(group.1, group.2), cells.join("   "));
    }
    say!("");
}
