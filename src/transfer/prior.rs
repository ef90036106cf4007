//! What the transfer matrix is expected to be before any lightmap is looked at (METHOD eq. 11): paths from the texels tell what each
//! sub-point's exitance does to each element of the basis, and direct light alone, of which there is plenty without a bake,
//! tells how the exitance of all sub-points follows from that of the points. The data then need only tell what is left.

use faer::linalg::matmul::matmul;
use faer::linalg::solvers::Solve;
use faer::{Accum, Mat, MatRef, Par, Side};
use rayon::prelude::*;

use super::fit::{Fit, choose_lambda, direct_vector, groups, leave_one_out, product};
use super::ridge::Ridge;
use super::{Gram, TransferError};
use crate::dataset::{Dataset, Measured};
use crate::math::Rgb;
use crate::progress::Progress;
use crate::transport::{Adjoint, Deposit};

/// An expected transfer matrix.
#[derive(Clone, Debug)]
pub struct Prior {
    /// Per group of vectors (R, G, B for mono; one for multi): `[element][row]`.
    matrices: Vec<Mat<f64>>,
}

/// A prior in the making: transfer from the sub-points, and sums over measured conditions.
pub struct PriorSums {
    groups: &'static [&'static [usize]],
    /// Per group, `[element][sub-point · channels of the group]`.
    from_sub_points: Vec<Mat<f64>>,
    /// Per group, Σ x xᵀ (the lower half) and Σ c xᵀ, with c the coefficients that the sub-points predict.
    squares: Vec<Mat<f64>>,
    products: Vec<Mat<f64>>,
}

/// What all conditions of a kind of light that is not the scenario's count together, relative to the scenario's own. With a
/// tenth the errors on the scenario's lights are those without other kinds, to a tenth of a point, and those on other kinds
/// nearly as low as with an equal share.
const FOREIGN: f64 = 0.1;

/// Ridge of the regression from points to sub-points, relative to trace(Σ x xᵀ).
const RIDGE: f64 = 1e-5;

/// How far above its kind's median a weighted direct vector may be, as in the fit itself.
const MOST_LEVERAGE: f64 = 8.0;

/// Bytes that a prior takes at most while it is made: the sums over texels and the matrices made of them, the deposits of a tile,
/// the sums over conditions with what solves them, and the conditions that are measured at once.
pub(super) fn bytes_needed(elements: u64, sub_points: u64, points: u64) -> u64 {
    let at_once = 64;
    let texels = crate::dataset::ROWS as u64 * sub_points * size_of::<(u32, Deposit)>() as u64;
    2 * 3 * 8 * sub_points * elements
        + texels
        + 3 * 8 * 3 * points * (3 * points + elements)
        + 3 * 8 * at_once * (2 * sub_points + 2 * points + elements)
}

/// Direct vectors, and the coefficients that sub-points predict for them.
type Pair = (Mat<f64>, Mat<f64>);

