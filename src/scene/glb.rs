//! Writes an asset as binary glTF 2.0: world space, one mesh with a primitive for each material, the lightmap's coordinates as
//! TEXCOORD_1, textures as PNG inside.

use std::io::Cursor;

use glam::{Affine2, Mat3, Vec3};
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use serde_json::{Map, Value, json};

use super::{Asset, Material, Reflectance, SceneError, TextureRef, Wrap};

/// Component types, sampler modes and buffer targets (glTF 2.0, section 5).
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const LINEAR: u32 = 9729;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

impl Asset {
    /// The asset as a .glb file, its lightmap laid out.
    ///
    /// TEXCOORD_0 is the asset's own first set (the lightmap's where it has none), TEXCOORD_1 the lightmap's, TEXCOORD_2 the
    /// asset's own second set where a texture reads it. A Lambert material is written as rough and not metallic, with
    /// `extras.relight.reflectance` = "lambert". Cameras and lights are not written.
    ///
    /// # Errors
    /// [`SceneError::TooLarge`] when it would take more than 4 GiB.
    pub fn to_glb(&self) -> Result<Vec<u8>, SceneError> {
        let mut file = Writer { json: json!({}), ..Default::default() };
        let primitives = file.primitives(self);
        let materials: Vec<Value> = self.materials.iter().map(|m| file.material(m)).collect();
        for texture in &self.textures {
            let mut png = Cursor::new(Vec::new());
            let (texels, kind) = (bytemuck::cast_slice(&texture.texels), ExtendedColorType::Rgba8);
            let encoder = PngEncoder::new(&mut png);
            encoder.write_image(texels, texture.width, texture.height, kind).expect("whole images, written to memory");
            let view = file.view(&png.into_inner(), None);
            let [s, t] = texture.wrap.map(wrap_mode);
            let sampler = json!({ "magFilter": LINEAR, "minFilter": LINEAR, "wrapS": s, "wrapT": t });
            let index =
                file.push("images", json!({ "name": texture.name, "mimeType": "image/png", "bufferView": view }));
            file.push("samplers", sampler);
            file.push("textures", json!({ "source": index, "sampler": index }));
        }
        file.json["materials"] = materials.into();
        file.json["meshes"] = json!([{ "name": self.name, "primitives": primitives }]);
        file.json["nodes"] = json!([{ "name": self.name, "mesh": 0 }]);
        file.finish().ok_or_else(|| SceneError::TooLarge { asset: self.name.clone() })
    }
}

/// A document being written, and its binary chunk.
#[derive(Default)]
struct Writer {
    json: Value,
    bytes: Vec<u8>,
    extensions: Vec<&'static str>,
}

