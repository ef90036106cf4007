//! `relight render`: one picture of the relit asset, or one of each moment of moving lights, on the GPU or the CPU, or path
//! traced.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use serde_json::json;

use super::lights::{CAMERA_HELP, LIGHT_HELP, camera, light_path, lights};
use super::{Failure, Reporter};
use crate::dataset::DirectVector;
use crate::gpu::{GpuError, Runtime};
use crate::light::{EmissionFacets, Light, LightTable};
use crate::model::{Model, Picture, Shown, View};
use crate::progress::Progress;
use crate::report::pictures;
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
    /// Lights that move: a .toml or .json file with a list `lights` as for --light, in which a value may be a list of
    /// keyframes, `intensity = [{ time = 0, value = 1 }, { time = 2.5, value = 8 }]`, and optionally `duration` (seconds) and
    /// `interpolation` (smooth, linear or step)
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// How many frames the path is shown in [default: as many as --fps makes of its duration]
    #[arg(long, requires = "path", value_name = "COUNT")]
    pub frames: Option<u32>,
    /// Frames a second [default: what --frames makes of the path's duration, or 30]
    #[arg(long, requires = "path", value_name = "RATE")]
    pub fps: Option<f32>,
    /// Where the picture goes: .png (tone mapped) or .exr (linear radiance). With --path: one animated .png or .apng, or
    /// pictures with numbers, as frames/%04d.png (or .exr), or a folder
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
pub fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let parse = || {
        let (width, height) = text.split_once(['x', 'X'])?;
        Some((width.trim().parse().ok()?, height.trim().parse().ok()?))
    };
    parse().ok_or_else(|| format!("expected WIDTHxHEIGHT, such as 1280x720, not {text}"))
}

impl Render {
    pub fn run(&self, json: Option<&Path>, reporter: &Reporter) -> Result<(), Failure> {
        let format = self.output.extension().map(|e| e.to_string_lossy().to_lowercase());
        if self.path.is_none() && !matches!(format.as_deref(), Some("png" | "exr")) {
            return Err(Failure::Input(format!("{}: pictures are .png or .exr", self.output.display())));
        }
        if self.exposure.is_some_and(|e| !(e.is_finite() && e > 0.0)) {
            return Err(Failure::Input("--exposure must be finite and positive".into()));
        }
        let model = Model::load(&self.model)?;
        let view = View::new(camera(self.camera.as_deref(), &model.asset)?, self.size.0, self.size.1);
        view.pinhole()?;
        if let Some(file) = &self.path {
            let still = if self.lights.is_empty() { Vec::new() } else { lights(&self.lights, &model.asset)? };
            return self.animate(&model, &view, (&light_path(file)?, file), &still, json, reporter);
        }
        let lights = lights(&self.lights, &model.asset)?;
        let start = Instant::now();
        let mut renderer = Renderer::new(self, &model)?;
        let (picture, direct) = renderer.picture(&view, &lights, self.show, reporter)?;
        let renderer = renderer.name();
        let seconds = start.elapsed().as_secs_f64();
        let exposure = self.exposure.unwrap_or_else(|| pictures::exposure_for(&picture));
        if format.as_deref() == Some("exr") {
            picture.write_exr(&self.output)?;
        } else {
            picture.write_png(&self.output, exposure)?;
        }
        say!("wrote {} ({renderer}, {seconds:.2} s)", self.output.display());
        let reading = model.scope.as_ref().zip(direct.as_ref()).and_then(|(scope, direct)| scope.read(direct));
        if let Some(reading) = &reading {
            say!("lights: {}", reading.verdict());
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
}

/// What makes pictures of a model.
pub enum Renderer<'m> {
    Traced { tracer: Box<Tracer<'m>>, paths: u32 },
    Cpu { tracer: Box<Tracer<'m>>, model: &'m Model },
    Gpu(Box<Runtime>),
}

impl<'m> Renderer<'m> {
    pub fn new(render: &Render, model: &'m Model) -> Result<Self, Failure> {
        let tracer = || Box::new(Tracer::new(&model.asset));
        Ok(if render.reference {
            Self::Traced { tracer: tracer(), paths: render.paths }
        } else if render.cpu {
            Self::Cpu { tracer: tracer(), model }
        } else {
            Self::Gpu(Box::new(Runtime::new(model).map_err(or_without_gpu)?))
        })
    }

    pub fn name(&self) -> String {
        match self {
            Self::Traced { paths, .. } => format!("path traced, {paths} paths a pixel"),
            Self::Cpu { .. } => "CPU".into(),
            Self::Gpu(runtime) => format!("GPU: {}", runtime.gpu().name),
        }
    }

    /// The picture, and the direct vector that it was relit from.
    pub fn picture(
        &mut self,
        view: &View,
        lights: &[Light],
        part: Part,
        progress: &dyn Progress,
    ) -> Result<(Picture, Option<DirectVector>), Failure> {
        let shown = match part {
            Part::Full => Shown::Full,
            Part::Direct => Shown::Direct,
            Part::Indirect => Shown::Indirect,
        };
        match self {
            Self::Traced { tracer, paths } => {
                let settings = ReferenceSettings { samples: *paths, max_bounces: 64, seed: 1 };
                let Reference { direct, indirect } = Reference::trace(tracer, view, lights, &settings, progress)?;
                let picture = match part {
                    Part::Full => pictures::sum(&direct, &indirect),
                    Part::Direct => direct,
                    Part::Indirect => indirect,
                };
                Ok((picture, None))
            }
            Self::Cpu { tracer, model } => {
                let table = LightTable::new(lights, &EmissionFacets::of(tracer.asset()));
                let direct = model.points.direct(tracer, &table);
                let coefficients = model.transfer.coefficients(&direct);
                let picture = model.render_with(tracer, view, &table, &coefficients, shown)?;
                Ok((picture, Some(direct)))
            }
            Self::Gpu(runtime) => {
                let picture = runtime.render(view, lights, shown).map_err(or_without_gpu)?;
                Ok((picture, Some(runtime.direct()?)))
            }
        }
    }
}

/// What a GPU lacks, the CPU has.
fn or_without_gpu(error: GpuError) -> Failure {
    match error {
        GpuError::NoAdapter { .. } | GpuError::TooLarge { .. } => {
            Failure::Input(format!("{error}, or render with --cpu"))
        }
        error => error.into(),
    }
}
