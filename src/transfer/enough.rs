//! Whether there are enough measurement points and conditions (METHOD section 12): what more of them would bring, found by
//! trial. The lights are measured at more points, which takes no bake; and a fit on half of the conditions tells how the error
//! falls with their number.
//!
//! The condition number of D and its leave-one-out residual say less: D of points that are too few is well-conditioned, and a
//! residual does not tell whether it is the points, the conditions or the basis that it comes from.

use super::error::mean_median_worst;
use super::fit::Fit;
use super::{Gram, Method, Prior, TrainSettings, TransferError, Trial};
use crate::dataset::Dataset;

/// A doubling is worth asking for that lowers the error by this share.
const WORTH: f64 = 0.1;

/// A doubling that lowers the error by less than this share is not worth its cost.
pub const LEAST_GAIN: f64 = 0.05;

/// Standard errors that a gain must be over to count as one.
const SIGMAS: f64 = 2.0;

/// More of something: how many, and the mean error to expect of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct More {
    pub enough: usize,
    pub error: f64,
}

/// How a mean error falls with the number of conditions: e² = floor + fall / N, so that each doubling brings half of what the one
/// before brought. Measured from 64 to 1,024 conditions on three scenes it brings 0.4 to 0.7 of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curve {
    /// N.
    pub conditions: usize,
    pub error: f64,
    /// What the last doubling took off e²; 0 where that is within its noise.
    pub fell: f64,
}

impl Curve {
    /// From the errors of two fits on the same conditions, one on half as many as the other's `conditions`.
    pub fn new(conditions: usize, of_half: &[f64], of_all: &[f64]) -> Self {
        let gains: Vec<f64> = of_half.iter().zip(of_all).map(|(half, all)| half - all).collect();
        let (half, all, gain) = (mean(of_half), mean(of_all), mean(&gains));
        let variance = gains.iter().map(|g| (g - gain).powi(2)).sum::<f64>() / (gains.len().max(2) - 1) as f64;
        let is_certain = gain > SIGMAS * (variance / gains.len().max(1) as f64).sqrt();
        Self { conditions, error: all, fell: if is_certain { half * half - all * all } else { 0.0 } }
    }

    /// The curve's next point: twice as many conditions.
    pub fn doubled(self) -> Self {
        let fell = self.fell / 2.0;
        // A hundredth of the energy is left in any case: a straight line does not know that errors are not negative.
        let squared = (self.error * self.error - fell).max(0.01 * self.error * self.error);
        Self { conditions: 2 * self.conditions, error: squared.sqrt(), fell }
    }

    /// Share of the error that twice as many conditions are expected to take off.
    pub fn gain(self) -> f64 {
        if self.error > 0.0 { 1.0 - self.doubled().error / self.error } else { 0.0 }
    }

    /// How many would do, if a doubling is worth asking for: one more is not worth its cost.
    pub fn shortage(self, most: usize) -> Option<More> {
        if self.gain() < WORTH || 2 * self.conditions > most {
            return None;
        }
        let mut curve = self;
        while curve.gain() >= LEAST_GAIN && 2 * curve.conditions <= most {
            curve = curve.doubled();
        }
        Some(More { enough: curve.conditions, error: curve.error })
    }
}

/// Error of a model that has `all`, if the error `own` of the fit that it is made from were `share` of what it is: what a local
/// basis adds stays.
fn instead(all: f64, own: f64, share: f64) -> f64 {
    (all * all + own * own * (share * share - 1.0)).max(0.0).sqrt()
}

/// Errors of as many elements as the fit's settings ask for; of a local basis all that it is made from.
fn of_settings(fit: &Fit, errors: Vec<Vec<f64>>) -> Vec<f64> {
    let last = errors.len().saturating_sub(1);
    let at = if fit.settings.method == Method::Local { last } else { (fit.settings.elements - 1).min(last) };
    errors.into_iter().nth(at).unwrap_or_default()
}

/// How the error of `fit` falls with the number of conditions, where the whole model's mean held-out error is `error`; `prior` is
/// what it was told. `None` where half of the conditions cannot be fitted to.
///
/// # Errors
/// As [`Fit::train`].
pub fn curve(
    fit: &Fit,
    prior: Option<&Prior>,
    dataset: &Dataset,
    gram: &Gram,
    error: f64,
) -> Result<Option<Curve>, TransferError> {
    let half = match Fit::train_on(dataset, gram, 0..dataset.training / 2, fit.settings) {
        Ok(half) => half,
        Err(TransferError::TooFewConditions { .. }) => return Ok(None),
        Err(error) => return Err(error),
    };
    let half = match prior.filter(|_| fit.prior) {
        Some(prior) => {
            let prior = prior.in_basis(fit, &half, gram);
            half.with_prior(dataset, &prior)?
        }
        None => half,
    };
    let errors_of = |fit: &Fit| Trial::of(fit, gram, dataset.held_out()).own_errors(dataset);
    Ok(Some(Curve { error, ..Curve::new(dataset.training, &errors_of(&half), &errors_of(fit)) }))
}

