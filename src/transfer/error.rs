//! How far a fit is from the truth on lights that it has never seen (METHOD eq. 9): per condition
//! sqrt(Σ a |i − î|²) / sqrt(Σ a |i|²) over texels (area a) and channels, and the same for the oracle, which is the true
//! lightmap projected on the basis.
//!
//! With î = U u the squared error is |i|² − 2 uᵀ Uᵀi + uᵀ UᵀU u, which needs inner products only. Those with a global basis
//! follow from the Gram matrix. A local basis is one of K n elements φₖ b that are not combinations of lightmaps: theirs take
//! one more look at the held-out ones.

use faer::linalg::solvers::Solve;
use faer::{ColRef, Mat, Side};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::fit::{Fit, direct_vector, groups, product};
use super::local::{LocalFit, Terms};
use super::{Gram, TransferError};
use crate::dataset::Dataset;
use crate::model::Channels;
use crate::progress::Progress;

/// Relative RMSE per held-out condition, as fractions.
#[derive(Clone, Debug, PartialEq)]
pub struct HeldOutErrors {
    pub transfer: Vec<f64>,
    pub oracle: Vec<f64>,
}

/// Figures over conditions, as fractions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ErrorSummary {
    pub mean: f64,
    pub median: f64,
    pub worst: f64,
    pub oracle_mean: f64,
}

impl HeldOutErrors {
    /// Errors of `fit` on the held-out conditions of `dataset`. Conditions without any indirect light are left out.
    pub fn of(fit: &Fit, dataset: &Dataset, gram: &Gram) -> Self {
        let products = fit.element_products(gram);
        let conditions: Vec<usize> = dataset.held_out().filter(|&h| gram.is_lit(h)).collect();
        let (transfer, oracle) = conditions.par_iter().map(|&h| errors_of(fit, dataset, gram, &products, h)).unzip();
        Self { transfer, oracle }
    }

    /// Errors of a local basis, as it is stored, and its transfer.
    ///
    /// # Errors
    /// When the dataset cannot be read, or `progress` cancels.
    pub fn of_local(
        local: &LocalFit,
        terms: &Terms,
        channels: Channels,
        dataset: &Dataset,
        gram: &Gram,
        progress: &dyn Progress,
    ) -> Result<Self, TransferError> {
        let projections = project(local, terms, channels, dataset, progress)?;
        // What the ridge leaves out of the oracle's projection is under 10⁻¹⁰ of the lightmap.
        let mut regular = local.products.clone();
        let width = regular.nrows();
        let trace: f64 = (0..width).map(|i| regular[(i, i)]).sum();
        let ridge = if trace > 0.0 { 1e-10 * trace / width as f64 } else { 1.0 };
        (0..width).for_each(|i| regular[(i, i)] += ridge);
        let cholesky = regular.llt(Side::Lower).map_err(|_| TransferError::NotFinite { what: "indirect light" })?;
        let conditions: Vec<usize> = dataset.held_out().filter(|&h| gram.is_lit(h)).collect();
        let errors = |&h: &usize| {
            let (mut squared, mut oracle_squared) = (0.0, 0.0);
            for (g, group) in groups(channels).iter().enumerate() {
                let truth = product(gram, channels, (g, h), (g, h));
                let projected = &projections[g * dataset.held_out().len() + h - dataset.training];
                let direct = direct_vector(dataset, group, h);
                let u: Vec<f64> = (&local.matrices[g] * ColRef::from_slice(&direct)).iter().copied().collect();
                squared += distance(truth, projected, &local.products, &u);
                let best: Vec<f64> = cholesky.solve(ColRef::from_slice(projected)).iter().copied().collect();
                oracle_squared += distance(truth, projected, &local.products, &best);
            }
            let norm = gram.squared_norm(h);
            ((squared.max(0.0) / norm).sqrt(), (oracle_squared.max(0.0) / norm).sqrt())
        };
        let (transfer, oracle) = conditions.par_iter().map(errors).unzip();
        Ok(Self { transfer, oracle })
    }

    pub fn summary(&self) -> ErrorSummary {
        let (mean, median, worst) = mean_median_worst(&self.transfer);
        ErrorSummary { mean, median, worst, oracle_mean: mean_median_worst(&self.oracle).0 }
    }
}

