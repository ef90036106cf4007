//! Measurement points, their sub-points, and the direct vector x.

pub mod direct;
#[cfg(feature = "train")]
pub mod nearest;
#[cfg(feature = "train")]
pub mod points;

#[cfg(feature = "train")]
pub use nearest::Nearest;
#[cfg(feature = "train")]
pub use points::{PointsError, normal_scale};

use glam::Vec3;

use crate::math::Rgb;

/// A point on the surface where direct light is measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasurementPoint {
    /// Metres, world space.
    pub position: Vec3,
    /// Unit shading normal.
    pub normal: Vec3,
    /// Unit geometric normal; shadow rays start on its side.
    pub geometric_normal: Vec3,
    pub albedo: Rgb,
}

/// P measurement points, each the mean of its nearest sub-points (paper 5.1 and Figure 4).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasurementPoints {
    pub points: Vec<MeasurementPoint>,
    /// Where light is evaluated.
    pub sub_points: Vec<MeasurementPoint>,
    /// `[point][neighbour]`: indices of the sub-points that a point averages, the same number for every point.
    pub neighbours: Vec<u32>,
}

impl MeasurementPoints {
    /// Sub-points that each point averages.
    pub fn neighbours_per_point(&self) -> usize {
        self.neighbours.len() / self.points.len().max(1)
    }

    /// The same points, each the mean of its `count` nearest sub-points alone.
    pub fn averaging(&self, count: usize) -> Self {
        let of_point = self.neighbours.chunks(self.neighbours_per_point().max(1));
        Self { neighbours: of_point.flat_map(|n| &n[..count.min(n.len())]).copied().collect(), ..self.clone() }
    }
}
