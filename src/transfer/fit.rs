//! The ways to train a global basis (METHOD section 4).
//!
//! - [`Method::Belcour`]: Belcour et al. 2022, section 4, as published. Each pair is divided by the norm of its direct vector,
//!   the mean is subtracted, and the mean counts as one of the n elements; at run time it is scaled by ‖x‖.
//! - [`Method::Linear`]: light transport is linear, and ‖x‖ is not. No mean; each condition is weighted by 1/‖i‖, so that the
//!   fit minimises the relative error that is reported; λ by leave-one-out.
//! - [`Method::Local`] starts as `Linear` does, with as many terms as tell; [`super::local`] goes on from there.

use std::ops::Range;

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::ridge::{Ridge, eigen_descending};
use super::{Gram, TransferError};
use crate::dataset::{Dataset, DatasetError, ROWS};
use crate::model::{Channels, Transfer};
use crate::progress::Progress;

/// How basis and transfer are fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Method {
    Belcour,
    Linear,
    Local,
}

impl Method {
    /// Its name in settings and tables.
    pub fn name(self) -> &'static str {
        match self {
            Method::Belcour => "belcour",
            Method::Linear => "linear",
            Method::Local => "local",
        }
    }
}

/// Terms of the global basis that a local one is fitted to. Measured at P = 512, N = 512, K = 256: twice as many change the error
/// from 6.47 to 6.50 % (cornell), 24.7 to 24.2 % (interior) and not at all (statue).
pub const LOCAL_TERMS: usize = 192;

/// How λ is chosen. Relative values are in units of trace(DDᵀ)/P, D as it is weighted for the fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Lambda {
    /// The largest relative value whose leave-one-out error is the least there is, within its standard error.
    LeaveOneOut,
    Relative(f64),
    /// In units of D itself. With `Method::Belcour` direct vectors have unit norm, as in the paper.
    Absolute(f64),
}

/// The paper's λ (its figure 7), for direct vectors of unit norm.
pub const PUBLISHED_LAMBDA: Lambda = Lambda::Absolute(0.01);

/// Leave-one-out on noisy data can prefer λ = 0; this share of trace(DDᵀ) keeps light kinds never trained on from blowing up.
const LEAVE_ONE_OUT_FLOOR: f64 = 1e-5;

/// What to fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainSettings {
    pub method: Method,
    pub channels: Channels,
    /// n; the mean counts as one for [`Method::Belcour`]; channels a texel for [`Method::Local`].
    pub elements: usize,
    pub lambda: Lambda,
}

/// What fits of all sizes and λ to the same weighted vectors have in common: their decompositions.
pub struct Spectrum {
    channels: Channels,
    /// Whether the mean was subtracted.
    centred: bool,
    /// Training conditions, and those that were kept.
    all: usize,
    kept: Vec<usize>,
    weights: Vec<f64>,
    /// What each vector counts in the mean.
    share: Vec<f64>,
    /// Of the lightmaps, largest first, and what of each vector they are made of.
    singular_values: Vec<f64>,
    vectors: Mat<f64>,
    /// Of the direct vectors, one a group.
    ridges: Vec<Ridge>,
}

/// A fitted basis and transfer, in the space of training vectors.
#[derive(Clone)]
pub struct Fit {
    pub settings: TrainSettings,
    /// The relative λ that was used.
    pub lambda: f64,
    /// Conditions left out because their light missed every measurement point or the whole lightmap.
    pub dropped: usize,
    /// Of the basis that the first n were taken from, largest first.
    pub singular_values: Vec<f64>,
    /// Whether M is what a [`super::Prior`] tells and the data add to it.
    pub prior: bool,
    /// Condition number of the weighted D, the largest over the channels.
    pub condition_number: f64,
    /// U = V · combination, with V the lightmaps of the training vectors: `[vector][element]`.
    pub(super) combination: Mat<f64>,
    /// Training conditions that were kept.
    pub(super) kept: Vec<usize>,
    /// Of each training vector: what multiplies both its direct vector and its lightmap.
    pub(super) weights: Vec<f64>,
    /// Per group of vectors (R, G, B for mono; one for multi), M: `[element][row]`.
    pub(super) matrices: Vec<Mat<f64>>,
}

