//! The matrices D and I: measured direct light and baked indirect light of the same lighting conditions.

pub mod build;

pub use build::Draw;

use crate::light::LightingCondition;

/// N conditions, the first `training` to train on, the rest held out.
#[derive(Clone, Debug)]
pub struct Dataset {
    pub conditions: Vec<LightingCondition>,
    /// How many of the conditions are for training.
    pub training: usize,
    /// D: `[point][channel][condition]`, radiant exitance at the measurement points.
    pub direct: Vec<f32>,
    /// I: `[texel][channel][condition]`, indirect irradiance.
    pub indirect: Vec<f32>,
    /// Surface area of each texel, m²: its weight in every inner product.
    pub texel_areas: Vec<f32>,
    /// Per condition, relative RMSE of I that is the path tracer's noise.
    pub noise: Vec<f32>,
}

impl Dataset {
    /// P.
    pub fn points(&self) -> usize {
        self.direct.len() / (3 * self.conditions.len()).max(1)
    }

    /// T.
    pub fn texels(&self) -> usize {
        self.texel_areas.len()
    }

    /// Indices of the held-out conditions.
    pub fn held_out(&self) -> std::ops::Range<usize> {
        self.training..self.conditions.len()
    }

    /// x of one condition and channel, one value per point.
    pub fn direct_column(&self, channel: usize, condition: usize) -> Vec<f64> {
        let n = self.conditions.len();
        let rows = self.direct.chunks_exact(3 * n);
        rows.map(|row| row[channel * n + condition] as f64).collect()
    }
}
