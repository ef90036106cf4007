//! What the window shows of the scene: relit on the GPU, both sides of the split put together, and handed to egui.

use std::time::{Duration, Instant};

use eframe::egui::TextureId;
use eframe::egui_wgpu::RenderState;
use eframe::wgpu;
use wgpu::util::DeviceExt;

use super::display::{Display, Frame, Look, What};
use super::reference::Traced;
use crate::gpu::{Gpu, GpuError, PassTimes, Runtime};
use crate::light::Light;
use crate::math::Rgb;
use crate::model::{Model, Picture, Shown, View};

/// One side of the split.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Side {
    pub what: What,
    /// Index of the model.
    pub model: usize,
    /// How many elements of a global basis are used.
    pub elements: usize,
}

pub struct Screen<'a> {
    window: RenderState,
    models: Vec<&'a Model>,
    /// Of each side, with the model that it runs.
    runtimes: [Option<(usize, Runtime)>; 2],
    /// Direct and indirect light.
    reference: Option<[Picture; 2]>,
    reference_texture: Option<(Shown, wgpu::Texture)>,
    display: Display,
    output: Option<(wgpu::Texture, TextureId)>,
}

impl<'a> Screen<'a> {
    pub fn new(window: RenderState, models: Vec<&'a Model>) -> Self {
        let display = Display::new(&window.device);
        Self { window, models, runtimes: [None, None], reference: None, reference_texture: None, display, output: None }
    }

    pub fn model(&self, index: usize) -> &'a Model {
        self.models[index]
    }

    /// The run time of a side, made where there is none yet.
    fn runtime(&mut self, at: usize, model: usize) -> Result<&mut Runtime, GpuError> {
        if self.runtimes[at].as_ref().is_none_or(|(of, _)| *of != model) {
            let name = self.window.adapter.get_info().name;
            let gpu = Gpu::from_device(self.window.device.clone(), self.window.queue.clone(), name);
            self.runtimes[at] = Some((model, Runtime::on(gpu, self.models[model])?));
        }
        Ok(&mut self.runtimes[at].as_mut().expect("made above").1)
    }

    /// Relights what a side shows. Returns the direct vector.
    pub fn relight(&mut self, at: usize, side: Side, lights: &[Light]) -> Result<Vec<Rgb>, GpuError> {
        let all = self.models[side.model].transfer.elements;
        let has_anchors = self.models[side.model].basis.anchors.is_some();
        let runtime = self.runtime(at, side.model)?;
        runtime.relight(lights)?;
        let direct = runtime.direct()?;
        // Of orthogonal elements the first n are the basis of n elements.
        if !has_anchors && side.elements < all {
            let mut coefficients = runtime.coefficients(&direct)?;
            coefficients[side.elements..].fill(Rgb::ZERO);
            runtime.set_coefficients(&coefficients);
        }
        Ok(direct)
    }

    /// Draws what a side shows and waits for it. Returns how long it took.
    pub fn draw(&mut self, at: usize, side: Side, view: &View, part: Shown) -> Result<Duration, GpuError> {
        let start = Instant::now();
        let runtime = self.runtime(at, side.model)?;
        runtime.draw(view, part)?;
        runtime.gpu().wait()?;
        Ok(start.elapsed())
    }

    /// Of the left side, where the GPU can tell.
    pub fn pass_times(&self) -> Result<Option<PassTimes>, GpuError> {
        self.runtimes[0].as_ref().map_or(Ok(None), |(_, runtime)| runtime.pass_times())
    }

    /// The left side's picture as it was drawn last.
    pub fn picture(&mut self, view: &View) -> Result<Option<Picture>, GpuError> {
        self.runtimes[0].as_mut().map(|(_, runtime)| runtime.read_picture(view)).transpose()
    }

    pub fn set_reference(&mut self, traced: Option<Traced>) {
        self.reference = traced.map(|traced| [traced.direct, traced.indirect]);
        self.reference_texture = None;
    }

    pub fn reference(&self, part: Shown) -> Option<Picture> {
        let [direct, indirect] = self.reference.as_ref()?;
        Some(match part {
            Shown::Full => {
                let pixels = direct.pixels.iter().zip(&indirect.pixels).map(|(&a, &b)| a + b).collect();
                Picture { pixels, ..*direct }
            }
            Shown::Direct => direct.clone(),
            Shown::Indirect | Shown::IndirectOnWhite => indirect.clone(),
        })
    }

    /// Puts the sides together at `size` pixels and gives the picture to egui.
    pub fn compose(&mut self, size: [u32; 2], sides: [Option<Side>; 2], look: &Look, part: Shown) -> TextureId {
        self.upload_reference(part);
        if self.output.as_ref().is_none_or(|(texture, _)| [texture.width(), texture.height()] != size) {
            self.renew_output(size);
        }
        let (output, id) = self.output.as_ref().expect("made above");
        let split =
            if sides[1].is_some() { (look.split.clamp(0.0, 1.0) * size[0] as f32).round() as u32 } else { size[0] };
        let black = || picture_texture(&self.window, [1, 1], &[Rgb::ZERO]);
        let drawn = |at: usize| {
            let runtime = self.runtimes[at].as_ref().filter(|_| sides[at].is_some());
            runtime.and_then(|(_, runtime)| runtime.picture()).cloned().unwrap_or_else(black)
        };
        let frame = Frame {
            what: [0, 1].map(|at| sides[at].map_or(What::Picture, |side| side.what)),
            pictures: [drawn(0), drawn(1)],
            reference: self.reference_texture.as_ref().map_or_else(black, |(_, texture)| texture.clone()),
            split,
        };
        self.display.show(&self.window.device, &self.window.queue, &frame, look, output);
        *id
    }

    fn renew_output(&mut self, size: [u32; 2]) {
        let texture = Display::output(&self.window.device, size);
        let view = texture.create_view(&Default::default());
        let (mut renderer, filter) = (self.window.renderer.write(), wgpu::FilterMode::Nearest);
        let id = match self.output.take() {
            Some((_, id)) => {
                renderer.update_egui_texture_from_wgpu_texture(&self.window.device, &view, filter, id);
                id
            }
            None => renderer.register_native_texture(&self.window.device, &view, filter),
        };
        drop(renderer);
        self.output = Some((texture, id));
    }

    fn upload_reference(&mut self, part: Shown) {
        if self.reference_texture.as_ref().is_some_and(|(of, _)| *of == part) {
            return;
        }
        let picture = self.reference(part);
        self.reference_texture = picture
            .map(|picture| (part, picture_texture(&self.window, [picture.width, picture.height], &picture.pixels)));
    }
}

fn picture_texture(window: &RenderState, [width, height]: [u32; 2], pixels: &[Rgb]) -> wgpu::Texture {
    let texels: Vec<[f32; 4]> = pixels.iter().map(|p| p.extend(1.0).to_array()).collect();
    window.device.create_texture_with_data(
        &window.queue,
        &wgpu::TextureDescriptor {
            label: Some("picture"),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba32Float,
            usage: wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        },
        wgpu::util::TextureDataOrder::LayerMajor,
        bytemuck::cast_slice(&texels),
    )
}
