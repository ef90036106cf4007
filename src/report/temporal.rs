//! Temporal stability: how wrong what changes from frame to frame is while a light moves. This is where few measurement points
//! show as flicker (paper 5.1 and Figure 4 b).

use std::ops::Range;

use super::assemble::ReportError;
use super::fits::Fits;
use crate::dataset::{Bytes, Dataset};
use crate::math::sampler::mix64;
use crate::measure::MeasurementPoints;
use crate::progress::Progress;
use crate::scene::{Lightmap, Tracer};
use crate::transfer::{Gram, Probe, Tested, TransferError};
use crate::transport::{BakeSettings, bake};

/// A dataset, and the points that its direct light is measured at.
#[derive(Clone, Copy)]
pub struct Measured<'a> {
    pub dataset: &'a Dataset,
    pub points: &'a MeasurementPoints,
    pub tracer: &'a Tracer<'a>,
}

/// Lightmaps of lights that move, baked with the same paths for all frames: their noise hardly changes from frame to frame.
pub struct Moving {
    /// Path after path.
    pub dataset: Dataset,
    /// Of each path.
    pub frames: usize,
}

impl Moving {
    /// The frames of each path.
    pub fn paths(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        (0..self.dataset.conditions.len()).step_by(self.frames.max(1)).map(|first| first..first + self.frames)
    }

    /// The frames after the training conditions of `set`, where fits to `set` can be tested on them.
    ///
    /// # Errors
    /// When lightmaps cannot be read, or `progress` cancels.
    pub fn after(&self, set: &Measured, progress: &dyn Progress) -> Result<(Dataset, Gram), TransferError> {
        let training = set.dataset.training;
        let frames = self.dataset.measured_at(set.tracer, set.points);
        let parts = [(set.dataset, (0..training).collect()), (&frames, (0..frames.conditions.len()).collect())];
        let dataset = Dataset::gather(&parts, training, progress)?;
        let gram = Gram::of(&dataset, progress)?;
        Ok((dataset, gram))
    }

    /// The noise of the first path's Δi, relative to Δi, by a second bake with paths of light of its own: part of every error. None
    /// where the frames do not fit into `memory`, or nothing changes.
    ///
    /// # Errors
    /// When lightmaps cannot be read, or `progress` cancels.
    pub fn noise(
        &self,
        tracer: &Tracer,
        lightmap: &Lightmap,
        settings: &BakeSettings,
        memory: Bytes,
        progress: &dyn Progress,
    ) -> Result<Option<f64>, ReportError> {
        let Some(path) = self.paths().next() else { return Ok(None) };
        let (n, texels) = (path.len(), lightmap.texels.len());
        if Bytes::resident().0 + (2 * 3 * 4 * n * texels) as u64 > memory.0 {
            return Ok(None);
        }
        let settings = BakeSettings { seed: mix64(settings.seed), ..*settings };
        let other = bake(tracer, lightmap, &self.dataset.conditions[path.clone()], &settings, progress)?.indirect;
        let own = self.dataset.indirect_of(path, progress)?;
        let (mut noise, mut norm) = (0.0, 0.0);
        for (i, (a, b)) in own.chunks_exact(n).zip(other.chunks_exact(n)).enumerate() {
            let area = self.dataset.texel_areas[i / 3] as f64;
            for (a, b) in a.windows(2).zip(b.windows(2)) {
                let (a, b) = ((a[1] - a[0]) as f64, (b[1] - b[0]) as f64);
                // Two noises of the same variance.
                noise += area * (a - b).powi(2) / 2.0;
                norm += area * a * a;
            }
        }
        Ok((norm > 0.0).then(|| (noise / norm).sqrt()))
    }

    /// Per fit and path sqrt(Σ a |Δi − Δî|²) / sqrt(Σ a |Δi|²), over all pairs of frames that follow each other. Paths along which
    /// no light changes are left out.
    ///
    /// # Errors
    /// When lightmaps cannot be read, or `progress` cancels.
    pub fn errors(&self, fits: &Fits, set: &Measured, progress: &dyn Progress) -> Result<Vec<Vec<f64>>, TransferError> {
        let (dataset, gram) = self.after(set, progress)?;
        let errors = |fitted| {
            let tested = fits.test(fitted, &dataset, &gram, progress)?;
            let of_path = |path: Range<usize>| self.error(&tested, path, dataset.training);
            Ok(self.paths().filter_map(of_path).collect())
        };
        fits.list.iter().map(errors).collect()
    }

    fn error(&self, tested: &Tested, path: Range<usize>, first: usize) -> Option<f64> {
        let (error, norm) = changes(tested, path, first).fold((0.0, 0.0), |sum, c| (sum.0 + c.0, sum.1 + c.1));
        (norm > 0.0).then(|| (error / norm).sqrt())
    }
}

/// |Δi − Δî|² and |Δi|² of each frame of `path` but the first. The first frame of all is condition `first`.
pub fn changes<'t>(tested: &'t Tested, path: Range<usize>, first: usize) -> impl Iterator<Item = (f64, f64)> + 't {
    let pairs = path.clone().zip(path.skip(1));
    pairs.map(move |(from, to)| tested.squared_error(&Probe::change(first + from, first + to)))
}
