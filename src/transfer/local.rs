//! A local basis: each texel stores n channels b(t), and takes its coefficients from its anchors (METHOD eq. 10),
//! i(t) = b(t) · Σₖ φₖ(t) Mₖ x, so that n channels do the work of many global elements: between anchors the frames turn with
//! the place. Fitted by alternating least squares to the terms F of a global basis, F(t) ≈ b(t) · Σₖ φₖ(t) Wₖ with Wₖ of
//! n × terms: given the frames W each texel's b is a problem of n unknowns, given all b the frames are one of K n.
//!
//! The terms are those that the direct light tells apart: principal components of the lightmaps that the global transfer
//! predicts for the training conditions. What x cannot tell is no use to be able to show.

use faer::linalg::solvers::Solve;
use faer::{Mat, MatMut, MatRef, Side};
use glam::Vec3;
use rayon::prelude::*;

use super::TransferError;
use super::anchors;
use super::fit::Fit;
use super::ridge::eigen_descending;
use super::small::{RIDGE, Small, dot};
use crate::dataset::Dataset;
use crate::model::{Anchors, Basis, Channels, Transfer, Values};
use crate::progress::Progress;

/// What all local fits to one global one have in common.
pub struct Terms {
    /// F, `[texel][component][term]`.
    values: Vec<f32>,
    count: usize,
    components: usize,
    /// Area of each texel.
    areas: Vec<f32>,
    anchors: Anchors,
    /// Per group of vectors (R, G, B for mono; one for multi), the terms' coefficients from x: `[term][row]`.
    predictors: Vec<Mat<f64>>,
}

/// How a texel's channels are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// 8 bits, with a scale for each texel.
    Byte,
    /// Half floats.
    Half,
}

/// A fitted local basis and its transfer.
pub struct LocalFit {
    /// n.
    pub channels: usize,
    pub precision: Precision,
    /// Σ a |F − b W|² after each pass of the alternation, relative to Σ a |F|².
    pub losses: Vec<f64>,
    /// b as it is stored, `[texel][component][channel]`, at most 1 in magnitude.
    values: Vec<f32>,
    /// The frames that b was fitted to; those of the transfer were fitted to b as it is stored.
    frames: Frames,
    /// BᵀB over texels, weighted by area, of the K n elements φₖ b: `[k n + j][…]`.
    pub(super) products: Mat<f64>,
    /// M of each group: `[k n + j][row]`.
    pub(super) matrices: Vec<Mat<f64>>,
}

/// Passes of the alternation.
const PASSES: usize = 20;

/// Terms with less than this share of the first one's energy are rounding.
const LEAST_ENERGY: f64 = 1e-12;

/// Parts that sums over texels are cut into, whatever the number of threads, so that they come out the same.
pub(super) const PARTS: usize = 8;

impl Terms {
    /// Terms of `fit`, a fit of [`super::Method::Local`], with at most `anchors` anchors for the texels at `spots` (position and
    /// normal).
    ///
    /// # Errors
    /// When the dataset cannot be read, or `progress` cancels.
    pub fn new(
        fit: &Fit,
        dataset: &Dataset,
        spots: &[(Vec3, Vec3)],
        anchors: usize,
        progress: &dyn Progress,
    ) -> Result<Self, TransferError> {
        let components = fit.settings.channels.components();
        // F = U E Λ^½ with E Λ Eᵀ the covariance of the predicted coefficients; its own coefficients are Λ^-½ Eᵀ M x.
        let (energies, vectors) = eigen_descending(fit.predicted_covariance(dataset).as_ref())?;
        let least = LEAST_ENERGY * energies.first().copied().unwrap_or(0.0);
        let count = energies.iter().take_while(|&&e| e > least && e > 0.0).count();
        let scaled = |by: &dyn Fn(f64) -> f64| {
            Mat::from_fn(vectors.nrows(), count, |row, j| vectors[(row, j)] * by(energies[j].sqrt()))
        };
        let combination = &fit.combination * scaled(&|s| s);
        let inverse = scaled(&|s| 1.0 / s);
        let mut values = vec![0f32; dataset.texels() * components * count];
        fit.for_each_expanded(combination.as_ref(), dataset, progress, |texels, rows| {
            let first = texels.start * components * count;
            values[first..first + rows.len()].iter_mut().zip(rows).for_each(|(v, &row)| *v = row as f32);
        })?;
        // More anchors where there is more light to be wrong about.
        let weights = norms(&values, components * count);
        Ok(Self {
            values,
            count,
            components,
            areas: dataset.texel_areas.clone(),
            anchors: anchors::place(spots, &weights, anchors),
            predictors: fit.matrices().iter().map(|m| inverse.transpose() * m).collect(),
        })
    }