impl PriorSums {
    /// Carries the basis of `fit`, which has no mean, back along the paths of `adjoint`.
    ///
    /// # Errors
    /// When the dataset cannot be read, or `progress` cancels.
    pub fn new(
        fit: &Fit,
        dataset: &Dataset,
        adjoint: &Adjoint,
        progress: &dyn Progress,
    ) -> Result<Self, TransferError> {
        assert!(!fit.has_mean(), "a mean's coefficient is no linear function of direct light");
        let channels = fit.settings.channels;
        let (elements, components) = (fit.combination.ncols(), channels.components());
        let row = 3 * elements;
        let sub_points = adjoint.sub_points();
        // `[sub-point][channel][element]`.
        let mut sums = vec![0f64; sub_points * row];
        fit.for_each_expanded(fit.combination.as_ref(), dataset, progress, |texels, rows| {
            let found: Vec<Vec<Deposit>> =
                texels.clone().into_par_iter().map(|texel| adjoint.texel(texel, progress)).collect();
            let mut found: Vec<(usize, Deposit)> =
                found.into_iter().enumerate().flat_map(|(at, list)| list.into_iter().map(move |d| (at, d))).collect();
            // Stable: each sub-point's deposits stay in the order of the texels, whoever adds them up.
            found.sort_by_key(|(_, d)| d.sub_point);
            sums.par_chunks_mut(row).enumerate().for_each(|(sub_point, sums)| {
                let first = found.partition_point(|(_, d)| (d.sub_point as usize) < sub_point);
                let own = found[first..].iter().take_while(|(_, d)| d.sub_point as usize == sub_point);
                for (at, deposit) in own {
                    let weight = deposit.weight * dataset.texel_areas[texels.start + at];
                    let basis = &rows[at * components * elements..(at + 1) * components * elements];
                    add(sums, weight, basis, elements);
                }
            });
        })?;
        let groups = groups(channels);
        let from_sub_points = (groups.iter())
            .map(|group| {
                Mat::from_fn(elements, sub_points * group.len(), |j, at| {
                    sums[at / group.len() * row + group[at % group.len()] * elements + j]
                })
            })
            .collect();
        let zeros = |height: usize| (groups.iter()).map(|g| Mat::zeros(height, dataset.points() * g.len())).collect();
        let squares =
            (groups.iter()).map(|g| Mat::zeros(dataset.points() * g.len(), dataset.points() * g.len())).collect();
        Ok(Self { groups, from_sub_points, squares, products: zeros(elements) })
    }

    /// Adds conditions of a kind of light, each weighted as in the fit: by the inverse norm of the light that it is predicted to
    /// cause, bounded against the others that were measured with it.
    pub fn add(&mut self, measured: &Measured) {
        let n = measured.conditions;
        // Direct vectors, and the coefficients that the sub-points predict.
        let pairs: Vec<Pair> = (self.groups.par_iter().zip(&self.from_sub_points))
            .map(|(group, transfer)| {
                let direct = Mat::from_fn(measured.points.len() / (3 * n) * group.len(), n, |row, k| {
                    measured.points[row_of(group, row) * n + k] as f64
                });
                (direct, predicted(transfer, &measured.sub_points, group, n))
            })
            .collect();
        let norms: Vec<(f64, f64)> = (0..n)
            .map(|k| {
                let direct: f64 = pairs.iter().map(|(x, _)| x.col(k).squared_norm_l2()).sum();
                let predicted: f64 = pairs.iter().map(|(_, c)| c.col(k).squared_norm_l2()).sum();
                (direct.sqrt(), predicted.sqrt())
            })
            .collect();
        let mut leverages: Vec<f64> = norms.iter().filter(|n| n.0 > 0.0 && n.1 > 0.0).map(|n| n.0 / n.1).collect();
        if leverages.is_empty() {
            return;
        }
        leverages.sort_by(f64::total_cmp);
        let most = MOST_LEVERAGE * leverages[leverages.len() / 2];
        let share = if measured.foreign.is_none() { 1.0 } else { FOREIGN };
        let each = (share / measured.of_kind as f64).sqrt();
        let weight = |&(x, c): &(f64, f64)| if x > 0.0 && c > 0.0 { each * (1.0 / c).min(most / x) } else { 0.0 };
        let weights: Vec<f64> = norms.iter().map(weight).collect();
        let sums = self.squares.par_iter_mut().zip(&mut self.products);
        sums.zip(&pairs).for_each(|((squares, products), (direct, predicted))| {
            let weighted = |m: &Mat<f64>| Mat::from_fn(m.nrows(), m.ncols(), |r, k| m[(r, k)] * weights[k]);
            let direct = weighted(direct);
            add_product(squares, direct.as_ref(), direct.transpose(), true);
            add_product(products, weighted(predicted).as_ref(), direct.transpose(), false);
        });
    }

