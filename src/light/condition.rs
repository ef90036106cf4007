//! One light and one lighting condition, in the units and words of KHR_lights_punctual, area lights and environments beside
//! them.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::{EnvironmentImage, Sky};
use crate::math::Rgb;
use crate::scene::{PunctualKind, PunctualLight};

/// A light. Colours are linear Rec. 709; directions are unit vectors along which the light shines. Area lights, as in most
/// engines, are no geometry: they hide nothing and cameras do not see them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase", deny_unknown_fields)]
pub enum Light {
    Point {
        position: Vec3,
        #[serde(default = "white")]
        color: Rgb,
        /// Candela (W/sr where radiometric units are meant).
        intensity: f32,
        /// Metres beyond which the light ends; none: unbounded.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        range: Option<f32>,
    },
    Spot {
        position: Vec3,
        direction: Vec3,
        #[serde(default = "white")]
        color: Rgb,
        /// Candela.
        intensity: f32,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        range: Option<f32>,
        /// Radians from the axis within which the intensity is full.
        #[serde(default)]
        inner_cone_angle: f32,
        /// Radians from the axis beyond which there is no light.
        #[serde(default = "quarter_pi")]
        outer_cone_angle: f32,
    },
    Directional {
        direction: Vec3,
        #[serde(default = "white")]
        color: Rgb,
        /// Lux on a surface that faces the light.
        intensity: f32,
    },
    /// A rectangle that shines from its front with the same radiance everywhere and in all directions.
    Rect {
        /// Its centre, metres.
        position: Vec3,
        direction: Vec3,
        /// What its height runs along, as nearly as the direction allows: where they are parallel, along z.
        #[serde(default = "y")]
        up: Vec3,
        /// Width and height, metres.
        size: [f32; 2],
        #[serde(default = "white")]
        color: Rgb,
        /// Nit (cd/m², W·m⁻²·sr⁻¹), as glTF's emission: a facing surface at d metres receives about radiance · area / d² lux.
        radiance: f32,
    },
    /// A disk, otherwise as `Rect`.
    Disk {
        position: Vec3,
        direction: Vec3,
        /// Metres.
        radius: f32,
        #[serde(default = "white")]
        color: Rgb,
        /// Nit.
        radiance: f32,
    },
    /// A sphere that shines outwards.
    Sphere {
        position: Vec3,
        /// Metres.
        radius: f32,
        #[serde(default = "white")]
        color: Rgb,
        /// Nit.
        radiance: f32,
    },
    /// Light from all around, as an image in latitude and longitude says.
    Environment {
        /// A .hdr or .exr file, twice as wide as high. Its middle column lies along −z, its right half towards +x.
        image: EnvironmentImage,
        /// Radians by which it is turned about +y, counter-clockwise as seen from above.
        #[serde(default)]
        rotation: f32,
        #[serde(default = "white")]
        color: Rgb,
        /// Nit per unit of the image.
        #[serde(default = "one")]
        intensity: f32,
    },
    /// A clear sky with its sun.
    Sky(Sky),
    /// The asset's own emissive surfaces, their radiance multiplied by `scale`.
    Emissive {
        #[serde(default = "one")]
        scale: f32,
    },
}

pub(super) fn white() -> Rgb {
    Vec3::ONE
}

fn y() -> Vec3 {
    Vec3::Y
}

fn quarter_pi() -> f32 {
    std::f32::consts::FRAC_PI_4
}

pub(super) fn one() -> f32 {
    1.0
}

/// How bright a light is, and of which colour.
pub struct Strength<'l> {
    /// None where it has no colour of its own.
    pub color: Option<&'l mut Rgb>,
    /// What the colour is multiplied with, and what files and people call it.
    pub amount: &'l mut f32,
    pub name: &'static str,
    pub unit: &'static str,
}

impl Light {
    /// Colour times intensity or radiance.
    pub fn radiant(&self) -> Rgb {
        let (color, _, amount) = self.strength();
        color * amount
    }

