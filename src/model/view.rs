//! What a picture is taken of: camera, size, sampling grid, and which part of the light it shows.
//!
//! The CPU and the GPU renderer sample the same rays: a regular grid of `samples_per_axis`² sub-pixel centres a pixel, whose
//! mean is the pixel.

use glam::{Mat4, Vec2, Vec3, Vec4};

use crate::math::Frame;
use crate::scene::Camera;

/// A camera and the grid that its picture is sampled on.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    pub camera: Camera,
    /// Pixels.
    pub width: u32,
    pub height: u32,
    /// What radiance is multiplied with before it is tone mapped, in 1 / (W·m⁻²·sr⁻¹). Renderers leave radiance as it is.
    pub exposure: f32,
    /// Samples along each side of a pixel.
    pub samples_per_axis: u32,
}

/// Which part of the light a picture shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Shown {
    /// Direct, indirect and emitted light.
    Full,
    /// What the lights send and surfaces emit, without interreflection.
    Direct,
    /// Reconstructed indirect light, albedo applied.
    Indirect,
    /// Reconstructed indirect irradiance over π: the same on a white surface.
    IndirectOnWhite,
}

/// Why a view cannot be rendered.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum ViewError {
    #[error("a picture of {width} x {height} pixels: each side must be from 1 to {MAX_SIDE}")]
    Size { width: u32, height: u32 },
    #[error("{0} samples along a pixel's side: must be from 1 to {MAX_SAMPLES_PER_AXIS}")]
    Samples(u32),
    #[error("camera eye {eye} and target {target} must be finite and apart")]
    Direction { eye: Vec3, target: Vec3 },
    #[error("camera up {0} must be finite")]
    Up(Vec3),
    #[error("vertical field of view of {0} degrees: must lie between 0 and 180")]
    FieldOfView(f32),
}

/// A picture's largest side, pixels: 2¹⁵ squared times 12 bytes is 12 GiB.
pub const MAX_SIDE: u32 = 1 << 15;
/// 256 samples a pixel.
pub const MAX_SAMPLES_PER_AXIS: u32 = 16;

/// The pinhole of a checked [`View`]: unit vectors along the view, and half the picture's sides at unit distance.
#[derive(Clone, Copy, Debug)]
pub struct Pinhole {
    pub eye: Vec3,
    forward: Vec3,
    right: Vec3,
    up: Vec3,
    half_extent: Vec2,
    /// Pixels.
    size: Vec2,
    samples_per_axis: f32,
}

impl View {
    /// A view of `camera` with two samples along each side of a pixel.
    pub fn new(camera: Camera, width: u32, height: u32) -> Self {
        Self { camera, width, height, exposure: 1.0, samples_per_axis: 2 }
    }

    /// Samples of the whole picture along each axis.
    pub fn samples(&self) -> [u32; 2] {
        [self.width * self.samples_per_axis, self.height * self.samples_per_axis]
    }

    /// Checks the view and lays out its pinhole. An up vector along the view is replaced by any other.
    pub fn pinhole(&self) -> Result<Pinhole, ViewError> {
        let &Self { width, height, samples_per_axis, .. } = self;
        let Camera { eye, target, up, vertical_fov } = self.camera;
        if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
            return Err(ViewError::Size { width, height });
        }
        if !(1..=MAX_SAMPLES_PER_AXIS).contains(&samples_per_axis) {
            return Err(ViewError::Samples(samples_per_axis));
        }
        if !(vertical_fov > 0.0 && vertical_fov < 180.0) {
            return Err(ViewError::FieldOfView(vertical_fov));
        }
        if !up.is_finite() {
            return Err(ViewError::Up(up));
        }
        let forward =
            (target - eye).try_normalize().filter(|_| eye.is_finite()).ok_or(ViewError::Direction { eye, target })?;
        let across = forward.cross(up.normalize_or(Vec3::Y));
        // Below this the direction of the cross product is rounding.
        let right = if across.length() > 1e-4 { across.normalize() } else { Frame::from_normal(forward).tangent };
        let half_height = (vertical_fov.to_radians() * 0.5).tan();
        Ok(Pinhole {
            eye,
            forward,
            right,
            up: right.cross(forward),
            half_extent: Vec2::new(half_height * width as f32 / height as f32, half_height),
            size: Vec2::new(width as f32, height as f32),
            samples_per_axis: samples_per_axis as f32,
        })
    }
}

