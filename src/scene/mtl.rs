//! MTL material libraries, as far as they say how light is reflected and emitted: Kd, map_Kd, Ke, map_Ke, Pr, Pm.

use std::collections::HashMap;
use std::path::Path;

use glam::{Mat3, Vec3};

use super::load::{one_line, read_file};
use super::material::Wrap;
use super::{Material, Reflectance, Texture, TextureRef, image_file};
use crate::math::Rgb;

/// Reflectance of a surface that nothing is said about.
const DEFAULT_REFLECTANCE: f32 = 0.8;

/// The materials of all libraries that an OBJ file names.
#[derive(Default)]
pub(super) struct Library {
    materials: HashMap<String, Material>,
    pub textures: Vec<Texture>,
    /// From path and encoding to texture; `None` where it does not load.
    loaded: HashMap<String, Option<u32>>,
    pub warnings: Vec<String>,
}

impl Library {
    /// The default material: Lambert, of reflectance 0.8.
    pub fn default_material(name: &str) -> Material {
        Material::lambert(name, Rgb::splat(DEFAULT_REFLECTANCE))
    }

    pub fn get(&self, name: &str) -> Option<&Material> {
        self.materials.get(name)
    }

    pub fn is_empty(&self) -> bool {
        self.materials.is_empty()
    }

    /// Reads a library beside the OBJ file. One that is missing is a warning.
    pub fn read(&mut self, name: &str, directory: &Path) {
        match read_file(&directory.join(name.replace('\\', "/"))) {
            Ok(bytes) => self.parse(&String::from_utf8_lossy(&bytes), name, directory),
            Err(reason) => {
                self.warnings
                    .push(format!("material library {name} cannot be read: {reason}; its materials are made up"));
            }
        }
    }

    fn parse(&mut self, text: &str, library: &str, directory: &Path) {
        let mut current: Option<Definition> = None;
        for (number, line) in text.lines().enumerate() {
            let line = line.trim();
            let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
            if keyword == "newmtl" {
                let previous = current.replace(Definition { name: rest.trim().to_owned(), ..Default::default() });
                self.define(previous, directory);
            } else if let Some(definition) = &mut current
                && definition.set(keyword, rest.trim()).is_none()
            {
                let number = number + 1;
                self.warnings.push(format!("{library} line {number}: \"{}\" was not understood", one_line(line)));
            }
        }
        self.define(current, directory);
    }

    fn define(&mut self, definition: Option<Definition>, directory: &Path) {
        let Some(d) = definition else { return };
        let mut material = Self::default_material(&d.name);
        let label = format!("material \"{}\"", d.name);
        let diffuse_map = d.diffuse_map.and_then(|path| self.texture(&path, directory, &label));
        material.base_colour_texture = diffuse_map;
        let mut diffuse =
            d.diffuse.unwrap_or(Vec3::splat(if diffuse_map.is_some() { 1.0 } else { DEFAULT_REFLECTANCE }));
        if diffuse_map.is_some() && diffuse == Vec3::ZERO {
            self.warnings.push(format!("{label}: Kd is 0 and would blacken map_Kd; it was set to 1"));
            diffuse = Vec3::ONE;
        }
        material.base_colour = diffuse.clamp(Vec3::ZERO, Vec3::ONE).extend(1.0);
        material.emissive_texture = d.emissive_map.and_then(|path| self.texture(&path, directory, &label));
        let emissive = d.emissive.unwrap_or(if material.emissive_texture.is_some() { Vec3::ONE } else { Vec3::ZERO });
        material.emissive = if emissive.is_finite() { emissive.max(Vec3::ZERO) } else { Vec3::ZERO };
        if d.roughness.is_some() || d.metallic.is_some() {
            material.reflectance = Reflectance::MetallicRoughness;
            material.roughness = d.roughness.unwrap_or(1.0).clamp(0.0, 1.0);
            material.metallic = d.metallic.unwrap_or(0.0).clamp(0.0, 1.0);
        }
        if d.transparent {
            self.warnings.push(format!("{label} is transparent; it is taken as opaque"));
        }
        self.materials.insert(d.name, material);
    }

    /// The texture at `path`, or `None` with a warning.
    pub fn texture(&mut self, path: &str, directory: &Path, label: &str) -> Option<TextureRef> {
        if !self.loaded.contains_key(path) {
            let decoded = read_file(&directory.join(path.replace('\\', "/")))
                .and_then(|bytes| image_file::decode(&bytes, &one_line(path), true, [Wrap::Repeat; 2]));
            let texture = match decoded {
                Ok(texture) => {
                    self.textures.push(texture);
                    Some(self.textures.len() as u32 - 1)
                }
                Err(reason) => {
                    let what = format!("{label}: texture \"{path}\" does not load: {reason}");
                    self.warnings.push(format!("{what}; the factor alone is used"));
                    None
                }
            };
            self.loaded.insert(path.to_owned(), texture);
        }
        let texture = self.loaded.get(path).copied().flatten()?;
        Some(TextureRef { texture, uv_set: 0, transform: Mat3::IDENTITY })
    }
}

/// One material as its library writes it.
#[derive(Default)]
struct Definition {
    name: String,
    diffuse: Option<Vec3>,
    diffuse_map: Option<String>,
    emissive: Option<Vec3>,
    emissive_map: Option<String>,
    roughness: Option<f32>,
    metallic: Option<f32>,
    transparent: bool,
}

impl Definition {
    /// Takes a statement in; `None` if a value that matters cannot be read.
    fn set(&mut self, keyword: &str, value: &str) -> Option<()> {
        match keyword {
            "Kd" => self.diffuse = Some(colour(value)?),
            "Ke" => self.emissive = Some(colour(value)?),
            "Pr" => self.roughness = Some(value.parse().ok()?),
            "Pm" => self.metallic = Some(value.parse().ok()?),
            "map_Kd" => self.diffuse_map = Some(map_file(value)?),
            "map_Ke" => self.emissive_map = Some(map_file(value)?),
            "d" => self.transparent |= value.parse::<f32>().ok()? < 1.0,
            "Tr" => self.transparent |= value.parse::<f32>().ok()? > 0.0,
            "map_d" => self.transparent = true,
            _ => {}
        }
        Some(())
    }
}

/// Three components, or one for all three.
fn colour(value: &str) -> Option<Vec3> {
    let c: Vec<f32> = value.split_whitespace().map(|w| w.parse().ok()).collect::<Option<_>>()?;
    match c[..] {
        [r, g, b] => Some(Vec3::new(r, g, b)),
        [grey] => Some(Vec3::splat(grey)),
        _ => None,
    }
}

/// The file name after a map statement's options.
fn map_file(value: &str) -> Option<String> {
    let mut rest = value;
    while rest.starts_with('-') {
        let (option, after) = rest.split_once(char::is_whitespace)?;
        rest = after.trim_start();
        // Options take words, or up to so many numbers.
        let (words, numbers) = match option {
            "-o" | "-s" | "-t" => (0, 3),
            "-mm" => (2, 0),
            _ => (1, 0),
        };
        for taken in 0..words.max(numbers) {
            let (word, after) = rest.split_once(char::is_whitespace)?;
            if taken >= words && word.parse::<f32>().is_err() {
                break;
            }
            rest = after.trim_start();
        }
    }
    (!rest.is_empty()).then(|| rest.to_owned())
}
