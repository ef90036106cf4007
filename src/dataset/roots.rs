//! Datasets in gamma space, and of fewer texels.

use rayon::prelude::*;

use super::folder::Visit;
use super::{Dataset, DatasetError, Indirect, ROWS};
use crate::progress::Progress;

impl Indirect {
    /// Hands all to `visit`, [`ROWS`] texels of `row` values at a time.
    pub(super) fn for_each_rows(&self, row: usize, visit: &mut Visit) -> Result<(), DatasetError> {
        match self {
            Indirect::Memory(values) => {
                let mut blocks = values.chunks((ROWS * row).max(1)).enumerate();
                blocks.try_for_each(|(i, rows)| visit(i * ROWS..i * ROWS + rows.len() / row, rows))
            }
            Indirect::Folder(shards) => shards.for_each_rows(row, visit),
            Indirect::Roots { of, gamma } => {
                let mut roots = Vec::new();
                of.for_each_rows(row, &mut |texels, rows| {
                    rows.par_iter().map(|&v| root(v, *gamma)).collect_into_vec(&mut roots);
                    visit(texels, &roots)
                })
            }
        }
    }
}

/// v^(1/γ); what is below zero is noise around it.
fn root(value: f32, gamma: f32) -> f32 {
    value.max(0.0).powf(1.0 / gamma)
}

impl Dataset {
    /// D and I raised to 1/γ (paper 5.3). Lightmaps in a folder stay there.
    pub fn roots(&self, gamma: f32) -> Self {
        Self {
            conditions: self.conditions.clone(),
            training: self.training,
            direct: self.direct.iter().map(|&x| root(x, gamma)).collect(),
            indirect: Indirect::Roots { of: Box::new(self.indirect.clone()), gamma },
            texel_areas: self.texel_areas.clone(),
            noise: self.noise.clone(),
        }
    }

    /// Every `stride`-th texel, in memory.
    ///
    /// # Errors
    /// As [`Self::for_each_rows`].
    pub fn thinned(&self, stride: usize, progress: &dyn Progress) -> Result<Self, DatasetError> {
        let row = 3 * self.conditions.len();
        let mut values = Vec::new();
        self.for_each_rows(progress, |texels, rows| {
            let of_texel = texels.zip(rows.chunks_exact(row)).filter(|(t, _)| t % stride == 0);
            of_texel.for_each(|(_, row)| values.extend_from_slice(row));
        })?;
        Ok(Self {
            conditions: self.conditions.clone(),
            training: self.training,
            direct: self.direct.clone(),
            indirect: Indirect::Memory(values),
            texel_areas: self.texel_areas.iter().step_by(stride).copied().collect(),
            noise: self.noise.clone(),
        })
    }
}
