//! One model, relit and drawn.

use super::device::{Gpu, GpuError};
use super::relighter::{Measure, Relighter, Settings};
use super::scene::Scene;
use super::shader::{Lookup, Stage};
use super::shading::Shading;
use super::timer::{PassTimes, Timer};
use crate::light::Light;
use crate::math::Rgb;
use crate::model::{Model, Picture, Shown, View};

/// A model on a GPU, with a renderer of its own: what `relight render` and `relight view` show. An engine, which has a renderer,
/// takes a [`Relighter`].
pub struct Runtime {
    relighter: Relighter,
    shading: Shading,
    timer: Option<Timer>,
    sub_points: usize,
    points: usize,
    elements: usize,
}

impl Runtime {
    /// Opens a GPU and uploads `model`.
    ///
    /// # Errors
    /// No adapter, or something in the model that does not fit the device's limits.
    pub fn new(model: &Model) -> Result<Self, GpuError> {
        Self::on(Gpu::new()?, model)
    }

    /// Uploads `model` to a device that is open already.
    pub fn on(gpu: Gpu, model: &Model) -> Result<Self, GpuError> {
        Self::with(gpu, model, Lookup::Texture)
    }

    /// The same with pixels that get their indirect light by `lookup`.
    pub fn with(gpu: Gpu, model: &Model, lookup: Lookup) -> Result<Self, GpuError> {
        let relighter = Relighter::on(gpu, model, Settings { measure: Measure::Rays, lookup })?;
        let Relighter { gpu, scene, .. } = &relighter;
        let scene = scene.as_ref().expect("it measures by rays");
        let shading = Shading::new(gpu, scene, &model.basis, lookup, relighter.bind_group_layout());
        gpu.check()?;
        let timer = gpu.has_timestamps().then(|| Timer::new(gpu, 1));
        let (sub_points, points) = (model.points.sub_points.len(), model.points.points.len());
        let elements = model.transfer.elements;
        Ok(Self { relighter, shading, timer, sub_points, points, elements })
    }

    pub fn gpu(&self) -> &Gpu {
        &self.relighter.gpu
    }

    fn scene(&mut self) -> &mut Scene {
        self.relighter.scene.as_mut().expect("it measures by rays")
    }

    /// Relights the asset and takes its picture; the picture of [`Model::render`].
    pub fn render(&mut self, view: &View, lights: &[Light], shown: Shown) -> Result<Picture, GpuError> {
        // A view is refused before anything is done for it.
        view.pinhole()?;
        self.relight(lights)?;
        self.draw(view, shown)?;
        self.read_picture(view)
    }

    /// Measures the direct light of `lights` and makes the indirect light of the lightmap from it. Nothing is waited
    /// for: the next [`Runtime::draw`] shows it.
    pub fn relight(&mut self, lights: &[Light]) -> Result<(), GpuError> {
        self.set_lights(lights)?;
        self.run(&[Stage::Measure, Stage::Downsample, Stage::Transfer, Stage::Reconstruct]);
        self.gpu().check()
    }

    /// x, as [`Runtime::relight`] last measured it: for [`crate::model::Scope::read`], among others.
    pub fn direct(&self) -> Result<Vec<Rgb>, GpuError> {
        self.download(&self.relighter.measurement.direct, self.points)
    }

    /// Draws what the lights of the last [`Runtime::relight`] show. The texture holds scene-linear radiance in f32 once
    /// the GPU is done; it is overwritten by the next call and replaced when the size changes.
    pub fn draw(&mut self, view: &View, shown: Shown) -> Result<&wgpu::Texture, GpuError> {
        let pinhole = view.pinhole()?;
        // Nothing can be looked at from closer than shadow rays resolve.
        let frame = &mut self.scene().frame;
        frame.clip_from_world = pinhole.clip_from_world(frame.shadow_offset.max(f32::MIN_POSITIVE));
        frame.eye_ws = pinhole.eye.to_array();
        frame.samples_per_axis = view.samples_per_axis;
        frame.shown = show_bits(shown);
        let Relighter { gpu, scene, .. } = &self.relighter;
        let scene = scene.as_ref().expect("it measures by rays");
        scene.write_frame(gpu);
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let size = [view.width, view.height];
        let picture = self.shading.encode(
            gpu,
            &mut encoder,
            scene,
            self.relighter.bind_group(),
            size,
            view.samples_per_axis,
            self.timer.as_ref(),
        )?;
        gpu.queue.submit([encoder.finish()]);
        gpu.check()?;
        Ok(picture)
    }

