//! `relight render`: one picture of the relit asset, on the GPU or the CPU, or path traced.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use serde_json::json;

use super::lights::{CAMERA_HELP, LIGHT_HELP, camera, lights};
use super::{Failure, Reporter};
use crate::dataset::DirectVector;
use crate::gpu::Runtime;
use crate::light::{EmissionFacets, Light, LightTable};
use crate::model::{Model, Picture, Shown, View};
use crate::report::figures;
use crate::scene::Tracer;
use crate::transport::reference::{Reference, ReferenceSettings};

/// Render the relit asset
#[derive(Args)]
pub struct Render {
    /// A model made by `relight train`
    pub model: PathBuf,
    #[arg(long = "light", value_name = "LIGHT", help = LIGHT_HELP)]
    pub lights: Vec<String>,
    #[arg(long, value_name = "CAMERA", help = CAMERA_HELP)]
    pub camera: Option<String>,
    /// Where the picture goes: .png (tone mapped) or .exr (linear radiance)
    #[arg(short, long, value_name = "IMAGE")]
    pub output: PathBuf,
    /// Width and height in pixels
    #[arg(long, default_value = "1280x720", value_parser = parse_size)]
    pub size: (u32, u32),
    /// What radiance is multiplied with before tone mapping [default: bright parts come out just under white]
    #[arg(long)]
    pub exposure: Option<f32>,
    /// Which part of the light is shown
    #[arg(long, value_enum, default_value_t = Part::Full)]
    pub show: Part,
    /// Render on the CPU: the same picture without a GPU
    #[arg(long)]
    pub cpu: bool,
    /// Path trace the picture: the truth that the model approximates
    #[arg(long, conflicts_with = "cpu")]
    pub reference: bool,
    /// Paths per pixel, for --reference
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub paths: u32,
}

/// The parts of the light.
#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
pub enum Part {
    Full,
    Direct,
    Indirect,
}

/// `WIDTHxHEIGHT`.
pub(super) fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let parse = || {
        let (width, height) = text.split_once(['x', 'X'])?;
        Some((width.trim().parse().ok()?, height.trim().parse().ok()?))
    };
    parse().ok_or_else(|| format!("expected WIDTHxHEIGHT, such as 1280x720, not {text}"))
}

impl Render {
    pub fn run(&self, json: Option<&Path>, reporter: &Reporter) -> Result<(), Failure> {
        let format = self.output.extension().map(|e| e.to_string_lossy().to_lowercase());
        if !matches!(format.as_deref(), Some("png" | "exr")) {
            return Err(Failure::Input(format!("{}: pictures are .png or .exr", self.output.display())));
        }
        if self.exposure.is_some_and(|e| !(e.is_finite() && e > 0.0)) {
            return Err(Failure::Input("--exposure must be finite and positive".into()));
        }
        let model = Model::load(&self.model)?;
        let lights = lights(&self.lights, &model.asset)?;
        let view = View::new(camera(self.camera.as_deref(), &model.asset)?, self.size.0, self.size.1);
        view.pinhole()?;
        let start = Instant::now();
        let (picture, renderer, direct) = self.picture(&model, &view, &lights, reporter)?;
        let seconds = start.elapsed().as_secs_f64();
        let exposure = self.exposure.unwrap_or_else(|| figures::exposure_for(&picture));
        if format.as_deref() == Some("exr") {
            picture.write_exr(&self.output)?;
        } else {
            picture.write_png(&self.output, exposure)?;
        }
        println!("wrote {} ({renderer}, {seconds:.2} s)", self.output.display());
        let reading = model.scope.as_ref().zip(direct.as_ref()).and_then(|(scope, direct)| scope.read(direct));
        if let Some(reading) = &reading {
            println!("lights: {}", reading.verdict());
        }
        let (width, height) = self.size;
        let figures = json!({
            "renderer": renderer,
            "seconds": seconds,
            "width": width,
            "height": height,
            "novelty": reading.map(|r| r.novelty),
            "like": reading.map(|r| r.like),
        });
        super::write_json(json, &figures)
    }

    /// The picture, what made it, and the direct vector that it was relit from.
    fn picture(
        &self,
        model: &Model,
        view: &View,
        lights: &[Light],
        reporter: &Reporter,
    ) -> Result<(Picture, String, Option<DirectVector>), Failure> {
        if self.reference {
            let tracer = Tracer::new(&model.asset);
            let settings = ReferenceSettings { samples: self.paths, max_bounces: 64, seed: 1 };
            let Reference { direct, indirect } = Reference::trace(&tracer, view, lights, &settings, reporter)?;
            let picture = match self.show {
                Part::Full => figures::sum(&direct, &indirect),
                Part::Direct => direct,
                Part::Indirect => indirect,
            };
            return Ok((picture, format!("path traced, {} paths a pixel", self.paths), None));
        }
        let shown = match self.show {
            Part::Full => Shown::Full,
            Part::Direct => Shown::Direct,
            Part::Indirect => Shown::Indirect,
        };
        if self.cpu {
            let tracer = Tracer::new(&model.asset);
            let table = LightTable::new(lights, &EmissionFacets::of(tracer.asset()));
            let direct = model.points.direct(&tracer, &table);
            let coefficients = model.transfer.coefficients(&direct);
            let picture = model.render_with(&tracer, view, &table, &coefficients, shown)?;
            return Ok((picture, "CPU".into(), Some(direct)));
        }
        let mut runtime = Runtime::new(model)?;
        let picture = runtime.render(view, lights, shown)?;
        let direct = runtime.direct()?;
        Ok((picture, format!("GPU: {}", runtime.gpu().name), Some(direct)))
    }
}
