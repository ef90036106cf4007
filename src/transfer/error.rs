//! How far a fit is from the truth on lights that it has never seen (METHOD eq. 9): per condition
//! sqrt(Σ a |i − î|²) / sqrt(Σ a |i|²) over texels (area a) and channels, and the same for the oracle, which is the true
//! lightmap projected on the basis.
//!
//! With î = U u the squared error is |i|² − 2 uᵀ Uᵀi + uᵀ UᵀU u, which needs inner products only. Those with a global basis
//! follow from the Gram matrix. A local basis is one of K n elements φₖ b that are not combinations of lightmaps: theirs take
//! one more look at the held-out ones.

use faer::linalg::solvers::{Llt, Solve};
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

/// What light is looked at: a weighted sum of conditions of a dataset.
#[derive(Clone, Debug, PartialEq)]
pub struct Probe {
    /// Condition and weight.
    pub parts: Vec<(usize, f64)>,
    /// Whether the lights shine at the same time. Otherwise each is reconstructed by itself, as the frames of an animation are,
    /// and what is looked at is the sum of the pictures: their difference where weights are 1 and −1.
    pub together: bool,
}

impl Probe {
    /// One condition.
    pub fn one(condition: usize) -> Self {
        Self { parts: vec![(condition, 1.0)], together: true }
    }

    /// What changes from one condition to another.
    pub fn change(from: usize, to: usize) -> Self {
        Self { parts: vec![(to, 1.0), (from, -1.0)], together: false }
    }
}

/// A reconstruction with its inner products with the lightmaps of the held-out conditions of a dataset, from which its error on
/// them and on their sums follows.
pub struct Tested<'t> {
    dataset: &'t Dataset,
    gram: &'t Gram,
    channels: Channels,
    /// UᵀU.
    products: Mat<f64>,
    /// Uᵀ i, `[group · H + condition]`, H conditions being held out.
    projections: Vec<Vec<f64>>,
    /// u of a group's direct vector.
    coefficients: Coefficients<'t>,
    oracle: Oracle,
}

/// From a group's direct vector to coefficients.
type Coefficients<'t> = Box<dyn Fn(usize, &[f64]) -> Vec<f64> + Sync + 't>;

/// How the coefficients nearest to a lightmap follow from its projections.
enum Oracle {
    /// Elements are orthonormal, but for the first where it is the mean, whose coefficient is given.
    Orthonormal {
        has_mean: bool,
    },
    Solve(Llt<f64>),
}

impl<'t> Tested<'t> {
    /// Of a global basis. The first conditions of `dataset` are those that `fit` was trained on.
    pub fn global(fit: &'t Fit, dataset: &'t Dataset, gram: &'t Gram) -> Self {
        let channels = fit.settings.channels;
        let held_out = dataset.held_out();
        let of = |i: usize| fit.project(gram, (i / held_out.len(), held_out.start + i % held_out.len()));
        Self {
            dataset,
            gram,
            channels,
            products: fit.element_products(gram),
            projections: (0..groups(channels).len() * held_out.len()).into_par_iter().map(of).collect(),
            coefficients: Box::new(|group, direct| fit.coefficients(group, direct)),
            oracle: Oracle::Orthonormal { has_mean: fit.has_mean() },
        }
    }

    /// Of a local basis, as it is stored, and its transfer.
    ///
    /// # Errors
    /// When the dataset cannot be read, or `progress` cancels.
    pub fn local(
        local: &'t LocalFit,
        terms: &Terms,
        channels: Channels,
        dataset: &'t Dataset,
        gram: &'t Gram,
        progress: &dyn Progress,
    ) -> Result<Self, TransferError> {
        // What the ridge leaves out of the oracle's projection is under 10⁻¹⁰ of the lightmap.
        let mut regular = local.products.clone();
        let width = regular.nrows();
        let trace: f64 = (0..width).map(|i| regular[(i, i)]).sum();
        let ridge = if trace > 0.0 { 1e-10 * trace / width as f64 } else { 1.0 };
        (0..width).for_each(|i| regular[(i, i)] += ridge);
        let cholesky = regular.llt(Side::Lower).map_err(|_| TransferError::NotFinite { what: "indirect light" })?;
        let coefficients = |group: usize, direct: &[f64]| -> Vec<f64> {
            (&local.matrices[group] * ColRef::from_slice(direct)).iter().copied().collect()
        };
        Ok(Self {
            dataset,
            gram,
            channels,
            products: local.products.clone(),
            projections: project(local, terms, channels, dataset, progress)?,
            coefficients: Box::new(coefficients),
            oracle: Oracle::Solve(cholesky),
        })
    }

    /// Held-out conditions that light the asset: of the others there is no relative error.
    pub fn lit(&self) -> Vec<usize> {
        self.dataset.held_out().filter(|&h| self.gram.is_lit(h)).collect()
    }

