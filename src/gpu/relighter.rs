//! Indirect light for a host application's own renderer, on its own device.

use super::bindings;
use super::device::{Gpu, GpuError};
use super::measurement::Measurement;
use super::point_textures::PointTextures;
use super::reconstruction::Reconstruction;
use super::scene::Scene;
use super::shader::{self, Lookup, Stage};
use super::stored::StoredBasis;
use super::timer::Timer;
use crate::light::Light;
use crate::model::Model;

/// Who measures the direct light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Measure {
    /// [`Relighter`] does, by shadow rays against the asset, of the lights given to [`Relighter::set_lights`].
    #[default]
    Rays,
    /// The host does, at the sub-points: it writes [`Relighter::exitance`].
    SubPoints,
    /// The host does, at the points: it writes [`Relighter::direct`].
    Points,
}

/// How a [`Relighter`] is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    pub measure: Measure,
    pub lookup: Lookup,
}

/// A model on the host's device: records its passes into the host's encoder, and gives the host's shaders a bind group and the
/// WGSL function `indirect_irradiance`.
///
/// ```no_run
/// # fn embed(device: &wgpu::Device, queue: &wgpu::Queue, host_wgsl: &str) -> Result<(), Box<dyn std::error::Error>> {
/// use relight::gpu::{Lookup, Measure, Relighter, Settings};
///
/// let model = relight::model::Model::load("room.relight".as_ref())?;
/// let lookup = Lookup::cheaper(&model.basis, 1920 * 1080);
/// let mut relighter = Relighter::new(device, queue, &model, Settings { measure: Measure::Rays, lookup })?;
///
/// // Once: a pipeline whose bind group 1 is the relighter's. In its fragment shader,
/// //     radiance += albedo / π · indirect_irradiance(lightmap_uv)
/// let wgsl = format!("{}{host_wgsl}", relighter.wgsl(1));
/// let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
///     bind_group_layouts: &[None, Some(relighter.bind_group_layout())],
///     ..Default::default()
/// });
///
/// // Whenever lights have changed, before what is drawn with them:
/// # let lights = [];
/// # let mut encoder = device.create_command_encoder(&Default::default());
/// relighter.set_lights(&lights)?;
/// relighter.encode(&mut encoder);
///
/// // In the host's render pass:
/// //     pass.set_bind_group(1, relighter.bind_group(), &[]);
/// # Ok(())
/// # }
/// ```
///
/// `lightmap_uv` is the mesh's lightmap coordinate ([`crate::scene::Mesh::lightmap_uvs`]; TEXCOORD_1 of what `relight export`
/// writes), `indirect_irradiance` in W/m² for lights in glTF's units, without the receiver's albedo.
///
/// Everything stays within WebGPU's default limits, but for the sizes of buffers and textures, which are checked, and needs no
/// optional feature. Mistakes in the use of wgpu go to the device's own error handler.
pub struct Relighter {
    pub(super) gpu: Gpu,
    /// What rays are traced against, where they are.
    pub(super) scene: Option<Scene>,
    pub(super) measurement: Measurement,
    pub(super) reconstruction: Option<Reconstruction>,
    pub(super) stored: StoredBasis,
    layout: wgpu::BindGroupLayout,
    bind_group: wgpu::BindGroup,
    function: String,
    points: PointTextures,
    settings: Settings,
}

impl Relighter {
    /// Uploads `model` to the host's device. The model is not needed afterwards.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] where something does not fit the device's limits.
    pub fn new(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        model: &Model,
        settings: Settings,
    ) -> Result<Self, GpuError> {
        Self::on(Gpu::of_host(device, queue), model, settings)
    }

    pub(super) fn on(gpu: Gpu, model: &Model, settings: Settings) -> Result<Self, GpuError> {
        let Settings { measure, lookup } = settings;
        let scene = match measure {
            Measure::Rays => Some(Scene::new(&gpu, &model.asset)?),
            Measure::SubPoints | Measure::Points => None,
        };
        let measurement = Measurement::new(&gpu, model, scene.as_ref())?;
        let stored = StoredBasis::new(&gpu, &model.basis, &measurement.coefficients)?;
        let reconstruction = (lookup == Lookup::Texture).then(|| Reconstruction::new(&gpu, &model.basis, &stored));
        let sampler = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("the basis"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        let unfiltered = wgpu::TextureSampleType::Float { filterable: false };
        let (types, resources) = match &reconstruction {
            Some(reconstruction) => (
                vec![(0, bindings::texture(unfiltered, wgpu::TextureViewDimension::D2))],
                vec![(0, wgpu::BindingResource::TextureView(&reconstruction.irradiance))],
            ),
            None => {
                let (mut types, mut resources) = (stored.types(!stored.is_local()), stored.resources());
                if !stored.is_local() {
                    types.push((4, wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering)));
                    resources.push((4, wgpu::BindingResource::Sampler(&sampler)));
                }
                (types, resources)
            }
        };
        let visibility = wgpu::ShaderStages::VERTEX_FRAGMENT | wgpu::ShaderStages::COMPUTE;
        let layout = bindings::numbered_layout(&gpu, "indirect light", visibility, &types);
        let bind_group = bindings::bind_numbered(&gpu, "indirect light", &layout, resources);
        let function = shader::indirect_irradiance(&model.basis, lookup, 0);
        let points = PointTextures::new(&gpu, &model.points.sub_points);
        Ok(Self { gpu, scene, measurement, reconstruction, stored, layout, bind_group, function, points, settings })
    }

