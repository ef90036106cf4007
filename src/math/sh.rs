//! Real spherical harmonics, for light and its transfer (Ramamoorthi and Hanrahan, *An Efficient Representation for
//! Irradiance Environment Maps*, 2001; Sloan, *Stupid Spherical Harmonics (SH) Tricks*, 2008).
//!
//! Order n has the bands l = 0 … n − 1 and n² functions; Y_lm is at index l(l+1) + m. The functions are orthonormal over
//! the sphere, z is their axis, and the sign is positive (no Condon–Shortley phase): Y₁ = √(3/4π) (y, z, x).

use std::sync::LazyLock;

use glam::{Mat3, Vec3};

use super::{Rgb, quadrature};

/// Greatest order that is supported.
pub const MAX_ORDER: usize = 8;

/// Functions of [`MAX_ORDER`].
pub const MAX_COUNT: usize = count(MAX_ORDER);

/// Functions of an order: n².
pub const fn count(order: usize) -> usize {
    order * order
}

/// The order that has `count` functions, if one does.
pub fn order_of(count: usize) -> Option<usize> {
    (1..=MAX_ORDER).find(|order| order * order == count)
}

/// Where band l starts and ends among the functions.
const fn band(l: usize) -> std::ops::Range<usize> {
    l * l..(l + 1) * (l + 1)
}

/// Factors of the recurrence for normalised associated Legendre functions over sinᵐ θ.
struct Recurrence {
    /// P(m, m), with √2 for m > 0 included.
    diagonal: [f32; MAX_ORDER],
    /// P(l, m) = a z P(l−1, m) − b P(l−2, m): `[l][m]`.
    factors: [[[f32; 2]; MAX_ORDER]; MAX_ORDER],
}

static RECURRENCE: LazyLock<Recurrence> = LazyLock::new(|| {
    let mut r = Recurrence { diagonal: [0.0; MAX_ORDER], factors: [[[0.0; 2]; MAX_ORDER]; MAX_ORDER] };
    // P(0,0) = 1/√4π; P(m,m) = √((2m+1)/2m) P(m−1,m−1); the step from m = 0 to 1 brings √2 in.
    let mut diagonal = (0.25 / std::f64::consts::PI).sqrt();
    for m in 0..MAX_ORDER {
        if m > 0 {
            let m = m as f64;
            diagonal *= ((2.0 * m + 1.0) / (2.0 * m)).sqrt() * if m == 1.0 { 2f64.sqrt() } else { 1.0 };
        }
        r.diagonal[m] = diagonal as f32;
        for l in m + 1..MAX_ORDER {
            let (l2, m2, k2) = ((l * l) as f64, (m * m) as f64, ((l - 1) * (l - 1)) as f64);
            let a = ((4.0 * l2 - 1.0) / (l2 - m2)).sqrt();
            let b = a * ((k2 - m2) / (4.0 * k2 - 1.0)).sqrt();
            r.factors[l][m] = [a as f32, b as f32];
        }
    }
    r
});

/// Y_j(`direction`) for all functions of `order` ≤ [`MAX_ORDER`]; `direction` is a unit vector.
#[inline]
pub fn evaluate(order: usize, direction: Vec3) -> [f32; MAX_COUNT] {
    let mut y = [0f32; MAX_COUNT];
    let r = &*RECURRENCE;
    // cos mφ sinᵐ θ and sin mφ sinᵐ θ are the parts of (x + iy)ᵐ.
    let (mut cos, mut sin) = (1f32, 0f32);
    for m in 0..order {
        let (mut p, mut previous) = (r.diagonal[m], 0f32);
        for l in m..order {
            if l > m {
                let [a, b] = r.factors[l][m];
                (p, previous) = (a * direction.z * p - b * previous, p);
            }
            let centre = l * (l + 1);
            y[centre - m] = p * sin;
            y[centre + m] = p * cos;
        }
        (cos, sin) = (direction.x * cos - direction.y * sin, direction.x * sin + direction.y * cos);
    }
    y
}

/// A_l: what the clamped cosine multiplies band l with, so that irradiance = Σ A_l L_lm Y_lm(normal): π, 2π/3, π/4, 0,
/// −π/24, … (Ramamoorthi and Hanrahan 2001, eq. 8).
pub fn cosine_lobe(l: usize) -> f32 {
    use std::f64::consts::PI;
    match l {
        0 => PI as f32,
        1 => (2.0 * PI / 3.0) as f32,
        _ if l % 2 == 1 => 0.0,
        _ => {
            // l! / (2ˡ (l/2)!²) is the product of (2k−1)/2k.
            let ratio: f64 = (1..=l / 2).map(|k| (2 * k - 1) as f64 / (2 * k) as f64).product();
            let sign = if l / 2 % 2 == 1 { 1.0 } else { -1.0 };
            (sign * 2.0 * PI * ratio / ((l + 2) * (l - 1)) as f64) as f32
        }
    }
}