    /// The same light with its colour multiplied; none where it has no colour of its own.
    pub fn tinted(&self, tint: Rgb) -> Option<Self> {
        let mut light = self.clone();
        *light.strength_mut().color? *= tint;
        Some(light)
    }

    /// Colour, and what it is multiplied with: name and value.
    fn strength(&self) -> (Rgb, &'static str, f32) {
        let mut light = self.clone();
        let Strength { color, amount, name, .. } = light.strength_mut();
        (color.copied().unwrap_or(Vec3::ONE), name, *amount)
    }

    /// Its parts that are coloured and dimmed.
    pub fn strength_mut(&mut self) -> Strength<'_> {
        let (color, amount, name, unit) = match self {
            Light::Point { color, intensity, .. } | Light::Spot { color, intensity, .. } => {
                (color, intensity, "intensity", "cd")
            }
            Light::Directional { color, intensity, .. } => (color, intensity, "intensity", "lx"),
            Light::Environment { color, intensity, .. } | Light::Sky(Sky { color, intensity, .. }) => {
                (color, intensity, "intensity", "×")
            }
            Light::Rect { color, radiance, .. }
            | Light::Disk { color, radiance, .. }
            | Light::Sphere { color, radiance, .. } => (color, radiance, "radiance", "nit"),
            Light::Emissive { scale } => return Strength { color: None, amount: scale, name: "scale", unit: "×" },
        };
        Strength { color: Some(color), amount, name, unit }
    }

    /// What is wrong with this light, if anything, as one line; otherwise the light with its direction made unit.
    pub fn validated(mut self) -> Result<Self, String> {
        let (color, name, amount) = self.strength();
        finite("color", color)?;
        if color.min_element() < 0.0 {
            return Err(format!("color {color} is negative"));
        }
        if !amount.is_finite() || amount < 0.0 {
            return Err(format!("{name} {amount} must be finite and not negative"));
        }
        match &mut self {
            Light::Point { position, range, .. } => {
                finite("position", *position)?;
                check_range(*range)?;
            }
            Light::Spot { position, direction, range, inner_cone_angle, outer_cone_angle, .. } => {
                finite("position", *position)?;
                check_range(*range)?;
                *direction = unit("direction", *direction)?;
                // KHR_lights_punctual: 0 ≤ inner < outer ≤ π/2; equal angles are taken as a hard edge.
                if !(0.0 <= *inner_cone_angle
                    && *inner_cone_angle <= *outer_cone_angle
                    && *outer_cone_angle > 0.0
                    && *outer_cone_angle <= FRAC_PI_2 + 1e-6)
                {
                    return Err(format!(
                        "cone angles {inner_cone_angle} and {outer_cone_angle} must satisfy 0 <= inner <= outer <= pi/2, outer > 0"
                    ));
                }
            }
            Light::Directional { direction, .. } => *direction = unit("direction", *direction)?,
            Light::Rect { position, direction, up, size, .. } => {
                finite("position", *position)?;
                *direction = unit("direction", *direction)?;
                *up = unit("up", *up)?;
                size.iter().try_for_each(|&side| length("size", side))?;
            }
            Light::Disk { position, direction, radius, .. } => {
                finite("position", *position)?;
                *direction = unit("direction", *direction)?;
                length("radius", *radius)?;
            }
            Light::Sphere { position, radius, .. } => {
                finite("position", *position)?;
                length("radius", *radius)?;
            }
            Light::Environment { rotation, .. } => {
                if !rotation.is_finite() {
                    return Err(format!("rotation {rotation} is not finite"));
                }
            }
            Light::Sky(sky) => sky.check()?,
            Light::Emissive { .. } => {}
        }
        Ok(self)
    }

    /// The half axes of a rectangle or disk (centre to the middle of two sides) and its area; None for other kinds.
    pub fn half_axes(&self) -> Option<([Vec3; 2], f32)> {
        match *self {
            Light::Rect { direction, up, size: [width, height], .. } => {
                let across = [up, Vec3::Z, Vec3::X].map(|up| direction.cross(up));
                let u = across.iter().find(|v| v.length_squared() > 1e-6).copied().unwrap_or(Vec3::X).normalize();
                Some(([u * (0.5 * width), u.cross(direction) * (0.5 * height)], width * height))
            }
            Light::Disk { direction, radius, .. } => {
                let frame = crate::math::Frame::from_normal(direction);
                Some(([frame.tangent * radius, frame.bitangent * radius], PI * radius * radius))
            }
            _ => None,
        }
    }
}

