//! The stages in order: one model, relit and drawn.

use super::device::{Gpu, GpuError};
use super::layout::FrameUniforms;
use super::measurement::Measurement;
use super::reconstruction::Reconstruction;
use super::scene::Scene;
use super::shader::Stage;
use super::shading::Shading;
use super::timer::{PassTimes, Timer};
use crate::light::Light;
use crate::math::Rgb;
use crate::model::{Model, Picture, Shown, View};
use crate::scene::tracer::RELATIVE_OFFSET;

/// A model on the GPU.
pub struct Runtime {
    gpu: Gpu,
    scene: Scene,
    measurement: Measurement,
    reconstruction: Reconstruction,
    shading: Shading,
    frame: FrameUniforms,
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
        let scene = Scene::new(&gpu, &model.asset)?;
        let measurement = Measurement::new(&gpu, model, &scene)?;
        let reconstruction = Reconstruction::new(&gpu, &model.basis, &measurement.coefficients)?;
        let shading = Shading::new(&gpu, &scene, &reconstruction.irradiance);
        let extent = model.asset.mesh.bounds().diagonal();
        let frame = FrameUniforms { shadow_offset: extent * RELATIVE_OFFSET, extent, ..bytemuck::Zeroable::zeroed() };
        gpu.check()?;
        let timer = gpu.has_timestamps().then(|| Timer::new(&gpu));
        let (sub_points, points) = (model.points.sub_points.len(), model.points.points.len());
        let elements = model.transfer.elements;
        Ok(Self { gpu, scene, measurement, reconstruction, shading, frame, timer, sub_points, points, elements })
    }

    pub fn gpu(&self) -> &Gpu {
        &self.gpu
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
        self.gpu.check()
    }

    /// x, as [`Runtime::relight`] last measured it: for [`crate::model::Scope::read`], among others.
    pub fn direct(&self) -> Result<Vec<Rgb>, GpuError> {
        self.download(&self.measurement.direct, self.points)
    }

    /// Draws what the lights of the last [`Runtime::relight`] show. The texture holds scene-linear radiance in f32 once
    /// the GPU is done; it is overwritten by the next call and replaced when the size changes.
    pub fn draw(&mut self, view: &View, shown: Shown) -> Result<&wgpu::Texture, GpuError> {
        let pinhole = view.pinhole()?;
        // Nothing can be looked at from closer than shadow rays resolve.
        self.frame.clip_from_world = pinhole.clip_from_world(self.frame.shadow_offset.max(f32::MIN_POSITIVE));
        self.frame.eye_ws = pinhole.eye.to_array();
        self.frame.samples_per_axis = view.samples_per_axis;
        self.frame.shown = show_bits(shown);
        self.write_frame();
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let size = [view.width, view.height];
        let picture = self.shading.encode(
            &self.gpu,
            &mut encoder,
            &self.scene,
            size,
            view.samples_per_axis,
            self.timer.as_ref(),
        )?;
        self.gpu.queue.submit([encoder.finish()]);
        self.gpu.check()?;
        Ok(picture)
    }

    /// Radiant exitance of each sub-point: the measure stage alone. CPU twin: `MeasurementPoints::sub_point_exitance`.
    pub fn sub_point_exitance(&mut self, lights: &[Light]) -> Result<Vec<Rgb>, GpuError> {
        self.set_lights(lights)?;
        self.run(&[Stage::Measure]);
        self.download(&self.measurement.exitance, self.sub_points)
    }

    /// x from the sub-points' exitance: the downsample stage alone. CPU twin: `MeasurementPoints::average`.
    pub fn average(&mut self, sub_point_exitance: &[Rgb]) -> Result<Vec<Rgb>, GpuError> {
        assert_eq!(sub_point_exitance.len(), self.sub_points, "values of another point set");
        self.upload(&self.measurement.exitance, sub_point_exitance);
        self.run(&[Stage::Downsample]);
        self.download(&self.measurement.direct, self.points)
    }

    /// u from x: the transfer stage alone. CPU twin: `Transfer::coefficients`.
    pub fn coefficients(&mut self, direct: &[Rgb]) -> Result<Vec<Rgb>, GpuError> {
        assert_eq!(direct.len(), self.points, "direct vector of another point set");
        self.upload(&self.measurement.direct, direct);
        self.run(&[Stage::Transfer]);
        self.download(&self.measurement.coefficients, self.elements)
    }

    /// Sets u, and the indirect light made of it, for the pictures drawn until the next [`Runtime::relight`].
    pub fn set_coefficients(&mut self, coefficients: &[Rgb]) {
        assert_eq!(coefficients.len(), self.elements, "coefficients of another basis");
        self.upload(&self.measurement.coefficients, coefficients);
        self.run(&[Stage::Reconstruct]);
    }

    /// Indirect irradiance over the lightmap's page, of either sign, `[y][x]`: the reconstruct stage's result. CPU twin:
    /// `Basis::reconstruct`.
    pub fn irradiance(&mut self) -> Result<Vec<Rgb>, GpuError> {
        self.reconstruction.read(&self.gpu)
    }

    /// Sets the lights that pictures are drawn with, and leaves the coefficients as they are.
    pub fn set_lights(&mut self, lights: &[Light]) -> Result<(), GpuError> {
        self.frame.light_count = self.scene.set_lights(&self.gpu, lights)?;
        self.write_frame();
        Ok(())
    }

    /// What [`Runtime::draw`] drew last, scene-linear radiance.
    pub fn picture(&self) -> Option<&wgpu::Texture> {
        self.shading.picture()
    }

    /// Reads back what [`Runtime::draw`] last drew of `view`.
    pub fn read_picture(&mut self, view: &View) -> Result<Picture, GpuError> {
        let &View { width, height, .. } = view;
        let picture = self.shading.picture().expect("drawn before it is read");
        let pixels = self.gpu.read_texture(picture)?;
        Ok(Picture { width, height, pixels })
    }

    /// How long each pass of the last [`Runtime::relight`] and [`Runtime::draw`] took; none where the GPU cannot tell.
    pub fn pass_times(&self) -> Result<Option<PassTimes>, GpuError> {
        self.timer.as_ref().map(|timer| timer.read(&self.gpu)).transpose()
    }

    fn run(&self, stages: &[Stage]) {
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        for &stage in stages {
            match stage {
                Stage::Reconstruct => self.reconstruction.encode(&mut encoder, self.timer.as_ref()),
                _ => self.measurement.encode(&mut encoder, stage, &self.scene, self.timer.as_ref()),
            }
        }
        self.gpu.queue.submit([encoder.finish()]);
    }

    fn write_frame(&self) {
        self.gpu.queue.write_buffer(&self.scene.frame, 0, bytemuck::bytes_of(&self.frame));
    }

    fn upload(&self, buffer: &wgpu::Buffer, values: &[Rgb]) {
        let padded: Vec<[f32; 4]> = values.iter().map(|v| v.extend(0.0).to_array()).collect();
        self.gpu.queue.write_buffer(buffer, 0, bytemuck::cast_slice(&padded));
    }

    fn download(&self, buffer: &wgpu::Buffer, count: usize) -> Result<Vec<Rgb>, GpuError> {
        let values: Vec<[f32; 4]> = self.gpu.download(buffer, count)?;
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
