//! Transfer between values in gamma space (paper 5.3, METHOD section 5): D and I raised to 1/γ before a fit, what is relit raised
//! to γ. Two lights then do not add, and plain diffuse light is linear; it pays where contrast is high and light is judged as it is
//! seen, and it is taken by itself only where a trial on training conditions has the lower error of the light.

use rayon::prelude::*;

use super::error::{HeldOutErrors, Tested, mean_median_worst};
use super::fit::{Fit, Lambda, Method, TrainSettings};
use super::local::{LocalFit, Terms};
use super::{Extent, Gram, TransferError};
use crate::dataset::Dataset;
use crate::model::Channels;
use crate::progress::{Progress, Silent};

/// The paper's γ.
pub const GAMMA: f32 = 2.2;

/// Texels and conditions of the trial: some tenths of a second.
const MOST_TEXELS: usize = 1024;
const TRAINED: usize = 128;
const TESTED: usize = 64;

/// Standard errors that a gain must be over to count as one.
const SIGMAS: f64 = 2.0;

/// What errors are of: γ, and held-out conditions that are lit.
#[derive(Clone, Copy, Debug)]
pub struct Judged<'j> {
    pub gamma: f32,
    pub conditions: &'j [usize],
}

/// The elements of a basis at a texel and component, with their values.
type Elements<'e> = dyn Fn(usize, usize, &mut Vec<(usize, f64)>) + Sync + 'e;

/// Relative errors (METHOD eq. 9) of the light, where `roots` and `fit` are in gamma space; negative values count as zero.
///
/// # Errors
/// When the dataset cannot be read, or `progress` cancels.
pub fn errors_of_global(
    fit: &Fit,
    roots: &Dataset,
    gram: &Gram,
    judged: Judged,
    progress: &dyn Progress,
) -> Result<HeldOutErrors, TransferError> {
    let values = fit.basis_values(roots, progress)?;
    let (texels, components) = (roots.texels(), fit.settings.channels.components());
    let elements = values.len() / (texels * components).max(1);
    let at = |texel: usize, component: usize, out: &mut Vec<(usize, f64)>| {
        out.extend((0..elements).map(|j| (j, values[(j * components + component) * texels + texel] as f64)));
    };
    errors(&Tested::global(fit, roots, gram), fit.settings.channels, roots, &at, judged, progress)
}

/// The same of a local basis, as it is stored.
///
/// # Errors
/// As [`errors_of_global`].
pub fn errors_of_local(
    local: &LocalFit,
    terms: &Terms,
    channels: Channels,
    roots: &Dataset,
    gram: &Gram,
    judged: Judged,
    progress: &dyn Progress,
) -> Result<HeldOutErrors, TransferError> {
    let tested = Tested::local(local, terms, channels, roots, gram, progress)?;
    let at = |texel: usize, component: usize, out: &mut Vec<(usize, f64)>| {
        out.extend(local.elements_at(terms, texel, component));
    };
    errors(&tested, channels, roots, &at, judged, progress)
}

fn errors(
    tested: &Tested,
    channels: Channels,
    roots: &Dataset,
    elements: &Elements,
    Judged { gamma, conditions }: Judged,
    progress: &dyn Progress,
) -> Result<HeldOutErrors, TransferError> {
    let (n, components) = (roots.conditions.len(), channels.components());
    let coefficients: Vec<[Vec<Vec<f64>>; 2]> = conditions.par_iter().map(|&h| tested.coefficients_of(h)).collect();
    // Σ a |i − î|² of the transfer and of the oracle, and Σ a |i|².
    let mut sums = vec![[0.0; 3]; conditions.len()];
    progress.begin("held out", roots.texels() as u64, "texels");
    let walked = roots.for_each_rows(progress, |texels, rows| {
        let places = texels.clone().flat_map(|t| (0..components).map(move |c| (t, c)));
        let mut found: Vec<Vec<(usize, f64)>> = vec![Vec::new(); texels.len() * components];
        found.iter_mut().zip(places).for_each(|(list, (texel, component))| elements(texel, component, list));
        sums.par_iter_mut().zip(conditions).zip(&coefficients).for_each(|((sums, &h), coefficients)| {
            for (at, texel) in texels.clone().enumerate() {
                let area = roots.texel_areas[texel] as f64;
                for channel in 0..3 {
                    // Mono: a group a channel, one value a texel; multi: one group, a value a channel.
                    let (group, component) = if components == 1 { (channel, 0) } else { (0, channel) };
                    let list = &found[at * components + component];
                    let truth = (rows[(at * 3 + channel) * n + h] as f64).powf(gamma as f64);
                    for (sum, u) in sums.iter_mut().zip(coefficients) {
                        let value: f64 = list.iter().map(|&(j, b)| b * u[group][j]).sum();
                        *sum += area * (value.max(0.0).powf(gamma as f64) - truth).powi(2);
                    }
                    sums[2] += area * truth * truth;
                }
            }
        });
    });
    progress.end();
    walked?;
    let (transfer, oracle) =
        sums.iter().map(|[error, oracle, norm]| ((error / norm).sqrt(), (oracle / norm).sqrt())).unzip();
    Ok(HeldOutErrors { transfer, oracle })
}