    /// |i − î|² and |i|² of a probe of held-out conditions.
    pub fn squared_error(&self, probe: &Probe) -> (f64, f64) {
        let (mut squared, mut norm) = (0.0, 0.0);
        for (g, group) in groups(self.channels).iter().enumerate() {
            let truth = self.truth(g, probe);
            let direct = |condition| direct_vector(self.dataset, group, condition);
            let u = if probe.together {
                (self.coefficients)(g, &sum_of(probe, direct))
            } else {
                sum_of(probe, |condition| (self.coefficients)(g, &direct(condition)))
            };
            squared += distance(truth, &self.projection(g, probe), &self.products, &u);
            norm += truth;
        }
        (squared.max(0.0), norm)
    }

    /// The same of the lightmap projected on the basis, for one condition: what no transfer can better.
    fn squared_oracle_error(&self, condition: usize) -> f64 {
        let probe = Probe::one(condition);
        let of_group = |g: usize| {
            let projected = self.projection(g, &probe);
            distance(self.truth(g, &probe), &projected, &self.products, &self.nearest(g, condition))
        };
        (0..groups(self.channels).len()).map(of_group).sum::<f64>().max(0.0)
    }

    /// Relative errors on all held-out conditions that are lit.
    pub fn errors(&self) -> HeldOutErrors {
        let errors = |&h: &usize| {
            let (squared, norm) = self.squared_error(&Probe::one(h));
            ((squared / norm).sqrt(), (self.squared_oracle_error(h) / norm).sqrt())
        };
        let (transfer, oracle) = self.lit().par_iter().map(errors).unzip();
        HeldOutErrors { transfer, oracle }
    }

    /// The coefficients that the direct light of a held-out condition gives, and those nearest to its lightmap, for each group.
    pub(super) fn coefficients_of(&self, condition: usize) -> [Vec<Vec<f64>>; 2] {
        let groups = groups(self.channels);
        let given = |group: &&[usize]| direct_vector(self.dataset, group, condition);
        let transferred = groups.iter().enumerate().map(|(g, group)| (self.coefficients)(g, &given(group))).collect();
        [transferred, (0..groups.len()).map(|g| self.nearest(g, condition)).collect()]
    }

    /// Coefficients of a lightmap projected on the basis.
    fn nearest(&self, group: usize, condition: usize) -> Vec<f64> {
        let projected = self.projection(group, &Probe::one(condition));
        match &self.oracle {
            Oracle::Solve(cholesky) => cholesky.solve(ColRef::from_slice(&projected)).iter().copied().collect(),
            Oracle::Orthonormal { has_mean: false } => projected,
            Oracle::Orthonormal { has_mean: true } => {
                let direct = direct_vector(self.dataset, groups(self.channels)[group], condition);
                let mean = (self.coefficients)(group, &direct)[0];
                let other = |j: usize| projected[j] - mean * self.products[(j, 0)];
                (0..projected.len()).map(|j| if j == 0 { mean } else { other(j) }).collect()
            }
        }
    }

    /// |i|² of a group of vectors.
    fn truth(&self, group: usize, probe: &Probe) -> f64 {
        let pairs = probe.parts.iter().flat_map(|&a| probe.parts.iter().map(move |&b| (a, b)));
        let product = |(a, b): ((usize, f64), (usize, f64))| {
            a.1 * b.1 * product(self.gram, self.channels, (group, a.0), (group, b.0))
        };
        pairs.map(product).sum()
    }

    /// Uᵀ i of a group of vectors.
    fn projection(&self, group: usize, probe: &Probe) -> Vec<f64> {
        let held_out = self.dataset.held_out();
        sum_of(probe, |condition| self.projections[group * held_out.len() + condition - held_out.start].clone())
    }
}

/// The weighted sum over a probe's conditions.
fn sum_of(probe: &Probe, of: impl Fn(usize) -> Vec<f64>) -> Vec<f64> {
    let weighted = |&(condition, weight): &(usize, f64)| of(condition).into_iter().map(|v| v * weight).collect();
    let add = |mut sum: Vec<f64>, part: Vec<f64>| {
        sum.iter_mut().zip(part).for_each(|(sum, v)| *sum += v);
        sum
    };
    probe.parts.iter().map(weighted).reduce(add).unwrap_or_default()
}

impl HeldOutErrors {
    /// Errors of `fit` on the held-out conditions of `dataset`. Conditions without any indirect light are left out.
    pub fn of(fit: &Fit, dataset: &Dataset, gram: &Gram) -> Self {
        Tested::global(fit, dataset, gram).errors()
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
        Ok(Tested::local(local, terms, channels, dataset, gram, progress)?.errors())
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
