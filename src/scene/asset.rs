//! What an asset file holds, once imported.

use glam::Vec3;

use super::{Material, Mesh, Texture};
use crate::math::Rgb;

/// An imported asset: geometry, materials, and the lights and cameras that its file defines.
#[derive(Clone, Debug)]
pub struct Asset {
    pub name: String,
    pub mesh: Mesh,
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
    /// KHR_lights_punctual lights, in world space.
    pub lights: Vec<PunctualLight>,
    pub cameras: Vec<Camera>,
    /// What was repaired or left out on import, each one line that names the thing.
    pub warnings: Vec<String>,
}

/// A light of KHR_lights_punctual.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PunctualLight {
    pub name: String,
    pub kind: PunctualKind,
    pub position: Vec3,
    /// Unit vector along which a spot or directional light shines.
    pub direction: Vec3,
    /// Colour times intensity: candela for point and spot, lux for directional.
    pub intensity: Rgb,
    /// Metres beyond which a point or spot light ends.
    pub range: Option<f32>,
}

/// The kinds of KHR_lights_punctual. Angles in radians from the axis.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PunctualKind {
    Point,
    Spot { inner_cone_angle: f32, outer_cone_angle: f32 },
    Directional,
}

/// A perspective camera in world space.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Metres.
    pub eye: Vec3,
    /// The point looked at.
    pub target: Vec3,
    #[serde(default = "Camera::default_up")]
    pub up: Vec3,
    /// Vertical field of view, degrees.
    #[serde(default = "Camera::default_fov")]
    pub vertical_fov: f32,
}

impl Camera {
    fn default_up() -> Vec3 {
        Vec3::Y
    }

    fn default_fov() -> f32 {
        40.0
    }
}