/// Adds light of the given irradiance (on a surface that faces it) from the one direction `towards` the light. The length
/// of `coefficients` is that of an order.
pub fn add_directional(coefficients: &mut [Rgb], towards: Vec3, irradiance: Rgb) {
    let order = order_of(coefficients.len()).unwrap_or(0);
    // The projection of a delta function is the value of each basis function at it.
    let y = evaluate(order, towards);
    for (c, y) in coefficients.iter_mut().zip(y) {
        *c += irradiance * y;
    }
}

/// Irradiance on an unshadowed surface with `normal` under light with these coefficients.
pub fn irradiance(coefficients: &[Rgb], normal: Vec3) -> Rgb {
    let order = order_of(coefficients.len()).unwrap_or(0);
    let y = evaluate(order, normal);
    let of_band = |l: usize| band(l).map(|j| coefficients[j] * y[j]).sum::<Rgb>() * cosine_lobe(l);
    (0..order).map(of_band).sum()
}

/// Turns functions on the sphere, band by band.
pub struct Rotation {
    /// Per band, (2l+1)², row after row.
    bands: Vec<Vec<f32>>,
}

impl Rotation {
    /// The matrices of ∫ Y_i(R ω) Y_j(ω) dω for `turned_from_original` R, by quadrature that is exact for these
    /// polynomials.
    pub fn new(order: usize, turned_from_original: Mat3) -> Self {
        let mut bands: Vec<Vec<f64>> = (0..order).map(|l| vec![0.0; (2 * l + 1) * (2 * l + 1)]).collect();
        for (direction, weight) in quadrature::sphere(order.max(1)) {
            let y = evaluate(order, direction);
            let turned = evaluate(order, turned_from_original * direction);
            for (l, matrix) in bands.iter_mut().enumerate() {
                for (row, i) in band(l).enumerate() {
                    for (column, j) in band(l).enumerate() {
                        matrix[row * (2 * l + 1) + column] += weight * turned[i] as f64 * y[j] as f64;
                    }
                }
            }
        }
        Self { bands: bands.into_iter().map(|m| m.into_iter().map(|x| x as f32).collect()).collect() }
    }

