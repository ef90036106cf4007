//! `relight bench`: what each pass of the run time costs on this machine (paper, Table 1).

use std::path::{Path, PathBuf};

use clap::Args;
use half::f16;
use serde::Serialize;
use serde_json::json;

use super::lights::{CAMERA_HELP, LIGHT_HELP, camera, lights};
use super::render::parse_size;
use super::{Failure, Reporter};
use crate::dataset::Draw;
use crate::gpu::bench::{BYTES_PER_PIXEL, Bench as Bed, Cost, Shaded};
use crate::gpu::shader::Stage;
use crate::gpu::{Gpu, GpuLight, Lookup, Runtime, SubPoint};
use crate::light::{EmissionFacets, Light, LightTable};
use crate::math::Rgb;
use crate::math::sampler::mix64;
use crate::measure::MeasurementPoints;
use crate::model::render::first_visible;
use crate::model::{Anchors, Basis, Model, Transfer, Values, View};
use crate::progress::Progress;
use crate::scene::{Camera, Tracer};
use crate::scene_file::SceneFile;

/// Time each pass of the run time on this machine's GPU
#[derive(Args)]
pub struct Bench {
    /// A model made by `relight train`
    pub model: PathBuf,
    /// Width and height of the frame in pixels
    #[arg(long, default_value = "1920x1080", value_parser = parse_size)]
    pub size: (u32, u32),
    #[arg(long, value_name = "CAMERA", help = CAMERA_HELP)]
    pub camera: Option<String>,
    /// A light to time with, as for `render` [default: the first lights that were held out of training]
    #[arg(long = "light", value_name = "LIGHT", long_help = LIGHT_HELP)]
    pub lights: Vec<String>,
}

/// Bytes of the buffer that is copied: what every WebGPU device can bind, and more than caches hold.
const COPIED: u64 = 128 << 20;

/// Elements of the global bases beside the model's own (paper, Table 1), and channels of the local one.
const GLOBAL: [usize; 3] = [4, 16, 64];
const LOCAL: usize = 4;
/// Anchors of a local basis where the model has none: the default of scene files.
const ANCHORS: usize = 128;

const LIGHTS: [usize; 4] = [1, 4, 16, 64];
const POINTS: [usize; 3] = [64, 256, 1024];

/// What one pass costs.
#[derive(Serialize)]
struct Row {
    pass: &'static str,
    method: &'static str,
    /// Elements of a global basis, channels of a local one.
    coefficients: usize,
    points: usize,
    lights: usize,
    /// Median.
    microseconds: f64,
    tenth: f64,
    ninetieth: f64,
    frames: usize,
    /// That the pass must move, each once: caches have the rest.
    bytes: usize,
    /// `bytes` a second over those of a copy.
    of_copy_bandwidth: f64,
    /// Whether basis and transfer are made-up values of that shape, rather than the model's: times only.
    made_up: bool,
}

/// The table, and what its rows are measured against.
struct Table {
    rows: Vec<Row>,
    /// Bytes a microsecond, read and written.
    copy: f64,
}

impl Table {
    fn add(&mut self, pass: &'static str, of: &Subject, cost: Cost, bytes: usize) {
        self.rows.push(Row {
            pass,
            method: of.method,
            coefficients: of.model.basis.elements,
            points: of.model.points.points.len(),
            lights: of.lights,
            microseconds: cost.median,
            tenth: cost.tenth,
            ninetieth: cost.ninetieth,
            frames: cost.frames,
            bytes,
            of_copy_bandwidth: bytes as f64 / cost.median.max(1e-3) / self.copy,
            made_up: of.made_up,
        });
    }

    /// The passes of one change of light.
    fn add_relight(&mut self, of: &Subject, bed: &Bed, only: &[Stage]) -> Result<(), Failure> {
        for (stage, cost) in bed.relight()? {
            if only.contains(&stage) {
                self.add(stage.name(), of, cost, of.bytes(stage, bed.basis_bytes() as usize));
            }
        }
        Ok(())
    }
}

/// A model that is timed.
struct Subject<'m> {
    model: &'m Model,
    method: &'static str,
    made_up: bool,
    /// Entries that stand for the lights.
    lights: usize,
}

