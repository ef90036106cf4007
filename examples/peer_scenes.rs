//! Writes scenes for other renderers, and this program's own pictures of them: for `tests/peers/mitsuba_agrees.py`, which
//! documents the files.
//!
//!     peer_scenes FOLDER SAMPLES SEEDS

use std::error::Error;
use std::path::Path;

use glam::Vec3;
use relight::light::Light;
use relight::model::View;
use relight::progress::Silent;
use relight::scene::{Asset, Tracer, generate};
use relight::transport::reference::{Reference, ReferenceSettings};
use serde_json::{Value, json};

const SIZE: u32 = 96;
const MAX_BOUNCES: u32 = 64;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, samples, seeds] = &arguments[..] else {
        return Err("usage: peer_scenes FOLDER SAMPLES SEEDS".into());
    };
    let (samples, seeds) = (samples.parse()?, seeds.parse()?);
    let white = Vec3::ONE;
    let spot = Light::Spot {
        position: Vec3::new(2.0, 4.6, 1.0),
        direction: Vec3::new(0.3, -0.8, 0.5).normalize(),
        color: Vec3::new(1.0, 0.9, 0.7),
        intensity: 40.0,
        range: None,
        inner_cone_angle: 0.6,
        outer_cone_angle: 0.6,
    };
    let point = Light::Point { position: Vec3::new(2.8, 4.5, 2.0), color: white, intensity: 25.0, range: None };
    let sun = Light::Directional { direction: Vec3::new(0.4, -0.5, 0.8).normalize(), color: white, intensity: 3.0 };
    let lamp = Light::Point { position: Vec3::new(4.0, 2.6, 3.4), color: white, intensity: 20.0, range: None };
    for (name, generator, light) in [
        ("cornell_spot", "cornell", spot),
        ("cornell_point", "cornell", point),
        ("cornell_sun", "cornell", sun),
        ("interior_point", "interior", lamp),
    ] {
        let asset = generate(generator).ok_or("unknown generator")?;
        write(&asset, &light, Path::new(folder), name, samples, seeds)?;
    }
    Ok(())
}

fn write(
    asset: &Asset,
    light: &Light,
    folder: &Path,
    name: &str,
    samples: u32,
    seeds: u64,
) -> Result<(), Box<dyn Error>> {
    let camera = asset.cameras[0].clone();
    let scene = json!({
        "width": SIZE, "height": SIZE, "max_bounces": MAX_BOUNCES,
        "camera": camera, "lights": [light], "meshes": meshes(asset),
    });
    std::fs::write(folder.join(name).with_extension("json"), scene.to_string())?;

    let tracer = Tracer::new(asset);
    let view = View { camera, width: SIZE, height: SIZE, exposure: 1.0, samples_per_axis: 1 };
    let mut bytes = Vec::new();
    for seed in 0..seeds {
        let settings = ReferenceSettings { samples, max_bounces: MAX_BOUNCES, seed };
        let picture = Reference::trace(&tracer, &view, std::slice::from_ref(light), &settings, &Silent)?;
        for (direct, indirect) in picture.direct.pixels.iter().zip(&picture.indirect.pixels) {
            bytes.extend((*direct + *indirect).to_array().iter().flat_map(|c| c.to_le_bytes()));
        }
    }
    Ok(std::fs::write(folder.join(name).with_extension("f32"), bytes)?)
}

/// One mesh per material.
fn meshes(asset: &Asset) -> Vec<Value> {
    let mesh = &asset.mesh;
    let of_material = |m: usize| {
        let triangles = mesh.triangles.iter().zip(&mesh.triangle_materials);
        let triangles: Vec<[u32; 3]> = triangles.filter(|(_, of)| **of as usize == m).map(|(t, _)| *t).collect();
        let reflectance = asset.materials[m].base_colour.truncate();
        json!({
            "positions": mesh.positions, "normals": mesh.normals, "triangles": triangles, "reflectance": reflectance,
        })
    };
    (0..asset.materials.len()).map(of_material).collect()
}
