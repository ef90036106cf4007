//! Held-out error of every method over basis sizes and orders.

use glam::Vec3;
use rayon::prelude::*;
use serde::Serialize;

use crate::dataset::{Dataset, DatasetError};
use crate::light::{EmissionFacets, LightingCondition};
use crate::math::Rgb;
use crate::model::Channels;
use crate::progress::Progress;
use crate::prt::{ShPrt, light_coefficients};
use crate::transfer::error::mean_median_worst;
use crate::transfer::{
    Fit, Gram, HeldOutErrors, Lambda, LocalFit, Method, PUBLISHED_LAMBDA, Precision, Prior, Terms, TrainSettings,
    TransferError,
};

/// Basis sizes that are compared: the paper's 4, 16 and 64 and those between.
pub const SIZES: [usize; 5] = [4, 8, 16, 32, 64];

/// Channels a texel of local bases that are compared.
pub const LOCAL_SIZES: [usize; 2] = [4, 8];

/// Orders of spherical harmonics that are compared; order l has l² coefficients a channel.
pub const ORDERS: [usize; 4] = [3, 4, 5, 6];

/// Held-out error of one method at one size, as fractions.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// belcour, linear, local, sh_prt_vertex or sh_prt_texel.
    pub method: &'static str,
    /// What is stored and multiplied per texel (or vertex) and channel.
    pub coefficients: usize,
    /// What a texel of the basis takes in the model; none for SH PRT.
    pub bytes_per_texel: Option<usize>,
    /// P; 0 for SH PRT, which measures nothing.
    pub points: usize,
    pub scenario: String,
    pub mean: f64,
    pub median: f64,
    pub worst: f64,
    /// Mean error of the truth projected on the basis; none for SH PRT.
    pub oracle_mean: Option<f64>,
    /// Mean error of direct and indirect light together, relative to both. The data-driven methods take direct light from
    /// the renderer as it is; SH PRT reconstructs it.
    pub total_mean: f64,
    /// Relative to trace(DDᵀ)/P; none for SH PRT.
    pub lambda: Option<f64>,
    /// How λ was chosen: `published`, `leave-one-out` or `given`; none for SH PRT.
    pub lambda_choice: Option<&'static str>,
}

/// Bakes the direct irradiance of some conditions, `[texel][channel][condition]`.
pub type DirectOf<'d, E> = dyn Fn(&[LightingCondition]) -> Result<Vec<f32>, E> + 'd;

/// Everything that is compared under one scenario.
pub struct Comparison<'a> {
    pub scenario: String,
    pub dataset: &'a Dataset,
    pub gram: &'a Gram,
    /// What is known of the transfer of `linear` and `local` beforehand.
    pub prior: Option<&'a Prior>,
    pub channels: Channels,
    /// λ given by the user for every fit, relative.
    pub lambda: Option<f64>,
    /// Position and normal of each texel.
    pub places: &'a [(Vec3, Vec3)],
    /// Anchors of local bases, and how their channels are stored.
    pub anchors: usize,
    pub precision: Precision,
    /// Classical SH PRT, by name.
    pub classical: &'a [(&'static str, &'a ShPrt)],
    /// Where local lights are seen from by classical SH PRT.
    pub centre: Vec3,
    /// What stands for the asset's own emission.
    pub emission: &'a EmissionFacets,
    /// Held-out lightmaps that are looked at together.
    pub at_once: usize,
}

/// What the lightmaps tell: the rest follows from inner products.
#[derive(Default)]
struct Looked {
    /// Per held-out condition, |i| over |direct + i|.
    indirect_shares: Vec<f64>,
    /// Per classical method and order, the error of the indirect and of all light of each held-out condition that is lit.
    classical: Vec<(Vec<f64>, Vec<f64>)>,
}

