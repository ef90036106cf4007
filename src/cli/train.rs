//! `relight train`: bakes D and I, trains, tests on held-out lights, writes the model.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use serde_json::json;

use super::pipeline::{Prepared, Trained, prepare};
use super::settings::Overrides;
use super::storage::Storage;
use super::{Failure, Reporter};
use crate::dataset::Bytes;
use crate::model::{Choice, Shortage};
use crate::report::pictures;
use crate::scene::Tracer;
use crate::scene_file::SceneFile;

/// Train a transfer for an asset
#[derive(Args)]
pub struct Train {
    /// A scene file, or a .glb, .gltf or .obj file to train under spot lights around it; nothing: the Cornell box built in
    pub scene: Option<PathBuf>,
    /// Where the model goes [default: out/NAME.relight]
    #[arg(short, long, value_name = "MODEL")]
    pub output: Option<PathBuf>,
    /// Write pictures of the measurement points and of the first basis elements to this folder
    #[arg(long, value_name = "DIR")]
    pub debug_images: Option<PathBuf>,
    #[command(flatten)]
    pub storage: Storage,
    #[command(flatten)]
    pub overrides: Overrides,
}

impl Train {
    pub fn run(&self, json: Option<&Path>, reporter: &Reporter) -> Result<(), Failure> {
        let start = Instant::now();
        let (mut scene, name) = match &self.scene {
            Some(path) => (SceneFile::read(path)?, path.display().to_string()),
            None => (SceneFile::cornell(), "cornell".to_owned()),
        };
        self.overrides.apply(&mut scene, &name)?;
        // What cannot fit whatever the asset is refused before the asset is read.
        let place = self.storage.place(Path::new(""))?;
        if let Some(rendered) = &place.rendered {
            self.overrides.take(&mut scene, rendered);
        }
        place.check_training(&scene, 0)?;
        let mut prepared = prepare(scene, &name, reporter)?;
        let output = self.output.clone().unwrap_or_else(|| default_output(&prepared.asset.name));
        super::check_output(&output)?;
        let budget = prepared.scene.train.budget();
        let trained = prepared.choose_and_train(&self.storage.place(&output)?, self.overrides.held(), reporter)?;
        let bytes = trained.model.save(&output)?;
        if let Some(folder) = &self.debug_images {
            write_debug_images(folder, &prepared, &trained)?;
        }
        let figures = figures(&trained, bytes, start.elapsed().as_secs_f64());
        print_summary(&trained, &output, bytes);
        super::write_json(json, &figures)?;
        // The best there is was trained and written; whoever asked for less error should know, scripts too.
        let mean = trained.model.record.held_out.mean;
        match budget.max_error {
            Some(most) if mean > most => Err(Failure::Work(format!(
                "{}: its error is {:.2} %, over --max-error {most}; allow more bytes or error, or bake more (--conditions auto, \
                 --paths)",
                output.display(),
                100.0 * mean
            ))),
            _ => Ok(()),
        }
    }
}

/// Pictures of the points (paper, Figure 4) and of the basis.
fn write_debug_images(folder: &Path, prepared: &Prepared, trained: &Trained) -> Result<(), Failure> {
    let tracer = Tracer::new(&prepared.asset);
    let points = pictures::point_images(&tracer, &trained.model.points)?;
    for (name, image) in ["points", "sub-points"].iter().zip(points) {
        super::write_file(&folder.join(format!("{name}.png")), &image.png)?;
    }
    let basis = pictures::basis_images(&prepared.lightmap, &trained.model.basis);
    for (j, image) in basis.iter().enumerate() {
        super::write_file(&folder.join(format!("basis-{:02}.png", j + 1)), &image.png)?;
    }
    say!("wrote pictures of the points and the basis to {}", folder.display());
    Ok(())
}

/// `out/NAME.relight`.
pub fn default_output(name: &str) -> PathBuf {
    let safe: String = name.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect();
    Path::new("out").join(format!("{safe}.relight"))
}

