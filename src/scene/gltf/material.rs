//! Materials: metallic-roughness (glTF 2.0, section 3.9) and the extensions that change it.

use std::collections::HashMap;
use std::path::Path;

use glam::{Vec3, Vec4};
use gltf::json::extensions::material::PbrSpecularGlossiness;
use gltf::json::material::{AlphaMode, Material as JsonMaterial};
use gltf::json::validation::Checked;
use gltf::json::{Index, Root};

use super::accessor::Buffers;
use super::label;
use super::texture::Textures;
use crate::scene::{Material, Reflectance, Texture};

/// Radiance beyond this is a mistake: the sun's disk has about 2·10⁷ W/(m²·sr).
const MAX_EMISSIVE: f32 = 1e12;

/// The materials that geometry uses, imported on first use.
pub(super) struct Materials<'a> {
    root: &'a Root,
    /// From the file's material, `None` for the default one, to the asset's.
    imported: HashMap<Option<usize>, u32>,
    materials: Vec<Material>,
    textures: Textures<'a>,
    warnings: Vec<String>,
}

impl<'a> Materials<'a> {
    pub fn new(root: &'a Root, buffers: &'a Buffers<'a>, directory: &'a Path) -> Self {
        let textures = Textures::new(root, buffers, directory);
        Self { root, imported: HashMap::new(), materials: Vec::new(), textures, warnings: Vec::new() }
    }

    /// Index of the asset's material for one of the file's, or for geometry without a material.
    pub fn index(&mut self, material: Option<Index<JsonMaterial>>) -> Result<u32, String> {
        let key = material.map(|m| m.value());
        if let Some(&index) = self.imported.get(&key) {
            return Ok(index);
        }
        let imported = match material {
            Some(index) => {
                let json = self.root.get(index).ok_or_else(|| format!("material {index} does not exist"))?;
                self.import(json, index.value())
            }
            None => self.import(&JsonMaterial::default(), 0),
        };
        let index = self.materials.len() as u32;
        self.materials.push(imported);
        self.imported.insert(key, index);
        Ok(index)
    }

    /// The materials and textures; what was replaced is appended to `warnings`.
    pub fn finish(self, warnings: &mut Vec<String>) -> (Vec<Material>, Vec<Texture>) {
        warnings.extend(self.warnings);
        (self.materials, self.textures.finish())
    }

    fn import(&mut self, json: &JsonMaterial, index: usize) -> Material {
        let label = label("material", index, json.name.as_ref());
        let pbr = &json.pbr_metallic_roughness;
        let extensions = json.extensions.as_ref();
        let strength = extensions.and_then(|e| e.emissive_strength.as_ref()).map_or(1.0, |e| e.emissive_strength.0);
        let mut texture = |info, srgb, what: &str| {
            self.textures.reference(info, srgb, &format!("{label}: {what} texture"), &mut self.warnings)
        };
        let mut material = Material {
            name: json.name.as_deref().map(crate::scene::load::one_line).unwrap_or_default(),
            reflectance: Reflectance::MetallicRoughness,
            base_colour: Vec4::from_array(pbr.base_color_factor.0).clamp(Vec4::ZERO, Vec4::ONE),
            base_colour_texture: pbr.base_color_texture.as_ref().and_then(|t| texture(t, true, "base colour")),
            metallic: pbr.metallic_factor.0.clamp(0.0, 1.0),
            roughness: pbr.roughness_factor.0.clamp(0.0, 1.0),
            metallic_roughness_texture: pbr
                .metallic_roughness_texture
                .as_ref()
                .and_then(|t| texture(t, false, "metallic-roughness")),
            emissive: Vec3::from_array(json.emissive_factor.0) * strength,
            emissive_texture: None,
            alpha_cutoff: None,
            double_sided: json.double_sided,
        };
        if material.emissive != Vec3::ZERO {
            material.emissive_texture = json.emissive_texture.as_ref().and_then(|t| texture(t, true, "emissive"));
        }
        if !(material.emissive.cmpge(Vec3::ZERO).all() && material.emissive.max_element() <= MAX_EMISSIVE) {
            self.warnings.push(format!("{label}: emission outside 0 to {MAX_EMISSIVE:e} was set to 0"));
            material.emissive = Vec3::ZERO;
        }
        match json.alpha_mode {
            Checked::Valid(AlphaMode::Mask) => material.alpha_cutoff = Some(json.alpha_cutoff.map_or(0.5, |c| c.0)),
            Checked::Valid(AlphaMode::Blend) => {
                self.warnings.push(format!("{label} is blended by alpha; it is taken as opaque"));
            }
            _ => {}
        }
        if let Some(json) = extensions.and_then(|e| e.pbr_specular_glossiness.as_ref()) {
            self.warnings
                .push(format!("{label} is specular-glossiness; it is taken as a dielectric of its diffuse colour"));
            self.set_specular_glossiness(&mut material, json, &label);
        }
        if extensions.is_some_and(|e| e.unlit.is_some()) {
            self.warnings.push(format!("{label} is unlit; it is taken as a Lambert surface of its base colour"));
            material.reflectance = Reflectance::Lambert;
        }
        material
    }

    fn set_specular_glossiness(&mut self, material: &mut Material, json: &PbrSpecularGlossiness, label: &str) {
        material.base_colour = Vec4::from_array(json.diffuse_factor.0).clamp(Vec4::ZERO, Vec4::ONE);
        let what = format!("{label}: diffuse texture");
        material.base_colour_texture =
            json.diffuse_texture.as_ref().and_then(|t| self.textures.reference(t, true, &what, &mut self.warnings));
        material.metallic = 0.0;
        material.roughness = (1.0 - json.glossiness_factor.0).clamp(0.0, 1.0);
        material.metallic_roughness_texture = None;
    }
}