impl Writer {
    /// Appends to one of the document's lists. Returns the place.
    fn push(&mut self, list: &str, value: Value) -> usize {
        if self.json[list].is_null() {
            self.json[list] = json!([]);
        }
        let list = self.json[list].as_array_mut().expect("a list of our own");
        list.push(value);
        list.len() - 1
    }

    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let mut view = json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = target.into();
        }
        self.bytes.extend_from_slice(bytes);
        self.push("bufferViews", view)
    }

    fn floats<T: bytemuck::Pod>(&mut self, kind: &str, values: &[T]) -> usize {
        let view = self.view(bytemuck::cast_slice(values), Some(ARRAY_BUFFER));
        self.push(
            "accessors",
            json!({ "bufferView": view, "componentType": FLOAT, "count": values.len(), "type": kind }),
        )
    }

    fn primitives(&mut self, asset: &Asset) -> Vec<Value> {
        let mesh = &asset.mesh;
        let mut attributes = Map::new();
        let positions = self.floats("VEC3", &mesh.positions);
        let bounds = mesh.bounds();
        self.json["accessors"][positions]["min"] = json!(bounds.min);
        self.json["accessors"][positions]["max"] = json!(bounds.max);
        attributes.insert("POSITION".into(), positions.into());
        attributes.insert("NORMAL".into(), self.floats("VEC3", &mesh.normals).into());
        let lightmap = self.floats("VEC2", &mesh.lightmap_uvs);
        // Sets are numbered without a gap.
        let first = if mesh.uvs[0].is_empty() { lightmap } else { self.floats("VEC2", &mesh.uvs[0]) };
        attributes.insert("TEXCOORD_0".into(), first.into());
        attributes.insert("TEXCOORD_1".into(), lightmap.into());
        let read = asset.materials.iter().flat_map(textures_of).any(|t| t.uv_set == 1);
        if read && !mesh.uvs[1].is_empty() {
            attributes.insert("TEXCOORD_2".into(), self.floats("VEC2", &mesh.uvs[1]).into());
        }
        if !mesh.colours.is_empty() {
            attributes.insert("COLOR_0".into(), self.floats("VEC3", &mesh.colours).into());
        }
        let mut by_material = vec![Vec::new(); asset.materials.len()];
        for (triangle, &material) in mesh.triangles.iter().zip(&mesh.triangle_materials) {
            by_material[material as usize].extend(*triangle);
        }
        let mut primitives = Vec::new();
        for (material, indices) in by_material.iter().enumerate().filter(|(_, indices)| !indices.is_empty()) {
            let view = self.view(bytemuck::cast_slice(indices), Some(ELEMENT_ARRAY_BUFFER));
            let (component, count) = (UNSIGNED_INT, indices.len());
            let accessor = json!({ "bufferView": view, "componentType": component, "count": count, "type": "SCALAR" });
            let indices = self.push("accessors", accessor);
            primitives.push(json!({ "attributes": attributes, "indices": indices, "material": material }));
        }
        primitives
    }

    fn material(&mut self, material: &Material) -> Value {
        let lambert = material.reflectance == Reflectance::Lambert;
        let (metallic, roughness) = if lambert { (0.0, 1.0) } else { (material.metallic, material.roughness) };
        let mut pbr = json!({
            "baseColorFactor": material.base_colour, "metallicFactor": metallic, "roughnessFactor": roughness,
        });
        if let Some(texture) = &material.base_colour_texture {
            pbr["baseColorTexture"] = self.texture(texture);
        }
        if let Some(texture) = material.metallic_roughness_texture.as_ref().filter(|_| !lambert) {
            pbr["metallicRoughnessTexture"] = self.texture(texture);
        }
        let mut json = json!({ "name": material.name, "pbrMetallicRoughness": pbr });
        if material.emissive != Vec3::ZERO {
            // Factors end at 1; what is brighter has a strength beside it.
            let strength = material.emissive.max_element().max(1.0);
            json["emissiveFactor"] = json!(material.emissive / strength);
            if strength > 1.0 {
                self.uses("KHR_materials_emissive_strength");
                json["extensions"] = json!({ "KHR_materials_emissive_strength": { "emissiveStrength": strength } });
            }
            if let Some(texture) = &material.emissive_texture {
                json["emissiveTexture"] = self.texture(texture);
            }
        }
        if let Some(cutoff) = material.alpha_cutoff {
            json["alphaMode"] = "MASK".into();
            json["alphaCutoff"] = cutoff.into();
        }
        if material.double_sided {
            json["doubleSided"] = true.into();
        }
        if lambert {
            json["extras"] = json!({ "relight": { "reflectance": material.reflectance } });
        }
        json
    }

    fn texture(&mut self, texture: &TextureRef) -> Value {
        let set = if texture.uv_set == 1 { 2 } else { 0 };
        let mut info = json!({ "index": texture.texture, "texCoord": set });
        if texture.transform != Mat3::IDENTITY {
            self.uses("KHR_texture_transform");
            let (scale, angle, offset) = Affine2::from_mat3(texture.transform).to_scale_angle_translation();
            // Counter-clockwise as seen with v downwards.
            let transform = json!({ "offset": offset, "rotation": -angle, "scale": scale });
            info["extensions"] = json!({ "KHR_texture_transform": transform });
        }
        info
    }

    fn uses(&mut self, extension: &'static str) {
        if !self.extensions.contains(&extension) {
            self.extensions.push(extension);
        }
    }

    /// Header, JSON and binary chunk (glTF 2.0, section 4); `None` where the length has no 32 bits.
    fn finish(mut self) -> Option<Vec<u8>> {
        self.json["asset"] = json!({ "version": "2.0", "generator": concat!("relight ", env!("CARGO_PKG_VERSION")) });
        self.json["scene"] = 0.into();
        self.json["scenes"] = json!([{ "nodes": [0] }]);
        self.json["buffers"] = json!([{ "byteLength": self.bytes.len() }]);
        if !self.extensions.is_empty() {
            self.json["extensionsUsed"] = json!(self.extensions);
        }
        let mut text = self.json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let length = u32::try_from(12 + 8 + text.len() + 8 + self.bytes.len()).ok()?;
        let mut file = Vec::with_capacity(length as usize);
        file.extend(b"glTF");
        file.extend([2, length, text.len() as u32].iter().flat_map(|word| word.to_le_bytes()));
        file.extend(b"JSON");
        file.extend(&text);
        file.extend((self.bytes.len() as u32).to_le_bytes());
        file.extend(b"BIN\0");
        file.extend(&self.bytes);
        Some(file)
    }
}

fn textures_of(material: &Material) -> impl Iterator<Item = &TextureRef> {
    let all = [&material.base_colour_texture, &material.metallic_roughness_texture, &material.emissive_texture];
    all.into_iter().flatten()
}