/// The vectors that a fit works on: for mono one group a channel, for multi one group of interleaved vectors.
pub(super) fn groups(channels: Channels) -> &'static [&'static [usize]] {
    match channels {
        Channels::Mono => &[&[0], &[1], &[2]],
        Channels::Multi => &[&[0, 1, 2]],
    }
}

/// Direct vector of `group` for one condition, channels interleaved as `[point][channel of the group]`.
pub(super) fn direct_vector(dataset: &Dataset, group: &[usize], condition: usize) -> Vec<f64> {
    let columns: Vec<Vec<f64>> = group.iter().map(|&c| dataset.direct_column(c, condition)).collect();
    (0..dataset.points()).flat_map(|p| columns.iter().map(move |column| column[p])).collect()
}

/// Inner product of the lightmap vectors of `a` and `b`, each (group, condition). Vectors of different channels of a mono
/// basis have one, too, since the channels share their texels.
pub(super) fn product(gram: &Gram, channels: Channels, a: (usize, usize), b: (usize, usize)) -> f64 {
    match channels {
        Channels::Mono => gram.product(a, b),
        Channels::Multi => (0..3).map(|c| gram.product((c, a.1), (c, b.1))).sum(),
    }
}

impl Spectrum {
    /// Decomposes the training conditions of `dataset` for fits of the given method (those of [`Method::Linear`] and
    /// [`Method::Local`] are the same), and of as many elements at least.
    ///
    /// # Errors
    /// [`TransferError::TooFewConditions`] when fewer conditions than basis elements are usable.
    pub fn of(dataset: &Dataset, gram: &Gram, settings: TrainSettings) -> Result<Self, TransferError> {
        Self::of_some(dataset, gram, 0..dataset.training, settings)
    }

    /// The same of some of the training conditions.
    ///
    /// # Errors
    /// As [`Self::of`].
    pub fn of_some(
        dataset: &Dataset,
        gram: &Gram,
        conditions: impl IntoIterator<Item = usize>,
        settings: TrainSettings,
    ) -> Result<Self, TransferError> {
        let TrainSettings { method, channels, elements, .. } = settings;
        let groups = groups(channels);
        let lit = |condition: &usize| {
            let seen = groups.iter().any(|group| direct_vector(dataset, group, *condition).iter().any(|&x| x != 0.0));
            seen && gram.is_lit(*condition)
        };
        let conditions: Vec<usize> = conditions.into_iter().collect();
        let all = conditions.len();
        let kept: Vec<usize> = conditions.into_iter().filter(lit).collect();
        if kept.len() < elements.max(1) {
            return Err(TransferError::TooFewConditions { kept: kept.len(), all, elements });
        }
        let n = kept.len();
        let direct: Vec<Mat<f64>> = groups
            .iter()
            .map(|group| {
                let columns: Vec<Vec<f64>> = kept.par_iter().map(|&k| direct_vector(dataset, group, k)).collect();
                Mat::from_fn(columns[0].len(), n, |row, k| columns[k][row])
            })
            .collect();

        // Vector v = group · n + k. Its weight multiplies both its direct vector and its lightmap.
        let norms: Vec<f64> = (0..groups.len() * n).map(|v| direct[v / n].col(v % n).norm_l2()).collect();
        let weights: Vec<f64> = match method {
            Method::Linear | Method::Local => {
                let of_condition = relative_weights(&kept, gram, &norms);
                (0..norms.len()).map(|v| of_condition[v % n]).collect()
            }
            // A channel without light has no pair to learn from.
            Method::Belcour => norms.iter().map(|&norm| if norm > 0.0 { 1.0 / norm } else { 0.0 }).collect(),
        };
        let used = weights.iter().filter(|&&w| w > 0.0).count();

        // Columns of `centring` map weighted vectors to the vectors that the SVD is taken of: I, or I − 1 1ᵀ/N where the mean
        // is subtracted.
        let weighted_gram = Mat::from_fn(weights.len(), weights.len(), |a, b| {
            weights[a] * weights[b] * product(gram, channels, (a / n, kept[a % n]), (b / n, kept[b % n]))
        });
        let centred = method == Method::Belcour;
        let share_of = |&weight: &f64| if centred && weight > 0.0 { 1.0 / used as f64 } else { 0.0 };
        let share: Vec<f64> = weights.iter().map(share_of).collect();
        let of_svd = if centred { centre(weighted_gram.as_ref(), &|v| share[v]) } else { weighted_gram };
        let (values, vectors) = eigen_descending(of_svd.as_ref())?;
        let singular_values: Vec<f64> = values.iter().map(|v| v.max(0.0).sqrt()).collect();
        let ridges = direct
            .par_iter()
            .enumerate()
            .map(|(g, d)| {
                let weighted = Mat::from_fn(d.nrows(), n, |row, k| d[(row, k)] * weights[g * n + k]);
                Ridge::new(weighted.as_ref())
            })
            .collect::<Result<Vec<Ridge>, _>>()?;
        Ok(Self { channels, centred, all, kept, weights, share, singular_values, vectors, ridges })
    }