/// What `--json` writes.
pub fn figures(trained: &Trained, model_bytes: u64, total_seconds: f64) -> serde_json::Value {
    let record = &trained.model.record;
    let held_out = &record.held_out;
    json!({
        "method": trained.fit.settings.method,
        "channels": trained.fit.settings.channels,
        "basis": trained.fit.settings.elements,
        "points": trained.model.points.points.len(),
        "conditions": record.conditions,
        "dropped": record.dropped,
        "held_out": held_out.conditions,
        "error": {
            "mean": held_out.mean,
            "median": held_out.median,
            "worst": held_out.worst,
            "oracle_mean": held_out.oracle_mean,
            "noise": held_out.noise,
            "negative": held_out.negative,
            "each": trained.errors.transfer,
        },
        "separation": record.separation,
        "lambda": record.lambda,
        "prior": record.prior,
        "choices": record.choices,
        "shortages": record.shortages,
        "anchors": trained.model.basis.anchors.as_ref().map(|a| a.count),
        "bytes_per_texel": trained.model.basis.bytes_per_texel(),
        "condition_number": trained.fit.condition_number,
        "seconds": { "bake": trained.bake_seconds, "train": trained.train_seconds, "total": total_seconds },
        "texels": trained.dataset.texels(),
        "paths_per_texel": trained.paths,
        "peak_bytes": Bytes::peak(),
        "model_bytes": model_bytes,
    })
}

/// What was chosen: a line for all that was chosen for one reason.
pub fn choice_lines(choices: &[Choice]) -> Vec<String> {
    let of_one_reason = choices.chunk_by(|a, b| a.why == b.why).map(|same| {
        let settings: Vec<String> = same.iter().map(|c| format!("{} = {}", c.setting, c.value)).collect();
        format!("{} ({})", settings.join(", "), same[0].why)
    });
    of_one_reason.collect()
}

/// What more of would lower the error, in one line.
pub fn shortage_line(shortage: &Shortage) -> String {
    let Shortage { setting, count, enough, error } = shortage;
    let (what, option) = match setting.as_str() {
        "points.count" => ("measurement points", "--points"),
        _ => ("conditions", "--conditions"),
    };
    let percent = 100.0 * error;
    format!(
        "warning: {count} {what} are too few: with {enough} the error would be about {percent:.1} % ({option} {enough})"
    )
}

/// The summary on stdout.
pub fn print_summary(trained: &Trained, output: &Path, bytes: u64) {
    let record = &trained.model.record;
    let held_out = &record.held_out;
    let percent = |x: f64| format!("{:.2} %", 100.0 * x);
    let anchors = trained.model.basis.anchors.as_ref();
    let anchors = anchors.map_or("elements".to_owned(), |a| format!("channels a texel, {} anchors", a.count));
    say!(
        "{} {anchors}, {} points, {} conditions: relative RMSE on {} held-out conditions",
        trained.fit.settings.elements,
        trained.model.points.points.len(),
        record.conditions,
        held_out.conditions
    );
    say!("  mean {}  median {}  worst {}", percent(held_out.mean), percent(held_out.median), percent(held_out.worst));
    say!(
        "  oracle {} (the best that this basis allows), noise of the lightmaps {}",
        percent(held_out.oracle_mean),
        held_out.noise.map_or("not known".to_owned(), percent)
    );
    say!("  negative light, clamped when shown: {} of the norm", percent(held_out.negative));
    choice_lines(&record.choices).iter().for_each(|line| say!("  chosen: {line}"));
    for shortage in &record.shortages {
        say!("  {}", shortage_line(shortage));
    }
    if let Some(weakest) = record.separation.iter().min_by(|a, b| a.auc.total_cmp(&b.auc)) {
        let kinds: Vec<&str> = record.separation.iter().map(|s| s.kind.as_str()).collect();
        say!(
            "  tells lights that it was not trained on ({}): AUC at least {:.3} ({})",
            kinds.join(", "),
            weakest.auc,
            weakest.kind
        );
    }
    let peak = Bytes::peak().map_or(String::new(), |peak| format!("; peak memory {:.0} MB", peak as f64 * 1e-6));
    say!("wrote {} ({:.1} MB){peak}", output.display(), bytes as f64 * 1e-6);
}