    /// The prior: what the points alone tell of the coefficients that all sub-points predict.
    ///
    /// # Errors
    /// [`TransferError::NotFinite`] when direct light is not finite.
    pub fn finish(self) -> Result<Prior, TransferError> {
        let solve = |(squares, products): (&Mat<f64>, &Mat<f64>)| -> Result<Mat<f64>, TransferError> {
            let trace: f64 = (0..squares.nrows()).map(|i| squares[(i, i)]).sum();
            let ridge = if trace > 0.0 { RIDGE * trace } else { 1.0 };
            let mut regular = squares.clone();
            (0..regular.nrows()).for_each(|i| regular[(i, i)] += ridge);
            let cholesky = regular.llt(Side::Lower).map_err(|_| TransferError::NotFinite { what: "direct light" })?;
            Ok(cholesky.solve(products.transpose()).transpose().to_owned())
        };
        let matrices = self.squares.par_iter().zip(&self.products).map(solve).collect::<Result<Vec<_>, _>>()?;
        Ok(Prior { matrices })
    }
}

/// Adds A B to `sum`; where it is symmetric, to its lower half alone.
fn add_product(sum: &mut Mat<f64>, a: MatRef<f64>, b: MatRef<f64>, symmetric: bool) {
    // Blocks of fixed size: the same sums on any number of threads.
    let blocks = sum.as_mut().par_col_chunks_mut(COLUMNS).zip(b.par_col_chunks(COLUMNS)).enumerate();
    blocks.for_each(|(block, (sum, b))| {
        let first = if symmetric { block * COLUMNS } else { 0 };
        let (rows, a) = (sum.nrows() - first, a.subrows(first, a.nrows() - first));
        matmul(sum.subrows_mut(first, rows), Accum::Add, a, b, 1.0, Par::Seq);
    });
}

/// Columns of a product that one thread makes at a time.
const COLUMNS: usize = 32;

/// The coefficients, `[element][condition]`, that sub-points' exitance, `[sub-point][channel][condition]`, predicts: `transfer`
/// times the rows of `group`.
fn predicted(transfer: &Mat<f64>, sub_points: &[f32], group: &[usize], n: usize) -> Mat<f64> {
    let mut coefficients = Mat::zeros(transfer.nrows(), n);
    coefficients.as_mut().par_col_chunks_mut(COLUMNS).enumerate().for_each(|(block, mut sum)| {
        let columns = block * COLUMNS..block * COLUMNS + sum.ncols();
        // A few rows at a time in double precision: all of them are megabytes.
        let mut doubles = Vec::with_capacity(ROWS * columns.len());
        for first in (0..transfer.ncols()).step_by(ROWS) {
            let count = ROWS.min(transfer.ncols() - first);
            doubles.clear();
            for row in first..first + count {
                let row = &sub_points[row_of(group, row) * n..][columns.clone()];
                doubles.extend(row.iter().map(|&x| x as f64));
            }
            let some = MatRef::from_row_major_slice(&doubles, count, columns.len());
            matmul(sum.as_mut(), Accum::Add, transfer.subcols(first, count), some, 1.0, Par::Seq);
        }
    });
    coefficients
}

/// Rows of a product's right side that are in double precision at once.
const ROWS: usize = 256;

/// Where a group's row stands among rows `[point][channel]`.
fn row_of(group: &[usize], row: usize) -> usize {
    row / group.len() * 3 + group[row % group.len()]
}

/// Adds `weight` times the elements at one texel, `[component][element]`, to a sub-point's sums, `[channel][element]`.
fn add(sums: &mut [f64], weight: Rgb, basis: &[f64], elements: usize) {
    for (channel, sums) in sums.chunks_exact_mut(elements).enumerate() {
        let component = if basis.len() == elements { 0 } else { channel };
        let weight = weight[channel] as f64;
        let basis = &basis[component * elements..(component + 1) * elements];
        sums.iter_mut().zip(basis).for_each(|(sum, b)| *sum += weight * b);
    }
}

