//! `relight view`: the window.

use std::path::PathBuf;

use clap::Args;

use super::lights::{CAMERA_HELP, LIGHT_HELP, camera, defined, light_path, lights};
use super::render::parse_size;
use super::{Failure, Reporter};
use crate::light::Light;
use crate::model::{Model, Picture};
use crate::progress::Progress;
use crate::scene::{Asset, Tracer};
use crate::transport::reference::{Reference, ReferenceSettings};
use crate::viewer::{self, Opening};

/// Open a window and relight the asset with lights that you move
#[derive(Args)]
pub struct View {
    /// Models made by `relight train`, all of one asset; the second and later ones can be compared with the first
    #[arg(required = true)]
    pub models: Vec<PathBuf>,
    #[arg(long = "light", value_name = "LIGHT", help = LIGHT_HELP)]
    pub lights: Vec<String>,
    /// Lights that move, as for `relight render --path`: they play in a loop
    #[arg(long, value_name = "FILE", conflicts_with = "lights")]
    pub path: Option<PathBuf>,
    #[arg(long, value_name = "CAMERA", help = CAMERA_HELP)]
    pub camera: Option<String>,
    /// The window's size
    #[arg(long, default_value = "1440x810", value_name = "WIDTHxHEIGHT", value_parser = parse_size)]
    pub size: (u32, u32),
    /// What the names of saved pictures and lights begin with [default: the first model's name, here]
    #[arg(short, long, value_name = "STEM")]
    pub output: Option<PathBuf>,
}

impl View {
    pub fn run(&self, reporter: &Reporter) -> Result<(), Failure> {
        let mut models: Vec<(String, Model)> = Vec::new();
        for path in &self.models {
            let model = Model::load(path)?;
            let name = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
            if let Some((first, other)) = models.first()
                && other.record.asset_hash != model.record.asset_hash
            {
                return Err(Failure::Input(format!(
                    "{}: is of another asset, or lightmap, than {first}",
                    path.display()
                )));
            }
            models.push((name, model));
        }
        let asset = &models[0].1.asset;
        let path = self.path.as_deref().map(light_path).transpose()?;
        let opening = Opening {
            path,
            lights: if self.lights.is_empty() { own(asset) } else { lights(&self.lights, asset)? },
            camera: camera(self.camera.as_deref(), asset)?,
            path_trace,
            stem: self.output.clone().unwrap_or_else(|| models[0].0.clone().into()),
            size: [self.size.0 as f32, self.size.1 as f32],
            models: &models,
        };
        reporter.note(&format!("{}: press ? in the window for help", self.models[0].display()));
        Ok(viewer::run(opening)?)
    }
}

/// The lights of the asset's file; where it has none, a spot light at its middle.
fn own(asset: &Asset) -> Vec<Light> {
    let mut lights = defined(asset);
    if lights.is_empty() {
        let bounds = asset.mesh.bounds();
        let extent = bounds.diagonal();
        let position = bounds.centre() + glam::Vec3::new(0.12, 0.2, 0.15) * extent;
        lights.push(Light::Spot {
            position,
            direction: (bounds.centre() - position).normalize_or(glam::Vec3::NEG_Y),
            color: glam::Vec3::ONE,
            intensity: std::f32::consts::PI * (0.5 * extent).powi(2),
            range: None,
            inner_cone_angle: 0.4,
            outer_cone_angle: 0.6,
        });
    }
    lights
}

fn path_trace(
    tracer: &Tracer,
    view: &crate::model::View,
    lights: &[Light],
    samples: u32,
    seed: u64,
    progress: &dyn Progress,
) -> Option<[Picture; 2]> {
    let settings = ReferenceSettings { samples, max_bounces: 64, seed };
    let Reference { direct, indirect } = Reference::trace(tracer, view, lights, &settings, progress).ok()?;
    Some([direct, indirect])
}