    /// At most about `most` of the texels, evenly spread, with `anchors` anchors of their own.
    pub fn thinned(&self, spots: &[(Vec3, Vec3)], most: usize, anchors: usize) -> Self {
        let stride = self.areas.len().div_ceil(most.max(1)).max(1);
        let row = self.components * self.count;
        let kept = || (0..self.areas.len()).step_by(stride);
        let values: Vec<f32> = kept().flat_map(|t| &self.values[t * row..(t + 1) * row]).copied().collect();
        let spots: Vec<(Vec3, Vec3)> = kept().map(|t| spots[t]).collect();
        Self {
            anchors: anchors::place(&spots, &norms(&values, row), anchors),
            values,
            areas: kept().map(|t| self.areas[t]).collect(),
            predictors: self.predictors.clone(),
            ..*self
        }
    }

    /// What n channels a texel leave of these terms after some passes, relative to them: Σ a |F − b W|² / Σ a |F|².
    pub fn residual(&self, channels: usize, passes: usize) -> f64 {
        let Alternation { frames, mut values, energy, .. } = alternate(self, channels, passes);
        fit_texels(self, &frames, &mut values, None) / energy.max(f64::MIN_POSITIVE)
    }

    /// F of one texel and component.
    fn row(&self, row: usize) -> &[f32] {
        &self.values[row * self.count..(row + 1) * self.count]
    }

    fn rows(&self) -> usize {
        self.areas.len() * self.components
    }
}

/// Norm of each `row` of values.
fn norms(values: &[f32], row: usize) -> Vec<f32> {
    let norm = |row: &[f32]| row.iter().map(|&v| (v as f64).powi(2)).sum::<f64>().sqrt() as f32;
    values.par_chunks_exact(row.max(1)).map(norm).collect()
}

/// W with what is derived from it.
struct Frames {
    /// `[k n + j][term]`.
    rows: Vec<f64>,
    /// W Wᵀ.
    products: Mat<f64>,
    channels: usize,
    terms: usize,
}

impl Frames {
    fn new(matrix: MatRef<f64>, channels: usize) -> Self {
        let (height, terms) = (matrix.nrows(), matrix.ncols());
        let rows = (0..height).flat_map(|r| (0..terms).map(move |c| matrix[(r, c)])).collect();
        Self { rows, products: matrix * matrix.transpose(), channels, terms }
    }

    fn row(&self, anchor: usize, channel: usize) -> &[f64] {
        let at = (anchor * self.channels + channel) * self.terms;
        &self.rows[at..at + self.terms]
    }

    /// Puts the normal matrix of a texel with these anchors into `small`: Σ φₖ φₗ Wₖ Wₗᵀ.
    fn normal_matrix(&self, blend: &[(usize, f32); 4], small: &mut Small) {
        let n = self.channels;
        small.matrix.fill(0.0);
        for &(k, share_k) in blend {
            for &(l, share_l) in blend {
                let share = share_k as f64 * share_l as f64;
                for (i, row) in small.matrix.chunks_exact_mut(n).enumerate() {
                    // Symmetric as a whole: columns, whose numbers lie side by side, for rows.
                    let products = self.products.col(k * n + i).subrows(l * n, n);
                    row.iter_mut().zip(products.iter()).for_each(|(sum, p)| *sum += share * p);
                }
            }
        }
    }

    /// Σ φₖ Wₖ F.
    fn right_side(&self, blend: &[(usize, f32); 4], terms: &[f64], out: &mut [f64]) {
        for (j, out) in out.iter_mut().enumerate() {
            *out = blend.iter().map(|&(k, share)| share as f64 * dot(self.row(k, j), terms)).sum();
        }
    }
}