fn wrap_mode(wrap: Wrap) -> u32 {
    match wrap {
        Wrap::Repeat => 10497,
        Wrap::Mirror => 33648,
        Wrap::Clamp => 33071,
    }
}

#[cfg(test)]
mod tests {
    use glam::{Vec2, Vec4};

    use super::*;
    use crate::scene::{Texture, UvPolicy, generate, lay_out, load};

    /// The Cornell box with a texture that is turned, one that glows, a colour at each vertex and a masked metal.
    fn asset() -> Asset {
        let mut asset = generate("cornell").unwrap();
        lay_out(&mut asset, 64, UvPolicy::Auto).unwrap();
        let count = asset.mesh.positions.len();
        asset.mesh.uvs[0] = asset.mesh.positions.iter().map(|p| Vec2::new(p.x + 0.3 * p.y, p.z)).collect();
        asset.mesh.colours = (0..count).map(|i| Vec3::new(1.0, 0.5, i as f32 / count as f32)).collect();
        let texels = (0..12).map(|i| [i * 20, 255 - i * 20, i, 200 + i]).collect();
        let wrap = [Wrap::Mirror, Wrap::Repeat];
        let texture = Texture { name: "stripes".into(), width: 4, height: 3, texels, srgb: true, wrap };
        asset.textures = vec![texture];
        let transform =
            Mat3::from(Affine2::from_scale_angle_translation(Vec2::new(0.5, 2.0), -0.4, Vec2::new(0.1, 0.7)));
        let reference = TextureRef { texture: 0, uv_set: 0, transform };
        asset.materials[0].base_colour_texture = Some(reference);
        asset.materials[1].emissive = Vec3::new(30.0, 4.0, 0.5);
        asset.materials[1].emissive_texture = Some(reference);
        let metal = &mut asset.materials[2];
        metal.reflectance = Reflectance::MetallicRoughness;
        (metal.metallic, metal.roughness, metal.alpha_cutoff, metal.double_sided) = (0.75, 0.25, Some(0.5), true);
        metal.base_colour = Vec4::new(0.9, 0.5, 0.1, 0.8);
        asset
    }

    #[test]
    fn what_is_written_is_read_back_alike() {
        let asset = asset();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("asset.glb");
        std::fs::write(&path, asset.to_glb().unwrap()).unwrap();
        let back = load(&path).unwrap();
        assert!(back.warnings.is_empty(), "{:?}", back.warnings);
        // Triangles come material by material, and so do the materials, which are imported on first use.
        let mut order: Vec<usize> = (0..asset.mesh.triangles.len()).collect();
        order.sort_by_key(|&t| asset.mesh.triangle_materials[t]);
        assert_eq!(back.mesh.triangles.len(), order.len());
        for (read, &written) in order.iter().enumerate() {
            let (a, b) = (&asset.mesh, &back.mesh);
            let (ta, tb) = (a.triangles[written], b.triangles[read]);
            for (i, j) in ta.into_iter().zip(tb).map(|(i, j)| (i as usize, j as usize)) {
                assert_eq!(a.positions[i], b.positions[j]);
                // Normals are made unit once more.
                assert!((a.normals[i] - b.normals[j]).abs().max_element() < 1e-6);
                assert_eq!((a.uvs[0][i], a.lightmap_uvs[i]), (b.uvs[0][j], b.uvs[1][j]));
            }
            let (here, there) = [(&asset, written), (&back, read)]
                .map(|(of, t)| (of.surface(t, 0.2, 0.3, Vec3::ZERO), of.is_cut_out(t, 0.2, 0.3)))
                .into();
            assert_eq!(here.1, there.1);
            let lambert = asset.materials[a.triangle_materials[written] as usize].reflectance == Reflectance::Lambert;
            if !lambert {
                assert_eq!(here.0.bsdf, there.0.bsdf);
            }
            // The factors and the turn go through decimals and an arc tangent.
            let close = |x: Vec3, y: Vec3| (x - y).abs().max_element() <= 1e-4 * x.abs().max_element() + 1e-5;
            let diffuse = |of: &Asset, t: usize| {
                of.base_colour(&of.materials[of.mesh.triangle_materials[t] as usize], t, 0.2, 0.3).truncate()
            };
            assert!(close(diffuse(&asset, written), diffuse(&back, read)));
            assert!(close(here.0.emitted, there.0.emitted));
        }
        let material = |name: &str| back.materials.iter().find(|m| m.name == name).unwrap().clone();
        let names: Vec<&str> = asset.materials.iter().map(|m| m.name.as_str()).collect();
        assert_eq!(material(names[2]), asset.materials[2]);
        assert!(material(names[0]).base_colour_texture.is_some());
    }
}