    /// Radiant exitance of each sub-point: the measure stage alone. CPU twin: `MeasurementPoints::sub_point_exitance`.
    pub fn sub_point_exitance(&mut self, lights: &[Light]) -> Result<Vec<Rgb>, GpuError> {
        self.set_lights(lights)?;
        self.run(&[Stage::Measure]);
        self.download(&self.relighter.measurement.exitance, self.sub_points)
    }

    /// x from the sub-points' exitance: the downsample stage alone. CPU twin: `MeasurementPoints::average`.
    pub fn average(&mut self, sub_point_exitance: &[Rgb]) -> Result<Vec<Rgb>, GpuError> {
        assert_eq!(sub_point_exitance.len(), self.sub_points, "values of another point set");
        self.upload(&self.relighter.measurement.exitance, sub_point_exitance);
        self.run(&[Stage::Downsample]);
        self.download(&self.relighter.measurement.direct, self.points)
    }

    /// u from x: the transfer stage alone. CPU twin: `Transfer::coefficients`.
    pub fn coefficients(&mut self, direct: &[Rgb]) -> Result<Vec<Rgb>, GpuError> {
        assert_eq!(direct.len(), self.points, "direct vector of another point set");
        self.upload(&self.relighter.measurement.direct, direct);
        self.run(&[Stage::Transfer]);
        self.download(&self.relighter.measurement.coefficients, self.elements)
    }

    /// Sets u, and the indirect light made of it, for the pictures drawn until the next [`Runtime::relight`].
    pub fn set_coefficients(&mut self, coefficients: &[Rgb]) {
        assert_eq!(coefficients.len(), self.elements, "coefficients of another basis");
        self.upload(&self.relighter.measurement.coefficients, coefficients);
        self.run(&[Stage::Reconstruct]);
    }

    /// Indirect irradiance over the lightmap's page, of either sign, `[y][x]`: the reconstruct stage's result. CPU twin:
    /// `Basis::reconstruct`.
    ///
    /// # Panics
    /// With [`Lookup::Fragment`], which has no such stage.
    pub fn irradiance(&mut self) -> Result<Vec<Rgb>, GpuError> {
        let reconstruction = self.relighter.reconstruction.as_ref().expect("Lookup::Texture reconstructs");
        reconstruction.read(self.gpu())
    }

    /// Sets the lights that pictures are drawn with, and leaves the coefficients as they are.
    pub fn set_lights(&mut self, lights: &[Light]) -> Result<(), GpuError> {
        self.relighter.set_lights(lights)
    }

    /// What [`Runtime::draw`] drew last, scene-linear radiance.
    pub fn picture(&self) -> Option<&wgpu::Texture> {
        self.shading.picture()
    }

    /// Reads back what [`Runtime::draw`] last drew of `view`.
    pub fn read_picture(&mut self, view: &View) -> Result<Picture, GpuError> {
        let &View { width, height, .. } = view;
        let picture = self.shading.picture().expect("drawn before it is read");
        let pixels = self.gpu().read_texture(picture)?;
        Ok(Picture { width, height, pixels })
    }

    /// How long each pass of the last [`Runtime::relight`] and [`Runtime::draw`] took; none where the GPU cannot tell. Passes that
    /// were not run since this was last asked took no time.
    pub fn pass_times(&self) -> Result<Option<PassTimes>, GpuError> {
        let read = |timer: &Timer| Ok(timer.read(self.gpu())?[0]);
        self.timer.as_ref().map(read).transpose()
    }

    fn run(&self, stages: &[Stage]) {
        let mut encoder = self.gpu().device.create_command_encoder(&Default::default());
        self.relighter.encode_stages(&mut encoder, stages, self.timer.as_ref());
        self.gpu().queue.submit([encoder.finish()]);
    }

    fn upload(&self, buffer: &wgpu::Buffer, values: &[Rgb]) {
        let padded: Vec<[f32; 4]> = values.iter().map(|v| v.extend(0.0).to_array()).collect();
        self.gpu().queue.write_buffer(buffer, 0, bytemuck::cast_slice(&padded));
    }

    fn download(&self, buffer: &wgpu::Buffer, count: usize) -> Result<Vec<Rgb>, GpuError> {
        let values: Vec<[f32; 4]> = self.gpu().download(buffer, count)?;
        Ok(values.into_iter().map(|[r, g, b, _]| Rgb::new(r, g, b)).collect())
    }
}

/// The SHOW_ bits of `shaders/frame.wgsl`.
fn show_bits(shown: Shown) -> u32 {
    const DIRECT: u32 = 1;
    const INDIRECT: u32 = 2;
    const WHITE: u32 = 4;
    match shown {
        Shown::Full => DIRECT | INDIRECT,
        Shown::Direct => DIRECT,
        Shown::Indirect => INDIRECT,
        Shown::IndirectOnWhite => INDIRECT | WHITE,
    }
}
