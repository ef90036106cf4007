//! Textures, images and samplers. What does not load is warned of, and its factor used alone.

use std::collections::HashMap;
use std::path::Path;

use glam::{Affine2, Mat3, Vec2};
use gltf::json::extensions::texture::TextureTransform;
use gltf::json::texture::{Info, Sampler, Texture as JsonTexture, WrappingMode};
use gltf::json::validation::Checked;
use gltf::json::{Root, Value};

use super::accessor::{Buffers, resolve};
use crate::scene::material::Wrap;
use crate::scene::{Texture, TextureRef, image_file};

/// The textures that materials use, decoded on first use.
pub(super) struct Textures<'a> {
    root: &'a Root,
    buffers: &'a Buffers<'a>,
    directory: &'a Path,
    /// From the file's texture and its encoding to the asset's; `None` where it does not load.
    imported: HashMap<(usize, bool), Option<u32>>,
    textures: Vec<Texture>,
}

impl<'a> Textures<'a> {
    pub fn new(root: &'a Root, buffers: &'a Buffers<'a>, directory: &'a Path) -> Self {
        Self { root, buffers, directory, imported: HashMap::new(), textures: Vec::new() }
    }

    pub fn finish(self) -> Vec<Texture> {
        self.textures
    }

    /// The texture as a material's `what` reads it, or `None` with a warning.
    pub fn reference(&mut self, info: &Info, srgb: bool, what: &str, warnings: &mut Vec<String>) -> Option<TextureRef> {
        let mut unusable = |reason: String| {
            warnings.push(format!("{what} {reason}; the factor alone is used"));
            None
        };
        let transform = info.extensions.as_ref().and_then(|e| e.texture_transform.as_ref());
        let uv_set = transform.and_then(|t| t.tex_coord).unwrap_or(info.tex_coord);
        if uv_set > 1 {
            return unusable(format!("reads TEXCOORD_{uv_set}, of which only 0 and 1 are supported"));
        }
        let transform = transform.map_or(Mat3::IDENTITY, uv_transform);
        if !transform.is_finite() {
            return unusable("has a transform that is not finite".to_owned());
        }
        let index = info.index.value();
        let imported = match self.imported.get(&(index, srgb)) {
            Some(&Some(texture)) => Ok(texture),
            Some(None) => Err(format!("{index} does not load either")),
            None => {
                let decoded = self.decode(index, srgb).map(|texture| {
                    self.textures.push(texture);
                    self.textures.len() as u32 - 1
                });
                self.imported.insert((index, srgb), decoded.as_ref().ok().copied());
                decoded
            }
        };
        match imported {
            Ok(texture) => Some(TextureRef { texture, uv_set, transform }),
            Err(reason) => unusable(reason),
        }
    }

    fn decode(&self, index: usize, srgb: bool) -> Result<Texture, String> {
        let json = self.root.textures.get(index).ok_or_else(|| format!("{index} does not exist"))?;
        // The smaller WebP image comes first where there is one, its fallback second.
        let sources = [webp_source(json), Some(json.source.value())];
        let mut reason = format!("{index} has no image");
        for source in sources.into_iter().flatten() {
            let Some(image) = self.root.images.get(source) else { continue };
            let name = image.uri.as_ref().filter(|uri| !uri.starts_with("data:")).or(image.name.as_ref());
            let name = name.cloned().unwrap_or_else(|| format!("image {source}"));
            let bytes = match (&image.uri, image.buffer_view) {
                (Some(uri), _) => resolve(uri, self.directory),
                (None, Some(view)) => self.buffers.view(view).map(<[u8]>::to_vec),
                (None, None) => Err("it has neither uri nor buffer view".to_owned()),
            };
            let sampler = json.sampler.and_then(|s| self.root.get(s));
            let wrap = sampler.map_or([Wrap::Repeat; 2], wrap_modes);
            let name = crate::scene::load::one_line(&name);
            match bytes.and_then(|bytes| image_file::decode(&bytes, &name, srgb, wrap)) {
                Ok(texture) => return Ok(texture),
                Err(why) => reason = format!("\"{name}\" does not load: {why}"),
            }
        }
        Err(reason)
    }
}

fn webp_source(texture: &JsonTexture) -> Option<usize> {
    let source = texture.extensions.as_ref()?.others.get("EXT_texture_webp")?.get("source").and_then(Value::as_u64)?;
    usize::try_from(source).ok()
}

fn wrap_modes(sampler: &Sampler) -> [Wrap; 2] {
    [&sampler.wrap_s, &sampler.wrap_t].map(|mode| match mode {
        Checked::Valid(WrappingMode::ClampToEdge) => Wrap::Clamp,
        Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::Mirror,
        _ => Wrap::Repeat,
    })
}

/// KHR_texture_transform: translation · rotation · scale. The rotation is counter-clockwise as seen with v downwards, so
/// its angle is negative in (u, v).
fn uv_transform(t: &TextureTransform) -> Mat3 {
    let scale = Vec2::from_array(t.scale.0);
    Mat3::from(Affine2::from_scale_angle_translation(scale, -t.rotation.0, Vec2::from_array(t.offset.0)))
}
