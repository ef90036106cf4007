//! Writes the folder that another renderer reads: the conditions, the asset, where its texels and measurement points are.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use glam::Vec3;
use safetensors::Dtype;

use super::super::DatasetError;
use super::super::error::unwritable;
use super::super::folder::write_tensors;
use super::super::manifest::points_hash;
use super::manifest::{Condition, FILE, Manifest};
use crate::files::write_whole;
use crate::light::{EnvironmentImage, EnvironmentMap, Light, LightingCondition};
use crate::math::Sampler;
use crate::measure::MeasurementPoints;
use crate::scene::{Asset, Lightmap};

pub const ASSET: &str = "asset.glb";
const TEXELS: &str = "texels.safetensors";
const POINTS: &str = "points.safetensors";

/// Points on each texel's surface that are written: their mean is the texel's within what the light varies inside a 16th of it.
const SAMPLES: usize = 16;

/// Bytes of points on texels, at most; where texels are many, each gets fewer.
const MOST_BYTES: usize = 512 << 20;

/// What is exported.
pub struct Export<'e> {
    pub asset: &'e Asset,
    pub lightmap: &'e Lightmap,
    pub points: &'e MeasurementPoints,
    /// The first `training` are to train on.
    pub conditions: &'e [LightingCondition],
    pub training: usize,
    pub max_bounces: u32,
    pub seed: u64,
    /// The scene file's settings.
    pub scene: serde_json::Value,
}

impl Export<'_> {
    /// Writes the folder. One that holds an export of the same asset whose conditions are the same as far as they go is
    /// extended: what was rendered for it stays good.
    ///
    /// # Errors
    /// When the folder holds another export, or cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), DatasetError> {
        let before = Manifest::read(folder)?;
        let mut maps = BTreeMap::new();
        let mut manifest = Manifest::new(format!("relight {}", env!("CARGO_PKG_VERSION")));
        manifest.asset_hash = self.asset.hash();
        manifest.points_hash = points_hash(self.points);
        manifest.size = self.lightmap.size as u32;
        manifest.max_bounces = self.max_bounces;
        manifest.scene = self.scene.clone();
        manifest.conditions = (self.conditions.iter().enumerate())
            .map(|(i, condition)| {
                let held_out = i >= self.training;
                let name = match held_out {
                    false => format!("indirect/train-{i:04}.exr"),
                    true => format!("indirect/test-{:04}.exr", i - self.training),
                };
                let lights = condition.lights.iter().flat_map(|light| portable(light, &mut maps)).collect();
                Condition { held_out, lights, indirect: name.into(), direct: None, noise: None }
            })
            .collect();
        if let Some(before) = before {
            manifest.go_on_from(before).map_err(|why| DatasetError::Rendered { path: folder.join(FILE), why })?;
        }

        let path = folder.join(ASSET);
        let glb = self.asset.to_glb().map_err(|e| DatasetError::Rendered { path: path.clone(), why: e.to_string() })?;
        write_whole(&path, &glb).map_err(unwritable(&path))?;
        for (name, map) in &maps {
            let path = folder.join(name);
            let bytes = exr_of(map)
                .map_err(|e| DatasetError::Rendered { path: path.clone(), why: format!("cannot be encoded: {e}") })?;
            write_whole(&path, &bytes).map_err(unwritable(&path))?;
        }
        self.write_texels(&folder.join(TEXELS))?;
        self.write_points(&folder.join(POINTS))?;
        // Last, so that a folder with a manifest is whole.
        manifest.write(folder).map_err(unwritable(&folder.join(FILE)))
    }

    fn write_texels(&self, path: &Path) -> Result<(), DatasetError> {
        let lightmap = self.lightmap;
        let texels = lightmap.texels.len();
        let samples = (MOST_BYTES / (24 * texels.max(1))).clamp(4, SAMPLES);
        let (mut positions, mut normals) = (Vec::new(), Vec::new());
        for t in 0..texels {
            let surface = lightmap.sampler(&self.asset.mesh, t);
            for i in 0..samples {
                let [u0, u1, ..] = Sampler::new(self.seed, lightmap.texels[t].index as u64, i as u32).next_4d();
                let front = self.asset.front(surface.sample([u0, u1]));
                positions.push(front.position);
                normals.push(front.normal);
            }
        }
        let index: Vec<u32> = lightmap.texels.iter().map(|t| t.index).collect();
        let area: Vec<f32> = lightmap.texels.iter().map(|t| t.area).collect();
        let shape = vec![texels, samples, 3];
        write_tensors(
            path,
            &[
                ("index", Dtype::U32, vec![texels], bytemuck::cast_slice(&index)),
                ("area", Dtype::F32, vec![texels], bytemuck::cast_slice(&area)),
                ("position", Dtype::F32, shape.clone(), bytemuck::cast_slice(&positions)),
                ("normal", Dtype::F32, shape, bytemuck::cast_slice(&normals)),
            ],
        )
    }

    fn write_points(&self, path: &Path) -> Result<(), DatasetError> {
        let points = self.points;
        let of = |field: fn(&crate::measure::MeasurementPoint) -> Vec3| -> Vec<Vec3> {
            points.sub_points.iter().map(field).collect()
        };
        let (positions, normals, albedos) = (of(|s| s.position), of(|s| s.normal), of(|s| s.albedo));
        let shape = vec![positions.len(), 3];
        let neighbours = vec![points.points.len(), points.neighbours_per_point()];
        write_tensors(
            path,
            &[
                ("position", Dtype::F32, shape.clone(), bytemuck::cast_slice(&positions)),
                ("normal", Dtype::F32, shape.clone(), bytemuck::cast_slice(&normals)),
                ("albedo", Dtype::F32, shape, bytemuck::cast_slice(&albedos)),
                ("neighbours", Dtype::U32, neighbours, bytemuck::cast_slice(&points.neighbours)),
            ],
        )
    }
}

