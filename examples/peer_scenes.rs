//! Writes scenes for other renderers, and this program's own pictures of them: for `tests/peers/mitsuba_agrees.py`, which
//! documents the files.
//!
//!     peer_scenes FOLDER SAMPLES SEEDS [GLTF]

use std::error::Error;
use std::path::Path;

use glam::{Mat3, Vec2, Vec3};
use relight::light::{EnvironmentImage, EnvironmentMap, Light, Sky};
use relight::model::View;
use relight::progress::Silent;
use relight::scene::{Asset, Camera, Material, Mesh, Tracer, generate, load};
use relight::transport::reference::{Reference, ReferenceSettings};
use serde_json::{Value, json};

const SIZE: u32 = 96;
const MAX_BOUNCES: u32 = 64;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, samples, seeds, gltf @ ..] = &arguments[..] else {
        return Err("usage: peer_scenes FOLDER SAMPLES SEEDS [GLTF]".into());
    };
    let write = |name: &str, asset: &Asset, light: Light| -> Result<(), Box<dyn Error>> {
        write(asset, &light, Path::new(folder), name, samples.parse()?, seeds.parse()?)
    };
    let generated = |name: &str| generate::generate(name).ok_or("unknown generator");
    let (cornell, interior, statue) = (generated("cornell")?, generated("interior")?, generated("statue")?);
    let (white, warm) = (Vec3::ONE, Vec3::new(1.0, 0.9, 0.7));
    let spot = Light::Spot {
        position: Vec3::new(2.0, 4.6, 1.0),
        direction: Vec3::new(0.3, -0.8, 0.5).normalize(),
        color: warm,
        intensity: 40.0,
        range: None,
        inner_cone_angle: 0.6,
        outer_cone_angle: 0.6,
    };
    write("cornell_spot", &cornell, spot)?;
    let point = Light::Point { position: Vec3::new(2.8, 4.5, 2.0), color: white, intensity: 25.0, range: None };
    write("cornell_point", &cornell, point)?;
    let sun = Light::Directional { direction: Vec3::new(0.4, -0.5, 0.8).normalize(), color: white, intensity: 3.0 };
    write("cornell_sun", &cornell, sun)?;
    let lamp = Light::Point { position: Vec3::new(4.0, 2.6, 3.4), color: white, intensity: 20.0, range: None };
    write("interior_point", &interior, lamp)?;

    // Other renderers' area lights hide what is behind them: these stand before the open front, above what the camera sees.
    let position = Vec3::new(2.6, 6.2, -2.5);
    let direction = (Vec3::new(2.8, 1.5, 3.0) - position).normalize();
    let rect = Light::Rect {
        position,
        direction,
        up: Vec3::new(0.3, 1.0, 0.0),
        size: [2.5, 1.2],
        color: warm,
        radiance: 20.0,
    };
    write("cornell_rect", &cornell, rect)?;
    write("cornell_disk", &cornell, Light::Disk { position, direction, radius: 1.1, color: warm, radiance: 20.0 })?;
    write("cornell_sphere", &cornell, Light::Sphere { position, radius: 0.9, color: warm, radiance: 20.0 })?;
    let light = |map| Light::Environment {
        image: EnvironmentImage::from_map("synthetic", map),
        rotation: 0.8,
        color: Vec3::new(1.0, 0.9, 0.8),
        intensity: 2.0,
    };
    write("cornell_environment", &cornell, light(synthetic()))?;
    // Where a shading normal is turned away from the eye Mitsuba's surfaces are black, and ours are not: with each triangle's own
    // normal there is no such place.
    let faceted = faceted(&statue);
    write("statue_environment", &faceted, light(synthetic()))?;
    let sky = Sky { sun_azimuth: -0.6, intensity: 1e-4, ..Sky::at(0.7) };
    write("statue_sky", &faceted, Light::Sky(sky))?;
    let bounds = statue.mesh.bounds();
    let position = bounds.centre() + Vec3::new(0.6, 1.6, 0.4) * bounds.diagonal();
    let direction = (bounds.centre() - position).normalize();
    let size = [0.8 * bounds.diagonal(), 0.5 * bounds.diagonal()];
    let rect = Light::Rect { position, direction, up: Vec3::Y, size, color: white, radiance: 5.0 };
    write("statue_rect", &faceted, rect.clone())?;
    write("statue_smooth", &statue, rect)?;

    let mut glowing = cornell.clone();
    // The block that is nearest to the opening glows all over.
    glowing
        .materials
        .push(Material { emissive: Vec3::new(2.0, 1.2, 0.6), ..Material::lambert("glowing", Vec3::splat(0.5)) });
    let number = glowing.materials.len() as u32 - 1;
    for triangle in 0..glowing.mesh.triangles.len() {
        let inside = |p: &Vec3| p.y < 1.66 && p.x > 0.5 && p.x < 3.2 && p.z > 0.5 && p.z < 3.0;
        if glowing.mesh.triangle_positions(triangle).iter().all(inside) {
            glowing.mesh.triangle_materials[triangle] = number;
        }
    }
    write("cornell_emissive", &glowing, Light::Emissive { scale: 1.0 })?;

    if let [path] = gltf {
        let mut textured = load(Path::new(path))?;
        textured.make_lambert();
        textured.cameras = vec![Camera::that_sees(&textured.mesh.bounds())];
        let bounds = textured.mesh.bounds();
        let position = bounds.centre() + Vec3::new(0.5, 1.2, 0.9) * bounds.diagonal();
        let direction = (bounds.centre() - position).normalize();
        let radius = 0.3 * bounds.diagonal();
        write("textured_disk", &textured, Light::Disk { position, direction, radius, color: white, radiance: 10.0 })?;
    }
    Ok(())
}

