//! Trains what tells a model's own lights from others ([`Scope`]; METHOD section 11): for each kind of light that the
//! scenario does not have a logistic regression on principal components, folded back to one weight per feature.

use faer::prelude::Solve;
use faer::{Mat, Side};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use super::TransferError;
use super::ridge::eigen_descending;
use crate::dataset::{Contrast, DirectVector};
use crate::math::Rgb;
use crate::model::scope::features;
use crate::model::{Scope, Separation};

/// Principal components that the classifiers work in. From 32 to 128 the separation is the same within its noise.
const COMPONENTS: usize = 64;

/// Vectors that the components are found from.
const SAMPLED: usize = 256;

/// Weight of the ridge, in units of vectors.
const RIDGE: f64 = 1.0;

/// Lights of a kind with fewer vectors than this cannot be told.
const LEAST: usize = 32;

/// Newton steps; they are quadratic near the end, and the ridge keeps them from running off.
const STEPS: usize = 20;

/// Share of the held-out lights that reads more than one half.
const FALSE_ALARMS: f64 = 0.05;

/// Vectors of all kinds together, about.
const VECTORS: u64 = 4_000;

/// Bytes of the vectors that a fit is given.
pub(super) fn vector_bytes(points: u64) -> u64 {
    VECTORS * points * 12
}

/// Bytes that a fit takes at most: what it is given, the components' Gram matrix with its eigenvectors, their copies and the
/// solver's own, the vectors' features and projections with what the allocator adds to each, and two classifiers at once, which
/// have copies of half of the projections.
pub(super) fn bytes_needed(points: u64) -> u64 {
    let (samples, projection) = (SAMPLED as u64, 8 * (COMPONENTS as u64 + 1));
    vector_bytes(points) + 5 * 8 * samples * samples + VECTORS * (points * 8 + 2 * projection + 3 * 48)
}

/// Fits a scope. `None` where there is nothing to tell apart.
///
/// # Errors
/// When an eigen-decomposition does not converge.
pub fn fit_scope(contrast: &Contrast, seed: u64) -> Result<Option<(Scope, Vec<Separation>)>, TransferError> {
    let of = |vectors: &[DirectVector]| -> Vec<Vec<f32>> { vectors.iter().filter_map(|x| features(x)).collect() };
    let mut own = of(&contrast.own);
    let held_out = of(&contrast.held_out);
    let others: Vec<(String, Vec<Vec<f32>>)> =
        contrast.others.iter().map(|(kind, x)| (kind.clone(), of(x))).filter(|(_, x)| x.len() >= LEAST).collect();
    if own.len() < LEAST || held_out.is_empty() || others.is_empty() {
        return Ok(None);
    }
    // Light adds: sums of seen lights are seen.
    own.extend(of(&sums(&contrast.own, seed)));
    // The last quarter of each kind is for the test.
    let fitted = |x: &[Vec<f32>]| x.len() - x.len() / 4;
    let all: Vec<&[f32]> =
        (own.iter().chain(others.iter().flat_map(|(_, x)| &x[..fitted(x)]))).map(|x| &x[..]).collect();
    let components = Components::of(&all)?;
    let own: Vec<Vec<f64>> = own.par_iter().map(|x| components.project(x)).collect();
    let rows: Vec<(Vec<f64>, f64)> = others
        .par_iter()
        .map(|(_, x)| {
            let other: Vec<Vec<f64>> = x[..fitted(x)].iter().map(|x| components.project(x)).collect();
            components.unfold(&logistic(&own, &other))
        })
        .collect();

    let logit = |x: &[f32]| -> f64 {
        let of = |(w, c): &(Vec<f64>, f64)| w.iter().zip(x).map(|(w, &x)| w * x as f64).sum::<f64>() + c;
        rows.iter().map(of).fold(f64::NEG_INFINITY, f64::max)
    };
    let mut seen: Vec<f64> = held_out.par_iter().map(|x| logit(x)).collect();
    seen.sort_by(f64::total_cmp);
    let limit = seen[((seen.len() as f64 * (1.0 - FALSE_ALARMS)) as usize).min(seen.len() - 1)];
    let separations = others
        .iter()
        .map(|(kind, x)| {
            let ranks = x[fitted(x)..].iter().map(|x| {
                let value = logit(x);
                let (below, not_above) = (seen.partition_point(|&s| s < value), seen.partition_point(|&s| s <= value));
                (below + not_above) as f64 / (2 * seen.len()) as f64
            });
            Separation { kind: kind.clone(), auc: ranks.sum::<f64>() / (x.len() - fitted(x)) as f64 }
        })
        .collect();
    let weights = rows.iter().flat_map(|(w, c)| {
        w.iter()
            .chain([c])
            .enumerate()
            .map(|(i, &v)| {
                // The constant is moved so that the limit reads one half.
                (if i == w.len() { v - limit } else { v }) as f32
            })
            .collect::<Vec<_>>()
    });
    let scope = Scope {
        weights: weights.collect(),
        kinds: others.into_iter().map(|(kind, _)| kind).collect(),
        points: contrast.own[0].len(),
    };
    Ok(Some((scope, separations)))
}