    /// Of the lightmaps, largest first.
    pub fn singular_values(&self) -> &[f64] {
        &self.singular_values
    }

    /// Fits basis and transfer matrix. Of `settings` the elements and λ count, and whether the basis is to become local.
    ///
    /// # Errors
    /// [`TransferError::TooFewConditions`] when fewer conditions than basis elements are usable.
    pub fn fit(&self, settings: TrainSettings) -> Result<Fit, TransferError> {
        let Self { centred, all, kept, weights, share, singular_values, vectors, ridges, .. } = self;
        let TrainSettings { method, elements, lambda, .. } = settings;
        let n = kept.len();
        if n < elements.max(1) {
            return Err(TransferError::TooFewConditions { kept: n, all: *all, elements });
        }
        let used = weights.iter().filter(|&&w| w > 0.0).count();
        let elements = if method == Method::Local { used.min(LOCAL_TERMS) } else { elements };

        // Elements of the SVD, after the mean if there is one. Where the data have lower rank the rest stay zero.
        let first = usize::from(*centred);
        let rank = singular_values.iter().take_while(|&&s| s > singular_values[0] * 1e-7 && s > 0.0).count();
        let spectral = elements.saturating_sub(first).min(rank);
        let mut combination = Mat::<f64>::zeros(weights.len(), elements);
        if *centred {
            (0..weights.len()).for_each(|v| combination[(v, 0)] = weights[v] * share[v]);
        }
        for j in 0..spectral {
            let mean: f64 = (0..weights.len()).filter(|&v| share[v] > 0.0).map(|v| vectors[(v, j)]).sum();
            for v in 0..weights.len() {
                let centred = vectors[(v, j)] - mean * share[v];
                combination[(v, first + j)] = weights[v] * centred / singular_values[j];
            }
        }
        // C = Uᵀ I = Σ Vᵀ, with a zero row for the mean: its coefficient is not fitted.
        let coefficients = Mat::from_fn(elements, weights.len(), |j, v| {
            if j < first || j >= first + spectral { 0.0 } else { singular_values[j - first] * vectors[(v, j - first)] }
        });

        let of_group = |g: usize| coefficients.as_ref().subcols(g * n, n);
        let relative = choose_lambda(lambda, ridges, of_group);
        let matrices = ridges.iter().enumerate().map(|(g, r)| r.solve(of_group(g), relative(r))).collect();
        Ok(Fit {
            settings: TrainSettings { channels: self.channels, ..settings },
            lambda: ridges.first().map_or(0.0, |r| relative(r) / r.mean_square.max(f64::MIN_POSITIVE)),
            dropped: all - n,
            singular_values: singular_values.clone(),
            prior: false,
            condition_number: ridges.iter().map(Ridge::condition_number).fold(1.0, f64::max),
            combination,
            kept: kept.clone(),
            weights: weights.clone(),
            matrices,
        })
    }
}

impl Fit {
    /// Fits basis and transfer matrix to the training conditions of `dataset`.
    ///
    /// # Errors
    /// [`TransferError::TooFewConditions`] when fewer conditions than basis elements are usable.
    pub fn train(dataset: &Dataset, gram: &Gram, settings: TrainSettings) -> Result<Self, TransferError> {
        Spectrum::of(dataset, gram, settings)?.fit(settings)
    }

    /// The same, on some of the training conditions.
    ///
    /// # Errors
    /// As [`Self::train`].
    pub fn train_on(
        dataset: &Dataset,
        gram: &Gram,
        conditions: impl IntoIterator<Item = usize>,
        settings: TrainSettings,
    ) -> Result<Self, TransferError> {
        Spectrum::of_some(dataset, gram, conditions, settings)?.fit(settings)
    }

