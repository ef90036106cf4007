//! The basis on the GPU, with the coefficients that it takes: what basis_global.wgsl and basis_local.wgsl read.

use super::bindings::{self, READ, UNIFORM};
use super::device::{Gpu, GpuError};
use super::textures::{Pixels, upload_basis};
use crate::model::Basis;

pub struct StoredBasis {
    coefficients: wgpu::Buffer,
    values: wgpu::TextureView,
    /// Indices and shares, of a local basis.
    anchors: Option<[wgpu::TextureView; 2]>,
    /// Bytes of the textures.
    pub bytes: u64,
}

impl StoredBasis {
    pub fn new(gpu: &Gpu, basis: &Basis, coefficients: &wgpu::Buffer) -> Result<Self, GpuError> {
        let values = upload_basis(gpu, basis)?;
        let anchors = match &basis.anchors {
            Some(anchors) => {
                let upload = |what: &str, codes: &[[u8; 4]], format| {
                    Pixels { side: basis.size as u32, format }.upload(gpu, what, codes.as_flattened())
                };
                let indices = upload("the anchors", &anchors.indices, wgpu::TextureFormat::Rgba8Uint)?;
                Some([indices, upload("the anchors' shares", &anchors.shares, wgpu::TextureFormat::Rgba8Unorm)?])
            }
            None => {
                gpu.check_uniform("the coefficients", coefficients.size())?;
                None
            }
        };
        let texel = basis.layers() * 4 * (basis.values.bytes() / basis.values.len().max(1)) + 8 * anchors.iter().len();
        let bytes = (texel * basis.size * basis.size) as u64;
        Ok(Self { coefficients: coefficients.clone(), values, anchors, bytes })
    }

    /// Bindings 0 to 3, as far as there are any. `filtered`: by a sampler.
    pub fn types(&self, filtered: bool) -> Vec<(u32, wgpu::BindingType)> {
        let (plane, pages) = (wgpu::TextureViewDimension::D2, wgpu::TextureViewDimension::D2Array);
        let values = bindings::texture(wgpu::TextureSampleType::Float { filterable: filtered }, pages);
        let mut types = vec![(0, if self.anchors.is_some() { READ } else { UNIFORM }), (1, values)];
        if self.anchors.is_some() {
            let float = wgpu::TextureSampleType::Float { filterable: false };
            types.push((2, bindings::texture(wgpu::TextureSampleType::Uint, plane)));
            types.push((3, bindings::texture(float, plane)));
        }
        types
    }

    /// What goes to [`Self::types`].
    pub fn resources(&self) -> Vec<(u32, wgpu::BindingResource<'_>)> {
        let mut resources =
            vec![(0, self.coefficients.as_entire_binding()), (1, wgpu::BindingResource::TextureView(&self.values))];
        for (binding, view) in (2..).zip(self.anchors.iter().flatten()) {
            resources.push((binding, wgpu::BindingResource::TextureView(view)));
        }
        resources
    }

    pub fn is_local(&self) -> bool {
        self.anchors.is_some()
    }
}