/// Mean, median and largest of `values`; zeros for none.
pub fn mean_median_worst(values: &[f64]) -> (f64, f64, f64) {
    if values.is_empty() {
        return (0.0, 0.0, 0.0);
    }
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    let median = (sorted[(n - 1) / 2] + sorted[n / 2]) / 2.0;
    (values.iter().sum::<f64>() / n as f64, median, sorted[n - 1])
}

/// Relative errors (transfer, oracle) on condition `h`.
fn errors_of(fit: &Fit, dataset: &Dataset, gram: &Gram, products: &Mat<f64>, h: usize) -> (f64, f64) {
    let channels = fit.settings.channels;
    let (mut squared, mut oracle_squared) = (0.0, 0.0);
    for (g, group) in groups(channels).iter().enumerate() {
        let truth = product(gram, channels, (g, h), (g, h));
        let projected = fit.project(gram, (g, h));
        let direct = direct_vector(dataset, group, h);
        let u = fit.coefficients(g, &direct);
        squared += distance(truth, &projected, products, &u);
        // The oracle's coefficients: projections on the orthonormal elements; the mean is not a free one.
        let mean = if fit.has_mean() { Some(u[0]) } else { None };
        let best: Vec<f64> = (0..u.len())
            .map(|j| match mean {
                Some(mean) if j == 0 => mean,
                Some(mean) => projected[j] - mean * products[(j, 0)],
                None => projected[j],
            })
            .collect();
        oracle_squared += distance(truth, &projected, products, &best);
    }
    let norm = gram.squared_norm(h);
    ((squared.max(0.0) / norm).sqrt(), (oracle_squared.max(0.0) / norm).sqrt())
}

/// |i − U u|².
fn distance(truth: f64, projected: &[f64], products: &Mat<f64>, u: &[f64]) -> f64 {
    let image = products * ColRef::from_slice(u);
    truth + u.iter().enumerate().map(|(j, &uj)| uj * (image[j] - 2.0 * projected[j])).sum::<f64>()
}

/// Held-out conditions that one task projects.
const TOGETHER: usize = 32;

/// Inner products of every element of a local basis with each held-out lightmap, weighted by area: `[group · H + condition]`, H
/// conditions being held out.
fn project(
    local: &LocalFit,
    terms: &Terms,
    channels: Channels,
    dataset: &Dataset,
    progress: &dyn Progress,
) -> Result<Vec<Vec<f64>>, TransferError> {
    let (held_out, n) = (dataset.held_out(), dataset.conditions.len());
    let groups = groups(channels);
    let width = local.products.nrows();
    // Each task has some conditions of one group: their sums, `[element][condition]`, are its own.
    let firsts = || held_out.clone().step_by(TOGETHER).map(|first| first..(first + TOGETHER).min(held_out.end));
    let mut tasks: Vec<(usize, std::ops::Range<usize>, Vec<f64>)> = (0..groups.len())
        .flat_map(|g| firsts().map(move |conditions| (g, conditions)))
        .map(|(g, conditions)| (g, conditions.clone(), vec![0.0; width * conditions.len()]))
        .collect();
    progress.begin("held out", dataset.texels() as u64, "texels");
    let walked = dataset.for_each_rows(progress, |texels, rows| {
        tasks.par_iter_mut().for_each(|(g, conditions, sums)| {
            for (texel, row) in texels.clone().zip(rows.chunks_exact(3 * n)) {
                let area = dataset.texel_areas[texel] as f64;
                for (component, &channel) in groups[*g].iter().enumerate() {
                    let lightmaps = &row[channel * n + conditions.start..channel * n + conditions.end];
                    for (element, value) in local.elements_at(terms, texel, component) {
                        let sums = &mut sums[element * lightmaps.len()..(element + 1) * lightmaps.len()];
                        let weighted = area * value;
                        sums.iter_mut().zip(lightmaps).for_each(|(sum, &i)| *sum += weighted * i as f64);
                    }
                }
            }
        });
    });
    progress.end();
    walked?;
    let columns = tasks.iter().flat_map(|(_, conditions, sums)| {
        let count = conditions.len();
        (0..count).map(move |c| sums.iter().skip(c).step_by(count).copied().collect())
    });
    Ok(columns.collect())
}