fn finite(name: &str, v: Vec3) -> Result<(), String> {
    if v.is_finite() { Ok(()) } else { Err(format!("{name} {v} is not finite")) }
}

fn check_range(range: Option<f32>) -> Result<(), String> {
    range.map_or(Ok(()), |r| length("range", r))
}

fn length(name: &str, metres: f32) -> Result<(), String> {
    if metres.is_finite() && metres > 0.0 {
        Ok(())
    } else {
        Err(format!("{name} {metres} must be finite and positive"))
    }
}

fn unit(name: &str, direction: Vec3) -> Result<Vec3, String> {
    direction.try_normalize().ok_or_else(|| format!("{name} {direction} has no length"))
}

impl From<&PunctualLight> for Light {
    fn from(light: &PunctualLight) -> Self {
        let PunctualLight { position, direction, intensity, range, .. } = *light;
        // The importer multiplied colour and intensity; the intensity is the largest channel, the colour the rest.
        let peak = intensity.max_element().max(f32::MIN_POSITIVE);
        let (color, intensity) = (intensity / peak, peak);
        match light.kind {
            PunctualKind::Point => Light::Point { position, color, intensity, range },
            PunctualKind::Spot { inner_cone_angle, outer_cone_angle } => {
                Light::Spot { position, direction, color, intensity, range, inner_cone_angle, outer_cone_angle }
            }
            PunctualKind::Directional => Light::Directional { direction, color, intensity },
        }
    }
}

/// A set of lights that shine together: one column of D and of I.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightingCondition {
    pub lights: Vec<Light>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Light, String> {
        serde_json::from_str::<Light>(text).map_err(|e| e.to_string()).and_then(Light::validated)
    }

    #[test]
    fn lights_are_read_with_their_defaults() {
        let rect =
            read(r#"{"type":"rect","position":[0,2,0],"direction":[0,-2,0],"size":[1,2],"radiance":5}"#).unwrap();
        let ([u, v], area) = rect.half_axes().unwrap();
        // A lamp that shines down has its height along z.
        assert_eq!((u.abs(), v.abs(), area), (Vec3::X * 0.5, Vec3::Z, 2.0));
        let sky = read(r#"{"type":"sky","sun_elevation":0.8}"#).unwrap();
        assert_eq!(sky, Light::Sky(Sky::at(0.8)));
        assert_eq!(serde_json::from_value::<Light>(serde_json::to_value(&sky).unwrap()).unwrap(), sky);
    }

    #[test]
    fn what_is_wrong_with_a_light_is_said() {
        for (text, part) in [
            (r#"{"type":"rect","position":[0,0,0],"direction":[0,1,0],"size":[1,0],"radiance":1}"#, "size 0"),
            (r#"{"type":"rect","position":[0,0,0],"direction":[0,0,0],"size":[1,1],"radiance":1}"#, "direction"),
            (r#"{"type":"rect","position":[0,0,0],"direction":[0,1,0],"size":[1,1],"intensity":1}"#, "intensity"),
            (r#"{"type":"disk","position":[0,0,0],"direction":[0,1,0],"radius":-1,"radiance":1}"#, "radius -1"),
            (r#"{"type":"sphere","position":[0,0,0],"radius":1,"radiance":-1}"#, "radiance -1"),
            (r#"{"type":"sky","sun_elevation":2}"#, "sun_elevation 2"),
            (r#"{"type":"sky","sun_elevation":1,"turbidity":30}"#, "turbidity 30"),
            (r#"{"type":"sky","sun_elevation":1,"haze":3}"#, "haze"),
            (r#"{"type":"environment"}"#, "image"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(part) && !error.contains('\n'), "{text}: {error}");
        }
    }
}