    /// Whether element 0 is the mean, scaled by ‖x‖.
    pub fn has_mean(&self) -> bool {
        self.settings.method == Method::Belcour
    }

    /// u = M x for one group's direct vector.
    pub(super) fn coefficients(&self, group: usize, direct: &[f64]) -> Vec<f64> {
        let x = faer::ColRef::from_slice(direct);
        let u = &self.matrices[group] * x;
        let mut u: Vec<f64> = u.iter().copied().collect();
        if self.has_mean() {
            u[0] = x.norm_l2();
        }
        u
    }

    /// Inner products of every element with the lightmap of (group, condition): `Uᵀ i`.
    pub(super) fn project(&self, gram: &Gram, target: (usize, usize)) -> Vec<f64> {
        let n = self.kept.len();
        let mut out = vec![0.0; self.combination.ncols()];
        for v in 0..self.combination.nrows() {
            let p = product(gram, self.settings.channels, (v / n, self.kept[v % n]), target);
            out.iter_mut().enumerate().for_each(|(j, out)| *out += self.combination[(v, j)] * p);
        }
        out
    }

    /// UᵀU: the identity, but for the mean's row and column.
    pub(super) fn element_products(&self, gram: &Gram) -> Mat<f64> {
        // A row of the Gram matrix at a time: a copy of all that are kept would be as large as the matrix itself.
        let (n, channels, vectors) = (self.kept.len(), self.settings.channels, self.combination.nrows());
        let mut lit = Mat::<f64>::zeros(vectors, self.combination.ncols());
        for a in 0..vectors {
            let row = Mat::from_fn(1, vectors, |_, b| {
                product(gram, channels, (a / n, self.kept[a % n]), (b / n, self.kept[b % n]))
            });
            lit.row_mut(a).copy_from((row * &self.combination).row(0));
        }
        self.combination.transpose() * lit
    }

    /// The basis over texels, `[element][component][texel]`, and the transfer to go with it. Elements are scaled to a largest
    /// magnitude of 1, which suits half floats, and the transfer's rows by the inverse.
    ///
    /// # Errors
    /// When the dataset cannot be read, or `progress` cancels.
    pub fn expand(&self, dataset: &Dataset, progress: &dyn Progress) -> Result<(Vec<f32>, Transfer), DatasetError> {
        let mut values = self.basis_values(dataset, progress)?;
        let elements = self.combination.ncols();
        let mut scales = vec![1.0; elements];
        let plane = values.len() / elements.max(1);
        // The mean keeps its scale: its coefficient is ‖x‖ itself.
        for j in usize::from(self.has_mean())..elements {
            let peak = values[j * plane..(j + 1) * plane].iter().fold(0f32, |m, v| m.max(v.abs()));
            if peak > 0.0 {
                scales[j] = peak as f64;
            }
        }
        for (element, &scale) in values.chunks_mut(plane.max(1)).zip(&scales) {
            element.iter_mut().for_each(|v| *v = (*v as f64 / scale) as f32);
        }
        let row_major = |m: &Mat<f64>| -> Vec<f32> {
            (0..m.nrows())
                .flat_map(|r| (0..m.ncols()).map(move |c| (m[(r, c)], r)))
                .map(|(v, r)| (v * scales[r]) as f32)
                .collect()
        };
        let transfer = Transfer {
            channels: self.settings.channels,
            elements,
            points: dataset.points(),
            matrices: self.matrices.iter().map(row_major).collect(),
            mean_scaled_by_norm: self.has_mean(),
            gamma: 1.0,
        };
        Ok((values, transfer))
    }

    /// U over texels: `[element][component][texel]`.
    pub(super) fn basis_values(&self, dataset: &Dataset, progress: &dyn Progress) -> Result<Vec<f32>, DatasetError> {
        let (texels, elements) = (dataset.texels(), self.combination.ncols());
        let components = self.settings.channels.components();
        let mut values = vec![0f32; texels * elements * components];
        self.for_each_expanded(self.combination.as_ref(), dataset, progress, |range, rows| {
            for (plane, at) in values.chunks_mut(texels.max(1)).zip(0..) {
                let (element, component) = (at / components, at % components);
                let of_texel = rows.iter().skip(component * elements + element).step_by(components * elements);
                plane[range.clone()].iter_mut().zip(of_texel).for_each(|(v, &row)| *v = row as f32);
            }
        })?;
        Ok(values)
    }

