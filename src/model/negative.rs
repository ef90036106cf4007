//! Negative light: a sum of basis elements rings, and where the true light is near zero its value can be below. It is clamped
//! when it is looked up (`shaders/shade.wgsl`, [`LightmapImage`](super::LightmapImage)'s readers), which can only bring it nearer to
//! the truth: no true value is negative, so the squared error falls by at least the square of what is cut off.

use rayon::prelude::*;

use super::{Basis, Transfer};
use crate::math::Rgb;

/// Texels that one task sums over.
const PART: usize = 4096;

/// Conditions whose coefficients are held at a time.
const AT_ONCE: usize = 32;

/// Per direct vector, sqrt(Σ a min(î, 0)²) / sqrt(Σ a î²) over `texels`, (index in the page, area a), and channels: how much of
/// the relit lightmap is negative light. Zero where it is dark. With a γ other than 1, of what is raised to it.
pub fn negative_shares(
    basis: &Basis,
    transfer: &Transfer,
    texels: &[(usize, f32)],
    direct_vectors: &[Vec<Rgb>],
) -> Vec<f64> {
    let some = direct_vectors.chunks(AT_ONCE).map(|some| {
        let coefficients: Vec<Vec<Rgb>> = some.par_iter().map(|x| transfer.coefficients(x)).collect();
        let parts: Vec<Vec<[f64; 2]>> = texels
            .par_chunks(PART)
            .map(|texels| {
                let of_light = |u: &Vec<Rgb>| {
                    texels.iter().fold([0.0; 2], |[negative, all], &(texel, area)| {
                        let value = basis.at(texel, u).as_dvec3();
                        let below = value.min(glam::DVec3::ZERO);
                        [negative + area as f64 * below.length_squared(), all + area as f64 * value.length_squared()]
                    })
                };
                coefficients.iter().map(of_light).collect()
            })
            .collect();
        // In order: a sum of the same numbers, whoever made them.
        let share = move |light: usize| {
            let sum = |which: usize| parts.iter().map(|part| part[light][which]).sum::<f64>();
            if sum(1) > 0.0 { (sum(0) / sum(1)).sqrt() } else { 0.0 }
        };
        (0..some.len()).map(share).collect::<Vec<f64>>()
    });
    some.flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Channels, Values};
    use half::f16;

    /// Two texels of areas 3 and 1, of which the second one is −½ x: sqrt(¼ / (3 + ¼)).
    #[test]
    fn the_share_is_that_of_the_norm() {
        let values = [1.0, 9.0, 9.0, -0.5].map(f16::from_f32).to_vec();
        let basis =
            Basis { size: 2, elements: 1, components: 1, values: Values::Half(values), anchors: None, gamma: 1.0 };
        let matrices = vec![vec![1.0]; 3];
        let transfer = Transfer {
            channels: Channels::Mono,
            elements: 1,
            points: 1,
            matrices,
            mean_scaled_by_norm: false,
            gamma: 1.0,
        };
        let lights = [Rgb::ONE, Rgb::new(0.0, 7.0, 0.0), Rgb::ZERO, -Rgb::ONE].map(|x| vec![x]);
        let shares = negative_shares(&basis, &transfer, &[(0, 3.0), (3, 1.0)], &lights);
        let expected = [(0.25f64 / 3.25).sqrt(), (0.25f64 / 3.25).sqrt(), 0.0, (3.0f64 / 3.25).sqrt()];
        for (share, expected) in shares.iter().zip(expected) {
            assert!((share - expected).abs() < 1e-6, "{shares:?}");
        }
    }
}
