//! Held-out error of every method over basis sizes and orders.

use glam::Vec3;
use rayon::prelude::*;
use serde::Serialize;

use crate::dataset::Dataset;
use crate::light::{EmissionFacets, LightingCondition};
use crate::math::Rgb;
use crate::model::Channels;
use crate::prt::{ShPrt, light_coefficients};
use crate::transfer::error::mean_median_worst;
use crate::transfer::{Fit, Gram, HeldOutErrors, Lambda, Method, PUBLISHED_LAMBDA, TrainSettings, TransferError};

/// Basis sizes that are compared: the paper's 4, 16 and 64 and those between.
pub const SIZES: [usize; 5] = [4, 8, 16, 32, 64];

/// Orders of spherical harmonics that are compared; order l has l² coefficients a channel.
pub const ORDERS: [usize; 4] = [3, 4, 5, 6];

/// Held-out error of one method at one size, as fractions.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// belcour, linear, sh_prt_vertex or sh_prt_texel.
    pub method: &'static str,
    /// What is stored and multiplied per texel (or vertex) and channel.
    pub coefficients: usize,
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

/// Everything that is compared under one scenario.
pub struct Comparison<'a> {
    pub scenario: String,
    pub dataset: &'a Dataset,
    pub gram: &'a Gram,
    /// Direct irradiance of the held-out conditions at the texels: `[texel][channel][held-out condition]`.
    pub direct: &'a [f32],
    pub channels: Channels,
    /// λ given by the user for every fit, relative.
    pub lambda: Option<f64>,
}

impl Comparison<'_> {
    /// The data-driven methods at every size that the training set allows. The baseline appears twice: with the paper's λ,
    /// and with the λ that leave-one-out finds, which is better still.
    pub fn data_driven(&self) -> Result<Vec<Row>, TransferError> {
        let lambdas = |method| match (self.lambda, method) {
            (Some(value), _) => vec![(Lambda::Relative(value), "given")],
            (None, Method::Linear) => vec![(Lambda::LeaveOneOut, "leave-one-out")],
            (None, Method::Belcour) => vec![(PUBLISHED_LAMBDA, "published"), (Lambda::LeaveOneOut, "leave-one-out")],
        };
        let mut rows = Vec::new();
        for (method, name) in [(Method::Belcour, "belcour"), (Method::Linear, "linear")] {
            for (lambda, choice) in lambdas(method) {
                for elements in SIZES {
                    let settings = TrainSettings { method, channels: self.channels, elements, lambda };
                    match Fit::train(self.dataset, self.gram, settings) {
                        Ok(fit) => rows.push(self.row(name, choice, &fit)),
                        // A training set smaller than the size has no such row.
                        Err(TransferError::TooFewConditions { .. }) => break,
                        Err(error) => return Err(error),
                    }
                }
            }
        }
        Ok(rows)
    }

    fn row(&self, method: &'static str, choice: &'static str, fit: &Fit) -> Row {
        let errors = HeldOutErrors::of(fit, self.dataset, self.gram);
        let summary = errors.summary();
        let shares = self.indirect_shares();
        let lit = self.dataset.held_out().filter(|&h| self.gram.is_lit(h));
        let total: Vec<f64> = lit.zip(&errors.transfer).map(|(h, e)| e * shares[h - self.dataset.training]).collect();
        Row {
            method,
            coefficients: fit.settings.elements,
            points: self.dataset.points(),
            scenario: self.scenario.clone(),
            mean: summary.mean,
            median: summary.median,
            worst: summary.worst,
            oracle_mean: Some(summary.oracle_mean),
            total_mean: mean_median_worst(&total).0,
            lambda: Some(fit.lambda),
            lambda_choice: Some(choice),
        }
    }

    /// Classical SH PRT at every order; `centre` is where local lights are seen from.
    pub fn classical(&self, prt: &ShPrt, method: &'static str, emission: &EmissionFacets, centre: Vec3) -> Vec<Row> {
        let held_out: Vec<&LightingCondition> = self.dataset.held_out().map(|h| &self.dataset.conditions[h]).collect();
        let lit: Vec<usize> = (0..held_out.len()).filter(|h| self.gram.is_lit(self.dataset.training + h)).collect();
        ORDERS
            .iter()
            .filter(|&&order| order <= prt.order)
            .map(|&order| {
                let (errors, totals): (Vec<f64>, Vec<f64>) = lit
                    .par_iter()
                    .map(|&h| {
                        let light = light_coefficients(&held_out[h].lights, emission, centre, order);
                        let (indirect, direct) = (prt.indirect(&light), prt.direct(&light));
                        let error = self.distance(h, |t| indirect[t], |_, _| Rgb::ZERO);
                        let total = self.distance(h, |t| indirect[t] + direct[t], |direct, _| direct);
                        (error, total)
                    })
                    .unzip();
                let (mean, median, worst) = mean_median_worst(&errors);
                Row {
                    method,
                    coefficients: order * order,
                    points: 0,
                    scenario: self.scenario.clone(),
                    mean,
                    median,
                    worst,
                    oracle_mean: None,
                    total_mean: mean_median_worst(&totals).0,
                    lambda: None,
                    lambda_choice: None,
                }
            })
            .collect()
    }

    /// Relative RMSE of `estimate` on held-out condition `h`: against the indirect light plus what `part` takes of (direct,
    /// indirect).
    fn distance(&self, h: usize, estimate: impl Fn(usize) -> Rgb, part: impl Fn(Rgb, Rgb) -> Rgb) -> f64 {
        let (mut error, mut norm) = (0.0, 0.0);
        for (t, &area) in self.dataset.texel_areas.iter().enumerate() {
            let (direct, indirect) = self.truth(t, h);
            let truth = indirect + part(direct, indirect);
            error += area as f64 * (truth - estimate(t)).length_squared() as f64;
            norm += area as f64 * truth.length_squared() as f64;
        }
        (error / norm).sqrt()
    }

    /// Direct and indirect irradiance at a texel under held-out condition `h`.
    pub fn truth(&self, texel: usize, h: usize) -> (Rgb, Rgb) {
        let (n, held_out) = (self.dataset.conditions.len(), self.dataset.held_out());
        let count = held_out.len();
        let at = |matrix: &[f32], n: usize, k: usize| {
            Rgb::from_array(std::array::from_fn(|channel| matrix[(texel * 3 + channel) * n + k]))
        };
        (at(self.direct, count, h), at(&self.dataset.indirect, n, held_out.start + h))
    }

    /// Per held-out condition, |i| over |direct + i|.
    fn indirect_shares(&self) -> Vec<f64> {
        let share = |h: usize| {
            let texels = self.dataset.texel_areas.iter().enumerate();
            let total: f64 = texels
                .map(|(t, &area)| {
                    let (direct, indirect) = self.truth(t, h);
                    area as f64 * (direct + indirect).length_squared() as f64
                })
                .sum();
            (self.gram.squared_norm(self.dataset.training + h) / total).sqrt()
        };
        (0..self.dataset.held_out().len()).into_par_iter().map(share).collect()
    }
}