impl Pinhole {
    /// Unit direction through the centre of sample (x, y), counted from the top left.
    pub fn direction(&self, x: u32, y: u32) -> Vec3 {
        self.through((Vec2::new(x as f32, y as f32) + 0.5) / self.samples_per_axis)
    }

    /// Unit direction through a point of the picture, in pixels from the top left.
    pub fn through(&self, pixel: Vec2) -> Vec3 {
        let p = (pixel / self.size * 2.0 - 1.0) * self.half_extent;
        (self.forward + self.right * p.x - self.up * p.y).normalize()
    }

    /// The projection whose pixel centres look along [`Pinhole::direction`]: depth 1 at `near_m`, falling to 0 at infinity,
    /// which keeps the relative precision of f32 depth even.
    pub fn clip_from_world(&self, near_m: f32) -> Mat4 {
        let row = |axis: Vec3, scale: f32| (axis * scale).extend(-axis.dot(self.eye) * scale);
        Mat4::from_cols(
            row(self.right, 1.0 / self.half_extent.x),
            row(self.up, 1.0 / self.half_extent.y),
            near_m * Vec4::W,
            row(self.forward, 1.0),
        )
        .transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> View {
        let camera =
            Camera { eye: Vec3::new(1.0, 2.0, 5.0), target: Vec3::new(0.0, 1.0, 0.0), up: Vec3::Y, vertical_fov: 50.0 };
        View::new(camera, 64, 48)
    }

    #[test]
    fn rays_and_projection_agree() {
        let pinhole = view().pinhole().unwrap();
        let clip_from_world = pinhole.clip_from_world(0.01);
        for (x, y) in [(0, 0), (127, 0), (63, 40), (5, 95)] {
            let clip = clip_from_world * (pinhole.eye + pinhole.direction(x, y) * 3.7).extend(1.0);
            let sample = Vec2::new((clip.x / clip.w + 1.0) * 64.0, (1.0 - clip.y / clip.w) * 48.0);
            // 128 samples across: an f32 rounding of coordinates of order 1 is 1e-7 · 64 samples, a handful of times.
            assert!((sample - Vec2::new(x as f32 + 0.5, y as f32 + 0.5)).length() < 1e-4, "{sample}");
        }
    }

    #[test]
    fn up_along_the_view_still_gives_a_frame() {
        let mut view = view();
        view.camera.up = view.camera.target - view.camera.eye;
        let pinhole = view.pinhole().unwrap();
        assert!(pinhole.direction(0, 0).is_finite() && (pinhole.up.length() - 1.0).abs() < 1e-5);
    }

    #[test]
    fn absurd_views_are_refused() {
        let broken = |change: fn(&mut View)| {
            let mut v = view();
            change(&mut v);
            v.pinhole().unwrap_err()
        };
        assert_eq!(broken(|v| v.width = 0), ViewError::Size { width: 0, height: 48 });
        assert_eq!(broken(|v| v.height = MAX_SIDE + 1), ViewError::Size { width: 64, height: MAX_SIDE + 1 });
        assert_eq!(broken(|v| v.samples_per_axis = 0), ViewError::Samples(0));
        assert!(matches!(broken(|v| v.camera.vertical_fov = f32::NAN), ViewError::FieldOfView(_)));
        assert!(matches!(broken(|v| v.camera.target = v.camera.eye), ViewError::Direction { .. }));
        assert!(matches!(broken(|v| v.camera.eye.x = f32::INFINITY), ViewError::Direction { .. }));
    }
}