impl Subject<'_> {
    fn bytes(&self, stage: Stage, basis: usize) -> usize {
        let (points, transfer) = (&self.model.points, &self.model.transfer);
        let (sub_points, count, colour) = (points.sub_points.len(), points.points.len(), 16);
        match stage {
            Stage::Measure => sub_points * (size_of::<SubPoint>() + colour) + self.lights * size_of::<GpuLight>(),
            Stage::Downsample => points.neighbours.len() * (4 + colour) + count * colour,
            Stage::Transfer => 12 * transfer.elements * count + colour * (count + transfer.elements),
            Stage::Reconstruct => basis + colour * (self.model.basis.size.pow(2) + transfer.elements),
            Stage::Shade | Stage::Resolve => 0,
        }
    }
}

impl Bench {
    pub fn run(&self, json: Option<&Path>, reporter: &Reporter) -> Result<(), Failure> {
        let model = Model::load(&self.model)?;
        let gpu = Gpu::new()?;
        let adapter = gpu.name.clone();
        let held_out = held_out_lights(&model, &self.model)?;
        let lights = match self.lights.is_empty() {
            true => held_out.first().cloned().unwrap_or_default(),
            false => lights(&self.lights, &model.asset)?,
        };
        let camera = match (&self.camera, model.asset.cameras.first()) {
            (None, None) => Camera::that_sees(&model.asset.mesh.bounds()),
            (argument, _) => camera(argument.as_deref(), &model.asset)?,
        };
        let mut view = View::new(camera, self.size.0, self.size.1);
        view.samples_per_axis = 1;
        view.pinhole()?;
        gpu.check_target([view.width, view.height])?;

        let method = method_of(&model);
        let mut bed = Bed::new(gpu, &model, Lookup::Texture, &lights)?;
        let subject = Subject { model: &model, method, made_up: false, lights: bed.light_entries() };
        reporter.note(&format!("bench: copies on {adapter}"));
        let copy = bed.copy(COPIED)?;
        let mut table = Table { rows: Vec::new(), copy: 2.0 * COPIED as f64 / copy.median };

        reporter.note("bench: passes of a change of light");
        table.add_relight(&subject, &bed, &Stage::ALL)?;
        for count in LIGHTS {
            let many: Vec<Light> = held_out.iter().flatten().cycle().take(count).cloned().collect();
            bed.set_lights(&many)?;
            table.add_relight(&Subject { lights: bed.light_entries(), ..subject }, &bed, &[Stage::Measure])?;
        }
        let per_point = model.points.neighbours_per_point();
        for count in POINTS {
            let mut other = made_up(&model, None);
            other.points = MeasurementPoints::place(&model.asset, count, per_point, 1)?;
            other.transfer = made_up_transfer(&model.transfer, model.transfer.elements, count);
            let bed = Bed::new(Gpu::new()?, &other, Lookup::Texture, &lights)?;
            let subject = Subject { model: &other, made_up: true, ..subject };
            table.add_relight(&subject, &bed, &[Stage::Measure, Stage::Downsample, Stage::Transfer])?;
        }

        reporter.note("bench: frames");
        let covered = covered(&model, &view);
        let frame = covered * BYTES_PER_PIXEL;
        bed.set_lights(&lights)?;
        let plain = bed.shade(&view, Shaded::Plain)?;
        table.add("no_gi", &Subject { method: "none", ..subject }, plain, frame);
        let shapes = GLOBAL.map(|n| (n, false)).into_iter().chain([(LOCAL, true)]);
        let others: Vec<Model> = shapes.map(|shape| made_up(&model, Some(shape))).collect();
        let mut storage = Vec::new();
        for model in [&model].into_iter().chain(&others) {
            let made_up = !std::ptr::eq(model, subject.model);
            let of = Subject { model, method: method_of(model), made_up, ..subject };
            for (lookup, pass) in [(Lookup::Fragment, "fragment"), (Lookup::Texture, "fragment_texture")] {
                let mut bed = Bed::new(Gpu::new()?, model, lookup, &lights)?;
                let cost = bed.shade(&view, Shaded::WithIndirect)?;
                let looked_up = match lookup {
                    Lookup::Fragment => bed.basis_bytes() as usize / model.basis.size.pow(2),
                    Lookup::Texture => 16,
                };
                table.add(pass, &of, cost, frame + covered * looked_up);
                if lookup == Lookup::Texture {
                    if made_up {
                        table.add_relight(&of, &bed, &[Stage::Transfer, Stage::Reconstruct])?;
                    }
                    storage.push(json!({
                        "method": of.method,
                        "coefficients": model.basis.elements,
                        "basis": bed.basis_bytes(),
                        "texture": 16 * model.basis.size.pow(2),
                        "matrix": 6 * model.transfer.elements * model.transfer.points,
                    }));
                }
            }
        }

        reporter.note("bench: direct light of the run time against that of training");
        let [mean, worst] = agreement(&model, &held_out)?;
        if !bed.has_clock() {
            say!(
                "times are by the wall clock, submission included: {adapter} has no clock of its own that tells passes"
            );
        }
        table.print(&adapter, &view, covered, plain.median);
        say!(
            "direct light on the GPU against that of training, {} held-out conditions: {:.4} % mean, {:.4} % worst",
            held_out.len(),
            100.0 * mean,
            100.0 * worst
        );
        say!("bases marked * are made-up values of that shape: their times mean something, their light does not");
        let points = size_of::<SubPoint>() * model.points.sub_points.len() + 4 * model.points.neighbours.len();
        let own = &storage[0];
        let bytes = own["basis"].as_u64().unwrap_or(0) + own["matrix"].as_u64().unwrap_or(0) + points as u64;
        say!("the model takes {:.2} MB of GPU memory, its asset aside", bytes as f64 * 1e-6);
        super::write_json(
            json,
            &json!({
                "adapter": adapter,
                "clock": if bed.has_clock() { "adapter" } else { "wall" },
                "size": [view.width, view.height],
                "covered_pixels": covered,
                "copy_bytes_per_second": table.copy * 1e6,
                "rows": table.rows,
                "bytes": bytes,
                "storage": storage,
                "direct_light": { "conditions": held_out.len(), "mean": mean, "worst": worst },
            }),
        )
    }
}