impl Prior {
    /// The part for a basis of `elements` elements, which begins as the one that this was made for: zero where it has more.
    fn rows(&self, group: usize, elements: usize) -> Mat<f64> {
        let own = &self.matrices[group];
        Mat::from_fn(elements, own.ncols(), |j, r| if j < own.nrows() { own[(j, r)] } else { 0.0 })
    }

    /// What this one, made for the basis U of `of`, tells of the basis W of `other`: Wᵀ U M₀, as far as U spans W.
    pub(super) fn in_basis(&self, of: &Fit, other: &Fit, gram: &Gram) -> Self {
        let (n, m) = (of.kept.len(), other.kept.len());
        let (channels, elements) = (of.settings.channels, of.combination.ncols());
        let mut lit = Mat::<f64>::zeros(other.combination.nrows(), elements);
        for a in 0..lit.nrows() {
            let row = Mat::from_fn(1, of.combination.nrows(), |_, b| {
                product(gram, channels, (a / m, other.kept[a % m]), (b / n, of.kept[b % n]))
            });
            lit.row_mut(a).copy_from((row * &of.combination).row(0));
        }
        let turn = other.combination.transpose() * lit;
        Self { matrices: (0..self.matrices.len()).map(|g| &turn * self.rows(g, elements)).collect() }
    }
}

