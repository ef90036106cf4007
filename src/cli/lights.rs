//! Lights and cameras on the command line.

use std::path::Path;

use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::Failure;
use crate::files::read_words;
use crate::light::{EnvironmentImages, Light, LightPath, LightingCondition};
use crate::scene::{Asset, Camera};

/// Help for `--light`.
pub const LIGHT_HELP: &str = "A light, as TOML or JSON in the words of KHR_lights_punctual, e.g. \
'{type=\"spot\", position=[0,2,0], direction=[0,-1,0], intensity=100}', with the types point, spot, directional (candela, lux), \
rect (position, direction, size=[w,h], radiance), disk and sphere (radius, radiance; nit), environment (image=\"map.hdr\", rotation, \
intensity), sky (sun_elevation, sun_azimuth, turbidity, intensity; radians) and emissive (scale); a .toml or .json file with a list \
`lights`; or `asset` for the lights of the asset's own file. May be given several times";

/// Help for `--camera`.
pub const CAMERA_HELP: &str = "A camera, as TOML or JSON, e.g. '{eye=[0,1,5], target=[0,1,0], vertical_fov=40}', or the number of \
one of the asset's cameras, from 0";

/// Reads the `--light` arguments.
pub fn lights(arguments: &[String], asset: &Asset) -> Result<Vec<Light>, Failure> {
    let (mut lights, mut images) = (Vec::new(), EnvironmentImages::default());
    for argument in arguments {
        let (read, folder) = if argument == "asset" {
            (own_lights(asset)?, Path::new(""))
        } else if argument.trim_start().starts_with('{') {
            (vec![inline("--light", argument)?], Path::new(""))
        } else {
            let path = Path::new(argument);
            (from_file(path)?, path.parent().unwrap_or(Path::new("")))
        };
        for mut light in read {
            // Paths in a file are relative to it.
            images.ready(&mut light, folder).map_err(|e| Failure::Input(e.to_string()))?;
            let checked = light.validated().map_err(|why| Failure::Input(format!("--light {argument}: {why}")))?;
            lights.push(checked);
        }
    }
    if lights.is_empty() {
        return Err(Failure::Input("no light is given; give one with --light, e.g. --light '{type=\"point\", position=[0,2,0], intensity=100}'".into()));
    }
    Ok(lights)
}

/// The lights that the asset's file defines: KHR_lights_punctual and emissive surfaces.
pub fn defined(asset: &Asset) -> Vec<Light> {
    let mut lights: Vec<Light> = asset.lights.iter().map(Light::from).collect();
    if asset.materials.iter().any(|m| m.emissive != crate::math::Rgb::ZERO) {
        lights.push(Light::Emissive { scale: 1.0 });
    }
    lights
}

/// The same, where there must be some.
fn own_lights(asset: &Asset) -> Result<Vec<Light>, Failure> {
    let lights = defined(asset);
    if lights.is_empty() {
        return Err(Failure::Input(format!("--light asset: {} defines no light and nothing in it emits", asset.name)));
    }
    Ok(lights)
}

fn from_file(path: &Path) -> Result<Vec<Light>, Failure> {
    let condition: Result<LightingCondition, String> = read_words(path);
    condition.map(|condition| condition.lights).map_err(|why| {
        // Keyframes are no lights, but the user may well think so.
        let moves = LightPath::read(path, &mut EnvironmentImages::default()).is_ok_and(|read| read.moves());
        let help = if moves { "; its lights move: give it with --path" } else { "" };
        Failure::Input(format!("--light {why}{help}"))
    })
}

/// Reads the `--path` argument.
pub fn light_path(file: &Path) -> Result<LightPath, Failure> {
    let path = LightPath::read(file, &mut EnvironmentImages::default());
    path.map_err(|why| Failure::Input(format!("--path {why}")))
}

/// Reads the `--camera` argument; without one, the asset's first camera.
pub fn camera(argument: Option<&str>, asset: &Asset) -> Result<Camera, Failure> {
    let choices = || match asset.cameras.len() {
        0 => Failure::Input(format!("{} has no camera; give one with --camera", asset.name)),
        n => Failure::Input(format!(
            "--camera {}: {} has {n} cameras, numbered from 0",
            argument.unwrap_or("0"),
            asset.name
        )),
    };
    let camera = match argument {
        Some(text) if text.trim_start().starts_with('{') => inline("--camera", text)?,
        other => {
            let index = other.unwrap_or("0").parse::<usize>().map_err(|_| {
                Failure::Input(format!(
                    "--camera {}: neither a camera in braces nor a number",
                    other.unwrap_or_default()
                ))
            })?;
            asset.cameras.get(index).cloned().ok_or_else(choices)?
        }
    };
    camera.check().map_err(|why| Failure::Input(format!("--camera: {why}")))?;
    Ok(camera)
}

/// A value in braces, JSON or a TOML inline table.
fn inline<T: DeserializeOwned>(option: &str, text: &str) -> Result<T, Failure> {
    #[derive(Deserialize)]
    struct Wrapped<T> {
        value: T,
    }
    if let Ok(value) = serde_json::from_str(text) {
        return Ok(value);
    }
    match toml::from_str::<Wrapped<T>>(&format!("value = {text}")) {
        Ok(wrapped) => Ok(wrapped.value),
        Err(toml_error) => {
            // JSON's own message is the better one for what is JSON.
            let message = match serde_json::from_str::<serde_json::Value>(text) {
                Ok(_) => serde_json::from_str::<T>(text).err().map(|e| e.to_string()),
                Err(_) => None,
            };
            let message = message.unwrap_or_else(|| one_line(toml_error.message()));
            Err(Failure::Input(format!("{option} {text}: {message}")))
        }
    }
}

fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}
