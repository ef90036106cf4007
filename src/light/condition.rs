//! One light and one lighting condition, in the units and words of KHR_lights_punctual.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::math::Rgb;
use crate::scene::{PunctualKind, PunctualLight};

/// A light. Colours are linear Rec. 709; directions are unit vectors along which the light shines.
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
    /// The asset's own emissive surfaces, their radiance multiplied by `scale`. Path traced only: a model is not
    /// trained on them.
    Emissive {
        #[serde(default = "one")]
        scale: f32,
    },
}

fn white() -> Rgb {
    Vec3::ONE
}

fn quarter_pi() -> f32 {
    std::f32::consts::FRAC_PI_4
}

fn one() -> f32 {
    1.0
}

impl Light {
    /// Colour times intensity.
    pub fn radiant(&self) -> Rgb {
        match *self {
            Light::Point { color, intensity, .. }
            | Light::Spot { color, intensity, .. }
            | Light::Directional { color, intensity, .. } => color * intensity,
            Light::Emissive { scale } => Vec3::splat(scale),
        }
    }

    /// What is wrong with this light, if anything, as one line; otherwise the light with its direction made unit.
    pub fn validated(mut self) -> Result<Self, String> {
        let finite = |name: &str, v: Vec3| {
            if v.is_finite() { Ok(()) } else { Err(format!("{name} {v} is not finite")) }
        };
        let (color, intensity) = match &self {
            Light::Point { color, intensity, .. }
            | Light::Spot { color, intensity, .. }
            | Light::Directional { color, intensity, .. } => (*color, *intensity),
            Light::Emissive { scale } => (Vec3::ONE, *scale),
        };
        finite("color", color)?;
        if color.min_element() < 0.0 {
            return Err(format!("color {color} is negative"));
        }
        if !intensity.is_finite() || intensity < 0.0 {
            return Err(format!("intensity {intensity} must be finite and not negative"));
        }
        match &mut self {
            Light::Point { position, range, .. } => {
                finite("position", *position)?;
                check_range(*range)?;
            }
            Light::Spot { position, direction, range, inner_cone_angle, outer_cone_angle, .. } => {
                finite("position", *position)?;
                check_range(*range)?;
                *direction = unit(*direction)?;
                // KHR_lights_punctual: 0 ≤ inner < outer ≤ π/2; equal angles are taken as a hard edge.
                if !(0.0 <= *inner_cone_angle
                    && *inner_cone_angle <= *outer_cone_angle
                    && *outer_cone_angle > 0.0
                    && *outer_cone_angle <= std::f32::consts::FRAC_PI_2 + 1e-6)
                {
                    return Err(format!(
                        "cone angles {inner_cone_angle} and {outer_cone_angle} must satisfy 0 <= inner <= outer <= pi/2, outer > 0"
                    ));
                }
            }
            Light::Directional { direction, .. } => *direction = unit(*direction)?,
            Light::Emissive { .. } => {}
        }
        Ok(self)
    }
}

fn check_range(range: Option<f32>) -> Result<(), String> {
    match range {
        Some(r) if !(r.is_finite() && r > 0.0) => Err(format!("range {r} must be finite and positive")),
        _ => Ok(()),
    }
}

fn unit(direction: Vec3) -> Result<Vec3, String> {
    direction.try_normalize().ok_or_else(|| format!("direction {direction} has no length"))
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
