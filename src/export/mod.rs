//! A trained model as files that engines load: the asset as GLB, the basis as KTX2 and OpenEXR, matrices and points as JSON and
//! safetensors, the shaders, and a page that says how to use them.

mod ktx2;
mod page;
mod tables;

use std::io::{self, Cursor};
use std::path::{Path, PathBuf};

use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage};

use self::ktx2::{Ktx2, Texels};
use crate::files::write_whole;
use crate::gpu::shader::{Stage, indirect_irradiance};
use crate::gpu::{Lookup, basis_layer};
use crate::model::{Basis, Model, Values};
use crate::scene::SceneError;

#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    #[error("{}: cannot be written: {source}; choose another folder with -o", path.display())]
    Write { path: PathBuf, source: io::Error },
    #[error(transparent)]
    Asset(#[from] SceneError),
    #[error("{}: cannot be encoded as OpenEXR: {source}", path.display())]
    Exr { path: PathBuf, source: exr::error::Error },
}

/// Writes `model` to `folder`, file by file, each whole or not at all. Returns their names and sizes in bytes.
///
/// # Errors
/// [`ExportError`] when the folder cannot be made or written to, or the asset does not fit a GLB file.
pub fn write(model: &Model, folder: &Path) -> Result<Vec<(&'static str, u64)>, ExportError> {
    let basis = &model.basis;
    let exr = |source| ExportError::Exr { path: folder.join("basis.exr"), source };
    let mut files = vec![
        ("asset.glb", model.asset.to_glb()?),
        ("basis.ktx2", basis_ktx2(basis)),
        ("basis.exr", basis_exr(basis).map_err(exr)?),
        ("transfer.json", tables::json(model).into_bytes()),
        ("transfer.safetensors", tables::safetensors(model)),
        ("downsample.wgsl", Stage::Downsample.source(basis, Lookup::Texture).into_bytes()),
        ("transfer.wgsl", Stage::Transfer.source(basis, Lookup::Texture).into_bytes()),
        ("reconstruct.wgsl", Stage::Reconstruct.source(basis, Lookup::Texture).into_bytes()),
        ("indirect_from_basis.wgsl", indirect_irradiance(basis, Lookup::Fragment, 0).into_bytes()),
        ("indirect_from_texture.wgsl", indirect_irradiance(basis, Lookup::Texture, 0).into_bytes()),
    ];
    if let Some(anchors) = &basis.anchors {
        let plane =
            |texels, codes: &[[u8; 4]]| Ktx2 { texels, size: basis.size, layers: None }.bytes(codes.as_flattened());
        files.push(("anchors.ktx2", plane(Texels::Uint8, &anchors.indices)));
        files.push(("shares.ktx2", plane(Texels::Unorm8, &anchors.shares)));
    }
    // Last: a folder with a page is whole.
    files.push(("README.md", page::page(model).into_bytes()));
    for (name, bytes) in &files {
        let path = folder.join(name);
        write_whole(&path, bytes).map_err(|source| ExportError::Write { path, source })?;
    }
    Ok(files.into_iter().map(|(name, bytes)| (name, bytes.len() as u64)).collect())
}

/// The array texture that the shaders read.
fn basis_ktx2(basis: &Basis) -> Vec<u8> {
    let texels = match basis.values {
        Values::Half(_) => Texels::Float16,
        Values::Byte(_) => Texels::Snorm8,
    };
    let layers: Vec<Vec<u8>> = (0..basis.layers()).map(|layer| basis_layer(basis, layer)).collect();
    Ktx2 { texels, size: basis.size, layers: Some(layers.len()) }.bytes(&layers.concat())
}

/// Each element as a channel, or three, of its own: values with the texel's scale applied.
fn basis_exr(basis: &Basis) -> exr::error::Result<Vec<u8>> {
    let texels = basis.size * basis.size;
    let scale = |texel: usize| basis.anchors.as_ref().map_or(1.0, |anchors| anchors.scale(texel));
    let channel = |plane: usize| {
        let (element, component) = (plane / basis.components, plane % basis.components);
        let suffix = if basis.components == 1 { "" } else { [".R", ".G", ".B"][component] };
        let values = (0..texels).map(|t| basis.values.get(plane * texels + t) * scale(t)).collect();
        AnyChannel::new(format!("element.{element:03}{suffix}").as_str(), FlatSamples::F32(values))
    };
    let channels = AnyChannels::sort((0..basis.elements * basis.components).map(channel).collect());
    let size = (basis.size, basis.size);
    let layer = Layer::new(size, LayerAttributes::default(), Encoding::FAST_LOSSLESS, channels);
    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer).write().to_buffered(&mut bytes)?;
    Ok(bytes.into_inner())
}
