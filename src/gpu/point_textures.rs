//! The sub-points as a G-buffer.

use super::device::Gpu;
use crate::measure::MeasurementPoint;

/// Where light is measured, a texel for each sub-point, row by row: textures of rgba32float, [`PointTextures::WIDTH`] wide. What the
/// host makes of them, albedo times the irradiance of its direct light, goes into a texture of the same size and from there to
/// [`Relighter::encode_exitance`](super::Relighter::encode_exitance).
pub struct PointTextures {
    /// Metres, world space; the fourth is 1, and 0 in texels past the last sub-point.
    pub position: wgpu::Texture,
    /// Unit shading normal, world space.
    pub normal: wgpu::Texture,
    /// Share of diffusely arriving light that leaves again, linear RGB.
    pub albedo: wgpu::Texture,
}

impl PointTextures {
    /// Texels. A row of rgba32float is then as long as copies between textures and buffers want it, a multiple of 256 bytes, and
    /// the most sub-points that a model can have fit the height that every device offers.
    pub const WIDTH: u32 = 256;

    /// Texels that `count` sub-points take, whole rows of them.
    pub fn texels(count: usize) -> usize {
        count.max(1).next_multiple_of(Self::WIDTH as usize)
    }

    pub(super) fn new(gpu: &Gpu, sub_points: &[MeasurementPoint]) -> Self {
        let texels = Self::texels(sub_points.len());
        let size = wgpu::Extent3d { width: Self::WIDTH, height: texels as u32 / Self::WIDTH, depth_or_array_layers: 1 };
        let upload = |what: &str, value: fn(&MeasurementPoint) -> [f32; 4]| {
            let mut values: Vec<[f32; 4]> = sub_points.iter().map(value).collect();
            values.resize(texels, [0.0; 4]);
            let usage =
                wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::COPY_SRC;
            let texture = gpu.texture(what, size, wgpu::TextureFormat::Rgba32Float, usage);
            let layout =
                wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(16 * Self::WIDTH), rows_per_image: None };
            gpu.queue.write_texture(texture.as_image_copy(), bytemuck::cast_slice(&values), layout, size);
            texture
        };
        Self {
            position: upload("sub-points: position", |p| p.position.extend(1.0).to_array()),
            normal: upload("sub-points: normal", |p| p.normal.extend(0.0).to_array()),
            albedo: upload("sub-points: albedo", |p| p.albedo.extend(0.0).to_array()),
        }
    }
}