impl Table {
    fn print(&self, adapter: &str, view: &View, covered: usize, plain: f64) {
        let pixels = view.width as usize * view.height as usize;
        say!(
            "{adapter}: {} x {}, {:.0} % covered; copies move {:.1} GB/s",
            view.width,
            view.height,
            100.0 * covered as f64 / pixels as f64,
            self.copy * 1e-3
        );
        say!(
            "{:<18}{:<9}{:>4}{:>7}{:>8}{:>12}{:>25}{:>10}{:>12}",
            "pass",
            "method",
            "n",
            "points",
            "lights",
            "median us",
            "10 to 90 %",
            "MB",
            "of copies"
        );
        for row in &self.rows {
            let spread = format!("{:.1} to {:.1}", row.tenth, row.ninetieth);
            let star = if row.made_up { "*" } else { "" };
            let versus = if row.pass.starts_with("fragment") {
                format!("  {:.2} x no_gi", row.microseconds / plain)
            } else {
                String::new()
            };
            say!(
                "{:<18}{:<9}{:>4}{:>7}{:>8}{:>12.1}{:>25}{:>10.3}{:>10.1} %{versus}",
                row.pass,
                format!("{}{star}", row.method),
                row.coefficients,
                row.points,
                row.lights,
                row.microseconds,
                spread,
                row.bytes as f64 * 1e-6,
                100.0 * row.of_copy_bandwidth
            );
        }
    }
}

/// As `--method` names it.
fn method_of(model: &Model) -> &'static str {
    match (&model.basis.anchors, model.transfer.mean_scaled_by_norm) {
        (Some(_), _) => "local",
        (None, true) => "belcour",
        (None, false) => "linear",
    }
}

/// The lights of each condition that the model's scene held out of training.
fn held_out_lights(model: &Model, place: &Path) -> Result<Vec<Vec<Light>>, Failure> {
    let scene: SceneFile = toml::from_str(&model.record.scene).map_err(|e| {
        Failure::Input(format!("{}: damaged: its scene settings do not parse: {}", place.display(), e.message()))
    })?;
    let draw = Draw { scenario: &scene.scenario, training: 0, held_out: scene.bake.held_out };
    let conditions = draw.conditions(&Tracer::new(&model.asset), scene.bake.seed)?;
    Ok(conditions.into_iter().map(|condition| condition.lights).collect())
}

