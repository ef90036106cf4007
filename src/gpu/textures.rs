//! Textures on the GPU: the materials' images on pages of one array texture, and the basis.
//!
//! WebGPU guarantees 16 sampled textures a stage and no arrays of bindings, so images of any size share pages of the
//! largest one's size. They are read code by code and filtered in the shader: exact at every wrap mode and size, with
//! the texture cache that a storage buffer of texels lacks, and free of that buffer's 128 MiB limit.

use super::device::{Gpu, GpuError};
use super::layout::TextureUse;
use crate::math::colour::linear_from_srgb;
use crate::model::{Basis, Values};
use crate::scene::{Texture, TextureRef, Wrap};

/// `page` of a use without texture.
const NO_TEXTURE: u32 = u32::MAX;

/// Where each texture lies.
pub struct Pages {
    pub view: wgpu::TextureView,
    places: Vec<Place>,
}

#[derive(Clone, Copy)]
struct Place {
    page: u32,
    origin: [u32; 2],
}

impl Pages {
    pub fn new(gpu: &Gpu, textures: &[Texture]) -> Result<Self, GpuError> {
        let (side, places) = pack(textures);
        let count = places.iter().map(|p| p.page + 1).max().unwrap_or(1);
        let size = wgpu::Extent3d { width: side[0], height: side[1], depth_or_array_layers: count };
        let pages = gpu.texture_array("material textures", size, wgpu::TextureFormat::Rgba8Uint)?;
        for (texture, place) in textures.iter().zip(&places) {
            gpu.queue.write_texture(
                wgpu::TexelCopyTextureInfo {
                    texture: &pages,
                    mip_level: 0,
                    origin: wgpu::Origin3d { x: place.origin[0], y: place.origin[1], z: place.page },
                    aspect: wgpu::TextureAspect::All,
                },
                texture.texels.as_flattened(),
                wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * texture.width), rows_per_image: None },
                wgpu::Extent3d { width: texture.width, height: texture.height, depth_or_array_layers: 1 },
            );
        }
        Ok(Self { view: array_view(&pages), places })
    }

    /// How a material's texture reads from its page.
    pub fn texture_use(&self, textures: &[Texture], reference: Option<&TextureRef>) -> TextureUse {
        let Some(reference) = reference else {
            return TextureUse { page: NO_TEXTURE, ..bytemuck::Zeroable::zeroed() };
        };
        let texture = &textures[reference.texture as usize];
        let place = self.places[reference.texture as usize];
        TextureUse {
            u_from_uv: reference.transform.row(0).to_array(),
            page: place.page,
            v_from_uv: reference.transform.row(1).to_array(),
            uv_set: reference.uv_set,
            origin: place.origin,
            size: [texture.width, texture.height],
            wrap: texture.wrap.map(|wrap| match wrap {
                Wrap::Repeat => 0,
                Wrap::Mirror => 1,
                Wrap::Clamp => 2,
            }),
            srgb: texture.srgb as u32,
            _pad: 0,
        }
    }
}

/// Packs textures in rows, tallest first, on pages as large as the widest and the tallest; one texel where there are none.
fn pack(textures: &[Texture]) -> ([u32; 2], Vec<Place>) {
    let side = textures.iter().fold([1, 1], |[w, h], t| [w.max(t.width), h.max(t.height)]);
    let mut order: Vec<usize> = (0..textures.len()).collect();
    order.sort_by_key(|&i| std::cmp::Reverse((textures[i].height, textures[i].width)));
    let mut places = vec![Place { page: 0, origin: [0, 0] }; textures.len()];
    let (mut page, mut x, mut row_top, mut row_bottom) = (0, 0, 0, 0);
    for i in order {
        let (width, height) = (textures[i].width, textures[i].height);
        if x + width > side[0] {
            (x, row_top) = (0, row_bottom);
        }
        if row_top + height > side[1] {
            page += 1;
            (x, row_top, row_bottom) = (0, 0, 0);
        }
        places[i] = Place { page, origin: [x, row_top] };
        x += width;
        row_bottom = row_bottom.max(row_top + height);
    }
    (side, places)
}

