//! Maps from the unit square to the domains that paths are drawn from, each beside its density.

use std::f32::consts::{FRAC_1_PI, PI, TAU};

use glam::{Vec2, Vec3};

use super::LANES;

/// Uniform on the unit disk, area preserving and continuous (Shirley and Chiu 1997).
pub fn sample_concentric_disk(u: Vec2) -> Vec2 {
    let p = u * 2.0 - 1.0;
    if p == Vec2::ZERO {
        return Vec2::ZERO;
    }
    let (radius, phi) =
        if p.x.abs() > p.y.abs() { (p.x, PI / 4.0 * (p.y / p.x)) } else { (p.y, PI / 2.0 - PI / 4.0 * (p.x / p.y)) };
    radius * Vec2::new(phi.cos(), phi.sin())
}

/// Direction about +z with density cos θ / π.
pub fn sample_cosine_hemisphere(u: Vec2) -> Vec3 {
    let d = sample_concentric_disk(u);
    d.extend((1.0 - d.length_squared()).max(0.0).sqrt())
}

/// [`sample_cosine_hemisphere`] of LANES points, to within rounding: `[axis][lane]` from `[coordinate][lane]`.
#[inline]
pub fn sample_cosine_hemispheres(u: &[[f32; LANES]; 2]) -> [[f32; LANES]; 3] {
    let mut directions = [[0.0; LANES]; 3];
    for i in 0..LANES {
        let (x, y) = (u[0][i] * 2.0 - 1.0, u[1][i] * 2.0 - 1.0);
        let x_leads = x.abs() > y.abs();
        let (radius, other) = if x_leads { (x, y) } else { (y, x) };
        // At most π/4, where these polynomials of sine and cosine err by less than f32 rounds (Moshier, Cephes, sinf and cosf).
        let angle = if radius == 0.0 { 0.0 } else { PI / 4.0 * (other / radius) };
        let square = angle * angle;
        let sin = ((-1.951_529_6e-4 * square + 8.332_161e-3) * square - 1.666_665_5e-1) * square * angle + angle;
        let cos = ((2.443_315_7e-5 * square - 1.388_731_6e-3) * square + 4.166_664_6e-2) * square * square
            - 0.5 * square
            + 1.0;
        directions[0][i] = radius * if x_leads { cos } else { sin };
        directions[1][i] = radius * if x_leads { sin } else { cos };
        directions[2][i] = (1.0 - radius * radius).max(0.0).sqrt();
    }
    directions
}

/// Per steradian.
pub fn pdf_cosine_hemisphere(cos_theta: f32) -> f32 {
    cos_theta.max(0.0) * FRAC_1_PI
}

/// Direction with uniform density on the sphere.
pub fn sample_uniform_sphere(u: Vec2) -> Vec3 {
    let z = 1.0 - 2.0 * u.x;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let phi = TAU * u.y;
    Vec3::new(r * phi.cos(), r * phi.sin(), z)
}

/// Per steradian.
pub fn pdf_uniform_sphere() -> f32 {
    FRAC_1_PI / 4.0
}

/// Direction about +z with uniform density within the cone of half-angle acos(`cos_max`).
pub fn sample_uniform_cone(u: Vec2, cos_max: f32) -> Vec3 {
    let z = 1.0 - u.x * (1.0 - cos_max);
    let r = (1.0 - z * z).max(0.0).sqrt();
    let phi = TAU * u.y;
    Vec3::new(r * phi.cos(), r * phi.sin(), z)
}

/// Per steradian, inside the cone.
pub fn pdf_uniform_cone(cos_max: f32) -> f32 {
    1.0 / (TAU * (1.0 - cos_max))
}

/// Barycentric coordinates of the second and third vertex, uniform by area (Heitz 2019, low distortion).
pub fn sample_uniform_triangle(u: Vec2) -> Vec2 {
    if u.x < u.y {
        let b0 = u.x * 0.5;
        Vec2::new(b0, u.y - b0)
    } else {
        let b1 = u.y * 0.5;
        Vec2::new(u.x - b1, b1)
    }
}

