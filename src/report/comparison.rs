//! Error of every method over basis sizes and orders: on held-out lights, and of what changes from frame to frame.

use glam::Vec3;
use rayon::prelude::*;
use serde::Serialize;

use super::assemble::ReportError;
use super::cost::Cost;
use super::fits::{Fits, Label, Recipe};
use super::temporal::{Measured, Moving};
use crate::dataset::DatasetError;
use crate::light::{EmissionFacets, LightingCondition};
use crate::math::Rgb;
use crate::progress::Progress;
use crate::prt::{ShPrt, light_coefficients};
use crate::transfer::error::mean_median_worst;
use crate::transfer::{ErrorSummary, Gram, TransferError};

/// Orders of spherical harmonics that are compared; order l has l² coefficients a channel.
pub const ORDERS: [usize; 5] = [2, 3, 4, 5, 6];

/// Held-out error of one method at one size, as fractions.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// belcour, linear, local, sh_prt_vertex or sh_prt_texel.
    pub method: &'static str,
    /// What is stored and multiplied per texel (or vertex) and channel.
    pub coefficients: usize,
    #[serde(flatten)]
    pub cost: Cost,
    /// P; 0 for SH PRT, which measures nothing.
    pub points: usize,
    pub scenario: String,
    /// Means over the training sets; `worst` is that of all.
    pub mean: f64,
    pub median: f64,
    pub worst: f64,
    /// Standard deviation of the mean over training sets; none for one set, or where nothing is trained.
    pub spread: Option<f64>,
    /// The mean of each training set, that of the model first.
    pub means: Vec<f64>,
    /// Mean error of the truth projected on the basis; none for SH PRT.
    pub oracle_mean: Option<f64>,
    /// Mean error of direct and indirect light together, relative to both. The data-driven methods take direct light from
    /// the renderer as it is; SH PRT reconstructs it.
    pub total_mean: f64,
    /// Error of what changes from frame to frame along paths of moving lights, mean over paths and training sets; none where no
    /// light was moved.
    pub temporal: Option<f64>,
    /// Its standard deviation over training sets.
    pub temporal_spread: Option<f64>,
    /// Relative to trace(DDᵀ)/P, of the model's training set; none for SH PRT.
    pub lambda: Option<f64>,
    /// How λ was chosen: `published`, `leave-one-out` or `given`; none for SH PRT.
    pub lambda_choice: Option<&'static str>,
}

/// Bakes the direct irradiance of some conditions, `[texel][channel][condition]`.
pub type DirectOf<'d> = dyn Fn(&[LightingCondition]) -> Result<Vec<f32>, ReportError> + 'd;

/// Everything that is compared under one scenario.
pub struct Comparison<'a> {
    pub scenario: &'a str,
    /// Training sets with the same held-out conditions, that of the model first.
    pub sets: &'a [Measured<'a>],
    /// Of the first set.
    pub gram: &'a Gram,
    pub recipe: Recipe<'a>,
    /// Lights that move.
    pub moving: Option<&'a Moving>,
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

/// One fit on one training set.
struct Outcome {
    label: Label,
    cost: Cost,
    lambda: f64,
    summary: ErrorSummary,
    total: f64,
    /// Mean over paths.
    temporal: Option<f64>,
}

