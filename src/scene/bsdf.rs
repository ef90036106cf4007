//! Reflection at a surface point: evaluation, sampling, density.
//!
//! Lambert, or the metallic-roughness model of glTF 2.0 (specification, appendix B): a diffuse lobe under a Trowbridge–Reitz
//! specular lobe, weighted by Schlick's Fresnel term at the half vector. That sum is reciprocal but not energy conserving:
//! a white dielectric seen at grazing angles may return more than it receives. Metals and Lambert surfaces never do.

use std::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3};

use super::Bsdf;
use crate::math::colour::luminance;
use crate::math::warp::{
    ggx_distribution, pdf_cosine_hemisphere, pdf_ggx_visible_normal, sample_cosine_hemisphere,
    sample_ggx_visible_normal,
};
use crate::math::{Frame, Rgb};

/// A direction drawn from a [`Bsdf`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BsdfSample {
    /// Unit vector towards where the light comes from.
    pub direction: Vec3,
    /// f · cos θ / pdf.
    pub weight: Rgb,
    /// Per steradian.
    pub pdf: f32,
}

impl Bsdf {
    /// The BRDF f, per steradian, without the cosine; zero for light from below `normal`. All vectors are unit and leave the
    /// surface. A view from below the shading normal counts as grazing, so that smooth silhouettes stay lit.
    /// GPU twin: `shaders/bsdf.wgsl`.
    pub fn evaluate(&self, normal: Vec3, to_view: Vec3, to_light: Vec3) -> Rgb {
        let cos_light = normal.dot(to_light);
        if cos_light <= 0.0 {
            return Vec3::ZERO;
        }
        if !self.specular {
            return self.diffuse * FRAC_1_PI;
        }
        let half = (to_view + to_light).normalize_or(normal);
        let fresnel = schlick(self.f0, to_view.dot(half));
        let distribution = ggx_distribution(normal.dot(half), self.alpha);
        let visibility = smith_visibility(normal.dot(to_view).max(0.0), cos_light, self.alpha);
        (1.0 - fresnel) * self.diffuse * FRAC_1_PI + fresnel * (distribution * visibility)
    }

    /// Draws the direction towards a light, with density [`Bsdf::pdf`], from `u` in [0, 1)⁴: cosine-distributed for the
    /// diffuse lobe, visible normals for the specular one. None where a specular direction falls below the surface.
    pub fn sample(&self, normal: Vec3, to_view: Vec3, u: [f32; 4]) -> Option<BsdfSample> {
        let frame = Frame::from_normal(normal);
        let specular_share = self.specular_share(normal.dot(to_view));
        let direction = if u[0] < specular_share {
            let view = frame.local_from_world(to_view);
            let half = sample_ggx_visible_normal(Vec2::new(u[1], u[2]), view, self.alpha);
            frame.world_from_local(half * (2.0 * view.dot(half)) - view).normalize()
        } else {
            frame.world_from_local(sample_cosine_hemisphere(Vec2::new(u[1], u[2])))
        };
        let pdf = self.pdf(normal, to_view, direction);
        let cos_light = normal.dot(direction);
        if cos_light <= 0.0 || pdf <= 0.0 {
            return None;
        }
        Some(BsdfSample { direction, weight: self.evaluate(normal, to_view, direction) * (cos_light / pdf), pdf })
    }

    /// Density of [`Bsdf::sample`], per steradian.
    pub fn pdf(&self, normal: Vec3, to_view: Vec3, to_light: Vec3) -> f32 {
        let cos_light = normal.dot(to_light);
        if cos_light <= 0.0 {
            return 0.0;
        }
        let share = self.specular_share(normal.dot(to_view));
        let diffuse = (1.0 - share) * pdf_cosine_hemisphere(cos_light);
        if share == 0.0 {
            return diffuse;
        }
        let frame = Frame::from_normal(normal);
        let view = frame.local_from_world(to_view);
        let half = (view + frame.local_from_world(to_light)).normalize();
        // A reflection about h covers four times the solid angle of h, over v·h.
        let jacobian = 1.0 / (4.0 * view.dot(half)).max(1e-6);
        diffuse + share * pdf_ggx_visible_normal(view, half, self.alpha) * jacobian
    }