/// Mean errors of the light, of fits to the same conditions in linear light and in gamma space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contest {
    pub linear: f64,
    pub gamma: f64,
    /// Whether gamma space is better by more than chance.
    pub gamma_wins: bool,
}

/// Bytes that a contest takes: lightmaps as they are, their roots and those of a tile, a Gram matrix and what a fit makes of it, the basis.
pub(super) fn bytes_needed(extent: &Extent) -> u64 {
    let trained = TRAINED.min(2 * extent.training / 3);
    let conditions = (trained + TESTED.min(extent.training - trained)) as u64;
    let (texels, components) = (extent.texels.min(MOST_TEXELS) as u64, extent.channels.components() as u64);
    let vectors = trained as u64 * 3 / components;
    let direct = 3 * extent.points as u64 * conditions;
    2 * 4 * (3 * texels * conditions + direct)
        + 8 * (3 * conditions).pow(2) * 3 / 2
        + 7 * 8 * vectors.pow(2)
        + 8 * direct
        + 4 * texels * 64 * components
}

impl Contest {
    /// Tries both on the training conditions of `dataset`, by a global basis of up to 64 elements, which tells what a local one
    /// can. None where there are too few of them.
    ///
    /// # Errors
    /// When the dataset cannot be read, or `progress` cancels.
    pub fn of(dataset: &Dataset, channels: Channels, progress: &dyn Progress) -> Result<Option<Self>, TransferError> {
        let trained = TRAINED.min(2 * dataset.training / 3);
        let tested = TESTED.min(dataset.training - trained);
        let some = Dataset::gather(&[(dataset, (0..trained + tested).collect())], trained, progress)?;
        let plain = some.thinned(some.texels().div_ceil(MOST_TEXELS).max(1), progress)?;
        let roots = plain.roots(GAMMA);
        let elements = 64.min(trained / 2);
        let settings = TrainSettings { method: Method::Linear, channels, elements, lambda: Lambda::LeaveOneOut };
        let fitted = |set: &Dataset| -> Result<(Gram, Fit), TransferError> {
            let gram = Gram::of(set, &Silent)?;
            let fit = Fit::train(set, &gram, settings)?;
            Ok((gram, fit))
        };
        let errors = || -> Result<[Vec<f64>; 2], TransferError> {
            let (gram, fit) = fitted(&plain)?;
            let lit: Vec<usize> = plain.held_out().filter(|&h| gram.is_lit(h)).collect();
            // Negative light counts as zero here, too.
            let linear = errors_of_global(&fit, &plain, &gram, Judged { gamma: 1.0, conditions: &lit }, &Silent)?;
            let (gram, fit) = fitted(&roots)?;
            let gamma = errors_of_global(&fit, &roots, &gram, Judged { gamma: GAMMA, conditions: &lit }, &Silent)?;
            Ok([linear.transfer, gamma.transfer])
        };
        match errors() {
            Ok([linear, gamma]) if linear.len() > 1 => {
                let gains: Vec<f64> = linear.iter().zip(&gamma).map(|(l, g)| l - g).collect();
                let mean = mean_median_worst(&gains).0;
                let variance = gains.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / (gains.len() - 1) as f64;
                let gamma_wins = mean > SIGMAS * (variance / gains.len() as f64).sqrt();
                let [linear, gamma] = [linear, gamma].map(|errors| mean_median_worst(&errors).0);
                Ok(Some(Self { linear, gamma, gamma_wins }))
            }
            Ok(_) | Err(TransferError::TooFewConditions { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }
}