impl Comparison<'_> {
    /// All rows: the data-driven methods first.
    pub fn rows<E: From<TransferError> + From<DatasetError>>(
        &self,
        direct_of: &DirectOf<E>,
        progress: &dyn Progress,
    ) -> Result<Vec<Row>, E> {
        let looked = self.look(direct_of, progress)?;
        let mut rows = self.data_driven(&looked.indirect_shares)?;
        rows.extend(self.local(&looked.indirect_shares, progress)?);
        let sizes = self.classical.iter().flat_map(|(name, prt)| orders(prt).map(move |order| (*name, order)));
        for ((method, order), (errors, totals)) in sizes.zip(&looked.classical) {
            let (mean, median, worst) = mean_median_worst(errors);
            rows.push(Row {
                method,
                coefficients: order * order,
                bytes_per_texel: None,
                points: 0,
                scenario: self.scenario.clone(),
                mean,
                median,
                worst,
                oracle_mean: None,
                total_mean: mean_median_worst(totals).0,
                lambda: None,
                lambda_choice: None,
            });
        }
        Ok(rows)
    }

    /// Walks the held-out lightmaps, some at a time.
    fn look<E: From<DatasetError>>(&self, direct_of: &DirectOf<E>, progress: &dyn Progress) -> Result<Looked, E> {
        let methods: usize = self.classical.iter().map(|(_, prt)| orders(prt).count()).sum();
        let mut looked = Looked { indirect_shares: Vec::new(), classical: vec![Default::default(); methods] };
        let held_out = self.dataset.held_out();
        for first in held_out.clone().step_by(self.at_once.max(1)) {
            let range = first..(first + self.at_once.max(1)).min(held_out.end);
            let conditions = &self.dataset.conditions[range.clone()];
            let truth = Truth {
                direct: &direct_of(conditions)?,
                indirect: &self.dataset.indirect_of(range.clone(), progress)?,
                areas: &self.dataset.texel_areas,
                conditions: conditions.len(),
            };
            let share = |k: usize| (self.gram.squared_norm(first + k) / truth.squared_norm(k)).sqrt();
            looked.indirect_shares.par_extend((0..conditions.len()).into_par_iter().map(share));
            let lit: Vec<usize> = (0..conditions.len()).filter(|k| self.gram.is_lit(first + k)).collect();
            let sizes = self.classical.iter().flat_map(|(_, prt)| orders(prt).map(move |order| (*prt, order)));
            for ((prt, order), (errors, totals)) in sizes.zip(&mut looked.classical) {
                let of = lit.par_iter().map(|&k| {
                    let light = light_coefficients(&conditions[k].lights, self.emission, self.centre, order);
                    let (indirect, direct) = (prt.indirect(&light), prt.direct(&light));
                    let error = truth.distance(k, |t| indirect[t], |_, _| Rgb::ZERO);
                    let total = truth.distance(k, |t| indirect[t] + direct[t], |direct, _| direct);
                    (error, total)
                });
                let (some_errors, some_totals): (Vec<f64>, Vec<f64>) = of.unzip();
                errors.extend(some_errors);
                totals.extend(some_totals);
            }
        }
        Ok(looked)
    }

    /// The global methods at every size that the training set allows. The baseline appears twice: with the paper's λ,
    /// and with the λ that leave-one-out finds, which is better still.
    fn data_driven(&self, indirect_shares: &[f64]) -> Result<Vec<Row>, TransferError> {
        let lambdas = |method| match (self.lambda, method) {
            (Some(value), _) => vec![(Lambda::Relative(value), "given")],
            (None, Method::Linear | Method::Local) => vec![(Lambda::LeaveOneOut, "leave-one-out")],
            (None, Method::Belcour) => vec![(PUBLISHED_LAMBDA, "published"), (Lambda::LeaveOneOut, "leave-one-out")],
        };
        let mut rows = Vec::new();
        for (method, name) in [(Method::Belcour, "belcour"), (Method::Linear, "linear")] {
            for (lambda, choice) in lambdas(method) {
                for elements in SIZES {
                    let settings = TrainSettings { method, channels: self.channels, elements, lambda };
                    match self.fit(settings) {
                        Ok(fit) => {
                            let errors = HeldOutErrors::of(&fit, self.dataset, self.gram);
                            let bytes = 2 * elements * self.channels.components();
                            rows.push(self.row(name, elements, bytes, (fit.lambda, choice), &errors, indirect_shares));
                        }
                        // A training set smaller than the size has no such row.
                        Err(TransferError::TooFewConditions { .. }) => break,
                        Err(error) => return Err(error),
                    }
                }
            }
        }
        Ok(rows)
    }

    fn fit(&self, settings: TrainSettings) -> Result<Fit, TransferError> {
        let fit = Fit::train(self.dataset, self.gram, settings)?;
        match self.prior.filter(|_| settings.method != Method::Belcour) {
            Some(prior) => fit.with_prior(self.dataset, prior),
            None => Ok(fit),
        }
    }

    /// Local bases, which share their terms.
    fn local(&self, indirect_shares: &[f64], progress: &dyn Progress) -> Result<Vec<Row>, TransferError> {
        let (lambda, choice) = match self.lambda {
            Some(value) => (Lambda::Relative(value), "given"),
            None => (Lambda::LeaveOneOut, "leave-one-out"),
        };
        let settings = TrainSettings { method: Method::Local, channels: self.channels, elements: 1, lambda };
        let fit = self.fit(settings)?;
        let terms = Terms::new(&fit, self.dataset, self.places, self.anchors, progress)?;
        let row = |channels: usize| {
            let local = LocalFit::train(&terms, channels, self.precision);
            let (dataset, gram) = (self.dataset, self.gram);
            let errors = HeldOutErrors::of_local(&local, &terms, self.channels, dataset, gram, progress)?;
            let bytes = local.bytes_per_texel(self.channels);
            Ok(self.row("local", channels, bytes, (fit.lambda, choice), &errors, indirect_shares))
        };
        LOCAL_SIZES.into_iter().map(row).collect()
    }

    fn row(
        &self,
        method: &'static str,
        coefficients: usize,
        bytes_per_texel: usize,
        (lambda, choice): (f64, &'static str),
        errors: &HeldOutErrors,
        indirect_shares: &[f64],
    ) -> Row {
        let summary = errors.summary();
        let lit = self.dataset.held_out().filter(|&h| self.gram.is_lit(h));
        let total: Vec<f64> =
            lit.zip(&errors.transfer).map(|(h, e)| e * indirect_shares[h - self.dataset.training]).collect();
        Row {
            method,
            coefficients,
            bytes_per_texel: Some(bytes_per_texel),
            points: self.dataset.points(),
            scenario: self.scenario.clone(),
            mean: summary.mean,
            median: summary.median,
            worst: summary.worst,
            oracle_mean: Some(summary.oracle_mean),
            total_mean: mean_median_worst(&total).0,
            lambda: Some(lambda),
            lambda_choice: Some(choice),
        }
    }
}