/// ‖x − x'‖ / ‖x'‖ between the direct vectors x of the GPU and x' that training measures: its mean and its largest value.
fn agreement(model: &Model, conditions: &[Vec<Light>]) -> Result<[f64; 2], Failure> {
    let mut runtime = Runtime::new(model)?;
    let tracer = Tracer::new(&model.asset);
    let emission = EmissionFacets::of(&model.asset);
    let norm = |x: &mut dyn Iterator<Item = Rgb>| x.map(|x| x.as_dvec3().length_squared()).sum::<f64>().sqrt();
    let mut differences = Vec::new();
    for lights in conditions {
        let trained = model.points.direct(&tracer, &LightTable::new(lights, &emission));
        runtime.relight(lights)?;
        let measured = runtime.direct()?;
        let length = norm(&mut trained.iter().copied());
        // A condition that lights no point has nothing to differ from.
        if length > 0.0 {
            differences.push(norm(&mut measured.iter().zip(&trained).map(|(a, b)| *a - *b)) / length);
        }
    }
    let mean = differences.iter().sum::<f64>() / differences.len().max(1) as f64;
    Ok([mean, differences.into_iter().fold(0.0, f64::max)])
}

/// Pixels of the view that show the asset, counted on every fourth row and column.
fn covered(model: &Model, view: &View) -> usize {
    let tracer = Tracer::new(&model.asset);
    let pinhole = view.pinhole().expect("checked before");
    let places = (0..view.height).step_by(4).flat_map(|y| (0..view.width).step_by(4).map(move |x| (x, y)));
    let (seen, all) = places.fold((0usize, 0usize), |(seen, all), (x, y)| {
        let hit = first_visible(&tracer, pinhole.eye, pinhole.direction(x, y)).is_some();
        (seen + hit as usize, all + 1)
    });
    (view.width as usize * view.height as usize) * seen / all.max(1)
}

/// The model with a basis of another shape, (elements, local), and a transfer to it, of values that mean nothing.
fn made_up(model: &Model, shape: Option<(usize, bool)>) -> Model {
    let mut other = model.clone();
    let Some((elements, local)) = shape else { return other };
    let size = model.basis.size;
    let texels = size * size;
    let components = model.transfer.channels.components();
    let random = |i: usize| mix64(i as u64) as u8;
    let values = elements * components * texels;
    let count = model.basis.anchors.as_ref().map_or(ANCHORS, |anchors| anchors.count);
    // Anchors on a grid, so that neighbours share them as they do on an asset.
    let across = (count as f64).sqrt().ceil() as usize;
    let cell = |at: usize| {
        let (x, y) = (at % size * across / size, at / size * across / size);
        let anchor = |dx: usize, dy: usize| (((y + dy) * across + x + dx) % count) as u8;
        [anchor(0, 0), anchor(1, 0), anchor(0, 1), anchor(1, 1)]
    };
    let anchors = local.then(|| Anchors {
        count,
        indices: (0..texels).map(cell).collect(),
        shares: (0..texels).map(|t| [random(t) / 4, random(t + 1) / 4, random(t + 2) / 4, 255]).collect(),
    });
    let values = match local {
        true => Values::Byte((0..values).map(|i| random(i) as i8).collect()),
        false => Values::Half((0..values).map(|i| f16::from_f32(random(i) as f32 / 255.0)).collect()),
    };
    let coefficients = elements * anchors.as_ref().map_or(1, |a| a.count);
    other.basis = Basis { size, elements, components, values, anchors, gamma: 1.0 };
    other.transfer = made_up_transfer(&model.transfer, coefficients, model.transfer.points);
    other
}

fn made_up_transfer(like: &Transfer, elements: usize, points: usize) -> Transfer {
    let row = points * like.matrices[0].len() / (like.elements * like.points).max(1);
    let matrix: Vec<f32> = (0..elements * row).map(|i| mix64(i as u64) as u8 as f32 * 1e-4).collect();
    let matrices = vec![matrix; like.matrices.len()];
    Transfer { channels: like.channels, elements, points, matrices, mean_scaled_by_norm: false, gamma: 1.0 }
}
