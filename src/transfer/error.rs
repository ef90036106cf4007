//! How far a fit is from the truth on lights that it has never seen (METHOD eq. 9): per condition
//! sqrt(Σ a |i − î|²) / sqrt(Σ a |i|²) over texels (area a) and channels, and the same for the oracle, which is the true
//! lightmap projected on the basis.
//!
//! With î = U u the squared error is |i|² − 2 uᵀ Uᵀi + uᵀ UᵀU u, which needs inner products only.

use faer::Mat;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Gram;
use super::fit::{Fit, direct_vector, groups, product};
use crate::dataset::Dataset;

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
    let mut out = truth;
    for (j, &uj) in u.iter().enumerate() {
        out -= 2.0 * uj * projected[j];
        out += u.iter().enumerate().map(|(k, uk)| uj * uk * products[(j, k)]).sum::<f64>();
    }
    out
}