/// As many sums of two or three of the vectors, each with a random weight.
fn sums(own: &[DirectVector], seed: u64) -> Vec<DirectVector> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let lit: Vec<&DirectVector> = own.iter().filter(|x| x.iter().any(|v| v.element_sum() > 0.0)).collect();
    let sum = |_| {
        let mut sum = vec![Rgb::ZERO; own[0].len()];
        for _ in 0..rng.random_range(2..=3) {
            let x = lit[rng.random_range(0..lit.len())];
            let weight = rng.random::<f32>() / x.iter().map(|v| v.length_squared()).sum::<f32>().sqrt();
            sum.iter_mut().zip(x).for_each(|(sum, &x)| *sum += x * weight);
        }
        sum
    };
    if lit.is_empty() { Vec::new() } else { (0..own.len()).map(sum).collect() }
}

/// The first principal components of a set of vectors.
struct Components {
    mean: Vec<f64>,
    /// `[feature][component]`, unit variance.
    directions: Mat<f64>,
}

impl Components {
    fn of(vectors: &[&[f32]]) -> Result<Self, TransferError> {
        let sampled: Vec<&[f32]> =
            (0..SAMPLED.min(vectors.len())).map(|i| vectors[i * vectors.len() / SAMPLED.min(vectors.len())]).collect();
        let (features, n) = (sampled[0].len(), sampled.len());
        let mean: Vec<f64> =
            (0..features).map(|f| sampled.iter().map(|x| x[f] as f64).sum::<f64>() / n as f64).collect();
        let centred = Mat::from_fn(features, n, |f, i| sampled[i][f] as f64 - mean[f]);
        let (values, vectors) = eigen_descending((centred.transpose() * &centred).as_ref())?;
        // Components that carry nothing are left out.
        let count = values.iter().take(COMPONENTS).take_while(|&&v| v > values[0] * 1e-10 && v > 0.0).count();
        // U = A V / σ has unit length, and along it the vectors the variance σ²/n.
        let mut directions = &centred * vectors.get(.., ..count);
        for (j, &value) in values.iter().take(count).enumerate() {
            directions.col_mut(j).iter_mut().for_each(|v| *v *= (n as f64).sqrt() / value);
        }
        Ok(Self { mean, directions })
    }

    /// Coordinates of a vector, and 1.
    fn project(&self, x: &[f32]) -> Vec<f64> {
        let along = |j: usize| {
            let terms = self.directions.col(j).iter().zip(x).zip(&self.mean);
            terms.map(|((d, &x), m)| d * (x as f64 - m)).sum::<f64>()
        };
        (0..self.directions.ncols()).map(along).chain([1.0]).collect()
    }

    /// Weights of the features and a constant, from those of the coordinates.
    fn unfold(&self, weights: &[f64]) -> (Vec<f64>, f64) {
        let count = self.directions.ncols();
        let of = |f: usize| (0..count).map(|j| self.directions[(f, j)] * weights[j]).sum::<f64>();
        let features: Vec<f64> = (0..self.mean.len()).map(of).collect();
        let at_mean: f64 = features.iter().zip(&self.mean).map(|(w, m)| w * m).sum();
        (features, weights[count] - at_mean)
    }
}