    /// Sets the lights that the next submission measures, for [`Measure::Rays`].
    ///
    /// Written through the queue: a command buffer that is recorded but not yet submitted sees these lights, too.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] for more lights than a buffer holds.
    ///
    /// # Panics
    /// Where the host measures.
    pub fn set_lights(&mut self, lights: &[Light]) -> Result<(), GpuError> {
        let scene = self.scene.as_mut().expect("lights are for Measure::Rays");
        scene.set_lights(&self.gpu, lights)
    }

    /// Records what is needed after a change of light: measure and downsample as far as the host does not, transfer, and
    /// reconstruct for [`Lookup::Texture`]. Until it is recorded anew the light stays as it is.
    pub fn encode(&self, encoder: &mut wgpu::CommandEncoder) {
        self.encode_timed(encoder, None);
    }

    pub(super) fn encode_timed(&self, encoder: &mut wgpu::CommandEncoder, timer: Option<&Timer>) {
        let stages: &[Stage] = match self.settings.measure {
            Measure::Rays => &[Stage::Measure, Stage::Downsample, Stage::Transfer, Stage::Reconstruct],
            Measure::SubPoints => &[Stage::Downsample, Stage::Transfer, Stage::Reconstruct],
            Measure::Points => &[Stage::Transfer, Stage::Reconstruct],
        };
        self.encode_stages(encoder, stages, timer);
    }

    pub(super) fn encode_stages(&self, encoder: &mut wgpu::CommandEncoder, stages: &[Stage], timer: Option<&Timer>) {
        for &stage in stages {
            match (stage, &self.reconstruction) {
                (Stage::Reconstruct, Some(reconstruction)) => reconstruction.encode(encoder, timer),
                (Stage::Reconstruct, None) => {}
                _ => self.measurement.encode(encoder, stage, self.scene.as_ref(), timer),
            }
        }
    }

    /// The layout of [`Self::bind_group`]; visible to every stage.
    pub fn bind_group_layout(&self) -> &wgpu::BindGroupLayout {
        &self.layout
    }

    /// What `indirect_irradiance` reads. The same for as long as the relighter lives.
    pub fn bind_group(&self) -> &wgpu::BindGroup {
        &self.bind_group
    }

    /// The WGSL function `indirect_irradiance(lightmap_uv: vec2f) -> vec3f`, W/m², not under zero, to be put before the host's own
    /// shader. Its bindings are in bind group `group`; all other names in it begin with `relight_` or `RELIGHT_`.
    pub fn wgsl(&self, group: u32) -> String {
        self.function.replace("@group(0)", &format!("@group({group})"))
    }

    /// The whole lightmap's indirect irradiance, W/m², of either sign, or with a γ its root (see [`crate::model::Transfer::gamma`]),
    /// for [`Lookup::Texture`]: rgba32float.
    pub fn irradiance(&self) -> Option<&wgpu::TextureView> {
        self.reconstruction.as_ref().map(|reconstruction| &reconstruction.irradiance)
    }

    /// Where light is measured, as textures, for a host that shades them as it shades its G-buffer (the paper's "fake
    /// G-buffer", section 4.3).
    pub fn points(&self) -> &PointTextures {
        &self.points
    }

    /// Radiant exitance of each sub-point under direct light: albedo times irradiance, W/m², RGB and an unused fourth; in the
    /// order of [`Self::points`] and of [`crate::measure::MeasurementPoints::sub_points`]. A storage buffer, to be written by
    /// the host for [`Measure::SubPoints`].
    pub fn exitance(&self) -> &wgpu::Buffer {
        &self.measurement.exitance
    }

    /// Records the copy of a texture of the size of [`Self::points`], rgba32float, that holds what [`Self::exitance`] is to hold.
    pub fn encode_exitance(&self, encoder: &mut wgpu::CommandEncoder, texture: &wgpu::Texture) {
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(16 * PointTextures::WIDTH),
            rows_per_image: None,
        };
        let to = wgpu::TexelCopyBufferInfo { buffer: &self.measurement.exitance, layout };
        encoder.copy_texture_to_buffer(texture.as_image_copy(), to, texture.size());
    }

    /// x: the same at the points, each the mean of its sub-points. A storage buffer, to be written by the host for
    /// [`Measure::Points`].
    pub fn direct(&self) -> &wgpu::Buffer {
        &self.measurement.direct
    }

    /// Bytes of the basis on the GPU, with anchors.
    pub fn basis_bytes(&self) -> u64 {
        self.stored.bytes
    }
}
