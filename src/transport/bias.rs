//! How far the gather integrator is from path tracing, less the noise of both.
//!
//! Two bakes of each, g and p, have independent noise: the mean of (g₁ − p₁)(g₂ − p₂) is the squared bias alone. What is
//! left of the noise is told from how far groups of texels disagree.

use std::ops::Range;

use super::{BakeError, BakeSettings, Baker, Integrator};
use crate::light::LightingCondition;
use crate::math::sampler::mix64;
use crate::progress::Progress;
use crate::scene::{Lightmap, Tracer};

/// The gather integrator's bias, relative to the root mean square of the indirect irradiance over texels, channels and conditions.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Bias {
    /// The estimate; zero where noise hides it.
    pub relative: f64,
    /// What it does not exceed with 97.5 % confidence.
    pub at_most: f64,
}

/// Groups of texels, spread over the lightmap: their disagreement tells the estimate's error.
const GROUPS: usize = 32;
const TEXELS_PER_GROUP: usize = 64;
const MOST_CONDITIONS: usize = 16;
const PATHS: u32 = 1024;

/// Student's t for 97.5 % with 31 degrees of freedom.
const T_97_5: f64 = 2.04;

impl Bias {
    /// Measures it on some of `conditions` and some texels. None where the settings' integrator is `path`.
    ///
    /// # Errors
    /// [`BakeError`] as a bake.
    pub fn measure(
        tracer: &Tracer,
        lightmap: &Lightmap,
        conditions: &[LightingCondition],
        settings: &BakeSettings,
        progress: &dyn Progress,
    ) -> Result<Option<Self>, BakeError> {
        if settings.integrator.for_asset(tracer.asset())? == Integrator::Path || conditions.is_empty() {
            return Ok(None);
        }
        let step = conditions.len().div_ceil(MOST_CONDITIONS);
        let conditions: Vec<LightingCondition> = conditions.iter().step_by(step).cloned().collect();
        let groups = groups(lightmap.texels.len());
        let mut bakes = Vec::new();
        for (k, integrator) in
            [Integrator::Gather, Integrator::Gather, Integrator::Path, Integrator::Path].into_iter().enumerate()
        {
            // No bake shares its random numbers with another.
            let seed = mix64(settings.seed ^ mix64(BIAS_STREAM + k as u64));
            let settings = BakeSettings { integrator, seed, paths: PATHS, ..*settings };
            let baker = Baker::new(tracer, lightmap, &conditions, &settings, progress)?;
            progress.begin("bias", groups.iter().map(|g| g.len() as u64).sum(), "texels");
            let rows: Result<Vec<Vec<f32>>, BakeError> =
                groups.iter().map(|group| Ok(baker.texels(group.clone(), progress)?.indirect)).collect();
            progress.end();
            bakes.push(rows?);
        }
        let n = conditions.len();
        let products: Vec<(f64, f64)> = (0..groups.len())
            .map(|g| {
                let [g1, g2, p1, p2] = [0, 1, 2, 3].map(|k| &bakes[k][g]);
                let (mut bias, mut light) = (0.0, 0.0);
                for (t, texel) in groups[g].clone().enumerate() {
                    let area = lightmap.texels[texel].area as f64;
                    for i in t * 3 * n..(t + 1) * 3 * n {
                        let (g1, g2, p1, p2) = (g1[i] as f64, g2[i] as f64, p1[i] as f64, p2[i] as f64);
                        bias += area * (g1 - p1) * (g2 - p2);
                        light += area * p1 * p2;
                    }
                }
                (bias, light)
            })
            .collect();
        Ok(Some(Self::of_groups(&products)))
    }

    /// From squared bias and squared light of each group.
    fn of_groups(products: &[(f64, f64)]) -> Self {
        let count = products.len() as f64;
        let light: f64 = products.iter().map(|p| p.1).sum::<f64>().max(f64::MIN_POSITIVE);
        let square = products.iter().map(|p| p.0).sum::<f64>() / light;
        // The ratio's linearised variance.
        let residuals = products.iter().map(|(bias, of)| (bias - square * of).powi(2)).sum::<f64>();
        let error = (residuals * count / (count - 1.0).max(1.0)).sqrt() / light;
        Self { relative: square.max(0.0).sqrt(), at_most: (square.max(0.0) + T_97_5 * error).sqrt() }
    }
}

/// Separates these bakes from all others.
const BIAS_STREAM: u64 = 0x6269_6173;

/// Ranges of texels, evenly spaced; all texels of a small lightmap.
fn groups(texels: usize) -> Vec<Range<usize>> {
    let count = GROUPS.min(texels);
    let start = |g: usize| g * texels / count;
    (0..count).map(|g| start(g)..start(g + 1).min(start(g) + TEXELS_PER_GROUP)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_lie_apart_and_cover_small_lightmaps() {
        for texels in [1, 7, 33, 500, 2047, 100_000] {
            let groups = groups(texels);
            assert!(groups.windows(2).all(|w| w[0].end <= w[1].start));
            assert!(groups.iter().all(|g| !g.is_empty() && g.end <= texels));
            let covered: usize = groups.iter().map(|g| g.len()).sum();
            assert!(covered >= texels.min(GROUPS * TEXELS_PER_GROUP), "{covered} of {texels}");
        }
    }

    /// Groups that agree leave no doubt; those that do not, leave room above.
    #[test]
    fn disagreement_is_doubt() {
        let agreed = Bias::of_groups(&[(0.01, 1.0); 8]);
        assert!((agreed.relative - 0.1).abs() < 1e-12 && (agreed.at_most - 0.1).abs() < 1e-6);
        let noise: Vec<(f64, f64)> = (0..8).map(|i| (if i % 2 == 0 { 0.01 } else { -0.01 }, 1.0)).collect();
        let noise = Bias::of_groups(&noise);
        assert!(noise.relative < 1e-9 && noise.at_most > 0.05);
    }
}
