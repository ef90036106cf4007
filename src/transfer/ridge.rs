//! Ridge regression from direct vectors to coefficients, for many λ at once (METHOD eq. 6; paper eq. 14).

use faer::{Mat, MatRef, Side};

use super::TransferError;

/// The thin SVD of a matrix D of direct vectors, D = W diag(s) Zᵀ, from which the ridge solution follows for any λ.
pub struct Ridge {
    /// `[row][r]`.
    left: Mat<f64>,
    singular_values: Vec<f64>,
    /// `[condition][r]`.
    right: Mat<f64>,
    /// trace(DDᵀ) over the number of rows: what λ is relative to.
    pub mean_square: f64,
}

/// Singular values below this share of the largest are rounding (the square root of f64's epsilon, since they come from
/// eigenvalues of a Gram matrix).
const RANK_TOLERANCE: f64 = 1.5e-8;

impl Ridge {
    /// `direct`: D, `[row][condition]`. Decomposes the smaller of DDᵀ and DᵀD.
    pub fn new(direct: MatRef<f64>) -> Result<Self, TransferError> {
        let (rows, conditions) = (direct.nrows(), direct.ncols());
        if !direct.is_all_finite() {
            return Err(TransferError::NotFinite { what: "direct light" });
        }
        let wide = rows <= conditions;
        let small = if wide { direct * direct.transpose() } else { direct.transpose() * direct };
        let (values, vectors) = eigen_descending(small.as_ref())?;
        let largest = values.first().copied().unwrap_or(0.0).max(0.0).sqrt();
        let singular_values: Vec<f64> =
            values.iter().map(|v| v.max(0.0).sqrt()).take_while(|&s| s > 0.0 && s > largest * RANK_TOLERANCE).collect();
        let kept = vectors.get(.., ..singular_values.len()).to_owned();
        let other = |product: Mat<f64>| {
            Mat::from_fn(product.nrows(), product.ncols(), |i, j| product[(i, j)] / singular_values[j])
        };
        let (left, right) = if wide {
            let right = other(direct.transpose() * &kept);
            (kept, right)
        } else {
            let left = other(direct * &kept);
            (left, kept)
        };
        let mean_square = values.iter().map(|v| v.max(0.0)).sum::<f64>() / rows.max(1) as f64;
        Ok(Self { left, singular_values, right, mean_square })
    }

    /// M = C (DᵀD + λI)⁻¹ Dᵀ for `coefficients` C, `[element][condition]`; λ absolute. Returns `[element][row]`.
    pub fn solve(&self, coefficients: MatRef<f64>, lambda: f64) -> Mat<f64> {
        let mut projected = coefficients * &self.right;
        for (j, &s) in self.singular_values.iter().enumerate() {
            let gain = s / (s * s + lambda);
            projected.col_mut(j).iter_mut().for_each(|x| *x *= gain);
        }
        projected * self.left.transpose()
    }

    /// Per condition, the sum over elements of the squared leave-one-out residual of C: what the fit without a condition is
    /// wrong by on that condition. With hat matrix H = Z diag(s²/(s² + λ)) Zᵀ it is (C − C H)ₖ / (1 − Hₖₖ), no refit needed
    /// (Allen's PRESS, 1974).
    pub fn leave_one_out(&self, coefficients: MatRef<f64>, lambda: f64) -> Vec<f64> {
        let mut shrunk = coefficients * &self.right;
        let shrink: Vec<f64> = self.singular_values.iter().map(|s| s * s / (s * s + lambda)).collect();
        for (j, f) in shrink.iter().enumerate() {
            shrunk.col_mut(j).iter_mut().for_each(|x| *x *= f);
        }
        let residual = coefficients - shrunk * self.right.transpose();
        (0..residual.ncols())
            .map(|k| {
                let leverage: f64 = shrink.iter().enumerate().map(|(j, f)| self.right[(k, j)].powi(2) * f).sum();
                // A condition that the fit reproduces whatever it is (leverage 1) has no leave-one-out residual to speak of;
                // it counts as a very bad one.
                let scale = 1.0 / (1.0 - leverage).max(1e-9);
                residual.col(k).squared_norm_l2() * scale * scale
            })
            .collect()
    }

    /// Rows of D: P, or 3 P for interleaved channels.
    pub fn rows(&self) -> usize {
        self.left.nrows()
    }

    /// Largest over smallest singular value of D: how ill-conditioned the points see the training conditions.
    pub fn condition_number(&self) -> f64 {
        match (self.singular_values.first(), self.singular_values.last()) {
            (Some(first), Some(last)) => first / last,
            _ => 1.0,
        }
    }
}

/// Eigenvalues of a symmetric matrix, largest first, and the eigenvectors as columns in the same order.
pub fn eigen_descending(symmetric: MatRef<f64>) -> Result<(Vec<f64>, Mat<f64>), TransferError> {
    let size = symmetric.nrows();
    if size == 0 {
        return Ok((Vec::new(), Mat::zeros(0, 0)));
    }
    let eigen = symmetric.self_adjoint_eigen(Side::Lower).map_err(|_| TransferError::NoConvergence { size })?;
    let (values, vectors) = (eigen.S().column_vector(), eigen.U());
    let descending = (0..size).rev().map(|i| values[i]).collect();
    Ok((descending, Mat::from_fn(size, size, |r, c| vectors[(r, size - 1 - c)])))
}
