//! What each pass costs on an adapter, by its own clock, after a warm-up, over many frames.
//!
//! Adapters without a clock are timed by the wall's, and so are those that run on the CPU: llvmpipe's stamps do not wait for
//! its compute passes.

use std::time::{Duration, Instant};

use super::bindings::{self, READ, READ_WRITE};
use super::device::{Gpu, GpuError};
use super::relighter::{Measure, Relighter, Settings};
use super::scene::Scene;
use super::shader::{self, Lookup, Stage};
use super::shading::{DEPTH, Pipelines, draw_batches};
use super::timer::{PassTimes, Timer};
use crate::light::Light;
use crate::model::{Model, View};

/// Frames that are submitted together, at most: the GPU does not fall idle between them.
const BATCH: u32 = 16;
/// Frames that count, unless they take longer than [`PATIENCE`]; at least one batch.
const FRAMES: usize = 256;
const PATIENCE: Duration = Duration::from_millis(1500);

/// What is drawn into: HDR, as engines have it.
const COLOUR: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;

/// Bytes of a pixel of the frame: colour written, depth read.
pub const BYTES_PER_PIXEL: usize = 8 + 4;

/// Microseconds of one pass over many frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    pub median: f64,
    /// A tenth of the frames took less, a tenth more than this.
    pub tenth: f64,
    pub ninetieth: f64,
    pub frames: usize,
}

impl Cost {
    fn of(mut samples: Vec<f64>, frames: usize) -> Self {
        samples.sort_by(f64::total_cmp);
        let at = |share: f64| samples[((samples.len() - 1) as f64 * share).round() as usize];
        Self { median: at(0.5), tenth: at(0.1), ninetieth: at(0.9), frames }
    }
}

/// Picks a pass.
type Pick = fn(&PassTimes) -> f64;

/// What of a frame shades a fragment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shaded {
    /// Direct light without shadows.
    Plain,
    /// The same and indirect light.
    WithIndirect,
}

/// One model on the device, to be timed.
pub struct Bench {
    relighter: Relighter,
    /// None where it is the wall clock that tells.
    timer: Option<Timer>,
    module: wgpu::ShaderModule,
    layout: wgpu::PipelineLayout,
}

impl Bench {
    /// Uploads `model`, lit by `lights`.
    pub fn new(gpu: Gpu, model: &Model, lookup: Lookup, lights: &[Light]) -> Result<Self, GpuError> {
        let mut relighter = Relighter::on(gpu, model, Settings { measure: Measure::Rays, lookup })?;
        relighter.set_lights(lights)?;
        let gpu = &relighter.gpu;
        let module = bindings::module(gpu, Stage::Shade, shader::bench(&model.basis, lookup));
        let groups = [&scene_of(&relighter).layout, relighter.bind_group_layout()];
        let layout = bindings::pipeline_layout(gpu, "bench", &groups);
        let on_cpu = gpu.device.adapter_info().device_type == wgpu::DeviceType::Cpu;
        let timer = (gpu.has_timestamps() && !on_cpu).then(|| Timer::new(gpu, BATCH));
        gpu.check()?;
        Ok(Self { relighter, timer, module, layout })
    }

    pub fn set_lights(&mut self, lights: &[Light]) -> Result<(), GpuError> {
        self.relighter.set_lights(lights)
    }

    /// Entries that stand for the lights: area lights and environments are many.
    pub fn light_entries(&self) -> usize {
        scene_of(&self.relighter).frame.light_count as usize
    }

    /// Whether times are the adapter's own, rather than the wall clock's.
    pub fn has_clock(&self) -> bool {
        self.timer.is_some()
    }

    /// Bytes of the basis on the GPU.
    pub fn basis_bytes(&self) -> u64 {
        self.relighter.basis_bytes()
    }

    /// Measure, downsample, transfer and, with [`Lookup::Texture`], reconstruct.
    pub fn relight(&self) -> Result<Vec<(Stage, Cost)>, GpuError> {
        let passes: [(Stage, Pick); 4] = [
            (Stage::Measure, |t| t.measure),
            (Stage::Downsample, |t| t.downsample),
            (Stage::Transfer, |t| t.transfer),
            (Stage::Reconstruct, |t| t.reconstruct),
        ];
        let all = passes.map(|(stage, _)| stage);
        let count = if self.relighter.irradiance().is_some() { 4 } else { 3 };
        let cost = |(stage, of): &(Stage, Pick)| -> Result<(Stage, Cost), GpuError> {
            // The adapter's clock tells them apart where they follow each other; the wall's does not.
            let stages = if self.timer.is_some() { &all[..] } else { std::slice::from_ref(stage) };
            let record = |encoder: &mut wgpu::CommandEncoder, timer: Option<&Timer>| {
                self.relighter.encode_stages(encoder, stages, timer);
            };
            Ok((*stage, self.cost(&record, *of)?))
        };
        passes[..count].iter().map(cost).collect()
    }

