//! Handles of the lights, in the scene: where they stand, what they are taken by, and what dragging does.

use eframe::egui::{Color32, Painter, Pos2, Rect, Stroke, vec2};
use glam::{Mat4, Vec2, Vec3};

use crate::light::Light;
use crate::math::colour::srgb8_from_linear;
use crate::model::View;
use crate::model::view::Pinhole;
use crate::scene::Camera;

/// Points of the screen within which a handle is taken.
const REACH: f32 = 11.0;
/// Radius of a handle, points.
const RADIUS: f32 = 7.0;
/// Length of what sticks out of a light (aim, axes), in shares of the asset's extent.
const ARM: f32 = 0.16;
/// Distance from the asset's centre at which distant lights have their handle, in shares of the extent.
const FAR: f32 = 0.55;

/// What a light is taken by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Handle {
    /// The light itself: moved in the plane that faces the camera. A distant light goes around the asset.
    Place(usize),
    /// Moved along x, y or z.
    Axis(usize, usize),
    /// Aimed.
    Aim(usize),
}

impl Handle {
    pub fn light(self) -> usize {
        match self {
            Handle::Place(light) | Handle::Axis(light, _) | Handle::Aim(light) => light,
        }
    }
}

/// From the scene to the screen and back.
pub struct Eyepiece {
    rect: Rect,
    camera: Camera,
    pinhole: Pinhole,
    clip_from_world: Mat4,
    /// Centre and diagonal of the asset's bounds.
    centre: Vec3,
    extent: f32,
}

impl Eyepiece {
    /// Of a camera that fills `rect`; none where the camera cannot see.
    pub fn new(camera: &Camera, rect: Rect, centre: Vec3, extent: f32) -> Option<Self> {
        let size = |points: f32| (points.round() as u32).max(1);
        let pinhole = View::new(camera.clone(), size(rect.width()), size(rect.height())).pinhole().ok()?;
        let clip_from_world = pinhole.clip_from_world((1e-4 * extent).max(f32::MIN_POSITIVE));
        Some(Self { rect, camera: camera.clone(), pinhole, clip_from_world, centre, extent })
    }

    pub fn eye(&self) -> Vec3 {
        self.camera.eye
    }

    /// Where a point of the scene is seen; none behind the camera.
    pub fn to_screen(&self, point: Vec3) -> Option<Pos2> {
        let clip = self.clip_from_world * point.extend(1.0);
        let share = vec2(clip.x / clip.w + 1.0, 1.0 - clip.y / clip.w) * 0.5;
        (clip.w > 0.0).then(|| self.rect.min + share * self.rect.size())
    }

    /// Unit direction in which a point of the screen is seen.
    pub fn ray(&self, at: Pos2) -> Vec3 {
        self.pinhole.through(Vec2::new(at.x - self.rect.min.x, at.y - self.rect.min.y))
    }

    /// Where the ray through `at` meets the plane through `point` that faces the camera.
    fn on_plane(&self, at: Pos2, point: Vec3) -> Option<Vec3> {
        let forward = self.camera.target - self.camera.eye;
        let (ray, normal) = (self.ray(at), forward.try_normalize()?);
        let t = (point - self.eye()).dot(normal) / ray.dot(normal);
        (t > 0.0 && t.is_finite()).then(|| self.eye() + ray * t)
    }

    /// How far along `axis` from `origin` the ray through `at` passes nearest.
    fn along(&self, at: Pos2, origin: Vec3, axis: Vec3) -> Option<f32> {
        let (ray, between) = (self.ray(at), self.eye() - origin);
        let cosine = axis.dot(ray);
        let t = (axis.dot(between) - cosine * ray.dot(between)) / (1.0 - cosine * cosine);
        t.is_finite().then_some(t)
    }

    /// Where a light's own handle stands; none for lights that have no place.
    fn place(&self, light: &Light) -> Option<Vec3> {
        let distant = || light.direction().map(|direction| self.centre - direction * (FAR * self.extent));
        light.position().or_else(distant)
    }

    fn aim(&self, light: &Light) -> Option<Vec3> {
        Some(light.position()? + light.direction()? * (ARM * self.extent))
    }

    fn axis_end(&self, light: &Light, axis: usize) -> Option<Vec3> {
        Some(light.position()? + Vec3::AXES[axis] * (ARM * self.extent))
    }

    /// The handle at a point of the screen. Those of the selected light come first.
    pub fn handle_at(&self, at: Pos2, lights: &[Light], selected: Option<usize>) -> Option<Handle> {
        let near = |point: Option<Vec3>| point.and_then(|p| self.to_screen(p)).is_some_and(|p| p.distance(at) <= REACH);
        if let Some((index, light)) = selected.and_then(|i| Some((i, lights.get(i)?))) {
            if near(self.place(light)) {
                return Some(Handle::Place(index));
            }
            if near(self.aim(light)) {
                return Some(Handle::Aim(index));
            }
            if let Some(axis) = (0..3).find(|&axis| near(self.axis_end(light, axis))) {
                return Some(Handle::Axis(index, axis));
            }
        }
        (0..lights.len()).find(|&i| near(self.place(&lights[i]))).map(Handle::Place)
    }