/// Linear value of each 8-bit sRGB code, as the CPU decodes it.
pub fn srgb_table() -> [f32; 256] {
    std::array::from_fn(|code| linear_from_srgb(code as f32 / 255.0))
}

/// A square texture of four codes a texel.
pub struct Pixels {
    pub side: u32,
    pub format: wgpu::TextureFormat,
}

impl Pixels {
    pub fn upload(self, gpu: &Gpu, what: &str, bytes: &[u8]) -> Result<wgpu::TextureView, GpuError> {
        let texture = gpu.texture_array(what, self.extent(1), self.format)?;
        self.write(gpu, &texture, 0, bytes);
        Ok(texture.create_view(&Default::default()))
    }

    fn extent(&self, layers: u32) -> wgpu::Extent3d {
        wgpu::Extent3d { width: self.side, height: self.side, depth_or_array_layers: layers }
    }

    fn write(&self, gpu: &Gpu, texture: &wgpu::Texture, layer: u32, bytes: &[u8]) {
        let row = bytes.len() as u32 / self.side;
        gpu.queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                texture,
                mip_level: 0,
                origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
                aspect: wgpu::TextureAspect::All,
            },
            bytes,
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row), rows_per_image: None },
            self.extent(1),
        );
    }
}

/// The basis as an array texture, f16 or 8 bits with a sign: four scalar elements a layer, or one RGB element.
pub fn upload_basis(gpu: &Gpu, basis: &Basis) -> Result<wgpu::TextureView, GpuError> {
    let format = match &basis.values {
        Values::Half(_) => wgpu::TextureFormat::Rgba16Float,
        Values::Byte(_) => wgpu::TextureFormat::Rgba8Snorm,
    };
    let pixels = Pixels { side: basis.size as u32, format };
    let texture = gpu.texture_array("basis", pixels.extent(basis.layers() as u32), format)?;
    for layer in 0..basis.layers() {
        pixels.write(gpu, &texture, layer as u32, &basis_layer(basis, layer));
    }
    Ok(array_view(&texture))
}

/// Texels of one layer of the basis texture, four values each, row by row.
pub fn basis_layer(basis: &Basis, layer: usize) -> Vec<u8> {
    match &basis.values {
        Values::Half(values) => layer_of(basis, values, layer),
        Values::Byte(codes) => layer_of(basis, codes, layer),
    }
}

/// Planes of consecutive elements, or of the components of one element, become the channels of a layer.
fn layer_of<T: bytemuck::Pod>(basis: &Basis, values: &[T], layer: usize) -> Vec<u8> {
    let plane = basis.size * basis.size;
    let planes = plane * basis.elements_per_layer() * basis.components;
    let mut texels = vec![T::zeroed(); 4 * plane];
    for (channel, values) in values[layer * planes..].chunks_exact(plane).take(planes / plane).enumerate() {
        for (texel, &value) in texels.chunks_exact_mut(4).zip(values) {
            texel[channel] = value;
        }
    }
    bytemuck::cast_slice(&texels).to_vec()
}

fn array_view(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packed_textures_stay_on_their_pages_and_apart() {
        let sizes = [(64, 64), (16, 64), (64, 16), (30, 30), (30, 30), (30, 30), (1, 1), (64, 64)];
        let textures: Vec<Texture> = sizes
            .iter()
            .map(|&(width, height)| Texture {
                name: String::new(),
                width,
                height,
                texels: Vec::new(),
                srgb: false,
                wrap: [Wrap::Repeat; 2],
            })
            .collect();
        let (side, places) = pack(&textures);
        assert_eq!(side, [64, 64]);
        let mut taken = std::collections::HashSet::new();
        for (texture, place) in textures.iter().zip(&places) {
            for y in 0..texture.height {
                for x in 0..texture.width {
                    let at = [place.origin[0] + x, place.origin[1] + y];
                    assert!(at[0] < side[0] && at[1] < side[1]);
                    assert!(taken.insert((place.page, at)), "two textures at {at:?} of page {}", place.page);
                }
            }
        }
    }
}
