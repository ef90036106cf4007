//! Least squares of a handful of unknowns: one texel's channels.

use half::f16;

use super::local::Precision;
use crate::model::basis::scale_of;

/// min |F − b W|² = |F|² + b G b − 2 b r, with G = W Wᵀ and r = W F, for each component of a texel.
pub struct Small {
    n: usize,
    /// G, `[i][j]`.
    pub matrix: Vec<f64>,
    /// r, `[component][i]`.
    pub right: Vec<f64>,
    /// b, `[component][i]`.
    pub solution: Vec<f64>,
    factor: Vec<f64>,
}

/// Ridge, relative to the mean of G's diagonal.
pub const RIDGE: f64 = 1e-6;

/// Sweeps over a texel's channels when they are rounded.
const SWEEPS: usize = 2;

impl Small {
    pub fn new(n: usize, components: usize) -> Self {
        let (square, rows) = (vec![0.0; n * n], vec![0.0; components * n]);
        Self { n, matrix: square.clone(), right: rows.clone(), solution: rows, factor: square }
    }

    /// Solves (G + ridge) b = r by Cholesky's decomposition; zeros where G is zero.
    pub fn solve(&mut self) {
        let (n, added) = (self.n, self.added());
        if added <= 0.0 {
            self.solution.fill(0.0);
            return;
        }
        let l = &mut self.factor;
        for i in 0..n {
            for j in 0..=i {
                let known: f64 = (0..j).map(|k| l[i * n + k] * l[j * n + k]).sum();
                let value = self.matrix[i * n + j] - known;
                l[i * n + j] = if i == j {
                    // Not under the ridge but for rounding.
                    (value + added).max(added * 0.5).sqrt()
                } else {
                    value / l[j * n + j]
                };
            }
        }
        for (x, right) in self.solution.chunks_exact_mut(n).zip(self.right.chunks_exact(n)) {
            for i in 0..n {
                let known: f64 = (0..i).map(|k| l[i * n + k] * x[k]).sum();
                x[i] = (right[i] - known) / l[i * n + i];
            }
            for i in (0..n).rev() {
                let known: f64 = (i + 1..n).map(|k| l[k * n + i] * x[k]).sum();
                x[i] = (x[i] - known) / l[i * n + i];
            }
        }
    }

    fn added(&self) -> f64 {
        RIDGE * (0..self.n).map(|i| self.matrix[i * self.n + i]).sum::<f64>() / self.n as f64
    }

    /// Puts the solution as it is stored in `out`, and returns the code of the scale that it is stored by ([`scale_of`]). With 8
    /// bits each channel is rounded, and then, in turn, moved to the code that is best with the others as they are.
    pub fn store(&self, precision: Precision, out: &mut [f32]) -> u8 {
        if precision == Precision::Half {
            out.iter_mut().zip(&self.solution).for_each(|(out, &b)| *out = f16::from_f64(b).to_f32());
            return u8::MAX;
        }
        let (n, added) = (self.n, self.added());
        let peak = self.solution.iter().fold(0f64, |peak, b| peak.max(b.abs()));
        let scale_code = (255.0 + 16.0 * peak.log2()).ceil().clamp(0.0, 255.0) as u8;
        let step = scale_of(scale_code) as f64 / 127.0;
        let rounded = |b: f64| ((b / step).round().clamp(-127.0, 127.0) * step) as f32;
        out.iter_mut().zip(&self.solution).for_each(|(out, &b)| *out = rounded(b));
        for (b, right) in out.chunks_exact_mut(n).zip(self.right.chunks_exact(n)) {
            for _ in 0..SWEEPS {
                for i in 0..n {
                    let others: f64 = (0..n).filter(|&j| j != i).map(|j| self.matrix[i * n + j] * b[j] as f64).sum();
                    let diagonal = self.matrix[i * n + i] + added;
                    if diagonal > 0.0 {
                        b[i] = rounded((right[i] - others) / diagonal);
                    }
                }
            }
        }
        scale_code
    }

    /// b G b − 2 b r: what |F − b W|² is more than |F|².
    pub fn change_of_loss(&self, b: &[f32]) -> f64 {
        let n = self.n;
        let of_component = |(b, right): (&[f32], &[f64])| -> f64 {
            let image = |i: usize| (0..n).map(|j| self.matrix[i * n + j] * b[j] as f64).sum::<f64>();
            (0..n).map(|i| b[i] as f64 * (image(i) - 2.0 * right[i])).sum()
        };
        b.chunks_exact(n).zip(self.right.chunks_exact(n)).map(of_component).sum()
    }
}

/// Inner product, in lanes that a vector register holds.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 8;
    let mut sums = [0f64; LANES];
    let (a_lanes, b_lanes) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f64 = a_lanes.remainder().iter().zip(b_lanes.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a_lanes.zip(b_lanes) {
        (0..LANES).for_each(|i| sums[i] += a[i] * b[i]);
    }
    sums.iter().sum::<f64>() + rest
}