    /// Hands V · `combination` to `visit`, some texels at a time: their range and `[texel][component][column]`.
    pub(super) fn for_each_expanded(
        &self,
        combination: MatRef<f64>,
        dataset: &Dataset,
        progress: &dyn Progress,
        mut visit: impl FnMut(Range<usize>, &[f64]),
    ) -> Result<(), DatasetError> {
        let (conditions, vectors, columns) = (dataset.conditions.len(), combination.nrows(), combination.ncols());
        let components = self.settings.channels.components();
        // Row-major, as the rows of I are.
        let weights: Vec<f64> = (0..vectors).flat_map(|v| (0..columns).map(move |j| combination[(v, j)])).collect();
        let weights = MatRef::from_row_major_slice(&weights, vectors, columns);
        let mut lightmaps = vec![0f64; ROWS * components * vectors];
        let mut out = vec![0f64; ROWS * components * columns];
        progress.begin("basis", dataset.texels() as u64, "texels");
        let walked = dataset.for_each_rows(progress, |range, rows| {
            let count = range.len() * components;
            // Blocks of fixed size: the same sums on any number of threads.
            let blocks = lightmaps[..count * vectors].par_chunks_mut(BLOCK * vectors);
            let outs = out[..count * columns].par_chunks_mut((BLOCK * columns).max(1));
            blocks.zip(outs).enumerate().for_each(|(b, (block, out))| {
                for (i, row) in block.chunks_exact_mut(vectors).enumerate() {
                    let (texel, component) = ((b * BLOCK + i) / components, (b * BLOCK + i) % components);
                    let texel = &rows[texel * 3 * conditions..(texel + 1) * 3 * conditions];
                    // Mono: one row of all channels' vectors; multi: a row for each channel.
                    for (group, vectors) in row.chunks_exact_mut(self.kept.len()).enumerate() {
                        let channel = &texel[(group + component) * conditions..];
                        vectors.iter_mut().zip(&self.kept).for_each(|(v, &condition)| *v = channel[condition] as f64);
                    }
                }
                let height = block.len() / vectors;
                let lightmaps = MatRef::from_row_major_slice(block, height, vectors);
                let out = MatMut::from_row_major_slice_mut(out, height, columns);
                matmul(out, Accum::Replace, lightmaps, weights, 1.0, Par::Seq);
            });
            visit(range, &out[..count * columns]);
        });
        progress.end();
        walked
    }

    /// Covariance, over the weighted training vectors, of the coefficients that the direct light predicts: Σ M D Dᵀ Mᵀ.
    pub(super) fn predicted_covariance(&self, dataset: &Dataset) -> Mat<f64> {
        let (terms, n) = (self.combination.ncols(), self.kept.len());
        let mut covariance = Mat::zeros(terms, terms);
        for (g, (group, matrix)) in groups(self.settings.channels).iter().zip(&self.matrices).enumerate() {
            let columns: Vec<Vec<f64>> = self.kept.par_iter().map(|&k| direct_vector(dataset, group, k)).collect();
            let direct = Mat::from_fn(matrix.ncols(), n, |row, k| columns[k][row] * self.weights[g * n + k]);
            let predicted = matrix * direct;
            covariance += &predicted * predicted.transpose();
        }
        covariance
    }

    /// M of a group of vectors (R, G, B for mono; one for multi): `[element][row]`.
    pub(super) fn matrices(&self) -> &[Mat<f64>] {
        &self.matrices
    }
}

/// Rows of lightmaps that one thread multiplies at a time.
const BLOCK: usize = 64;

/// How far above the median a condition's weighted direct vector may be.
const MOST_LEVERAGE: f64 = 8.0;

