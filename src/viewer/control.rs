//! How the camera is moved: orbit, pan, zoom, look around and fly.

use glam::{Quat, Vec2, Vec3};

use crate::scene::Camera;

/// The camera does not look steeper than this, radians from the horizon.
const STEEPEST: f32 = 1.55;

/// Turns the eye about the target; `turn` in radians, to the right and down.
pub fn orbit(camera: &mut Camera, turn: Vec2) {
    let offset = turned(camera.eye - camera.target, camera.up, -turn);
    camera.eye = camera.target + offset;
}

/// Turns the target about the eye.
pub fn look(camera: &mut Camera, turn: Vec2) {
    let forward = turned(camera.eye - camera.target, camera.up, -turn);
    camera.target = camera.eye - forward;
}

/// Moves eye and target across the view so that what is at the target follows the pointer: `shift` in shares of the
/// picture's height, to the right and down.
pub fn pan(camera: &mut Camera, shift: Vec2) {
    let (right, up, distance) = axes(camera);
    let height = 2.0 * (camera.vertical_fov.to_radians() * 0.5).tan() * distance;
    let by = (up * shift.y - right * shift.x) * height;
    camera.eye += by;
    camera.target += by;
}

/// Brings the eye nearer to the target by a factor, but not closer than `nearest` metres.
pub fn zoom(camera: &mut Camera, factor: f32, nearest: f32) {
    let offset = camera.eye - camera.target;
    let length = (offset.length() / factor).max(nearest);
    camera.eye = camera.target + offset.normalize_or(Vec3::Z) * length;
}

/// Moves eye and target by `by` metres to the right, up and forwards.
pub fn fly(camera: &mut Camera, by: Vec3) {
    let (right, up, _) = axes(camera);
    let forward = (camera.target - camera.eye).normalize_or(Vec3::NEG_Z);
    let by = right * by.x + up * by.y + forward * by.z;
    camera.eye += by;
    camera.target += by;
}

/// Unit vectors across the view, and the distance to the target.
pub fn axes(camera: &Camera) -> (Vec3, Vec3, f32) {
    let forward = camera.target - camera.eye;
    let right = forward.cross(camera.up).normalize_or(Vec3::X);
    (right, right.cross(forward).normalize_or(Vec3::Y), forward.length())
}

/// `offset` turned about `up` and tilted, but not over the pole.
fn turned(offset: Vec3, up: Vec3, turn: Vec2) -> Vec3 {
    let up = up.normalize_or(Vec3::Y);
    let offset = Quat::from_axis_angle(up, turn.x) * offset;
    let across = up.cross(offset).normalize_or(Vec3::X);
    let height = (offset.normalize_or(Vec3::Z).dot(up)).clamp(-1.0, 1.0).asin();
    let tilt = (height - turn.y).clamp(-STEEPEST, STEEPEST) - height;
    Quat::from_axis_angle(across, -tilt) * offset
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera { eye: Vec3::new(0.0, 0.0, 4.0), target: Vec3::ZERO, up: Vec3::Y, vertical_fov: 40.0 }
    }

    #[test]
    fn orbiting_keeps_the_distance_and_stops_at_the_pole() {
        let mut c = camera();
        orbit(&mut c, Vec2::new(std::f32::consts::FRAC_PI_2, 0.0));
        assert!(
            (c.eye - Vec3::new(-4.0, 0.0, 0.0)).length() < 1e-4,
            "dragged to the right, the left side shows: {}",
            c.eye
        );
        orbit(&mut c, Vec2::new(0.0, 10.0));
        assert!((c.eye.length() - 4.0).abs() < 1e-4 && c.eye.y > 3.99, "dragged down, the top shows: {}", c.eye);
        assert!(c.check().is_ok());
        orbit(&mut c, Vec2::new(0.0, -20.0));
        assert!(c.eye.y < -3.99 && c.check().is_ok());
    }

    #[test]
    fn looking_turns_the_target_and_flying_moves_both() {
        let mut c = camera();
        look(&mut c, Vec2::new(std::f32::consts::FRAC_PI_2, 0.0));
        assert!(
            (c.target - Vec3::new(4.0, 0.0, 4.0)).length() < 1e-4,
            "dragged to the right, it looks right: {}",
            c.target
        );
        let mut c = camera();
        fly(&mut c, Vec3::new(1.0, 2.0, 3.0));
        assert!(
            (c.eye - Vec3::new(1.0, 2.0, 1.0)).length() < 1e-5
                && (c.target - Vec3::new(1.0, 2.0, -3.0)).length() < 1e-5
        );
    }

    #[test]
    fn what_is_panned_follows_the_pointer_and_zoom_has_an_end() {
        let mut c = camera();
        pan(&mut c, Vec2::new(0.5, 0.0));
        // Half a picture's height at 4 m: tan 20° · 4 m.
        assert!((c.target.x + 20f32.to_radians().tan() * 4.0).abs() < 1e-4, "{}", c.target);
        zoom(&mut c, 2.0, 0.1);
        assert!(((c.eye - c.target).length() - 2.0).abs() < 1e-5);
        zoom(&mut c, 1e9, 0.1);
        assert!(((c.eye - c.target).length() - 0.1).abs() < 1e-6);
    }
}
