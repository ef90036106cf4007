//! Sizes of a model from a budget (METHOD section 12): elements or channels n, anchors K and points P. The error of each size
//! is estimated by cross-validation on the training conditions; held-out lights have no part in it.

use glam::Vec3;

use super::enough::mean;
use super::local::Terms;
use super::{Fit, Gram, Method, Prior, TrainSettings, TransferError, Trial};
use crate::dataset::Dataset;
use crate::model::Channels;
use crate::progress::Progress;

/// What a model may take.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Budget {
    /// Mean held-out error.
    pub max_error: Option<f64>,
    /// As [`Size::bytes`] counts them.
    pub max_bytes: Option<u64>,
}

/// Sizes of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Elements, or channels a texel.
    pub elements: usize,
    /// 0: a global basis.
    pub anchors: usize,
    pub points: usize,
    /// Sub-points that each point averages.
    pub sub_points: usize,
}

/// What is the same for all sizes.
#[derive(Clone, Copy, Debug)]
pub struct Storage {
    /// Side of the lightmap.
    pub lightmap_size: usize,
    pub channels: Channels,
    /// Bytes of a value of the basis.
    pub value: usize,
}

/// A size, what it takes and the error to expect of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    pub size: Size,
    pub bytes: u64,
    pub error: f64,
}

impl Size {
    /// Bytes that a run time loads for indirect light: the basis with its anchors over the lightmap's whole page, the transfer
    /// matrices, the points and sub-points. Not the asset, and not what tells lights that were not trained on.
    pub fn bytes(&self, storage: &Storage) -> u64 {
        let Self { elements, anchors, points, sub_points } = *self;
        let page = storage.lightmap_size * storage.lightmap_size;
        let of_anchors = if anchors > 0 { 8 } else { 0 };
        let basis = page * (elements * storage.channels.components() * storage.value + of_anchors);
        // R, G and B for mono, or one of three times the length.
        let matrices = 3 * 2 * points * elements * anchors.max(1);
        // Position, two normals and albedo; which sub-points each point averages.
        let of_points = 4 * 3 * 4 * (points + points * sub_points) + 4 * points * sub_points;
        (basis + matrices + of_points) as u64
    }
}

impl Budget {
    pub fn is_given(&self) -> bool {
        self.max_error.is_some() || self.max_bytes.is_some()
    }

    /// The smallest that reaches the error and fits the bytes; where none does, the one of the least error that fits, but the smallest
    /// of those within [`ALIKE`] of it. Without an error to reach the same. `None` where none fits.
    pub fn choose(&self, candidates: &[Candidate]) -> Option<Candidate> {
        let fits = || candidates.iter().filter(|c| self.max_bytes.is_none_or(|most| c.bytes <= most));
        let least = fits().map(|c| c.error).fold(f64::INFINITY, f64::min);
        let reached = fits().any(|c| self.max_error.is_some_and(|most| c.error <= most));
        let enough = if reached { self.max_error.unwrap_or(least) } else { (1.0 + ALIKE) * least };
        fits()
            .filter(|c| c.error <= enough)
            .min_by(|a, b| a.bytes.cmp(&b.bytes).then(a.error.total_cmp(&b.error)))
            .copied()
    }
}

/// Errors that differ by less than this share are alike: it is about the estimates' own uncertainty.
const ALIKE: f64 = 0.02;

/// Elements that are tried: a global basis of more is slower than a local one of the same error.
pub const MOST_ELEMENTS: usize = 64;
/// Channels and anchors that are tried for a local basis.
pub const CHANNELS: [usize; 6] = [2, 3, 4, 6, 8, 16];
pub const ANCHORS: [usize; 5] = [16, 32, 64, 128, 256];
/// Coefficients n K that are tried: the frames of all anchors are one dense problem of as many unknowns.
const MOST_COEFFICIENTS: usize = 1024;
/// Points that are tried.
pub const POINTS: [usize; 5] = [64, 128, 256, 512, 1024];

/// Parts that the training conditions are cut into; a fit on all but one of them is tested on that one.
const FOLDS: usize = 4;
/// Conditions to be tested on, after which no more folds are tried.
const TESTED: usize = 128;

