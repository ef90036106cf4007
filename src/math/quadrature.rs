//! Exact integration of polynomials: over an interval (Gauss–Legendre) and over the sphere.

use std::f64::consts::{PI, TAU};

use glam::Vec3;

/// Nodes in (−1, 1) and weights that integrate polynomials of degree 2n − 1 exactly. Newton's method on the Legendre
/// polynomial Pₙ from Tricomi's estimate of its roots (Press et al., *Numerical Recipes*, section 4.6).
pub fn gauss_legendre(n: usize) -> Vec<(f64, f64)> {
    (0..n)
        .map(|i| {
            let mut x = (PI * (i as f64 + 0.75) / (n as f64 + 0.5)).cos();
            let mut slope = 1.0;
            // Converges quadratically; the estimate is good to a few digits.
            for _ in 0..8 {
                let (mut p, mut previous) = (1.0, 0.0);
                for k in 0..n {
                    let k = k as f64;
                    (p, previous) = (((2.0 * k + 1.0) * x * p - k * previous) / (k + 1.0), p);
                }
                slope = n as f64 * (x * p - previous) / (x * x - 1.0);
                x -= p / slope;
            }
            (x, 2.0 / ((1.0 - x * x) * slope * slope))
        })
        .collect()
}

/// Unit vectors and solid angles (steradians, 4π in all) that integrate polynomials of degree 2n − 1 over the sphere exactly.
pub fn sphere(n: usize) -> Vec<(Vec3, f64)> {
    let mut points = Vec::with_capacity(2 * n * n);
    for (z, weight) in gauss_legendre(n) {
        let r = (1.0 - z * z).sqrt();
        for i in 0..2 * n {
            let phi = TAU * (i as f64 + 0.5) / (2 * n) as f64;
            let direction = Vec3::new((r * phi.cos()) as f32, (r * phi.sin()) as f32, z as f32);
            points.push((direction, weight * TAU / (2 * n) as f64));
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ∫₋₁¹ xᵏ dx = 2/(k+1) for even k, 0 for odd, up to degree 2n − 1; degree 2n is the control that fails.
    #[test]
    fn gauss_legendre_is_exact_to_its_degree() {
        for n in 1..=16usize {
            let integral = |k: usize| gauss_legendre(n).iter().map(|(x, w)| w * x.powi(k as i32)).sum::<f64>();
            for k in 0..2 * n {
                let exact = if k % 2 == 0 { 2.0 / (k as f64 + 1.0) } else { 0.0 };
                assert!((integral(k) - exact).abs() < 1e-13, "n = {n}, k = {k}");
            }
            assert!(n > 8 || (integral(2 * n) - 2.0 / (2 * n + 1) as f64).abs() > 1e-9);
        }
    }
}