/// The asset with each triangle's own normal.
fn faceted(asset: &Asset) -> Asset {
    let mut asset = asset.clone();
    let mesh = &asset.mesh;
    let corners: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    let normal = |t: usize| mesh.triangle_cross(t).normalize_or(Vec3::Y);
    let normals = (0..mesh.triangles.len()).flat_map(|t| [normal(t); 3]).collect();
    let per_corner = |values: &[Vec2]| corners.iter().filter_map(|&v| values.get(v as usize).copied()).collect();
    asset.mesh = Mesh {
        positions: corners.iter().map(|&v| mesh.positions[v as usize]).collect(),
        normals,
        uvs: [per_corner(&mesh.uvs[0]), per_corner(&mesh.uvs[1])],
        lightmap_uvs: per_corner(&mesh.lightmap_uvs),
        triangles: (0..corners.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
        ..mesh.clone()
    };
    asset
}

/// A smooth sky with a bright lamp in it.
fn synthetic() -> EnvironmentMap {
    let (width, height) = (256, 128);
    let texel = |i: usize| {
        let (x, y) = ((i % width) as f32 / width as f32, (i / width) as f32 / height as f32);
        let glow = (-((x - 0.3) * (x - 0.3) * 4.0 + (y - 0.35) * (y - 0.35)) * 200.0).exp();
        Vec3::new(0.3 + 0.2 * (6.0 * x).sin(), 0.5 - 0.3 * y, 0.4 + 0.3 * (9.0 * x + 2.0 * y).cos()) + 30.0 * glow
    };
    EnvironmentMap::new(width, height, (0..width * height).map(texel).collect())
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
        "camera": camera, "lights": peer_lights(light, folder, name)?, "meshes": meshes(asset, folder, name)?,
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

/// The light as the script takes it.
fn peer_lights(light: &Light, folder: &Path, name: &str) -> Result<Vec<Value>, Box<dyn Error>> {
    let radiance = light.radiant();
    Ok(match light {
        Light::Rect { position, direction, .. } | Light::Disk { position, direction, .. } => {
            let ([u, v], _) = light.half_axes().ok_or("not flat")?;
            // The script's axes are right-handed.
            let v = if u.cross(v).dot(*direction) < 0.0 { -v } else { v };
            let kind = if matches!(light, Light::Rect { .. }) { "rect" } else { "disk" };
            vec![json!({"type": kind, "position": position, "u": u, "v": v, "normal": direction, "radiance": radiance})]
        }
        Light::Sphere { position, radius, .. } => {
            vec![json!({"type": "sphere", "position": position, "radius": radius, "radiance": radiance})]
        }
        Light::Environment { image, rotation, .. } => {
            vec![environment(image.map(), *rotation, radiance, &folder.join(format!("{name}_map.f32")))?]
        }
        Light::Sky(sky) => vec![
            environment(&sky.tabulate(), sky.rotation(), radiance, &folder.join(format!("{name}_map.f32")))?,
            json!({
                "type": "directional", "direction": -sky.towards_sun(), "color": radiance * sky.sun_illuminance(), "intensity": 1.0,
            }),
        ],
        Light::Emissive { .. } => Vec::new(),
        other => vec![serde_json::to_value(other)?],
    })
}

/// The map at the points of a finer grid: columns centred on theirs, rows from pole to pole, both included.
fn environment(map: &EnvironmentMap, rotation: f32, colour: Vec3, file: &Path) -> Result<Value, Box<dyn Error>> {
    let (width, height) = (1024, 513);
    let local_from_world = Mat3::from_rotation_y(-rotation);
    let mut bytes = Vec::new();
    for y in 0..height {
        let theta = std::f32::consts::PI * y as f32 / (height - 1) as f32;
        for x in 0..width {
            let phi = std::f32::consts::TAU * (x as f32 + 0.5) / width as f32;
            let direction = Vec3::new(theta.sin() * phi.sin(), theta.cos(), -theta.sin() * phi.cos());
            let radiance = map.look((local_from_world * direction).normalize()).0 * colour;
            bytes.extend(radiance.to_array().iter().flat_map(|c| c.to_le_bytes()));
        }
    }
    std::fs::write(file, bytes)?;
    Ok(json!({"type": "environment", "file": file, "width": width, "height": height}))
}

/// One mesh per material.
fn meshes(asset: &Asset, folder: &Path, name: &str) -> Result<Vec<Value>, Box<dyn Error>> {
    let mesh = &asset.mesh;
    let mut meshes = Vec::new();
    for (m, material) in asset.materials.iter().enumerate() {
        let triangles = mesh.triangles.iter().zip(&mesh.triangle_materials);
        let triangles: Vec<[u32; 3]> = triangles.filter(|(_, of)| **of as usize == m).map(|(t, _)| *t).collect();
        if triangles.is_empty() {
            continue;
        }
        let mut value = json!({
            "positions": mesh.positions, "normals": mesh.normals, "triangles": triangles,
            "reflectance": material.base_colour.truncate(), "emission": material.emissive,
        });
        if let Some(texture) = &material.base_colour_texture {
            let image = &asset.textures[texture.texture as usize];
            let file = folder.join(format!("{name}_{m}.rgba"));
            std::fs::write(&file, image.texels.concat())?;
            let uvs = mesh.uvs[texture.uv_set as usize].iter();
            value["uvs"] = json!(uvs.map(|&uv| texture.transform.transform_point2(uv)).collect::<Vec<_>>());
            value["texture"] = json!({"file": file, "width": image.width, "height": image.height});
        }
        meshes.push(value);
    }
    Ok(meshes)
}