    /// Probability of the specular lobe: its share of the light that a surface seen at `cos_view` returns, about.
    fn specular_share(&self, cos_view: f32) -> f32 {
        // Visible normals are not defined for a view from below.
        if !self.specular || cos_view <= 0.0 {
            return 0.0;
        }
        let fresnel = schlick(self.f0, cos_view);
        let specular = luminance(fresnel);
        let diffuse = luminance((1.0 - fresnel) * self.diffuse);
        specular / (specular + diffuse)
    }
}

/// Schlick's approximation of the Fresnel reflectance.
fn schlick(f0: Rgb, cos: f32) -> Rgb {
    f0 + (1.0 - f0) * (1.0 - cos).clamp(0.0, 1.0).powi(5)
}

/// Height-correlated Smith masking and shadowing over 4 cos θᵥ cos θₗ (glTF 2.0, appendix B.3.3).
fn smith_visibility(cos_view: f32, cos_light: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let view = cos_light * (cos_view * cos_view * (1.0 - a2) + a2).sqrt();
    let light = cos_view * (cos_light * cos_light * (1.0 - a2) + a2).sqrt();
    0.5 / (view + light).max(1e-7)
}

#[cfg(test)]
mod tests {
    use std::f32::consts::TAU;

    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    const NORMAL: Vec3 = Vec3::new(0.48, 0.6, 0.64);

    fn metal(alpha: f32) -> Bsdf {
        Bsdf { diffuse: Vec3::ZERO, f0: Vec3::new(1.0, 0.8, 0.4), alpha, specular: true }
    }

    fn dielectric(alpha: f32) -> Bsdf {
        Bsdf { diffuse: Vec3::new(0.7, 0.5, 0.2), f0: Vec3::splat(0.04), alpha, specular: true }
    }

    fn lambert() -> Bsdf {
        Bsdf { diffuse: Vec3::new(1.0, 0.5, 0.2), f0: Vec3::ZERO, alpha: 1.0, specular: false }
    }

    /// Direction about NORMAL at cos θ and φ.
    fn direction(cos: f32, phi: f32) -> Vec3 {
        let sin = (1.0 - cos * cos).sqrt();
        Frame::from_normal(NORMAL).world_from_local(Vec3::new(sin * phi.cos(), sin * phi.sin(), cos))
    }

    const CELLS: [usize; 2] = [16, 32];

    /// χ² of `count` samples of `sampled` binned over (cos θ, φ), with one more bin for None, against the integral of
    /// `assumed`'s density over each bin; and its degrees of freedom.
    fn chi_squared(sampled: &Bsdf, assumed: &Bsdf, view: Vec3, count: usize) -> (f64, f64) {
        let mut rng = Pcg64::seed_from_u64(7);
        let frame = Frame::from_normal(NORMAL);
        let mut seen = vec![0.0; CELLS[0] * CELLS[1] + 1];
        for _ in 0..count {
            let bin = sampled.sample(NORMAL, view, rng.random()).map_or(CELLS[0] * CELLS[1], |sample| {
                let d = frame.local_from_world(sample.direction);
                let row = ((d.z * CELLS[0] as f32) as usize).min(CELLS[0] - 1);
                let column = ((d.y.atan2(d.x) / TAU).rem_euclid(1.0) * CELLS[1] as f32) as usize;
                row * CELLS[1] + column.min(CELLS[1] - 1)
            });
            seen[bin] += 1.0;
        }
        const FINE: usize = 24;
        let mut expected: Vec<f64> = (0..CELLS[0] * CELLS[1])
            .map(|bin| {
                let (row, column) = (bin / CELLS[1], bin % CELLS[1]);
                let mut sum = 0.0;
                for i in 0..FINE * FINE {
                    let cos = (row as f32 + ((i / FINE) as f32 + 0.5) / FINE as f32) / CELLS[0] as f32;
                    let phi = (column as f32 + ((i % FINE) as f32 + 0.5) / FINE as f32) / CELLS[1] as f32 * TAU;
                    sum += assumed.pdf(NORMAL, view, direction(cos, phi)) as f64;
                }
                sum * std::f64::consts::TAU / (CELLS[0] * CELLS[1] * FINE * FINE) as f64
            })
            .collect();
        expected.push((1.0 - expected.iter().sum::<f64>()).max(0.0));
        // Bins with fewer than five expected samples are pooled, as the χ² approximation asks.
        let (mut statistic, mut bins, mut rest) = (0.0, 0.0, (0.0, 0.0));
        for (&seen, expected) in seen.iter().zip(expected.iter().map(|p| p * count as f64)) {
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
        }
        (statistic, bins - 1.0)
    }