impl LocalFit {
    /// Fits n `channels` a texel to `terms`.
    pub fn train(terms: &Terms, channels: usize, precision: Precision) -> Self {
        let n = channels;
        let Alternation { frames, mut values, energy, mut losses } = alternate(terms, n, PASSES);
        let mut frames = frames;
        // What is stored is made from these frames, and the frames anew from what is stored.
        losses.push(fit_texels(terms, &frames, &mut values, None) / energy.max(f64::MIN_POSITIVE));
        let peaks = scale_to(&mut values, n, |column| column.fold(0f32, |peak, v| peak.max(v.abs())) as f64);
        frames = frames.scaled(&peaks);
        fit_texels(terms, &frames, &mut values, Some(precision));
        let (matrix, products) = fit_frames(terms, n, &values);
        let matrices = terms.predictors.iter().map(|p| &matrix * p).collect();
        Self { channels, precision, losses, values, frames, products, matrices }
    }

    /// What a texel takes in the model: its channels, four anchors and their shares.
    pub fn bytes_per_texel(&self, channels: Channels) -> usize {
        let value = if self.precision == Precision::Byte { 1 } else { 2 };
        self.channels * channels.components() * value + 8
    }

    /// M of each anchor.
    pub fn transfer(&self, terms: &Terms, channels: Channels) -> Transfer {
        let row_major = |m: &Mat<f64>| -> Vec<f32> {
            (0..m.nrows()).flat_map(|r| (0..m.ncols()).map(move |c| m[(r, c)] as f32)).collect()
        };
        let rows = self.matrices.first().map_or(0, |m| m.ncols());
        Transfer {
            channels,
            elements: terms.anchors.count * self.channels,
            points: rows / channels.components(),
            matrices: self.matrices.iter().map(row_major).collect(),
            mean_scaled_by_norm: false,
            gamma: 1.0,
        }
    }

    /// The elements φₖ b that are not zero at a texel and component, with their values.
    pub(super) fn elements_at<'s>(
        &'s self,
        terms: &'s Terms,
        texel: usize,
        component: usize,
    ) -> impl Iterator<Item = (usize, f64)> + 's {
        let n = self.channels;
        let row = texel * terms.components + component;
        let values = &self.values[row * n..(row + 1) * n];
        let blend = terms.anchors.of(texel).into_iter().filter(|&(_, share)| share > 0.0);
        blend.flat_map(move |(k, share)| {
            values.iter().enumerate().map(move |(j, &b)| (k * n + j, share as f64 * b as f64))
        })
    }

    /// The basis over the whole page. `finish` lays a plane of path traced values per texel out over the page, and each texel
    /// of the page takes the anchors of the texel that `sources` names: the terms are finished, since they are linear, and the
    /// channels fitted to them.
    pub fn page(&self, terms: &Terms, sources: &[u32], finish: &(dyn Fn(&[f32]) -> Vec<f32> + Sync)) -> Basis {
        let (n, components, page) = (self.channels, terms.components, sources.len());
        let texels = terms.areas.len();
        let of_source = |list: &[[u8; 4]]| -> Vec<[u8; 4]> {
            sources.iter().map(|&t| list.get(t as usize).copied().unwrap_or([0; 4])).collect()
        };
        let mut anchors = Anchors {
            count: terms.anchors.count,
            indices: of_source(&terms.anchors.indices),
            shares: of_source(&terms.anchors.shares),
        };
        // Σₖ φₖ Wₖ F, term by term: `[texel of the page][component][channel]`.
        let row = components * n;
        let mut right = vec![0f64; page * row];
        let terms_at_once = PLANES.div_ceil(components);
        for first in (0..terms.count).step_by(terms_at_once) {
            let some = first..(first + terms_at_once).min(terms.count);
            let planes: Vec<f32> = some
                .clone()
                .flat_map(|term| (0..components).map(move |c| (term, c)))
                .flat_map(|(term, c)| (0..texels).map(move |t| terms.values[(t * components + c) * terms.count + term]))
                .collect();
            let pages = finish(&planes);
            right.par_chunks_mut(row).enumerate().for_each(|(texel, right)| {
                let blend = anchors.of(texel);
                for (i, term) in some.clone().enumerate() {
                    for j in 0..n {
                        let frame: f64 = blend.iter().map(|&(k, s)| s as f64 * self.frames.row(k, j)[term]).sum();
                        for component in 0..components {
                            let value = pages[(i * components + component) * page + texel] as f64;
                            right[component * n + j] += frame * value;
                        }
                    }
                }
            });
        }
        let mut stored = vec![0f32; right.len()];
        let blends: Vec<[(usize, f32); 4]> = (0..page).map(|texel| anchors.of(texel)).collect();
        let rows = stored.par_chunks_mut(row).zip(right.par_chunks(row)).zip(&blends).zip(&mut anchors.shares);
        rows.for_each_init(
            || Small::new(n, components),
            |small, (((out, right), blend), share)| {
                self.frames.normal_matrix(blend, small);
                small.right.copy_from_slice(right);
                small.solve();
                share[3] = small.store(self.precision, out);
            },
        );
        // `[channel][component][texel]`.
        let of_plane = |at: usize| (at % components) * n + at / components;
        let planes = (0..row).flat_map(|at| (0..page).map(move |texel| (texel, of_plane(at))));
        let value = |(texel, at): (usize, usize)| stored[texel * row + at];
        let values = match self.precision {
            Precision::Half => Values::Half(planes.map(|at| half::f16::from_f32(value(at))).collect()),
            Precision::Byte => {
                let code = |at: (usize, usize)| (value(at) / anchors.scale(at.0) * 127.0).round() as i8;
                Values::Byte(planes.map(code).collect())
            }
        };
        let size = page.isqrt();
        Basis { size, elements: n, components, values, anchors: Some(anchors), gamma: 1.0 }
    }
}