    /// Drags `handle` from one point of the screen to another. `surface_at` gives the surface under a ray, which lights are
    /// aimed at.
    pub fn drag(
        &self,
        handle: Handle,
        light: &mut Light,
        from: Pos2,
        to: Pos2,
        surface_at: impl Fn(Vec3) -> Option<Vec3>,
    ) {
        match (handle, light.position()) {
            (Handle::Place(_), Some(position)) => {
                if let (Some(a), Some(b)) = (self.on_plane(from, position), self.on_plane(to, position)) {
                    light.position_mut().into_iter().for_each(|p| *p += b - a);
                }
            }
            // Around the asset: to the nearest point of the sphere that its handle stands on.
            (Handle::Place(_), None) => {
                let (ray, radius) = (self.ray(to), FAR * self.extent);
                let offset = self.eye() - self.centre;
                let (half, rest) = (offset.dot(ray), offset.length_squared() - radius * radius);
                let root = (half * half - rest).max(0.0).sqrt();
                // The front of the sphere, unless its handle is on the back.
                let behind = light.direction().is_some_and(|d| (-d).dot(offset) < 0.0);
                let t = if behind { -half + root } else { -half - root };
                light.aim(self.centre - (self.eye() + ray * t));
            }
            (Handle::Axis(_, axis), Some(position)) => {
                let axis = Vec3::AXES[axis];
                if let (Some(a), Some(b)) = (self.along(from, position, axis), self.along(to, position, axis)) {
                    light.position_mut().into_iter().for_each(|p| *p += axis * (b - a));
                }
            }
            (Handle::Aim(_), Some(position)) => {
                let target = surface_at(self.ray(to)).or_else(|| self.on_plane(to, self.aim(light)?));
                target.into_iter().for_each(|target| light.aim(target - position));
            }
            _ => {}
        }
    }

    /// Draws all handles.
    pub fn paint(&self, painter: &Painter, lights: &[Light], selected: Option<usize>) {
        for (i, light) in lights.iter().enumerate() {
            self.paint_light(painter, light, selected == Some(i));
        }
    }

    fn paint_light(&self, painter: &Painter, light: &Light, selected: bool) {
        let colour = light_colour(light);
        let outline = Stroke::new(
            if selected { 2.5 } else { 1.5 },
            if selected { Color32::WHITE } else { Color32::from_gray(30) },
        );
        let faint = Stroke::new(1.5, colour.gamma_multiply(0.8));
        let line = |a: Vec3, b: Vec3, stroke: Stroke| {
            if let (Some(a), Some(b)) = (self.to_screen(a), self.to_screen(b)) {
                painter.line_segment([a, b], stroke);
            }
        };
        let Some(place) = self.place(light) else { return };
        self.paint_shape(light, &|a, b| line(a, b, faint));
        if selected && light.position().is_some() {
            for (axis, colour) in [
                (0, Color32::from_rgb(213, 94, 0)),
                (1, Color32::from_rgb(0, 158, 115)),
                (2, Color32::from_rgb(0, 114, 178)),
            ] {
                let Some(end) = self.axis_end(light, axis) else { continue };
                line(place, end, Stroke::new(2.5, colour));
                self.to_screen(end).into_iter().for_each(|p| _ = painter.circle_filled(p, 4.5, colour));
            }
        }
        match self.aim(light) {
            Some(aim) if selected => {
                line(place, aim, Stroke::new(2.0, Color32::WHITE));
                self.to_screen(aim).into_iter().for_each(|p| _ = painter.circle(p, 5.0, colour, outline));
            }
            Some(aim) => line(place, aim, faint),
            None if light.position().is_none() => line(place, self.centre, faint),
            None => {}
        }
        if let Some(at) = self.to_screen(place) {
            painter.circle(at, RADIUS, colour, outline);
        }
    }

    /// The outline of an area light, or of a spot light's cone.
    fn paint_shape(&self, light: &Light, line: &dyn Fn(Vec3, Vec3)) {
        let ring = |centre: Vec3, [u, v]: [Vec3; 2]| {
            let at = |i: i32| {
                let (sin, cos) = (i as f32 * std::f32::consts::TAU / 32.0).sin_cos();
                centre + u * cos + v * sin
            };
            (0..32).for_each(|i| line(at(i), at(i + 1)));
        };
        match *light {
            Light::Rect { position, .. } => {
                let Some(([u, v], _)) = light.half_axes() else { return };
                let corners = [u + v, u - v, -u - v, v - u].map(|offset| position + offset);
                (0..4).for_each(|i| line(corners[i], corners[(i + 1) % 4]));
            }
            Light::Disk { position, .. } => {
                light.half_axes().into_iter().for_each(|(axes, _)| ring(position, axes));
            }
            Light::Sphere { position, radius, .. } => {
                let (right, up, _) = super::control::axes(&self.camera);
                ring(position, [right * radius, up * radius]);
            }
            Light::Spot { position, direction, outer_cone_angle, .. } => {
                let frame = crate::math::Frame::from_normal(direction);
                let (sin, cos) = outer_cone_angle.sin_cos();
                let length = ARM * self.extent;
                ring(
                    position + direction * (length * cos),
                    [frame.tangent, frame.bitangent].map(|v| v * (length * sin)),
                );
            }
            _ => {}
        }
    }
}