/// Weights 1/‖i‖, so that the fit minimises the relative error, but bounded: a condition that lights the points well and the
/// lightmap hardly at all (a sun on a roof) would otherwise outweigh all others together. `norms` are those of the direct
/// vectors, `[group][condition]`.
fn relative_weights(kept: &[usize], gram: &Gram, norms: &[f64]) -> Vec<f64> {
    let n = kept.len();
    let direct_norm = |k: usize| (0..norms.len() / n).map(|g| norms[g * n + k].powi(2)).sum::<f64>().sqrt();
    let relative: Vec<f64> = kept.iter().map(|&condition| 1.0 / gram.squared_norm(condition).sqrt()).collect();
    let mut leverages: Vec<f64> = (0..n).map(|k| relative[k] * direct_norm(k)).collect();
    leverages.sort_by(f64::total_cmp);
    let most = MOST_LEVERAGE * leverages[n / 2];
    (0..n).map(|k| relative[k].min(most / direct_norm(k))).collect()
}

/// Gram matrix after the mean of the vectors (those with a share) is subtracted from each of them: J G Jᵀ with J = 1 − 1 shareᵀ.
fn centre(gram: MatRef<f64>, share: &dyn Fn(usize) -> f64) -> Mat<f64> {
    let size = gram.nrows();
    let with_mean: Vec<f64> = (0..size).map(|a| (0..size).map(|b| gram[(a, b)] * share(b)).sum()).collect();
    let mean_square: f64 = (0..size).map(|a| with_mean[a] * share(a)).sum();
    Mat::from_fn(size, size, |a, b| {
        // A vector that is not used stays zero.
        if share(a) == 0.0 || share(b) == 0.0 { 0.0 } else { gram[(a, b)] - with_mean[a] - with_mean[b] + mean_square }
    })
}

/// Squared leave-one-out residual of each condition, all groups together.
pub(super) fn leave_one_out<'c>(
    ridges: &[Ridge],
    coefficients: impl Fn(usize) -> MatRef<'c, f64>,
    lambda: impl Fn(&Ridge) -> f64,
) -> Vec<f64> {
    let of_group = ridges.iter().enumerate().map(|(g, r)| r.leave_one_out(coefficients(g), lambda(r)));
    let add = |mut sum: Vec<f64>, part: Vec<f64>| {
        sum.iter_mut().zip(part).for_each(|(sum, v)| *sum += v);
        sum
    };
    of_group.reduce(add).unwrap_or_default()
}

/// The largest λ whose leave-one-out error is above the least one by no more than its standard error, that of the difference
/// over conditions. `errors` are those of rising λ. Where few conditions tell little of λ the matrix stays small: lights that
/// are like none of them are then not blown up.
fn largest_as_good(errors: &[Vec<f64>]) -> usize {
    let total = |e: &Vec<f64>| e.iter().sum::<f64>();
    let best = (0..errors.len()).min_by(|&a, &b| total(&errors[a]).total_cmp(&total(&errors[b]))).unwrap_or(0);
    let as_good = |i: &usize| {
        let n = errors[*i].len() as f64;
        let worse: Vec<f64> = errors[*i].iter().zip(&errors[best]).map(|(a, b)| a - b).collect();
        let mean = worse.iter().sum::<f64>() / n;
        let variance = worse.iter().map(|w| (w - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        mean <= (variance / n).sqrt()
    };
    (best..errors.len()).rev().find(as_good).unwrap_or(best)
}

/// Absolute λ for each group's ridge.
pub(super) fn choose_lambda<'c>(
    lambda: Lambda,
    ridges: &[Ridge],
    coefficients: impl Fn(usize) -> MatRef<'c, f64> + Sync,
) -> impl Fn(&Ridge) -> f64 {
    let relative = match lambda {
        Lambda::Relative(value) => value,
        Lambda::Absolute(_) => 0.0,
        Lambda::LeaveOneOut => {
            let rows = ridges.iter().map(|r| r.rows()).max().unwrap_or(1) as f64;
            let floor = LEAVE_ONE_OUT_FLOOR * rows;
            // Four values a decade: the error is flat around its minimum.
            let candidates: Vec<f64> = (0..=24).map(|i| floor * 10f64.powf(i as f64 / 4.0)).collect();
            let errors: Vec<Vec<f64>> = candidates
                .par_iter()
                .map(|&value| leave_one_out(ridges, &coefficients, |r| value * r.mean_square))
                .collect();
            candidates[largest_as_good(&errors)]
        }
    };
    move |ridge| match lambda {
        Lambda::Absolute(value) => value,
        _ => relative * ridge.mean_square,
    }
}