/// What the alternation came to.
struct Alternation {
    frames: Frames,
    /// b, scaled; to be fitted once more to `frames`.
    values: Vec<f32>,
    /// Σ a |F|².
    energy: f64,
    /// Of each pass, relative to the energy.
    losses: Vec<f64>,
}

/// Fits channels and frames in turns.
fn alternate(terms: &Terms, n: usize, passes: usize) -> Alternation {
    let anchors = terms.anchors.count;
    // All frames start as the first n terms.
    let start = Mat::from_fn(anchors * n, terms.count, |row, term| if row % n == term { 1.0 } else { 0.0 });
    let mut frames = Frames::new(start.as_ref(), n);
    let mut values = vec![0f32; terms.rows() * n];
    let energy: f64 = (0..terms.rows())
        .map(|row| {
            terms.areas[row / terms.components] as f64 * terms.row(row).iter().map(|&f| (f as f64).powi(2)).sum::<f64>()
        })
        .sum();
    let mut losses = Vec::new();
    for _ in 0..passes {
        losses.push(fit_texels(terms, &frames, &mut values, None) / energy.max(f64::MIN_POSITIVE));
        scale_to(&mut values, n, |column| {
            (column.map(|v| (v as f64).powi(2)).sum::<f64>() / terms.rows().max(1) as f64).sqrt()
        });
        frames = Frames::new(fit_frames(terms, n, &values).0.as_ref(), n);
    }
    Alternation { frames, values, energy, losses }
}

/// Planes of terms that are finished at a time.
pub(super) const PLANES: usize = 12;

impl Frames {
    /// Each channel times its factor.
    fn scaled(&self, factors: &[f64]) -> Self {
        let n = self.channels;
        let scaled =
            Mat::from_fn(self.products.nrows(), self.terms, |r, c| self.rows[r * self.terms + c] * factors[r % n]);
        Self::new(scaled.as_ref(), n)
    }
}

/// Given the frames, the channels of each texel, rounded to `precision` if one is given. Returns Σ a |F − b W|².
fn fit_texels(terms: &Terms, frames: &Frames, values: &mut [f32], precision: Option<Precision>) -> f64 {
    let (n, components) = (frames.channels, terms.components);
    let part = terms.areas.len().div_ceil(PARTS).max(1);
    let parts = values.par_chunks_mut(part * components * n).enumerate().map(|(p, values)| {
        let (mut small, mut of_row) = (Small::new(n, components), vec![0f64; terms.count]);
        let mut loss = 0.0;
        for (texel, out) in (p * part..).zip(values.chunks_exact_mut(components * n)) {
            let blend = terms.anchors.of(texel);
            let mut energy = 0.0;
            frames.normal_matrix(&blend, &mut small);
            for (c, right) in small.right.chunks_exact_mut(n).enumerate() {
                of_row.iter_mut().zip(terms.row(texel * components + c)).for_each(|(v, &f)| *v = f as f64);
                frames.right_side(&blend, &of_row, right);
                energy += dot(&of_row, &of_row);
            }
            small.solve();
            match precision {
                None => small.solution.iter().zip(out.iter_mut()).for_each(|(s, out)| *out = *s as f32),
                Some(precision) => _ = small.store(precision, out),
            }
            loss += terms.areas[texel] as f64 * (energy + small.change_of_loss(out));
        }
        loss
    });
    // In order: a sum of the same numbers, whoever made them.
    parts.collect::<Vec<f64>>().into_iter().sum()
}