/// The light's colour at full brightness.
fn light_colour(light: &Light) -> Color32 {
    let colour = light.clone().color_mut().map_or(Vec3::ONE, |c| *c / c.max_element().max(f32::MIN_POSITIVE));
    let [r, g, b] = srgb8_from_linear(colour);
    Color32::from_rgb(r, g, b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use eframe::egui::pos2;

    fn eyepiece() -> Eyepiece {
        let camera = Camera { eye: Vec3::new(0.0, 0.0, 5.0), target: Vec3::ZERO, up: Vec3::Y, vertical_fov: 60.0 };
        let rect = Rect::from_min_size(pos2(100.0, 50.0), vec2(400.0, 300.0));
        Eyepiece::new(&camera, rect, Vec3::ZERO, 2.0).unwrap()
    }

    fn spot(position: Vec3) -> Light {
        let text = r#"{"type": "spot", "position": [0,0,0], "direction": [0,-1,0], "intensity": 1}"#;
        let mut light: Light = serde_json::from_str(text).unwrap();
        *light.position_mut().unwrap() = position;
        light
    }

    #[test]
    fn rays_and_projection_are_inverse() {
        let e = eyepiece();
        for point in [Vec3::ZERO, Vec3::new(0.7, -0.4, 1.0), Vec3::new(-1.0, 1.0, -3.0)] {
            let at = e.to_screen(point).unwrap();
            assert!((e.ray(at) - (point - e.eye()).normalize()).length() < 1e-5);
        }
        assert_eq!(e.to_screen(Vec3::new(0.0, 0.0, 6.0)), None, "behind the camera");
    }

    #[test]
    fn a_dragged_light_is_under_the_pointer_and_keeps_its_depth() {
        let e = eyepiece();
        let mut light = spot(Vec3::new(0.2, 0.1, 1.0));
        let from = e.to_screen(light.position().unwrap()).unwrap();
        assert_eq!(e.handle_at(from, &[light.clone()], None), Some(Handle::Place(0)));
        assert_eq!(e.handle_at(from + vec2(30.0, 30.0), &[light.clone()], None), None);
        let to = from + vec2(60.0, -25.0);
        e.drag(Handle::Place(0), &mut light, from, to, |_| None);
        let position = light.position().unwrap();
        assert!(e.to_screen(position).unwrap().distance(to) < 1e-2 && (position.z - 1.0).abs() < 1e-5, "{position}");
    }

    #[test]
    fn axes_move_along_themselves_alone() {
        let e = eyepiece();
        let start = Vec3::new(0.2, 0.1, 1.0);
        let end = start + Vec3::X * (ARM * 2.0);
        let mut light = spot(start);
        let from = e.to_screen(end).unwrap();
        assert_eq!(e.handle_at(from, &[light.clone()], Some(0)), Some(Handle::Axis(0, 0)));
        let to = e.to_screen(end + Vec3::X * 0.5).unwrap() + vec2(0.0, 3.0);
        e.drag(Handle::Axis(0, 0), &mut light, from, to, |_| None);
        let moved = light.position().unwrap() - start;
        assert!((moved.x - 0.5).abs() < 0.02 && moved.y == 0.0 && moved.z == 0.0, "{moved}");
    }

    #[test]
    fn lights_aim_at_the_surface_under_the_pointer_and_suns_go_around() {
        let e = eyepiece();
        let mut light = spot(Vec3::Y);
        e.drag(Handle::Aim(0), &mut light, pos2(0.0, 0.0), pos2(0.0, 0.0), |_| Some(Vec3::new(1.0, 0.0, 0.0)));
        assert!((light.direction().unwrap() - Vec3::new(1.0, -1.0, 0.0).normalize()).length() < 1e-6);
        let text = r#"{"type": "directional", "direction": [0,0,-1], "intensity": 1}"#;
        let mut sun: Light = serde_json::from_str(text).unwrap();
        let up = Vec3::new(0.0, 0.8, 0.6);
        let to = e.to_screen(up * (FAR * 2.0)).unwrap();
        e.drag(Handle::Place(0), &mut sun, to, to, |_| None);
        assert!((sun.direction().unwrap() + up).length() < 1e-4, "{sun:?}");
    }
}