    /// χ² with k degrees of freedom is nearly normal with mean k and variance 2k: five sigmas above is a failure.
    fn agrees((statistic, freedom): (f64, f64)) -> bool {
        statistic < freedom + 5.0 * (2.0 * freedom).sqrt()
    }

    #[test]
    fn sampler_draws_with_its_density() {
        for bsdf in [lambert(), metal(0.15), metal(0.6), dielectric(0.15), dielectric(1.0)] {
            for cos in [0.95, 0.5, 0.15] {
                let view = direction(cos, 1.0);
                let result = chi_squared(&bsdf, &bsdf, view, 40_000);
                assert!(agrees(result), "{bsdf:?} at cos {cos}: {result:?}");
            }
        }
        // Control: another roughness has another density.
        assert!(!agrees(chi_squared(&metal(0.6), &metal(0.5), direction(0.5, 1.0), 40_000)));
    }

    #[test]
    fn reflection_is_reciprocal() {
        for bsdf in [lambert(), metal(0.1), dielectric(0.4)] {
            for i in 0..50 {
                let a = direction(0.02 + 0.019 * i as f32, 2.4 * i as f32);
                let b = direction(1.0 - 0.019 * i as f32, 1.7 * i as f32);
                let (forth, back) = (bsdf.evaluate(NORMAL, a, b), bsdf.evaluate(NORMAL, b, a));
                // D's denominator cancels to about α² near its peak: a rounding of n·h, 1e-7, grows by 4/α² at most.
                let tolerance = 1e-6 + 4e-7 / (bsdf.alpha * bsdf.alpha);
                assert!((forth - back).abs().max_element() <= tolerance * forth.max_element(), "{forth} {back}");
            }
        }
    }

    /// Mean weight of the red channel, which is the albedo seen from cos θ = `cos`, and the mean's standard deviation.
    fn furnace(bsdf: &Bsdf, cos: f32) -> (f64, f64) {
        let mut rng = Pcg64::seed_from_u64(3);
        let view = direction(cos, 0.3);
        let weights: Vec<f64> =
            (0..20_000).map(|_| bsdf.sample(NORMAL, view, rng.random()).map_or(0.0, |s| s.weight.x as f64)).collect();
        let mean = weights.iter().sum::<f64>() / weights.len() as f64;
        let variance = weights.iter().map(|w| (w - mean) * (w - mean)).sum::<f64>() / weights.len() as f64;
        (mean, (variance / weights.len() as f64).sqrt())
    }

    /// Under white light from everywhere nothing returns more than it got.
    #[test]
    fn white_furnace_is_at_most_one_for_metal_and_lambert() {
        for bsdf in [lambert(), metal(0.05), metal(0.3), metal(1.0)] {
            for cos in [1.0, 0.6, 0.2, 0.05] {
                let (mean, sigma) = furnace(&bsdf, cos);
                // 1e-4: f32 rounding of the weights where their variance is zero.
                assert!(mean <= 1.0 + 4.0 * sigma + 1e-4, "{bsdf:?} at cos {cos}: {mean} ± {sigma}");
            }
        }
    }

    /// At α = 1 and normal incidence D is 1/π and V is 1/(2(1 + c)), so a white metal returns ∫ c/(1 + c) dc = 1 − ln 2.
    #[test]
    fn roughest_white_metal_returns_one_minus_ln_2() {
        let (mean, sigma) = furnace(&metal(1.0), 1.0);
        assert!((mean - (1.0 - std::f64::consts::LN_2)).abs() < 4.0 * sigma, "{mean} ± {sigma}");
    }

    #[test]
    fn nothing_arrives_from_below() {
        for bsdf in [lambert(), dielectric(0.3)] {
            assert_eq!(bsdf.evaluate(NORMAL, NORMAL, -NORMAL), Vec3::ZERO);
            assert_eq!(bsdf.pdf(NORMAL, NORMAL, -NORMAL), 0.0);
        }
    }
}