    /// Shading of all that `view` sees, without the depth pass before it.
    pub fn shade(&mut self, view: &View, shaded: Shaded) -> Result<Cost, GpuError> {
        let pinhole = view.pinhole()?;
        self.relighter.gpu.check_target([view.width, view.height])?;
        let scene = self.relighter.scene.as_mut().expect("it measures by rays");
        scene.frame.clip_from_world = pinhole.clip_from_world(scene.frame.shadow_offset.max(f32::MIN_POSITIVE));
        scene.frame.eye_ws = pinhole.eye.to_array();
        scene.write_frame(&self.relighter.gpu);

        let gpu = &self.relighter.gpu;
        let pipelines = Pipelines { gpu, module: self.module.clone(), layout: self.layout.clone() };
        let entry = match shaded {
            Shaded::Plain => "plain",
            Shaded::WithIndirect => "with_indirect",
        };
        let depths = [false, true].map(|sided| [false, true].map(|masked| pipelines.depth(sided, masked)));
        let shades = [false, true].map(|sided| pipelines.shade(sided, entry, COLOUR));
        let size = wgpu::Extent3d { width: view.width, height: view.height, depth_or_array_layers: 1 };
        let target = |format| {
            let texture = gpu.texture("bench", size, format, wgpu::TextureUsages::RENDER_ATTACHMENT);
            texture.create_view(&Default::default())
        };
        let (colour, depth) = (target(COLOUR), target(DEPTH));
        let attachment =
            |depth_ops| wgpu::RenderPassDepthStencilAttachment { view: &depth, depth_ops, stencil_ops: None };

        let scene = scene_of(&self.relighter);
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        // What is looked up is there, and so is the depth.
        self.relighter.encode(&mut encoder);
        let clear = wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Store };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("depth"),
            depth_stencil_attachment: Some(attachment(Some(clear))),
            ..Default::default()
        });
        draw_batches(&mut pass, scene, self.relighter.bind_group(), |batch| {
            &depths[batch.double_sided as usize][batch.masked as usize]
        });
        drop(pass);
        gpu.queue.submit([encoder.finish()]);

        let record = |encoder: &mut wgpu::CommandEncoder, timer: Option<&Timer>| {
            let colour = wgpu::RenderPassColorAttachment {
                view: &colour,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store },
            };
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("bench"),
                color_attachments: &[Some(colour)],
                depth_stencil_attachment: Some(attachment(None)),
                timestamp_writes: timer.map(Timer::only_shade_pass),
                ..Default::default()
            });
            let of = |batch: &super::scene::Batch| &shades[batch.double_sided as usize];
            draw_batches(&mut pass, scene, self.relighter.bind_group(), of);
        };
        self.cost(&record, |t| t.shade)
    }

    /// A copy of this many bytes within the GPU's memory: twice as many are moved.
    pub fn copy(&self, bytes: u64) -> Result<Cost, GpuError> {
        let gpu = &self.relighter.gpu;
        let vectors = (bytes / 16) as usize;
        let buffers = [gpu.written::<[f32; 4]>("copied", vectors)?, gpu.written::<[f32; 4]>("copy", vectors)?];
        let layout = bindings::layout(gpu, "copy", wgpu::ShaderStages::COMPUTE, &[READ, READ_WRITE]);
        let resources = [buffers[0].as_entire_binding(), buffers[1].as_entire_binding()];
        let group = bindings::bind(gpu, "copy", &layout, resources);
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("copy"),
            source: wgpu::ShaderSource::Wgsl(shader::COPY.into()),
        });
        let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("copy"),
            layout: Some(&bindings::pipeline_layout(gpu, "copy", &[&layout])),
            module: &module,
            entry_point: Some("copy"),
            compilation_options: Default::default(),
            cache: None,
        });
        let workgroups = vectors.div_ceil(256) as u32;
        let across = workgroups.min(1 << 14);
        let record = |encoder: &mut wgpu::CommandEncoder, timer: Option<&Timer>| {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("copy"),
                timestamp_writes: timer.map(|timer| timer.compute_pass(Stage::Measure)),
            });
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &group, &[]);
            pass.dispatch_workgroups(across, workgroups.div_ceil(across), 1);
        };
        self.cost(&record, |t| t.measure)
    }

    /// What one pass of many frames costs: `record` records the frame, `of` picks the pass.
    fn cost(&self, record: &dyn Fn(&mut wgpu::CommandEncoder, Option<&Timer>), of: Pick) -> Result<Cost, GpuError> {
        let gpu = &self.relighter.gpu;
        let timer = self.timer.as_ref();
        // Microseconds of each frame, or by the wall clock of a frame in the mean.
        let batch = |size: u32| -> Result<Vec<f64>, GpuError> {
            let mut encoder = gpu.device.create_command_encoder(&Default::default());
            for frame in 0..size {
                if let Some(timer) = timer {
                    timer.frame.set(frame);
                }
                record(&mut encoder, timer);
            }
            let start = Instant::now();
            gpu.queue.submit([encoder.finish()]);
            if let Some(timer) = timer {
                return Ok(timer.read(gpu)?[..size as usize].iter().map(of).collect());
            }
            gpu.wait()?;
            Ok(vec![start.elapsed().as_secs_f64() * 1e6 / size as f64])
        };
        // The first frame compiles shaders; the second tells how many make a batch where drawing is slow.
        batch(1)?;
        let start = Instant::now();
        batch(1)?;
        let affordable = PATIENCE.as_secs_f64() / 8.0 / start.elapsed().as_secs_f64();
        let size = (affordable as u32).clamp(1, BATCH);
        // A GPU that was idle wakes.
        batch(size)?;
        let (start, mut samples, mut frames) = (Instant::now(), Vec::new(), 0);
        while samples.is_empty() || (frames < FRAMES && start.elapsed() < PATIENCE) {
            samples.extend(batch(size)?);
            frames += size as usize;
        }
        gpu.check()?;
        Ok(Cost::of(samples, frames))
    }
}

fn scene_of(relighter: &Relighter) -> &Scene {
    relighter.scene.as_ref().expect("it measures by rays")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cost_is_the_median_and_the_tenths() {
        let cost = Cost::of((0..=100).rev().map(f64::from).collect(), 101);
        assert_eq!(cost, Cost { median: 50.0, tenth: 10.0, ninetieth: 90.0, frames: 101 });
        assert_eq!(Cost::of(vec![3.0], 1).ninetieth, 3.0);
    }
}