impl Manifest {
    /// Takes over what `before` knows about lightmaps that are rendered already.
    fn go_on_from(&mut self, before: Manifest) -> Result<(), String> {
        let other = |what: &str| format!("holds an export of {what}; choose another folder, or remove this one");
        if before.asset_hash != self.asset_hash || before.size != self.size {
            return Err(other("another asset or lightmap"));
        }
        if before.points_hash != self.points_hash {
            return Err(other("other measurement points"));
        }
        let old: BTreeMap<PathBuf, Condition> =
            before.conditions.into_iter().map(|c| (c.indirect.clone(), c)).collect();
        for condition in &mut self.conditions {
            match old.get(&condition.indirect) {
                Some(old) if old.lights != condition.lights => return Err(other("other lights")),
                Some(old) => *condition = old.clone(),
                None => {}
            }
        }
        (self.renderer, self.samples) = (before.renderer, before.samples);
        Ok(())
    }
}

/// The light in kinds that renderers have: a sky becomes an environment and its sun. Maps are put into `maps` under the path
/// that the light names.
fn portable(light: &Light, maps: &mut BTreeMap<PathBuf, EnvironmentMap>) -> Vec<Light> {
    let mut environment = |map: &EnvironmentMap, rotation: f32, color: Vec3, intensity: f32| {
        let texels: Vec<Vec3> = map.radiances().collect();
        let hash = blake3::hash(bytemuck::cast_slice(&texels)).to_hex();
        let path = PathBuf::from(format!("environments/{}.exr", &hash[..16]));
        maps.entry(path.clone()).or_insert_with(|| map.clone());
        Light::Environment { image: EnvironmentImage::from(path), rotation, color, intensity }
    };
    match light {
        Light::Environment { image, rotation, color, intensity } => {
            vec![environment(image.map(), *rotation, *color, *intensity)]
        }
        Light::Sky(sky) => {
            let sun = sky.sun_illuminance() * sky.color * sky.intensity;
            let peak = sun.max_element();
            let mut lights = vec![environment(&sky.tabulate(), sky.rotation(), sky.color, sky.intensity)];
            if peak > 0.0 {
                let direction = -sky.towards_sun();
                lights.push(Light::Directional { direction, color: sun / peak, intensity: peak });
            }
            lights
        }
        other => vec![other.clone()],
    }
}

fn exr_of(map: &EnvironmentMap) -> exr::error::Result<Vec<u8>> {
    use exr::prelude::*;
    let texels: Vec<Vec3> = map.radiances().collect();
    let width = map.width();
    let colour = |at: Vec2<usize>| {
        let c = texels[at.y() * width + at.x()];
        (c.x, c.y, c.z)
    };
    let channels = SpecificChannels::rgb(colour);
    // What the simplest readers read.
    let line_order = LineOrder::Increasing;
    let encoding = Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order };
    let layer = Layer::new((width, map.height()), LayerAttributes::default(), encoding, channels);
    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer).write().to_buffered(&mut bytes)?;
    Ok(bytes.into_inner())
}