/// Half vector about +z as seen from `view` (both local), with the density of [`pdf_ggx_visible_normal`]
/// (Dupuy and Benyoub, *Sampling Visible GGX Normals with Spherical Caps*, 2023).
pub fn sample_ggx_visible_normal(u: Vec2, view: Vec3, alpha: f32) -> Vec3 {
    let stretched = Vec3::new(view.x * alpha, view.y * alpha, view.z).normalize();
    let phi = TAU * u.x;
    let z = (1.0 - u.y) * (1.0 + stretched.z) - stretched.z;
    let r = (1.0 - z * z).clamp(0.0, 1.0).sqrt();
    let h = Vec3::new(r * phi.cos(), r * phi.sin(), z) + stretched;
    Vec3::new(h.x * alpha, h.y * alpha, h.z.max(0.0)).normalize()
}

/// Per steradian of half vectors: D(h) G₁(v) max(v·h, 0) / v_z.
pub fn pdf_ggx_visible_normal(view: Vec3, half: Vec3, alpha: f32) -> f32 {
    ggx_distribution(half.z, alpha) * smith_g1(view.z, alpha) * view.dot(half).max(0.0) / view.z.max(1e-6)
}

/// Trowbridge–Reitz microfacet density D(h), per steradian.
pub fn ggx_distribution(cos_half: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let d = cos_half * cos_half * (a2 - 1.0) + 1.0;
    a2 * FRAC_1_PI / (d * d).max(1e-20)
}

