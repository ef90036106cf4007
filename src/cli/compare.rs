//! `relight compare`: held-out error of this model, of the paper's baseline and of classical SH PRT, as a report.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::pipeline::{Prepared, Trained};
use super::storage::{Place, Storage};
use super::{Failure, Reporter};
use crate::dataset::{Dataset, Draw};
use crate::light::scenario::{KindWeights, Sky};
use crate::light::{EmissionFacets, LightTable, Scenario};
use crate::model::Model;
use crate::progress::Progress;
use crate::report::Row;
use crate::report::assemble::{Inputs, Scenery};
use crate::report::page::method_label;
use crate::scene::Tracer;
use crate::scene_file::SceneFile;
use crate::transfer::Gram;

/// Compare a model with the paper's baseline and with classical SH PRT
#[derive(Args)]
pub struct Compare {
    /// A model made by `relight train`
    pub model: PathBuf,
    /// The folder for report.html, errors.csv, comparison.json and images
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    /// Paths per pixel of the reference pictures
    #[arg(long, default_value_t = REFERENCE_PATHS, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub reference_paths: u32,
    #[command(flatten)]
    pub storage: Storage,
}

/// At this many paths a pixel the reference's noise hardly shows in a picture.
pub const REFERENCE_PATHS: u32 = 48;

/// Share of directional conditions that must light the asset for the distant scenario to be compared, too.
const LEAST_LIT: f64 = 0.25;

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
        compare(&prepared, &trained, &place, &self.output, self.reference_paths, json, reporter)
    }
}

/// Writes the report of `trained` to `folder` and prints the error table.
pub fn compare(
    prepared: &Prepared,
    trained: &Trained,
    place: &Place,
    folder: &Path,
    reference_paths: u32,
    json: Option<&Path>,
    reporter: &Reporter,
) -> Result<(), Failure> {
    let tracer = Tracer::new(&prepared.asset);
    let distant = distant(prepared, trained, place, &tracer, reporter)?;
    let prior_of = |scenario: &Scenario, dataset: &Dataset, gram: &Gram| {
        prepared.prior_of_all(scenario, &tracer, &trained.model.points, (dataset, gram), reporter)
    };
    let prior = prior_of(&prepared.scene.scenario, &trained.dataset, &trained.gram)?;
    let of_distant = match &distant {
        Some((dataset, gram)) => prior_of(&distant_scenario(), dataset, gram)?,
        None => None,
    };
    let own = Scenery { name: "as trained", dataset: &trained.dataset, gram: &trained.gram, prior: prior.as_ref() };
    let mut scenarios = vec![own];
    if let Some((dataset, gram)) = &distant {
        scenarios.push(Scenery { name: "distant lights", dataset, gram, prior: of_distant.as_ref() });
    }
    let inputs = Inputs {
        model: &trained.model,
        tracer: &tracer,
        lightmap: &prepared.lightmap,
        finish: &prepared.finish(&tracer),
        bake: prepared.bake_settings(),
        lambda: prepared.scene.train.lambda,
        places: &prepared.places(),
        anchors: prepared.scene.train.anchors,
        precision: prepared.scene.train.precision(),
        reference_paths,
        memory: place.memory,
        fit: &trained.fit,
        errors: &trained.errors,
        scenarios,
    };
    let report = inputs.assemble(reporter)?;
    let figures = json!({ "rows": report.page.rows, "views": report.views, "bake": { "bias": report.bias } });
    super::write_file(&folder.join("report.html"), report.page.to_html().as_bytes())?;
    super::write_file(&folder.join("comparison.json"), format!("{figures:#}\n").as_bytes())?;
    for (name, text) in &report.tables {
        super::write_file(&folder.join(name), text.as_bytes())?;
    }
    for (name, png) in &report.images {
        super::write_file(&folder.join("images").join(name), png)?;
    }
    if let Some(bias) = report.bias {
        let (relative, at_most) = (100.0 * bias.relative, 100.0 * bias.at_most);
        println!("bias of the gather integrator against path tracing: {relative:.2} %, at most {at_most:.2} %");
    }
    print_table(&report.page.rows);
    println!("wrote {} and {} images beside it", folder.join("report.html").display(), report.images.len());
    super::write_json(json, &figures)
}

/// Directional lights from everywhere.
fn distant_scenario() -> Scenario {
    Scenario {
        kinds: KindWeights { directional: 1.0, ..KindWeights::default() },
        sky: Sky::Everywhere,
        ..Scenario::default()
    }
}

/// The same asset under directional lights, trained and tested anew: what classical PRT is made for. None where distant light
/// hardly reaches the asset, as in a closed room.
fn distant(
    prepared: &Prepared,
    trained: &Trained,
    place: &Place,
    tracer: &Tracer,
    reporter: &Reporter,
) -> Result<Option<(Dataset, Gram)>, Failure> {
    let scenario = distant_scenario();
    if prepared.scene.scenario.kinds == scenario.kinds {
        return Ok(None);
    }
    let bake = &prepared.scene.bake;
    let draw =
        Draw { scenario: &scenario, training: bake.conditions.first().min(192), held_out: bake.held_out.min(96) };
    let settings = prepared.bake_settings();
    let conditions = draw.conditions(tracer, settings.seed)?;
    let table = LightTable::from_conditions(&conditions, &EmissionFacets::of(&prepared.asset));
    let points = &trained.model.points;
    let direct = points.direct_matrix(tracer, &table);
    let n = conditions.len();
    let is_lit = |c: usize| direct.chunks_exact(3 * n).any(|row| (0..3).any(|channel| row[channel * n + c] > 0.0));
    let lit: Vec<usize> = (0..n).filter(|&c| is_lit(c)).collect();
    if (lit.len() as f64) < LEAST_LIT * n as f64 {
        reporter.note(
            "distant light hardly reaches this asset: classical PRT is compared under the model's own scenario only",
        );
        return Ok(None);
    }
    // Suns that no measurement point sees would be dropped after the bake; they are not baked in the first place.
    let training = lit.iter().filter(|&&c| c < draw.training).count();
    let conditions = lit.iter().map(|&c| conditions[c].clone()).collect();
    let scene = SceneFile { scenario, ..prepared.scene.clone() };
    let place = Place { folder: place.folder.join("distant"), memory: place.memory, rendered: None };
    let dataset = prepared.bake(&scene, tracer, points, conditions, training, &place, reporter)?;
    let gram = Gram::of(&dataset, reporter)?;
    Ok(Some((dataset, gram)))
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
            println!("\nmean relative RMSE on held-out lights, {scenario}; in brackets the oracle");
        }
        let cells: Vec<String> = rows
            .iter()
            .filter(|r| (r.scenario.as_str(), r.method, r.lambda_choice) == group)
            .map(|r| {
                let oracle = r.oracle_mean.map_or(String::new(), |o| format!(" ({:.1})", 100.0 * o));
                format!("{}: {:.1}{oracle} %", r.coefficients, 100.0 * r.mean)
            })
            .collect();
        println!("  {:<34} {}", method_label(group.1, group.2), cells.join("   "));
    }
    println!();
}
