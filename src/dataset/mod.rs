//! The matrices D and I: measured direct light and baked indirect light of the same lighting conditions.
//!
//! I is T × 3N values, in memory or in a folder of shards ([`folder`]); either way it is walked a few texels at a time.

pub mod build;
pub mod bytes;
pub mod contrast;
pub mod error;
pub mod folder;
pub mod manifest;
pub mod rendered;
mod roots;
mod select;
mod shard;
pub mod unbaked;

use std::ops::Range;

pub use build::Draw;
pub use bytes::Bytes;
pub use contrast::{Contrast, DirectVector};
pub use error::DatasetError;
pub use folder::Job;
pub use manifest::{Identity, identity};
pub use rendered::{Export, Reading, Rendered};
pub use unbaked::{Measured, OF_SCENARIO, Unbaked};

use crate::light::LightingCondition;
use crate::math::Rgb;
use crate::progress::Progress;

/// N conditions, the first `training` to train on, the rest held out.
#[derive(Clone, Debug)]
pub struct Dataset {
    pub conditions: Vec<LightingCondition>,
    /// How many of the conditions are for training.
    pub training: usize,
    /// D: `[point][channel][condition]`, radiant exitance at the measurement points.
    pub direct: Vec<f32>,
    pub indirect: Indirect,
    /// Surface area of each texel, m²: its weight in every inner product.
    pub texel_areas: Vec<f32>,
    /// Per condition, relative RMSE of I that is the path tracer's noise.
    pub noise: Vec<f32>,
}

/// I: `[texel][channel][condition]`, indirect irradiance.
#[derive(Clone, Debug)]
pub enum Indirect {
    Memory(Vec<f32>),
    Folder(folder::Shards),
    /// The γth roots of others, raised as they are read.
    Roots {
        of: Box<Indirect>,
        gamma: f32,
    },
}

/// Texels that I is walked by: 256 rows of 1,000 f64 vectors fill 2 MB, the second-level cache.
pub const ROWS: usize = 256;

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
    pub fn held_out(&self) -> Range<usize> {
        self.training..self.conditions.len()
    }

    /// x of one condition and channel, one value per point.
    pub fn direct_column(&self, channel: usize, condition: usize) -> Vec<f64> {
        let n = self.conditions.len();
        let rows = self.direct.chunks_exact(3 * n);
        rows.map(|row| row[channel * n + condition] as f64).collect()
    }

    /// x of one condition.
    pub fn direct(&self, condition: usize) -> DirectVector {
        let n = self.conditions.len();
        let value = |row: &[f32]| Rgb::from_array([0, 1, 2].map(|channel| row[channel * n + condition]));
        self.direct.chunks_exact(3 * n).map(value).collect()
    }

    /// Hands all of I to `visit`, in order, [`ROWS`] texels at a time, the last the rest: the range of texels and their rows,
    /// `[texel][channel][condition]`. Texels advance `progress`.
    ///
    /// # Errors
    /// When a shard cannot be read, or `progress` cancels.
    pub fn for_each_rows(
        &self,
        progress: &dyn Progress,
        mut visit: impl FnMut(Range<usize>, &[f32]),
    ) -> Result<(), DatasetError> {
        let row = 3 * self.conditions.len();
        let visit = &mut |texels: Range<usize>, rows: &[f32]| {
            if progress.cancelled() {
                return Err(DatasetError::Cancelled);
            }
            let count = texels.len() as u64;
            visit(texels, rows);
            progress.advance(count);
            Ok(())
        };
        self.indirect.for_each_rows(row, visit)
    }

    /// I of some conditions: `[texel][channel][condition of the range]`.
    ///
    /// # Errors
    /// As [`Self::for_each_rows`].
    pub fn indirect_of(&self, conditions: Range<usize>, progress: &dyn Progress) -> Result<Vec<f32>, DatasetError> {
        let n = self.conditions.len();
        let mut out = Vec::with_capacity(self.texels() * 3 * conditions.len());
        self.for_each_rows(progress, |_, rows| {
            rows.chunks(n.max(1)).for_each(|channel| out.extend_from_slice(&channel[conditions.clone()]));
        })?;
        Ok(out)
    }
}
