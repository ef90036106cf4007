//! The node graph: world transforms, lights and cameras.

use std::f32::consts::FRAC_PI_2;

use glam::{Mat4, Quat, Vec3};
use gltf::json::camera::Type as CameraType;
use gltf::json::extensions::scene::khr_lights_punctual::{Light, Type as LightType};
use gltf::json::validation::Checked;
use gltf::json::{Index, Node, Root};

use super::label;
use crate::scene::{Camera, PunctualKind, PunctualLight};

/// A node of the imported scene.
pub(super) struct Placed<'a> {
    pub node: &'a Node,
    pub index: usize,
    pub world_from_node: Mat4,
}

/// The nodes of the default scene, of the first, or below every root, each before its children.
///
/// # Errors
/// A node that does not exist, or that is reached twice: nodes form trees (glTF 2.0, section 3.5.2).
pub(super) fn placed(root: &Root) -> Result<Vec<Placed<'_>>, String> {
    let scene = match root.scene {
        Some(index) => Some(root.get(index).ok_or_else(|| format!("scene {index} does not exist"))?),
        None => root.scenes.first(),
    };
    let tops: Vec<usize> = match scene {
        Some(scene) => scene.nodes.iter().map(Index::value).collect(),
        None => {
            let mut is_child = vec![false; root.nodes.len()];
            for child in root.nodes.iter().flat_map(|n| n.children.iter().flatten()) {
                if let Some(flag) = is_child.get_mut(child.value()) {
                    *flag = true;
                }
            }
            (0..root.nodes.len()).filter(|&n| !is_child[n]).collect()
        }
    };
    let mut reached = vec![false; root.nodes.len()];
    let mut placed = Vec::new();
    let mut open: Vec<(usize, Mat4)> = tops.iter().rev().map(|&n| (n, Mat4::IDENTITY)).collect();
    while let Some((index, world_from_parent)) = open.pop() {
        let node = root.nodes.get(index).ok_or_else(|| format!("node {index} does not exist"))?;
        if std::mem::replace(&mut reached[index], true) {
            let node = label("node", index, node.name.as_ref());
            return Err(format!("{node} is reached twice; give each node one parent and no cycle"));
        }
        let world_from_node = world_from_parent * parent_from_node(node);
        let children = node.children.iter().flatten().rev();
        open.extend(children.map(|child| (child.value(), world_from_node)));
        placed.push(Placed { node, index, world_from_node });
    }
    Ok(placed)
}

fn parent_from_node(node: &Node) -> Mat4 {
    if let Some(matrix) = &node.matrix {
        return Mat4::from_cols_array(matrix);
    }
    let rotation = node.rotation.map_or(Quat::IDENTITY, |r| Quat::from_array(r.0));
    let rotation = if rotation.length_squared().is_normal() { rotation.normalize() } else { Quat::IDENTITY };
    Mat4::from_scale_rotation_translation(
        node.scale.map_or(Vec3::ONE, Vec3::from_array),
        rotation,
        node.translation.map_or(Vec3::ZERO, Vec3::from_array),
    )
}

/// The KHR_lights_punctual lights of the scene. A node's light shines along its −Z.
pub(super) fn lights(root: &Root, placed: &[Placed], warnings: &mut Vec<String>) -> Vec<PunctualLight> {
    let defined = root.extensions.as_ref().and_then(|e| e.khr_lights_punctual.as_ref());
    let defined: &[Light] = defined.map_or(&[], |e| &e.lights);
    let mut lights = Vec::new();
    for node in placed {
        let Some(reference) = node.node.extensions.as_ref().and_then(|e| e.khr_lights_punctual.as_ref()) else {
            continue;
        };
        let index = reference.light.value();
        let name = defined.get(index).and_then(|l| l.name.as_ref()).or(node.node.name.as_ref());
        match defined.get(index).ok_or("it does not exist").and_then(|light| punctual(light, node)) {
            Ok(light) => lights.push(light),
            Err(reason) => warnings.push(format!("{} was left out: {reason}", label("light", index, name))),
        }
    }
    lights
}

fn punctual(light: &Light, node: &Placed) -> Result<PunctualLight, &'static str> {
    let Checked::Valid(kind) = light.type_ else { return Err("its type is not point, spot or directional") };
    let kind = match kind {
        LightType::Point => PunctualKind::Point,
        LightType::Directional => PunctualKind::Directional,
        LightType::Spot => {
            let spot = light.spot.as_ref().ok_or("it is a spot light without cone angles")?;
            let (inner, outer) = (spot.inner_cone_angle, spot.outer_cone_angle);
            if !(inner >= 0.0 && inner <= outer && outer > 0.0 && outer <= FRAC_PI_2) {
                return Err("its cone angles are not 0 ≤ inner ≤ outer ≤ π/2");
            }
            PunctualKind::Spot { inner_cone_angle: inner, outer_cone_angle: outer }
        }
    };
    let intensity = Vec3::from_array(light.color) * light.intensity;
    if !intensity.is_finite() || intensity.min_element() < 0.0 {
        return Err("its intensity is negative or not finite");
    }
    let position = node.world_from_node.transform_point3(Vec3::ZERO);
    let direction = node.world_from_node.transform_vector3(Vec3::NEG_Z).try_normalize();
    let direction = direction.filter(|_| position.is_finite()).ok_or("its node's transform is not invertible")?;
    let range = light.range.filter(|r| *r > 0.0 && r.is_finite());
    let name = light.name.as_ref().or(node.node.name.as_ref()).cloned().unwrap_or_default();
    Ok(PunctualLight { name: crate::scene::load::one_line(&name), kind, position, direction, intensity, range })
}

/// The scene's perspective cameras. Each looks along its node's −Z, at a target one metre away.
pub(super) fn cameras(root: &Root, placed: &[Placed], warnings: &mut Vec<String>) -> Vec<Camera> {
    let mut cameras = Vec::new();
    for node in placed {
        let Some(index) = node.node.camera else { continue };
        let camera = root.get(index);
        let name = camera.and_then(|c| c.name.as_ref()).or(node.node.name.as_ref());
        let label = label("camera", index.value(), name);
        let perspective = camera
            .filter(|c| matches!(c.type_, Checked::Valid(CameraType::Perspective)))
            .and_then(|c| c.perspective.as_ref())
            .filter(|p| p.yfov > 0.0 && p.yfov < std::f32::consts::PI);
        let Some(perspective) = perspective else {
            warnings.push(format!("{label} was left out: it is not a perspective camera"));
            continue;
        };
        let world = &node.world_from_node;
        let eye = world.transform_point3(Vec3::ZERO);
        let forward = world.transform_vector3(Vec3::NEG_Z).try_normalize();
        let up = world.transform_vector3(Vec3::Y).try_normalize();
        match (forward, up) {
            (Some(forward), Some(up)) if eye.is_finite() => {
                let vertical_fov = perspective.yfov.to_degrees();
                cameras.push(Camera { eye, target: eye + forward, up, vertical_fov });
            }
            _ => warnings.push(format!("{label} was left out: its node's transform is not invertible")),
        }
    }
    cameras
}
