//! What an asset file holds, once imported.

use glam::Vec3;

use super::{Aabb, Material, Mesh, Texture};
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

impl Asset {
    /// Names this geometry, layout and look: BLAKE3 of mesh, materials and textures, hexadecimal.
    #[cfg(feature = "train")]
    pub fn hash(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        let mesh = &self.mesh;
        let mut add = |bytes: &[u8]| {
            hasher.update(&(bytes.len() as u64).to_le_bytes());
            hasher.update(bytes);
        };
        add(bytemuck::cast_slice(&mesh.positions));
        add(bytemuck::cast_slice(&mesh.normals));
        add(bytemuck::cast_slice(&mesh.uvs[0]));
        add(bytemuck::cast_slice(&mesh.uvs[1]));
        add(bytemuck::cast_slice(&mesh.colours));
        add(bytemuck::cast_slice(&mesh.lightmap_uvs));
        add(bytemuck::cast_slice(&mesh.triangles));
        add(bytemuck::cast_slice(&mesh.triangle_materials));
        for texture in &self.textures {
            add(bytemuck::cast_slice(&texture.texels));
            add(format!("{} {} {} {:?}", texture.width, texture.height, texture.srgb, texture.wrap).as_bytes());
        }
        add(format!("{:?}", self.materials).as_bytes());
        hasher.finalize().to_hex().to_string()
    }
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

impl Camera {
    /// A camera that looks down a little on all of `bounds`, from the front (+z) and to the right.
    pub fn that_sees(bounds: &Aabb) -> Self {
        let fov = Self::default_fov();
        let radius = bounds.diagonal() * 0.5;
        let distance = radius / (fov.to_radians() * 0.5).sin();
        let direction = Vec3::new(0.45, 0.35, 1.0).normalize();
        let target = bounds.centre();
        Self { eye: target + direction * distance, target, up: Vec3::Y, vertical_fov: fov }
    }

    /// What is wrong with the camera, if anything.
    pub fn check(&self) -> Result<(), String> {
        if !(self.eye.is_finite() && self.target.is_finite() && self.up.is_finite()) {
            return Err("eye, target and up must be finite".into());
        }
        let forward = self.target - self.eye;
        if forward.length() == 0.0 || forward.normalize().cross(self.up.normalize_or_zero()).length() < 1e-4 {
            return Err("eye and target must differ, and up must not point along the view".into());
        }
        if !(self.vertical_fov > 0.0 && self.vertical_fov < 180.0) {
            return Err(format!("vertical_fov {} must be between 0 and 180 degrees", self.vertical_fov));
        }
        Ok(())
    }
}