/// How many of more points would do, if they are worth asking for. `candidates` are numbers of points, rising, and `measure`
/// gives the dataset measured at so many; `error` and `oracle` are the mean held-out ones of the whole model.
///
/// # Errors
/// As `measure`, and where D is not finite.
pub fn points<E: From<TransferError>>(
    fit: &Fit,
    dataset: &Dataset,
    gram: &Gram,
    (error, oracle): (f64, f64),
    candidates: &[usize],
    mut measure: impl FnMut(usize) -> Result<Dataset, E>,
) -> Result<Option<More>, E> {
    // Points cannot better the basis.
    if oracle > (1.0 - WORTH) * error {
        return Ok(None);
    }
    let trial = Trial::of(fit, gram, dataset.held_out());
    let mean_of = |dataset: &Dataset| Ok::<f64, TransferError>(mean(&of_settings(fit, trial.errors(dataset)?)));
    let (own, now) = (mean(&trial.own_errors(dataset)), mean_of(dataset)?.max(f64::MIN_POSITIVE));
    let mut found: Vec<More> = Vec::new();
    for &enough in candidates {
        let other = mean_of(&measure(enough)?)?;
        let more = More { enough, error: instead(error, own, other / now) };
        let before = found.last().map_or(error, |m| m.error);
        found.push(more);
        // Still more would bring less again.
        if more.error > (1.0 - LEAST_GAIN) * before {
            break;
        }
    }
    let least = found.iter().map(|m| m.error).fold(f64::INFINITY, f64::min);
    if least > (1.0 - WORTH) * error {
        return Ok(None);
    }
    Ok(found.into_iter().find(|m| m.error <= (1.0 + LEAST_GAIN) * least))
}

/// How the error falls with the number of conditions, by training conditions alone: fits on a quarter and on half of them, tested on
/// the other half, carried on to all. `tell` makes the prior that a fit is told, if it is told one. `None` where a quarter of
/// the conditions cannot be fitted to.
///
/// # Errors
/// As `tell` and [`Fit::train`].
pub fn curve_of_training<E: From<TransferError>>(
    dataset: &Dataset,
    gram: &Gram,
    settings: TrainSettings,
    tell: impl FnOnce(&Fit) -> Result<Option<Prior>, E>,
) -> Result<Option<Curve>, E> {
    let n = dataset.training;
    let fit_on = |count: usize| match Fit::train_on(dataset, gram, 0..count, settings) {
        Err(TransferError::TooFewConditions { .. }) => Ok(None),
        fit => fit.map(Some),
    };
    let (Some(mut quarter), Some(mut half)) = (fit_on(n / 4)?, fit_on(n / 2)?) else { return Ok(None) };
    if let Some(prior) = tell(&half)? {
        quarter = quarter.clone().with_prior(dataset, &prior.in_basis(&half, &quarter, gram))?;
        half = half.with_prior(dataset, &prior)?;
    }
    let errors_of = |fit: &Fit| Trial::of(fit, gram, n / 2..n).own_errors(dataset);
    let (quarter, half) = (errors_of(&quarter), errors_of(&half));
    Ok((!half.is_empty()).then(|| Curve::new(n / 2, &quarter, &half).doubled()))
}

pub(super) fn mean(values: &[f64]) -> f64 {
    mean_median_worst(values).0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Errors of `count` conditions around `mean`, the same spread for all.
    fn errors(mean: f64, count: usize) -> Vec<f64> {
        (0..count).map(|i| mean * (0.5 + (i as f64 + 0.5) / count as f64)).collect()
    }

    /// On e² = floor + fall / N the curve is exact, and what it calls enough is where a doubling brings under 5 %.
    #[test]
    fn a_curve_carries_on_as_it_fell() {
        let error = |n: usize| (0.01f64 + 5.0 / n as f64).sqrt();
        let curve = Curve::new(128, &errors(error(64), 50), &errors(error(128), 50));
        assert!((curve.doubled().error - error(256)).abs() < 1e-12);
        assert!((curve.doubled().doubled().error - error(512)).abs() < 1e-12);
        let more = curve.shortage(1 << 16).unwrap();
        let gain = |n: usize| 1.0 - error(2 * n) / error(n);
        assert!(gain(more.enough) < LEAST_GAIN && gain(more.enough / 2) >= LEAST_GAIN, "{more:?}");
        assert!((more.error - error(more.enough)).abs() < 1e-12);
        assert_eq!(curve.shortage(200), None, "no more can be had");
        // Controls: a flat curve asks for nothing, nor does a fall within its noise.
        let flat = Curve::new(128, &errors(error(1 << 20), 50), &errors(error(1 << 21), 50));
        assert!(flat.shortage(1 << 16).is_none());
        let noisy = |shift: usize| (0..50).map(|i| 0.2 + 0.1 * ((i + shift) % 7) as f64).collect::<Vec<f64>>();
        assert_eq!(Curve::new(128, &noisy(3), &noisy(0)).fell, 0.0);
    }
}