/// Given the channels, the frames of all anchors, and the normal matrix of that problem.
fn fit_frames(terms: &Terms, channels: usize, values: &[f32]) -> (Mat<f64>, Mat<f64>) {
    let (n, count) = (channels, terms.count);
    let width = terms.anchors.count * n;
    // Texels of each anchor, with their shares.
    let mut members: Vec<Vec<(usize, f64)>> = vec![Vec::new(); terms.anchors.count];
    for texel in 0..terms.areas.len() {
        for (k, share) in terms.anchors.of(texel).into_iter().filter(|a| a.1 > 0.0) {
            members[k].push((texel, share as f64));
        }
    }
    // Columns of an anchor are summed by one thread, over its texels in order: the same sums on any number of threads.
    let (mut normal, mut right) = (Mat::<f64>::zeros(width, width), Mat::<f64>::zeros(count, width));
    let columns = normal.as_mut().par_col_chunks_mut(n).zip(right.as_mut().par_col_chunks_mut(n)).zip(&members);
    columns.for_each(|((normal, right), members)| {
        // Apart from the matrices, where they stay in the cache.
        let (mut of_anchors, mut of_terms) = (vec![0f64; n * width], vec![0f64; n * count]);
        let (mut square, mut of_row) = (vec![0f64; n * n], vec![0f64; count]);
        for &(texel, share) in members {
            square.fill(0.0);
            for row in texel * terms.components..(texel + 1) * terms.components {
                let b = &values[row * n..(row + 1) * n];
                of_row.iter_mut().zip(terms.row(row)).for_each(|(v, &f)| *v = f as f64);
                for (i, (square, sums)) in
                    square.chunks_exact_mut(n).zip(of_terms.chunks_exact_mut(count.max(1))).enumerate()
                {
                    let weighted = terms.areas[texel] as f64 * share * b[i] as f64;
                    square.iter_mut().zip(b).for_each(|(sum, &b)| *sum += weighted * b as f64);
                    sums.iter_mut().zip(&of_row).for_each(|(sum, f)| *sum += weighted * f);
                }
            }
            for (l, share) in terms.anchors.of(texel).into_iter().filter(|a| a.1 > 0.0) {
                for (sums, square) in of_anchors.chunks_exact_mut(width).zip(square.chunks_exact(n)) {
                    sums[l * n..(l + 1) * n].iter_mut().zip(square).for_each(|(sum, v)| *sum += share as f64 * v);
                }
            }
        }
        copy_columns(normal, &of_anchors);
        copy_columns(right, &of_terms);
    });
    let trace: f64 = (0..width).map(|i| normal[(i, i)]).sum();
    let ridge = if trace > 0.0 { RIDGE * trace / width as f64 } else { 1.0 };
    let mut regular = normal.clone();
    (0..width).for_each(|i| regular[(i, i)] += ridge);
    // Positive definite by its ridge, but for numbers that are not finite, which the Gram matrix has refused.
    let frames = (regular.llt(Side::Lower))
        .map_or_else(|_| Mat::zeros(width, count), |cholesky| cholesky.solve(right.transpose()));
    (frames, normal)
}

/// Columns one after the other.
fn copy_columns(to: MatMut<f64>, from: &[f64]) {
    let height = to.nrows();
    to.col_iter_mut().zip(from.chunks_exact(height.max(1))).for_each(|(to, from)| {
        to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
    });
}

/// Divides each channel by its `size`. Returns the sizes.
fn scale_to(values: &mut [f32], n: usize, size: impl Fn(&mut dyn Iterator<Item = f32>) -> f64) -> Vec<f64> {
    let sizes: Vec<f64> = (0..n)
        .map(|j| match size(&mut values.iter().skip(j).step_by(n).copied()) {
            s if s > 0.0 => s,
            _ => 1.0,
        })
        .collect();
    for row in values.chunks_exact_mut(n) {
        row.iter_mut().zip(&sizes).for_each(|(v, s)| *v = (*v as f64 / s) as f32);
    }
    sizes
}