/// Mean errors of a global basis with each number of elements, `[points][elements − 1]`, for each of `measured`: the dataset
/// measured at several numbers of points.
///
/// # Errors
/// As [`Fit::train`].
pub fn cross_validate(
    measured: &[Dataset],
    gram: &Gram,
    settings: TrainSettings,
) -> Result<Vec<Vec<f64>>, TransferError> {
    let Some(first) = measured.first() else { return Ok(Vec::new()) };
    let n = first.training;
    let mut pooled: Vec<Vec<Vec<f64>>> = vec![Vec::new(); measured.len()];
    for fold in 0..FOLDS {
        let fit = Fit::train_on(first, gram, (0..n).filter(|c| c % FOLDS != fold), settings)?;
        let trial = Trial::of(&fit, gram, (fold..n).step_by(FOLDS));
        for (dataset, pooled) in measured.iter().zip(&mut pooled) {
            let errors = trial.errors(dataset)?;
            pooled.resize(if pooled.is_empty() { errors.len() } else { pooled.len().min(errors.len()) }, Vec::new());
            pooled.iter_mut().zip(errors).for_each(|(all, errors)| all.extend(errors));
        }
        if pooled.iter().flatten().next().is_some_and(|all| all.len() >= TESTED) {
            break;
        }
    }
    Ok(pooled.into_iter().map(|of| of.iter().map(|errors| mean(errors)).collect()).collect())
}

/// What a prior makes of the mean errors of [`cross_validate`], as a factor for each number of elements: found on the first of
/// its folds at the points of `dataset`, for which `tell` makes the prior of a fit. Fewer points gain more by it. Empty where
/// there is none.
///
/// # Errors
/// As `tell` and [`Fit::train`].
pub fn told<E: From<TransferError>>(
    dataset: &Dataset,
    gram: &Gram,
    settings: TrainSettings,
    tell: impl FnOnce(&Fit) -> Result<Option<Prior>, E>,
) -> Result<Vec<f64>, E> {
    let n = dataset.training;
    let fit = Fit::train_on(dataset, gram, (0..n).filter(|c| c % FOLDS != 0), settings)?;
    let Some(prior) = tell(&fit)? else { return Ok(Vec::new()) };
    let errors_of = |fit: &Fit| -> Vec<f64> {
        let trial = Trial::of(fit, gram, (0..n).step_by(FOLDS));
        trial.own_errors_by_elements(dataset).iter().map(|errors| mean(errors)).collect()
    };
    let (plain, told) = (errors_of(&fit), errors_of(&fit.clone().with_prior(dataset, &prior)?));
    Ok(told.iter().zip(&plain).map(|(told, plain)| if told < plain { told / plain } else { 1.0 }).collect())
}

/// Texels and passes that residuals of a local basis are estimated with: 1 to 25 % under those of all texels and 20 passes, from 2
/// channels and 16 anchors to 4 and 128.
const TEXELS: usize = 4096;
const QUICK_PASSES: usize = 6;

/// A mean of relative errors is less than the root of their mean square. Measured on three scenes at two numbers of points.
const OF_MEAN: f64 = 0.8;

/// What a local basis adds to the error of the global one that it is made from: relative residuals for each number of channels and
/// anchors, as products of what channels and what anchors do.
pub struct Residuals {
    /// For each of [`ANCHORS`], with 4 channels.
    of_anchors: [f64; ANCHORS.len()],
    /// For each of [`CHANNELS`], relative to 4.
    of_channels: [f64; CHANNELS.len()],
}