/// Smith's masking function for one direction.
pub fn smith_g1(cos: f32, alpha: f32) -> f32 {
    let cos = cos.max(1e-6);
    2.0 * cos / (cos + (alpha * alpha + (1.0 - alpha * alpha) * cos * cos).sqrt())
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    const ROWS: usize = 12;
    const COLUMNS: usize = 16;
    const SAMPLES: usize = 40_000;

    /// Both ways of the map to directions agree to rounding: a few units in the last place of 1.
    #[test]
    fn directions_side_by_side_are_those_of_one() {
        let mut rng = Pcg64::seed_from_u64(3);
        let mut largest = 0f32;
        for round in 0..2_000 {
            let mut u: [[f32; LANES]; 2] = std::array::from_fn(|_| std::array::from_fn(|_| rng.random()));
            if round == 0 {
                // The middle, edges, corners and diagonals.
                u[0][..8].copy_from_slice(&[0.5, 0.0, 0.0, 0.999_999_9, 0.25, 0.75, 0.5, 0.5]);
                u[1][..8].copy_from_slice(&[0.5, 0.0, 0.5, 0.999_999_9, 0.25, 0.25, 0.0, 0.999_999_9]);
            }
            let [x, y, z] = sample_cosine_hemispheres(&u);
            for i in 0..LANES {
                let one = sample_cosine_hemisphere(Vec2::new(u[0][i], u[1][i]));
                let off = Vec3::new(x[i], y[i], z[i]) - one;
                assert!(off.truncate().abs().max_element() < 4.0 * f32::EPSILON, "{one}: {off}");
                // z is the root of what rounds by a few units.
                let square = z[i] * z[i] - one.z * one.z;
                assert!(square.abs() < 8.0 * f32::EPSILON, "{one}: {off}");
                largest = largest.max(off.length());
            }
        }
        assert!(largest > 0.0, "the control: they do round differently");
    }

    /// χ² of samples binned over the unit square by `cell`, against the integral of `density` (over that square) in each bin;
    /// and its degrees of freedom.
    fn chi_squared(cell: impl Fn(Vec2) -> Vec2, density: impl Fn(Vec2) -> f64) -> (f64, f64) {
        let mut rng = Pcg64::seed_from_u64(11);
        let mut seen = vec![0.0; ROWS * COLUMNS];
        for _ in 0..SAMPLES {
            let p = cell(Vec2::new(rng.random(), rng.random()));
            let (row, column) = ((p.x * ROWS as f32) as usize, (p.y * COLUMNS as f32) as usize);
            seen[row.min(ROWS - 1) * COLUMNS + column.min(COLUMNS - 1)] += 1.0;
        }
        // Midpoint rule, 32 by 32 a bin.
        const FINE: usize = 32;
        let expected: Vec<f64> = (0..ROWS * COLUMNS)
            .map(|bin| {
                let (row, column) = (bin / COLUMNS, bin % COLUMNS);
                let fine =
                    |cell: usize, i: usize, cells: usize| (cell as f32 + (i as f32 + 0.5) / FINE as f32) / cells as f32;
                let sum: f64 = (0..FINE * FINE)
                    .map(|i| density(Vec2::new(fine(row, i / FINE, ROWS), fine(column, i % FINE, COLUMNS))))
                    .sum();
                sum / (ROWS * COLUMNS * FINE * FINE) as f64
            })
            .collect();
        // The midpoint rule is off by half a percent for the narrowest lobe below.
        let total: f64 = expected.iter().sum();
        assert!((total - 1.0).abs() < 0.01, "the density integrates to {total}");
        // Bins with fewer than five expected samples are pooled, as the χ² approximation asks.
        let (mut statistic, mut bins, mut rest) = (0.0, 0.0, (0.0, 0.0));
        for (&seen, expected) in seen.iter().zip(expected.iter().map(|p| p * SAMPLES as f64)) {
            if expected < 5.0 {
                rest = (rest.0 + seen, rest.1 + expected);
            } else {
                statistic += (seen - expected) * (seen - expected) / expected;
                bins += 1.0;
            }
        }
        if rest.1 >= 5.0 {
            statistic += (rest.0 - rest.1) * (rest.0 - rest.1) / rest.1;
            bins += 1.0;
        } else {
            // Hardly anything is expected there: more than ten samples have p < 0.02 at most, and mostly far less.
            assert!(rest.0 <= 10.0 + rest.1, "{} samples where {} are expected", rest.0, rest.1);
        }
        (statistic, bins - 1.0)
    }

    /// χ² with k degrees of freedom is nearly normal with mean k and variance 2k: five sigmas above is a failure.
    fn agrees((statistic, freedom): (f64, f64)) -> bool {
        statistic < freedom + 5.0 * (2.0 * freedom).sqrt()
    }

    /// χ² of directions with density `pdf` per steradian, over ((1 + z)/2, φ/2π), in which solid angle is 4π times area.
    fn chi_squared_of_directions(sample: impl Fn(Vec2) -> Vec3, pdf: impl Fn(Vec3) -> f32) -> (f64, f64) {
        let cell = |u: Vec2| {
            let d = sample(u);
            assert!((d.length() - 1.0).abs() < 1e-5, "{d} is not unit");
            Vec2::new(0.5 + 0.5 * d.z, (d.y.atan2(d.x) / TAU).rem_euclid(1.0))
        };
        let density = |p: Vec2| {
            let (z, phi) = (2.0 * p.x - 1.0, TAU * p.y);
            let r = (1.0 - z * z).max(0.0).sqrt();
            4.0 * std::f64::consts::PI * pdf(Vec3::new(r * phi.cos(), r * phi.sin(), z)) as f64
        };
        chi_squared(cell, density)
    }

    #[test]
    fn concentric_disk_is_uniform() {
        let sampled = |u| {
            let d = sample_concentric_disk(u);
            Vec2::new(d.length_squared(), (d.y.atan2(d.x) / TAU).rem_euclid(1.0))
        };
        assert!(agrees(chi_squared(sampled, |_| 1.0)));
        // Control: radii that are uniform instead of their squares.
        let crowded = |u| sampled(u).with_x(sampled(u).x.sqrt());
        assert!(!agrees(chi_squared(crowded, |_| 1.0)));
        assert_eq!(sample_concentric_disk(Vec2::splat(0.5)), Vec2::ZERO);
    }

    #[test]
    fn cosine_hemisphere_draws_with_its_density() {
        let result = chi_squared_of_directions(sample_cosine_hemisphere, |d| pdf_cosine_hemisphere(d.z));
        assert!(agrees(result), "{result:?}");
        let uniform = |d: Vec3| if d.z > 0.0 { 1.0 / TAU } else { 0.0 };
        assert!(!agrees(chi_squared_of_directions(sample_cosine_hemisphere, uniform)), "the control");
    }

    #[test]
    fn uniform_sphere_draws_with_its_density() {
        let result = chi_squared_of_directions(sample_uniform_sphere, |_| pdf_uniform_sphere());
        assert!(agrees(result), "{result:?}");
        assert!(!agrees(chi_squared_of_directions(|u| sample_uniform_cone(u, -0.8), |_| pdf_uniform_sphere())));
    }

    #[test]
    fn uniform_cone_draws_with_its_density() {
        // Cones that end at a bin's border, so that the midpoint rule integrates the step exactly.
        for cos_max in [0.5, 0.0, -0.5, 2.0 / 3.0] {
            let inside = |d: Vec3| if d.z > cos_max { pdf_uniform_cone(cos_max) } else { 0.0 };
            let result = chi_squared_of_directions(|u| sample_uniform_cone(u, cos_max), inside);
            assert!(agrees(result), "cos {cos_max}: {result:?}");
        }
        let other = |d: Vec3| if d.z > 0.5 { pdf_uniform_cone(0.5) } else { 0.0 };
        assert!(!agrees(chi_squared_of_directions(|u| sample_uniform_cone(u, 2.0 / 3.0), other)), "the control");
    }

    /// Uniform in the triangle b + c < 1: with b, c the map (1 − (1 − b)², c/(1 − b)) is uniform on the square.
    #[test]
    fn uniform_triangle_is_uniform() {
        let square = |b: Vec2| {
            assert!(b.min_element() >= 0.0 && b.element_sum() <= 1.0 + 1e-6, "{b} is outside");
            Vec2::new(1.0 - (1.0 - b.x).powi(2), b.y / (1.0 - b.x))
        };
        assert!(agrees(chi_squared(|u| square(sample_uniform_triangle(u)), |_| 1.0)));
        // Control: scaling u instead of folding it crowds a corner.
        let crowded = |u: Vec2| square(Vec2::new(u.x, u.y * (1.0 - u.x)));
        assert!(!agrees(chi_squared(crowded, |_| 1.0)));
    }

    #[test]
    fn ggx_visible_normals_draw_with_their_density() {
        for alpha in [0.2, 0.5, 1.0] {
            for cos in [1.0f32, 0.7, 0.2] {
                let view = Vec3::new((1.0 - cos * cos).sqrt() * 0.8, (1.0 - cos * cos).sqrt() * -0.6, cos);
                let pdf = |h: Vec3| if h.z > 0.0 { pdf_ggx_visible_normal(view, h, alpha) } else { 0.0 };
                let result = chi_squared_of_directions(|u| sample_ggx_visible_normal(u, view, alpha), pdf);
                assert!(agrees(result), "α {alpha}, cos {cos}: {result:?}");
            }
        }
        let view = Vec3::new(0.6, 0.0, 0.8);
        let rougher = |h: Vec3| if h.z > 0.0 { pdf_ggx_visible_normal(view, h, 0.6) } else { 0.0 };
        assert!(
            !agrees(chi_squared_of_directions(|u| sample_ggx_visible_normal(u, view, 0.5), rougher)),
            "the control"
        );
    }
}
