//! The Gram matrix of all lightmap vectors, in f64 (METHOD eq. 4).
//!
//! f64, because eigenvalues are squared singular values: in f32 everything under 3e-4 of the largest would be lost.

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, Mat, MatRef, Par};
use rayon::prelude::*;

use super::TransferError;
use crate::dataset::{Dataset, ROWS};
use crate::math::Rgb;
use crate::progress::Progress;

/// Inner products of all pairs of lightmap vectors, weighted by texel area: one vector per channel and condition.
pub struct Gram {
    /// Symmetric; row and column `channel · N + condition`.
    pub products: Mat<f64>,
    /// N, held-out conditions included.
    pub conditions: usize,
    /// Squared norm under which a condition counts as dark.
    dark: f64,
}

/// Norm of a lightmap, relative to the median one, under which a condition counts as dark.
const DARK: f64 = 0.01;

/// Norm, relative to the brightest, of light that only comes through cracks; it has no part in the median.
const CRACK: f64 = 1e-4;

/// Columns that one task accumulates. Fixed, so that sums have the same order on any number of threads.
const COLUMNS: usize = 192;

impl Gram {
    /// # Errors
    /// [`TransferError::NotFinite`] when the dataset holds a value that is not finite; [`TransferError::Dataset`] when it cannot
    /// be read or `progress` cancels.
    pub fn of(dataset: &Dataset, progress: &dyn Progress) -> Result<Self, TransferError> {
        let n = dataset.conditions.len();
        let width = 3 * n;
        // A block of columns holds the rows on and below its first diagonal entry: the lower triangle, in column blocks.
        let mut blocks: Vec<Mat<f64>> =
            (0..width).step_by(COLUMNS).map(|start| Mat::zeros(width - start, COLUMNS.min(width - start))).collect();
        let mut tile = vec![0f64; ROWS * width];
        progress.begin("gram", dataset.texels() as u64, "texels");
        let walked = dataset.for_each_rows(progress, |texels, rows| {
            let areas = &dataset.texel_areas[texels];
            tile.par_chunks_mut(width).zip(rows.par_chunks(width)).zip(areas).for_each(|((out, row), &area)| {
                let weight = (area as f64).sqrt();
                out.iter_mut().zip(row).for_each(|(out, &value)| *out = value as f64 * weight);
            });
            let a = MatRef::from_row_major_slice(&tile[..areas.len() * width], areas.len(), width);
            blocks.par_iter_mut().enumerate().for_each(|(i, block)| {
                let (start, columns) = (i * COLUMNS, block.ncols());
                let own = a.subcols(start, columns);
                let (mut diagonal, mut below) = block.as_mut().split_at_row_mut(columns);
                triangular::matmul(
                    diagonal.as_mut(),
                    BlockStructure::TriangularLower,
                    Accum::Add,
                    own.transpose(),
                    BlockStructure::Rectangular,
                    own,
                    BlockStructure::Rectangular,
                    1.0,
                    Par::Seq,
                );
                let rest = a.subcols(start + columns, width - start - columns);
                faer::linalg::matmul::matmul(below.as_mut(), Accum::Add, rest.transpose(), own, 1.0, Par::Seq);
            });
        });
        progress.end();
        walked?;
        drop(tile);
        let products = Mat::from_fn(width, width, |r, c| {
            let (r, c) = (r.max(c), r.min(c));
            let block = c / COLUMNS;
            blocks[block][(r - block * COLUMNS, c - block * COLUMNS)]
        });
        if !products.is_all_finite() {
            return Err(TransferError::NotFinite { what: "indirect light" });
        }
        let mut gram = Self { products, conditions: n, dark: 0.0 };
        let mut norms: Vec<f64> = (0..n).map(|c| gram.squared_norm(c)).collect();
        let brightest = norms.iter().copied().fold(0.0, f64::max);
        norms.retain(|&norm| norm > brightest * CRACK * CRACK);
        norms.sort_by(f64::total_cmp);
        gram.dark = norms.get(norms.len() / 2).map_or(0.0, |median| median * DARK * DARK);
        Ok(gram)
    }

    /// Of some of the conditions, in this order. Which of them are dark stays as it is.
    pub fn select(&self, conditions: &[usize]) -> Self {
        let n = conditions.len();
        let column = |i: usize| i / n * self.conditions + conditions[i % n];
        let products = Mat::from_fn(3 * n, 3 * n, |r, c| self.products[(column(r), column(c))]);
        Self { products, conditions: n, dark: self.dark }
    }

    /// Of the same conditions with the colours of their lights multiplied, each by its tint.
    pub fn tinted(&self, tints: &[Rgb]) -> Self {
        let n = self.conditions;
        let tint = |i: usize| tints[i % n][i / n] as f64;
        let products = Mat::from_fn(3 * n, 3 * n, |r, c| self.products[(r, c)] * tint(r) * tint(c));
        Self { products, ..*self }
    }

    /// Inner product of the lightmaps of two conditions, each in one channel.
    pub fn product(&self, a: (usize, usize), b: (usize, usize)) -> f64 {
        self.products[(a.0 * self.conditions + a.1, b.0 * self.conditions + b.1)]
    }

    /// Whether a condition lights the asset indirectly: its lightmap is not under a hundredth of the median one. What is
    /// darker, such as a sun that a roof keeps out, is not worth a basis element, and a relative error on it says nothing.
    pub fn is_lit(&self, condition: usize) -> bool {
        self.squared_norm(condition) > self.dark
    }

    /// Squared norm of a condition's lightmap, all channels together.
    pub fn squared_norm(&self, condition: usize) -> f64 {
        (0..3).map(|c| self.product((c, condition), (c, condition))).sum()
    }
}