impl Residuals {
    /// From `fit`, a fit of [`Method::Local`], for texels at `spots`.
    ///
    /// # Errors
    /// When the dataset cannot be read, or `progress` cancels.
    pub fn estimate(
        fit: &Fit,
        dataset: &Dataset,
        spots: &[(Vec3, Vec3)],
        progress: &dyn Progress,
    ) -> Result<Self, TransferError> {
        const FOUR: usize = 4;
        let terms = Terms::new(fit, dataset, spots, ANCHORS[0], progress)?;
        let residual = |channels: usize, anchors: usize| {
            terms.thinned(spots, TEXELS, anchors).residual(channels, QUICK_PASSES).sqrt()
        };
        let mut of_anchors = [0.0; ANCHORS.len()];
        let tried = ANCHORS.len() - 1;
        for (i, &anchors) in ANCHORS[..tried].iter().enumerate() {
            of_anchors[i] = residual(FOUR, anchors);
        }
        // The thinned texels are too few for the last; it goes on as the two before.
        of_anchors[tried] = of_anchors[tried - 1].powi(2) / of_anchors[tried - 2].max(f64::MIN_POSITIVE);
        let of_channels = CHANNELS.map(|channels| match channels {
            FOUR => 1.0,
            _ => residual(channels, ANCHORS[1]) / of_anchors[1].max(f64::MIN_POSITIVE),
        });
        Ok(Self { of_anchors, of_channels })
    }

    /// Mean error of a local basis made from a global one whose error is `global`.
    fn error(&self, global: f64, channels: usize, anchors: usize) -> f64 {
        let residual = OF_MEAN * self.of_channels[channels] * self.of_anchors[anchors];
        (global * global + residual * residual).sqrt()
    }
}

/// All sizes with their errors: `errors` as of [`cross_validate`] with the numbers of `points` and of the sub-points that each
/// averages; `residuals` where the basis is local.
pub fn candidates(
    points: &[(usize, usize)],
    errors: &[Vec<f64>],
    residuals: Option<&Residuals>,
    storage: &Storage,
) -> Vec<Candidate> {
    let candidate = |elements, anchors, (points, sub_points), error| {
        let size = Size { elements, anchors, points, sub_points };
        Candidate { size, bytes: size.bytes(storage), error }
    };
    let of_points = |(&points, errors): (&(usize, usize), &Vec<f64>)| -> Vec<Candidate> {
        match residuals {
            None => (errors.iter().take(MOST_ELEMENTS).enumerate())
                .map(|(j, &error)| candidate(j + 1, 0, points, error))
                .collect(),
            Some(residuals) => {
                let global = errors.last().copied().unwrap_or(1.0);
                let all = (0..CHANNELS.len()).flat_map(|c| (0..ANCHORS.len()).map(move |k| (c, k)));
                all.filter(|&(c, k)| CHANNELS[c] * ANCHORS[k] <= MOST_COEFFICIENTS)
                    .map(|(c, k)| candidate(CHANNELS[c], ANCHORS[k], points, residuals.error(global, c, k)))
                    .collect()
            }
        }
    };
    points.iter().zip(errors).flat_map(of_points).collect()
}

/// Settings under which sizes are tried: as many elements as are tried at most.
pub fn trial_settings(settings: TrainSettings, training: usize) -> TrainSettings {
    let elements = match settings.method {
        Method::Local => settings.elements,
        Method::Linear | Method::Belcour => MOST_ELEMENTS.min(training * (FOLDS - 1) / FOLDS / 2).max(1),
    };
    TrainSettings { elements, ..settings }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(bytes: u64, error: f64) -> Candidate {
        Candidate { size: Size { elements: bytes as usize, anchors: 0, points: 1, sub_points: 1 }, bytes, error }
    }

    #[test]
    fn budgets_are_kept() {
        let all: Vec<Candidate> =
            [(1, 0.5), (2, 0.3), (3, 0.31), (4, 0.2), (8, 0.198), (16, 0.1)].map(|(b, e)| candidate(b, e)).to_vec();
        let chosen = |max_error, max_bytes| Budget { max_error, max_bytes }.choose(&all).map(|c| c.bytes);
        assert_eq!(chosen(Some(0.3), None), Some(2), "the smallest that reaches it");
        assert_eq!(chosen(Some(0.05), None), Some(16), "the best where none does");
        assert_eq!(chosen(None, Some(3)), Some(2), "the best that fits");
        assert_eq!(chosen(None, Some(10)), Some(4), "the smallest of those alike");
        assert_eq!(chosen(Some(0.15), Some(10)), Some(4), "both, the error out of reach");
        assert_eq!(chosen(Some(0.4), Some(10)), Some(2), "both");
        assert_eq!(chosen(None, Some(0)), None, "nothing fits");
    }
}