/// Logistic regression of `ones` against `zeros`, both sides of equal weight, with a ridge on all but the last coordinate.
fn logistic(zeros: &[Vec<f64>], ones: &[Vec<f64>]) -> Vec<f64> {
    let size = zeros[0].len();
    let all = (zeros.len() + ones.len()) as f64;
    let samples = || {
        let of_zeros = zeros.iter().map(|x| (x, 0.0, all / (2 * zeros.len()) as f64));
        of_zeros.chain(ones.iter().map(|x| (x, 1.0, all / (2 * ones.len()) as f64)))
    };
    let mut weights = vec![0.0; size];
    for _ in 0..STEPS {
        let mut gradient = Mat::<f64>::zeros(size, 1);
        let mut hessian = Mat::<f64>::zeros(size, size);
        for (x, target, share) in samples() {
            let logit: f64 = weights.iter().zip(x).map(|(w, x)| w * x).sum();
            let p = 1.0 / (1.0 + (-logit).exp());
            let (slope, curvature) = (share * (p - target), share * p * (1.0 - p));
            for i in 0..size {
                gradient[(i, 0)] += slope * x[i];
                for j in 0..=i {
                    hessian[(i, j)] += curvature * x[i] * x[j];
                }
            }
        }
        for i in 0..size {
            // A little on the constant, too: with perfectly separate sides the curvature vanishes.
            let ridge = if i + 1 < size { RIDGE } else { 1e-9 * all };
            gradient[(i, 0)] += ridge * weights[i];
            hessian[(i, i)] += ridge;
        }
        let Ok(factor) = hessian.llt(Side::Lower) else { break };
        let step = factor.solve(&gradient);
        let length = step.norm_l2();
        weights.iter_mut().enumerate().for_each(|(i, w)| *w -= step[(i, 0)]);
        if length < 1e-8 {
            break;
        }
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bumps of a width and a random place on a line of points.
    fn bumps(width: f32, count: usize, seed: u64) -> Vec<DirectVector> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let bump = |_| {
            let (middle, height) = (rng.random::<f32>() * 40.0, rng.random::<f32>() + 0.1);
            (0..40).map(|p| Rgb::splat(height * (-((p as f32 - middle) / width).powi(2)).exp())).collect()
        };
        (0..count).map(bump).collect()
    }

    fn separation(other: Vec<DirectVector>) -> (Scope, f64) {
        let others = vec![("other".to_owned(), other)];
        let contrast = Contrast { own: bumps(3.0, 400, 1), held_out: bumps(3.0, 400, 2), others };
        let (scope, separation) = fit_scope(&contrast, 7).unwrap().unwrap();
        (scope, separation[0].auc)
    }

    /// Other shapes are told. Of the same shape nothing can be: the AUC of 100 against 400 has a standard error of at most
    /// sqrt((100 + 400 + 1) / (12 · 100 · 400)) = 0.032.
    #[test]
    fn other_shapes_are_told_and_equal_ones_are_not() {
        let (scope, auc) = separation(bumps(12.0, 400, 3));
        assert!(auc > 0.95, "{auc}");
        let (_, chance) = separation(bumps(3.0, 400, 4));
        assert!((chance - 0.5).abs() < 4.0 * 0.032, "{chance}");
        // Calibrated: one in twenty of held-out vectors reads over one half; of 400 others 20 ± 4.4 do.
        let novelty = |x: &DirectVector| scope.read(x).unwrap().novelty;
        let alarms = bumps(3.0, 400, 5).iter().filter(|x| novelty(x) > 0.5).count();
        // The limit is an estimate from as many.
        assert!((alarms as f64 - 20.0).abs() < 4.0 * 4.4 * 2f64.sqrt(), "{alarms}");
        // Sums of seen vectors are seen more often than not.
        let sums = sums(&bumps(3.0, 200, 6), 8);
        assert!(sums.iter().filter(|x| novelty(x) < 0.5).count() > sums.len() / 2);
    }

    #[test]
    fn too_little_gives_no_scope() {
        let contrast = |own: usize, others| Contrast { own: bumps(3.0, own, 1), held_out: bumps(3.0, 9, 2), others };
        let other = || vec![("other".to_owned(), bumps(9.0, 100, 3))];
        assert!(fit_scope(&contrast(4, other()), 1).unwrap().is_none());
        assert!(fit_scope(&contrast(100, Vec::new()), 1).unwrap().is_none());
        let dark = vec![("other".to_owned(), vec![vec![Rgb::ZERO; 40]; 100])];
        assert!(fit_scope(&contrast(100, dark), 1).unwrap().is_none());
    }
}