    /// Coefficients of the function f(R⁻¹ω) from those of f(ω), of this rotation's order.
    pub fn apply(&self, coefficients: &[Rgb]) -> Vec<Rgb> {
        let mut turned = Vec::with_capacity(coefficients.len());
        for (l, matrix) in self.bands.iter().enumerate() {
            let original = &coefficients[band(l)];
            turned.extend(
                matrix.chunks_exact(2 * l + 1).map(|row| row.iter().zip(original).map(|(m, c)| *c * *m).sum::<Rgb>()),
            );
        }
        turned
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::PI;

    const DIRECTIONS: [Vec3; 4] = [Vec3::Z, Vec3::NEG_X, Vec3::new(0.48, -0.6, 0.64), Vec3::new(-0.36, 0.48, -0.8)];

    /// ∫ Y_i Y_j = δ_ij; the integrand has degree 2·7, the quadrature is exact to 2·8 − 1.
    #[test]
    fn harmonics_are_orthonormal() {
        let mut gram = vec![0f64; MAX_COUNT * MAX_COUNT];
        for (direction, weight) in quadrature::sphere(MAX_ORDER) {
            let y = evaluate(MAX_ORDER, direction);
            for i in 0..MAX_COUNT {
                for j in 0..MAX_COUNT {
                    gram[i * MAX_COUNT + j] += weight * (y[i] * y[j]) as f64;
                }
            }
        }
        for i in 0..MAX_COUNT {
            for j in 0..MAX_COUNT {
                let expected = if i == j { 1.0 } else { 0.0 };
                // f32 rounding of sums of 128 terms of order one.
                assert!((gram[i * MAX_COUNT + j] - expected).abs() < 2e-6, "({i}, {j})");
            }
        }
    }

    /// The published polynomials of bands 0 to 2 (Ramamoorthi and Hanrahan 2001, eq. 3).
    #[test]
    fn low_bands_are_the_published_polynomials() {
        for d in DIRECTIONS {
            let y = evaluate(3, d);
            let expected = [
                0.282_095,
                0.488_603 * d.y,
                0.488_603 * d.z,
                0.488_603 * d.x,
                1.092_548 * d.x * d.y,
                1.092_548 * d.y * d.z,
                0.315_392 * (3.0 * d.z * d.z - 1.0),
                1.092_548 * d.x * d.z,
                0.546_274 * (d.x * d.x - d.y * d.y),
            ];
            for (y, expected) in y.iter().zip(expected) {
                assert!((y - expected).abs() < 2e-6, "{d}: {y} for {expected}");
            }
        }
    }

    /// Addition theorem: Σ_m Y_lm(a) Y_lm(b) = (2l+1)/4π P_l(a·b).
    #[test]
    fn bands_satisfy_the_addition_theorem() {
        for a in DIRECTIONS {
            for b in DIRECTIONS {
                let (ya, yb) = (evaluate(MAX_ORDER, a), evaluate(MAX_ORDER, b));
                let (mut p, mut previous) = (1f32, 0f32);
                for l in 0..MAX_ORDER {
                    let sum: f32 = band(l).map(|j| ya[j] * yb[j]).sum();
                    assert!((sum - (2 * l + 1) as f32 / (4.0 * PI) * p).abs() < 5e-6, "band {l} of {a}, {b}");
                    let k = l as f32;
                    (p, previous) = (((2.0 * k + 1.0) * a.dot(b) * p - k * previous) / (k + 1.0), p);
                }
            }
        }
    }

    /// A_l = 2π ∫₀¹ P_l(x) x dx, by Gauss–Legendre on [0, 1]; and the values that are known by heart.
    #[test]
    fn cosine_lobe_is_the_integral_of_legendre_times_cosine() {
        for l in 0..12 {
            let integral: f64 = quadrature::gauss_legendre(12)
                .iter()
                .map(|(x, w)| {
                    let x = 0.5 * (x + 1.0);
                    let (mut p, mut previous) = (1.0, 0.0);
                    for k in 0..l {
                        let k = k as f64;
                        (p, previous) = (((2.0 * k + 1.0) * x * p - k * previous) / (k + 1.0), p);
                    }
                    0.5 * w * p * x
                })
                .sum();
            assert!((cosine_lobe(l) as f64 - std::f64::consts::TAU * integral).abs() < 1e-6, "A_{l}");
        }
        for (l, known) in [PI, 2.0 * PI / 3.0, PI / 4.0, 0.0, -PI / 24.0, 0.0, PI / 64.0].into_iter().enumerate() {
            assert!((cosine_lobe(l) - known).abs() < 1e-6, "A_{l}");
        }
    }

    /// The truncated clamped cosine Σ A_l (2l+1)/4π P_l(cos θ) is off most at the horizon, where bands 0, 2, 4, 6 leave
    /// 1/4, 3/32, 15/256, 175/4096.
    #[test]
    fn irradiance_of_a_directional_light_is_the_truncated_clamped_cosine() {
        let towards = DIRECTIONS[2];
        for (order, at_horizon) in [(1, 1.0 / 4.0), (3, 3.0 / 32.0), (5, 15.0 / 256.0), (7, 175.0 / 4096.0)] {
            let mut light = vec![Rgb::ZERO; count(order)];
            add_directional(&mut light, towards, Rgb::ONE);
            let horizon = irradiance(&light, towards.any_orthonormal_vector()).x;
            assert!((horizon - at_horizon).abs() < 1e-5, "order {order}: {horizon}");
            for (normal, _) in quadrature::sphere(24) {
                let error = irradiance(&light, normal).x - normal.dot(towards).max(0.0);
                // Order 1, a constant, is off most where the surface faces the light.
                assert!(error.abs() < at_horizon + 1e-5 || order == 1, "order {order}: {error}");
            }
        }
    }

    #[test]
    fn rotation_turns_the_light_and_keeps_each_bands_energy() {
        let turn = Mat3::from_axis_angle(Vec3::new(0.36, 0.48, 0.8), 1.234);
        let rotation = Rotation::new(MAX_ORDER, turn);
        let mut light = vec![Rgb::ZERO; MAX_COUNT];
        let mut expected = light.clone();
        for (i, d) in DIRECTIONS.into_iter().enumerate() {
            let colour = Rgb::new(1.0, i as f32, 0.5);
            add_directional(&mut light, d, colour);
            add_directional(&mut expected, turn * d, colour);
        }
        let turned = rotation.apply(&light);
        for (t, e) in turned.iter().zip(&expected) {
            assert!((*t - *e).abs().max_element() < 2e-5, "{t} for {e}");
        }
        for l in 0..MAX_ORDER {
            let energy = |c: &[Rgb]| band(l).map(|j| c[j].x * c[j].x).sum::<f32>();
            assert!((energy(&turned) - energy(&light)).abs() < 1e-5 * energy(&light).max(1.0), "band {l}");
        }
        // Control: the light as it was is another one.
        assert!(light.iter().zip(&expected).any(|(a, b)| (*a - *b).length() > 0.1));
    }
}