impl Comparison<'_> {
    /// All rows, the data-driven methods first, and the fits to the first training set.
    ///
    /// # Errors
    /// When a fit fails, a dataset cannot be read, or `progress` cancels.
    pub fn rows(&self, direct_of: &DirectOf, progress: &dyn Progress) -> Result<(Vec<Row>, Fits), ReportError> {
        let looked = self.look(direct_of, progress)?;
        let fits = self.recipe.fit(self.sets[0], self.gram, progress)?;
        let mut outcomes = vec![self.outcomes(&fits, &self.sets[0], self.gram, &looked.indirect_shares, progress)?];
        for set in &self.sets[1..] {
            let gram = Gram::of(set.dataset, progress)?;
            let fits = self.recipe.fit(*set, &gram, progress)?;
            outcomes.push(self.outcomes(&fits, set, &gram, &looked.indirect_shares, progress)?);
        }
        let mut rows: Vec<Row> = (outcomes[0].iter())
            .map(|first| {
                let same = |set: &Vec<Outcome>| set.iter().position(|o| o.label == first.label);
                let of_sets: Vec<&Outcome> = outcomes.iter().filter_map(|set| Some(&set[same(set)?])).collect();
                self.row(&of_sets)
            })
            .collect();
        let changes = match self.moving {
            Some(moving) => {
                self.classical.iter().map(|(_, prt)| self.classical_changes(prt, moving, progress)).collect()
            }
            None => Ok(Vec::<Vec<f64>>::new()),
        };
        let changes: Vec<f64> = changes?.concat();
        let sizes = self.classical.iter().flat_map(|(name, prt)| orders(prt).map(move |order| (*name, *prt, order)));
        for (i, ((method, prt, order), (errors, totals))) in sizes.zip(&looked.classical).enumerate() {
            let (mean, median, worst) = mean_median_worst(errors);
            rows.push(Row {
                method,
                coefficients: order * order,
                cost: Cost::classical(prt, order, self.recipe.lightmap_size),
                points: 0,
                scenario: self.scenario.to_owned(),
                mean,
                median,
                worst,
                spread: None,
                means: vec![mean],
                oracle_mean: None,
                total_mean: mean_median_worst(totals).0,
                temporal: changes.get(i).copied(),
                temporal_spread: None,
                lambda: None,
                lambda_choice: None,
            });
        }
        Ok((rows, fits))
    }

    /// Walks the held-out lightmaps, some at a time.
    fn look(&self, direct_of: &DirectOf, progress: &dyn Progress) -> Result<Looked, ReportError> {
        let dataset = self.sets[0].dataset;
        let methods: usize = self.classical.iter().map(|(_, prt)| orders(prt).count()).sum();
        let mut looked = Looked { indirect_shares: Vec::new(), classical: vec![Default::default(); methods] };
        let held_out = dataset.held_out();
        for first in held_out.clone().step_by(self.at_once.max(1)) {
            let range = first..(first + self.at_once.max(1)).min(held_out.end);
            let conditions = &dataset.conditions[range.clone()];
            let truth = Truth {
                direct: &direct_of(conditions)?,
                indirect: &dataset.indirect_of(range.clone(), progress)?,
                areas: &dataset.texel_areas,
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

    /// Every fit to `set`, tested.
    fn outcomes(
        &self,
        fits: &Fits,
        set: &Measured,
        gram: &Gram,
        indirect_shares: &[f64],
        progress: &dyn Progress,
    ) -> Result<Vec<Outcome>, TransferError> {
        let temporal = self.moving.map(|moving| moving.errors(fits, set, progress)).transpose()?;
        let outcome = |(k, fitted): (usize, &super::fits::Fitted)| {
            let tested = fits.test(fitted, set.dataset, gram, progress)?;
            let errors = tested.errors();
            let of_lit = tested.lit().into_iter().zip(&errors.transfer);
            let total: Vec<f64> = of_lit.map(|(h, e)| e * indirect_shares[h - set.dataset.training]).collect();
            Ok(Outcome {
                label: fitted.label,
                cost: fitted.cost,
                lambda: fitted.lambda,
                summary: errors.summary(),
                total: mean_median_worst(&total).0,
                temporal: temporal.as_ref().map(|of_fits| mean_median_worst(&of_fits[k]).0),
            })
        };
        fits.list.iter().enumerate().map(outcome).collect()
    }

    /// One fit's row from its outcomes on all training sets.
    fn row(&self, sets: &[&Outcome]) -> Row {
        let mean = |of: &dyn Fn(&Outcome) -> f64| sets.iter().map(|o| of(o)).sum::<f64>() / sets.len() as f64;
        let means: Vec<f64> = sets.iter().map(|o| o.summary.mean).collect();
        let temporal: Option<Vec<f64>> = sets.iter().map(|o| o.temporal).collect();
        Row {
            method: sets[0].label.method,
            coefficients: sets[0].label.size,
            cost: sets[0].cost,
            points: self.sets[0].dataset.points(),
            scenario: self.scenario.to_owned(),
            mean: mean(&|o| o.summary.mean),
            median: mean(&|o| o.summary.median),
            worst: sets.iter().map(|o| o.summary.worst).fold(0.0, f64::max),
            spread: standard_deviation(&means),
            means,
            oracle_mean: Some(mean(&|o| o.summary.oracle_mean)),
            total_mean: mean(&|o| o.total),
            temporal: temporal.as_ref().map(|t| mean_median_worst(t).0),
            temporal_spread: temporal.as_ref().and_then(|t| standard_deviation(t)),
            lambda: Some(sets[0].lambda),
            lambda_choice: Some(sets[0].label.lambda_choice),
        }
    }

    /// Error of what changes from frame to frame, per order, mean over the paths.
    fn classical_changes(
        &self,
        prt: &ShPrt,
        moving: &Moving,
        progress: &dyn Progress,
    ) -> Result<Vec<f64>, DatasetError> {
        let orders: Vec<usize> = orders(prt).collect();
        let areas = &self.sets[0].dataset.texel_areas;
        let mut errors = vec![Vec::new(); orders.len()];
        for path in moving.paths() {
            let mut sums = vec![(0.0, 0.0); orders.len()];
            // Frames some at a time; the last of them is the first of the next.
            for first in path.clone().step_by(self.at_once.max(1)) {
                let range = first..(first + self.at_once.max(1) + 1).min(path.end);
                let conditions = &moving.dataset.conditions[range.clone()];
                let indirect = &moving.dataset.indirect_of(range, progress)?;
                let truth = Truth { direct: &[], indirect, areas, conditions: conditions.len() };
                let light = |k: usize| light_coefficients(&conditions[k].lights, self.emission, self.centre, prt.order);
                for (&order, sums) in orders.iter().zip(&mut sums) {
                    let of = (1..conditions.len()).into_par_iter().map(|k| {
                        let change = light(k).into_iter().zip(light(k - 1)).map(|(a, b)| a - b);
                        let change: Vec<Rgb> = change.take(order * order).collect();
                        truth.distance_of_change(k, &prt.indirect(&change))
                    });
                    let parts: Vec<(f64, f64)> = of.collect();
                    parts.into_iter().for_each(|(error, norm)| *sums = (sums.0 + error, sums.1 + norm));
                }
            }
            // Along a path where nothing changes there is no relative error.
            let changing = errors.iter_mut().zip(&sums).filter(|(_, sums)| sums.1 > 0.0);
            changing.for_each(|(errors, sums)| errors.push((sums.0 / sums.1).sqrt()));
        }
        Ok(errors.iter().map(|of_paths| mean_median_worst(of_paths).0).collect())
    }
}

/// Of a sample; none of fewer than two values.
pub fn standard_deviation(values: &[f64]) -> Option<f64> {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.len() > 1).then(|| (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt())
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

    /// |Δi − Δî|² and |Δi|² of what changes from condition k − 1 to k.
    fn distance_of_change(&self, k: usize, estimate: &[Rgb]) -> (f64, f64) {
        let (mut error, mut norm) = (0.0, 0.0);
        for ((t, &area), estimate) in self.areas.iter().enumerate().zip(estimate) {
            let truth = self.value(self.indirect, t, k) - self.value(self.indirect, t, k - 1);
            error += area as f64 * (truth - estimate).length_squared() as f64;
            norm += area as f64 * truth.length_squared() as f64;
        }
        (error, norm)
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
        (self.value(self.direct, texel, k), self.value(self.indirect, texel, k))
    }

    fn value(&self, matrix: &[f32], texel: usize, k: usize) -> Rgb {
        Rgb::from_array(std::array::from_fn(|channel| matrix[(texel * 3 + channel) * self.conditions + k]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spread_is_the_sample_standard_deviation() {
        assert_eq!(standard_deviation(&[1.0, 2.0, 3.0]), Some(1.0));
        assert_eq!(standard_deviation(&[5.0]), None);
    }
}
