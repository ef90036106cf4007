//! From coefficients to irradiance over the lightmap's page: the reconstruct stage.
//!
//! Once for each change of light, whatever the view, and a pixel is left with one lookup. Irradiance is kept in f32, which
//! holds sunlight in lux as well as a candle's.

use super::bindings::{self, READ, UNIFORM};
use super::device::{Gpu, GpuError};
use super::layout::BasisShape;
use super::shader::Stage;
use super::textures::{Pixels, elements_per_layer, upload_basis};
use super::timer::Timer;
use crate::math::Rgb;
use crate::model::Basis;

const IRRADIANCE: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Float;

/// Side of a workgroup in `reconstruct.wgsl`.
const TILE: u32 = 8;

pub struct Reconstruction {
    pipeline: wgpu::ComputePipeline,
    bind_group: wgpu::BindGroup,
    size: u32,
    texture: wgpu::Texture,
    /// W/m², of either sign.
    pub irradiance: wgpu::TextureView,
}

impl Reconstruction {
    pub fn new(gpu: &Gpu, basis: &Basis, coefficients: &wgpu::Buffer) -> Result<Self, GpuError> {
        let size = basis.size as u32;
        let shape = BasisShape {
            size,
            layers: basis.elements.div_ceil(elements_per_layer(basis.components)) as u32,
            components: basis.components as u32,
            elements: basis.elements as u32,
            anchors: basis.anchors.as_ref().map_or(0, |a| a.count as u32),
        };
        let shape = gpu.uniform("basis shape", &shape);
        let values = upload_basis(gpu, basis)?;
        // A global basis has a texel for form's sake.
        let (side, indices, shares) = match &basis.anchors {
            Some(anchors) => (size, &anchors.indices[..], &anchors.shares[..]),
            None => (1, &[[0; 4]][..], &[[0; 4]][..]),
        };
        let anchors =
            |what: &str, codes: &[[u8; 4]], format| Pixels { side, format }.upload(gpu, what, codes.as_flattened());
        let indices = anchors("the anchors", indices, wgpu::TextureFormat::Rgba8Uint)?;
        let shares = anchors("the anchors' shares", shares, wgpu::TextureFormat::Rgba8Unorm)?;
        let written = wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_SRC;
        let read = wgpu::TextureUsages::TEXTURE_BINDING;
        let extent = wgpu::Extent3d { width: size, height: size, depth_or_array_layers: 1 };
        let texture = gpu.texture("irradiance", extent, IRRADIANCE, written | read);
        let irradiance = texture.create_view(&Default::default());

        let float = wgpu::TextureSampleType::Float { filterable: false };
        let types = [
            UNIFORM,
            READ,
            bindings::texture(float, wgpu::TextureViewDimension::D2Array),
            bindings::texture(wgpu::TextureSampleType::Uint, wgpu::TextureViewDimension::D2),
            bindings::texture(float, wgpu::TextureViewDimension::D2),
            wgpu::BindingType::StorageTexture {
                access: wgpu::StorageTextureAccess::WriteOnly,
                format: IRRADIANCE,
                view_dimension: wgpu::TextureViewDimension::D2,
            },
        ];
        let layout = bindings::layout(gpu, "reconstruct", wgpu::ShaderStages::COMPUTE, &types);
        let resources = [
            shape.as_entire_binding(),
            coefficients.as_entire_binding(),
            wgpu::BindingResource::TextureView(&values),
            wgpu::BindingResource::TextureView(&indices),
            wgpu::BindingResource::TextureView(&shares),
            wgpu::BindingResource::TextureView(&irradiance),
        ];
        let bind_group = bindings::bind(gpu, "reconstruct", &layout, resources);
        let pipeline = bindings::compute_pipeline(gpu, Stage::Reconstruct, &[&layout]);
        Ok(Self { pipeline, bind_group, size, texture, irradiance })
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
        pass.dispatch_workgroups(self.size.div_ceil(TILE), self.size.div_ceil(TILE), 1);
    }
}