/// The orders that are compared of those that were baked.
fn orders(prt: &ShPrt) -> impl Iterator<Item = usize> {
    let most = prt.order;
    ORDERS.into_iter().filter(move |&order| order <= most)
}

/// Lightmaps of some conditions: `[texel][channel][condition]`.
struct Truth<'t> {
    direct: &'t [f32],
    indirect: &'t [f32],
    areas: &'t [f32],
    conditions: usize,
}

impl Truth<'_> {
    /// Relative RMSE of `estimate` on condition `k`: against the indirect light plus what `part` takes of (direct, indirect).
    fn distance(&self, k: usize, estimate: impl Fn(usize) -> Rgb, part: impl Fn(Rgb, Rgb) -> Rgb) -> f64 {
        let (mut error, mut norm) = (0.0, 0.0);
        for (t, &area) in self.areas.iter().enumerate() {
            let (direct, indirect) = self.at(t, k);
            let truth = indirect + part(direct, indirect);
            error += area as f64 * (truth - estimate(t)).length_squared() as f64;
            norm += area as f64 * truth.length_squared() as f64;
        }
        (error / norm).sqrt()
    }

    /// |direct + i|² of condition `k`.
    fn squared_norm(&self, k: usize) -> f64 {
        let texels = self.areas.iter().enumerate();
        texels
            .map(|(t, &area)| {
                let (direct, indirect) = self.at(t, k);
                area as f64 * (direct + indirect).length_squared() as f64
            })
            .sum()
    }

    /// Direct and indirect irradiance.
    fn at(&self, texel: usize, k: usize) -> (Rgb, Rgb) {
        let of = |matrix: &[f32]| {
            Rgb::from_array(std::array::from_fn(|channel| matrix[(texel * 3 + channel) * self.conditions + k]))
        };
        (of(self.direct), of(self.indirect))
    }
}
