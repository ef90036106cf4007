//! A fit on some of the training conditions, tested on others of them: what sizes are chosen by and what tells whether there
//! are enough points and conditions, so that the held-out lights have no part in any choice. All in the space of lightmap vectors.

use faer::Mat;
use rayon::prelude::*;

use super::fit::{Fit, choose_lambda, direct_vector, groups, product};
use super::ridge::Ridge;
use super::{Gram, TransferError};
use crate::dataset::Dataset;

/// Everything about a trial that does not depend on the measurement points.
pub struct Trial<'f> {
    fit: &'f Fit,
    /// Conditions that it is tested on.
    test: Vec<usize>,
    /// Per group of vectors, Uᵀ i of the weighted training vectors and of the test's: `[element][condition]`.
    coefficients: Vec<Mat<f64>>,
    truths: Vec<Mat<f64>>,
    /// Squared norm of each test condition's lightmap.
    norms: Vec<f64>,
}

/// Rows of coefficients that λ is chosen by: the first ones hold nearly all of the light.
const DECISIVE: usize = 32;

/// Conditions whose inner products with the basis are found at a time.
const AT_ONCE: usize = 64;

impl<'f> Trial<'f> {
    /// Tests `fit` on those conditions of `test` that are lit. Its elements must be orthonormal: those of
    /// [`super::Method::Belcour`] are not.
    pub fn of(fit: &'f Fit, gram: &Gram, test: impl IntoIterator<Item = usize>) -> Self {
        let test: Vec<usize> = test.into_iter().filter(|&t| gram.is_lit(t)).collect();
        let (channels, n) = (fit.settings.channels, fit.kept.len());
        let of = |g: usize, conditions: &[usize], weight: &(dyn Fn(usize) -> f64 + Sync)| {
            let (vectors, elements) = (fit.combination.nrows(), fit.combination.ncols());
            let mut out = Mat::zeros(elements, conditions.len());
            let parts: Vec<Mat<f64>> = (conditions.par_chunks(AT_ONCE).enumerate())
                .map(|(part, conditions)| {
                    let lit = Mat::from_fn(vectors, conditions.len(), |v, k| {
                        weight(part * AT_ONCE + k)
                            * product(gram, channels, (v / n, fit.kept[v % n]), (g, conditions[k]))
                    });
                    fit.combination.transpose() * lit
                })
                .collect();
            for (part, values) in parts.iter().enumerate() {
                out.subcols_mut(part * AT_ONCE, values.ncols()).copy_from(values);
            }
            out
        };
        let all = 0..groups(channels).len();
        let coefficients = all.clone().map(|g| of(g, &fit.kept, &|k| fit.weights[g * n + k])).collect();
        let truths = all.map(|g| of(g, &test, &|_| 1.0)).collect();
        let norms = test.iter().map(|&t| gram.squared_norm(t)).collect();
        Self { fit, test, coefficients, truths, norms }
    }

    /// Relative errors (METHOD eq. 9), `[elements − 1][test condition]`, where the light is measured as in `dataset`: that of the
    /// trial, or the same lights at other points.
    ///
    /// # Errors
    /// When D is not finite.
    pub fn errors(&self, dataset: &Dataset) -> Result<Vec<Vec<f64>>, TransferError> {
        let (fit, n) = (self.fit, self.fit.kept.len());
        let settings = fit.settings;
        let groups = groups(settings.channels);
        let ridges = (0..groups.len())
            .into_par_iter()
            .map(|g| Ridge::new(columns(dataset, groups[g], &fit.kept, &|k| fit.weights[g * n + k]).as_ref()));
        let ridges: Vec<Ridge> = ridges.collect::<Result<_, _>>()?;
        let decisive = DECISIVE.min(self.fit.combination.ncols());
        let absolute = choose_lambda(settings.lambda, &ridges, |g| self.coefficients[g].get(..decisive, ..));
        let matrices: Vec<Mat<f64>> = (ridges.par_iter().enumerate())
            .map(|(g, ridge)| ridge.solve(self.coefficients[g].as_ref(), absolute(ridge)))
            .collect();
        Ok(self.errors_of(dataset, &matrices))
    }

    /// Relative errors of the fit as it is, with what a prior told it.
    pub fn own_errors(&self, dataset: &Dataset) -> Vec<f64> {
        self.own_errors_by_elements(dataset).pop().unwrap_or_default()
    }

    /// The same of its first elements alone, `[elements − 1][test condition]`.
    pub fn own_errors_by_elements(&self, dataset: &Dataset) -> Vec<Vec<f64>> {
        self.errors_of(dataset, &self.fit.matrices)
    }

    /// The same of any transfer matrices, one a group of vectors.
    fn errors_of(&self, dataset: &Dataset, matrices: &[Mat<f64>]) -> Vec<Vec<f64>> {
        let groups = groups(self.fit.settings.channels);
        let elements = self.fit.combination.ncols();
        let mut squared = vec![self.norms.clone(); elements + 1];
        let predicted: Vec<Mat<f64>> = (matrices.par_iter().zip(groups))
            .map(|(matrix, group)| matrix * columns(dataset, group, &self.test, &|_| 1.0))
            .collect();
        // |i − U u|² = |i|² − Σⱼ (2 uⱼ cⱼ − uⱼ²), element by element.
        for j in 0..elements {
            for k in 0..self.test.len() {
                let gained = |(u, c): (&Mat<f64>, &Mat<f64>)| u[(j, k)] * (2.0 * c[(j, k)] - u[(j, k)]);
                squared[j + 1][k] = squared[j][k] - predicted.iter().zip(&self.truths).map(gained).sum::<f64>();
            }
        }
        let relative = |row: &Vec<f64>| row.iter().zip(&self.norms).map(|(e, n)| (e.max(0.0) / n).sqrt()).collect();
        squared[1..].iter().map(relative).collect()
    }
}

/// D of some conditions and a group of channels, each column times its weight.
fn columns(
    dataset: &Dataset,
    group: &[usize],
    conditions: &[usize],
    weight: &(dyn Fn(usize) -> f64 + Sync),
) -> Mat<f64> {
    let columns: Vec<Vec<f64>> = conditions.par_iter().map(|&c| direct_vector(dataset, group, c)).collect();
    let rows = columns.first().map_or(0, Vec::len);
    Mat::from_fn(rows, conditions.len(), |row, k| columns[k][row] * weight(k))
}
