//! From coefficients to irradiance over the lightmap's page: the reconstruct stage.
//!
//! Once for each change of light, whatever the view, and a pixel is left with one bilinear lookup. Irradiance is kept in f32,
//! which holds sunlight in lux as well as a candle's.

use super::bindings;
use super::device::{Gpu, GpuError};
use super::shader::{Lookup, Stage};
use super::stored::StoredBasis;
use super::timer::Timer;
use crate::math::Rgb;
use crate::model::Basis;

const IRRADIANCE: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Float;

/// Side of a workgroup in `reconstruct.wgsl`.
const TILE: u32 = 8;

pub struct Reconstruction {
    pipeline: wgpu::ComputePipeline,
    bind_group: wgpu::BindGroup,
    texture: wgpu::Texture,
    /// W/m², of either sign.
    pub irradiance: wgpu::TextureView,
}

impl Reconstruction {
    pub fn new(gpu: &Gpu, basis: &Basis, stored: &StoredBasis) -> Self {
        let size = basis.size as u32;
        let written = wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_SRC;
        let read = wgpu::TextureUsages::TEXTURE_BINDING;
        let extent = wgpu::Extent3d { width: size, height: size, depth_or_array_layers: 1 };
        let texture = gpu.texture("irradiance", extent, IRRADIANCE, written | read);
        let irradiance = texture.create_view(&Default::default());
        let target = wgpu::BindingType::StorageTexture {
            access: wgpu::StorageTextureAccess::WriteOnly,
            format: IRRADIANCE,
            view_dimension: wgpu::TextureViewDimension::D2,
        };
        let mut types = stored.types(false);
        types.push((4, target));
        let mut resources = stored.resources();
        resources.push((4, wgpu::BindingResource::TextureView(&irradiance)));
        let layout = bindings::numbered_layout(gpu, "reconstruct", wgpu::ShaderStages::COMPUTE, &types);
        let bind_group = bindings::bind_numbered(gpu, "reconstruct", &layout, resources);
        let source = Stage::Reconstruct.source(basis, Lookup::Texture);
        let pipeline = bindings::compute_pipeline(gpu, Stage::Reconstruct, source, &[&layout]);
        Self { pipeline, bind_group, texture, irradiance }
    }

    /// Waits, then returns the irradiance, `[y][x]`.
    pub fn read(&self, gpu: &Gpu) -> Result<Vec<Rgb>, GpuError> {
        gpu.read_texture(&self.texture)
    }

    pub fn encode(&self, encoder: &mut wgpu::CommandEncoder, timer: Option<&Timer>) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("reconstruct"),
            timestamp_writes: timer.map(|timer| timer.compute_pass(Stage::Reconstruct)),
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bind_group, &[]);
        let tiles = self.texture.width().div_ceil(TILE);
        pass.dispatch_workgroups(tiles, tiles, 1);
    }
}