impl Fit {
    /// The fit to what `prior` leaves of the data, M = M₀ + (C − M₀ D) Dᵀ (DDᵀ + λ′)⁻¹, with a λ of its own, if its leave-one-out
    /// error is lower than this fit's; else this fit.
    ///
    /// # Errors
    /// When the direct light cannot be decomposed.
    pub fn with_prior(mut self, dataset: &Dataset, prior: &Prior) -> Result<Self, TransferError> {
        let n = self.kept.len();
        let elements = self.combination.ncols();
        let parts = groups(self.settings.channels)
            .par_iter()
            .enumerate()
            .map(|(g, group)| {
                let columns: Vec<Vec<f64>> = self.kept.iter().map(|&k| direct_vector(dataset, group, k)).collect();
                let direct = Mat::from_fn(columns[0].len(), n, |row, k| columns[k][row] * self.weights[g * n + k]);
                // C = Σ Vᵀ, from U = I V Σ⁻¹.
                let coefficients = Mat::from_fn(elements, n, |j, k| {
                    let v = g * n + k;
                    self.combination[(v, j)] * self.singular_values[j].powi(2) / self.weights[v]
                });
                let expected = prior.rows(g, elements);
                let residual = &coefficients - &expected * &direct;
                Ok((Ridge::new(direct.as_ref())?, coefficients, expected, residual))
            })
            .collect::<Result<Vec<_>, TransferError>>()?;
        let (ridges, parts): (Vec<Ridge>, Vec<[Mat<f64>; 3]>) =
            parts.into_iter().map(|(ridge, c, expected, residual)| (ridge, [c, expected, residual])).unzip();
        let residual_of = |g: usize| -> MatRef<f64> { parts[g][2].as_ref() };
        let plain = leave_one_out(&ridges, |g| parts[g][0].as_ref(), |r| self.lambda * r.mean_square);
        let lambda = choose_lambda(self.settings.lambda, &ridges, residual_of);
        let total = |errors: Vec<f64>| errors.into_iter().sum::<f64>();
        if total(leave_one_out(&ridges, residual_of, &lambda)) >= total(plain) {
            return Ok(self);
        }
        self.lambda = ridges.first().map_or(0.0, |r| lambda(r) / r.mean_square.max(f64::MIN_POSITIVE));
        self.matrices = (ridges.iter().zip(&parts))
            .map(|(ridge, [_, expected, residual])| expected + ridge.solve(residual.as_ref(), lambda(ridge)))
            .collect();
        self.prior = true;
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::dataset::Indirect;
    use crate::light::LightingCondition;
    use crate::model::Channels;
    use crate::progress::Silent;
    use crate::transfer::{Gram, HeldOutErrors, Lambda, Method, TrainSettings};

    const POINTS: usize = 12;
    const TEXELS: usize = 60;

    /// I = G D for a random G of full rank, `[texel][point]`, and random D.
    fn dataset(transport: &[Vec<f32>], training: usize) -> Dataset {
        let n = training + 6;
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let direct: Vec<f32> = (0..POINTS * 3 * n).map(|_| rng.random()).collect();
        let of = |row: &Vec<f32>, at: usize| (0..POINTS).map(|p| row[p] * direct[p * 3 * n + at]).sum::<f32>();
        let indirect =
            transport.iter().flat_map(|row| (0..3 * n).map(move |at| (row, at))).map(|(row, at)| of(row, at));
        Dataset {
            conditions: vec![LightingCondition::default(); n],
            training,
            indirect: Indirect::Memory(indirect.collect()),
            direct,
            texel_areas: (0..TEXELS).map(|_| 0.5 + rng.random::<f32>()).collect(),
            noise: vec![0.0; n],
        }
    }

    /// Uᵀ diag(a) G, for all channels.
    fn told_by(fit: &Fit, dataset: &Dataset, transport: &[Vec<f32>]) -> Prior {
        let mut matrix = Mat::zeros(fit.combination.ncols(), POINTS);
        fit.for_each_expanded(fit.combination.as_ref(), dataset, &Silent, |texels, rows| {
            for (texel, row) in texels.zip(rows.chunks_exact(fit.combination.ncols())) {
                let area = dataset.texel_areas[texel] as f64;
                matrix += Mat::from_fn(row.len(), POINTS, |j, p| row[j] * area * transport[texel][p] as f64);
            }
        })
        .unwrap();
        Prior { matrices: vec![matrix; 3] }
    }

    /// Eight conditions cannot tell what twelve points do, and the prior that is the transport itself leaves nothing to tell: the
    /// error falls to the rounding of the f32 data (1e-7) times the conditioning of D (under 1e3). A prior that tells another
    /// transport is not taken.
    #[test]
    fn a_true_prior_makes_few_conditions_enough_and_a_false_one_is_refused() {
        let mut rng = Pcg64Mcg::seed_from_u64(9);
        let mut transport = || -> Vec<Vec<f32>> {
            (0..TEXELS).map(|_| (0..POINTS).map(|_| rng.random::<f32>() - 0.5).collect()).collect()
        };
        let (true_one, false_one) = (transport(), transport());
        let dataset = dataset(&true_one, 8);
        let gram = Gram::of(&dataset, &Silent).unwrap();
        let (channels, lambda) = (Channels::Mono, Lambda::LeaveOneOut);
        // The three channels of 8 conditions are 24 vectors: a basis of as many has the rank of the transport.
        let settings = TrainSettings { method: Method::Local, channels, elements: 1, lambda };
        let fit = |prior: Option<&[Vec<f32>]>| {
            let plain = Fit::train(&dataset, &gram, settings).unwrap();
            match prior {
                Some(transport) => {
                    let prior = told_by(&plain, &dataset, transport);
                    plain.with_prior(&dataset, &prior).unwrap()
                }
                None => plain,
            }
        };
        let error = |fit: &Fit| HeldOutErrors::of(fit, &dataset, &gram).summary().worst;
        let (plain, told, lied_to) = (fit(None), fit(Some(&true_one)), fit(Some(&false_one)));
        assert!(told.prior && error(&told) < 1e-4, "{}", error(&told));
        assert!(error(&plain) > 0.1, "the control: {}", error(&plain));
        assert!(!lied_to.prior && lied_to.matrices == plain.matrices);
    }
}
