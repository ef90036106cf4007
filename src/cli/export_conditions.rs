//! `relight export-conditions`: writes the lights to render for those who render elsewhere.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::choose::draw;
use super::pipeline::prepare;
use super::settings::Overrides;
use super::{Failure, Reporter};
use crate::dataset::Export;
use crate::measure::MeasurementPoints;
use crate::scene::Tracer;
use crate::scene_file::SceneFile;

/// Write the lights, the asset and its texels for another renderer, to train from its lightmaps
#[derive(Args)]
pub struct ExportConditions {
    /// A scene file, or a .glb, .gltf or .obj file
    pub scene: PathBuf,
    /// The folder; `relight train SCENE --dataset DIR` reads it when it is rendered
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
    #[command(flatten)]
    pub overrides: Overrides,
}

impl ExportConditions {
    pub fn run(&self, json: Option<&Path>, reporter: &Reporter) -> Result<(), Failure> {
        let mut scene = SceneFile::read(&self.scene)?;
        let place = self.scene.display().to_string();
        self.overrides.apply(&mut scene, &place)?;
        super::check_output(&self.output.join("conditions.json"))?;
        let prepared = prepare(scene, &place, reporter)?;
        let tracer = Tracer::new(&prepared.asset);
        let (bake, settings) = (&prepared.scene.bake, &prepared.scene.points);
        let points = MeasurementPoints::place(&prepared.asset, settings.count, settings.sub_points(), bake.seed)?;
        let draw = draw(&prepared.scene);
        let export = Export {
            asset: &prepared.asset,
            lightmap: &prepared.lightmap,
            points: &points,
            conditions: &draw.conditions(&tracer, bake.seed)?,
            training: draw.training,
            max_bounces: bake.max_bounces,
            seed: bake.seed,
            scene: serde_json::to_value(&prepared.scene).unwrap_or_default(),
        };
        export.write(&self.output)?;
        let (texels, folder) = (prepared.lightmap.texels.len(), self.output.display());
        say!(
            "wrote {folder}: {} conditions to train on, {} held out; {texels} texels, {} points",
            draw.training,
            draw.held_out,
            points.points.len()
        );
        say!("next: python render_mitsuba.py {folder}, or render_blender.py (in python/), or any renderer that");
        say!("keeps to docs/DATASET.md; then relight train {place} --dataset {folder} with the same settings");
        super::write_json(
            json,
            &json!({ "conditions": draw.training, "held_out": draw.held_out, "texels": texels, "points": points.points.len() }),
        )
    }
}
