//! What training needs: conditions, measurement points, λ; and what more lights at once do.

use super::super::assemble::{Inputs, ReportError};
use super::super::comparison::standard_deviation;
use super::super::page::{Block, Plot, Section};
use super::super::plot::{Axis, Series, line_plot};
use super::super::table::lines;
use super::super::temporal::Measured;
use super::series_of;
use crate::dataset::Dataset;
use crate::math::sampler::mix64;
use crate::measure::MeasurementPoints;
use crate::progress::Progress;
use crate::transfer::error::mean_median_worst;
use crate::transfer::{Gram, HeldOutErrors, Lambda, Method, Probe, Spectrum, TrainSettings, TransferError};

const SIZES: [usize; 1] = [16];
const LOCAL_SIZES: [usize; 1] = [4];

/// Points that are tried.
const POINTS: [usize; 6] = [16, 32, 64, 128, 256, 512];

/// Fewest conditions that are trained on.
const FEWEST: usize = 16;

/// Lights at once.
const TOGETHER: [usize; 5] = [1, 2, 4, 8, 16];

/// Random sums of held-out lights that are tested.
const SUMS: u64 = 128;

/// Error over the number of conditions, the number of points, λ, and lights that shine together.
///
/// # Errors
/// When a fit fails, or `progress` cancels.
pub fn sweeps(inputs: &Inputs, progress: &dyn Progress) -> Result<Section, ReportError> {
    let sweeps =
        [conditions(inputs, progress)?, points(inputs, progress)?, lambda(inputs)?, together(inputs, progress)?];
    let (plots, data) = sweeps.into_iter().unzip();
    Ok(Section {
        here: "Mean over held-out lights, of 16 elements (4 channels a texel of a local basis).".into(),
        blocks: vec![Block::Plots(plots)],
        data,
        ..Section::default()
    })
}

/// Lines of a plot, and of its data.
#[derive(Default)]
struct Sweep {
    series: Vec<Series>,
    rows: Vec<[String; 5]>,
}

impl Sweep {
    /// Adds each fit's errors at `at`.
    fn add(&mut self, at: f64, label: &super::Label, errors: &[f64]) {
        let (mean, median, _) = mean_median_worst(errors);
        let series = series_of(label);
        let line = match self.series.iter().position(|s| s.label == series.label) {
            Some(line) => line,
            None => {
                self.series.push(series);
                self.series.len() - 1
            }
        };
        self.series[line].points.push((at, mean));
        let fields =
            [label.method.to_owned(), label.size.to_string(), at.to_string(), mean.to_string(), median.to_string()];
        self.rows.push(fields);
    }

    /// Fits to `dataset` and tests on its held-out conditions.
    fn fit(
        &mut self,
        at: f64,
        inputs: &Inputs,
        set: Measured,
        gram: &Gram,
        progress: &dyn Progress,
    ) -> Result<(), ReportError> {
        let fits = inputs.recipe.one_size(&SIZES, &LOCAL_SIZES).fit(set, gram, progress)?;
        for fitted in &fits.list {
            let errors = fits.test(fitted, set.dataset, gram, progress)?.errors();
            self.add(at, &fitted.label, &errors.transfer);
        }
        Ok(())
    }

    /// The plot, and the name and text of its data.
    fn plot(self, name: &str, title: &str, note: &str, x: &Axis, column: &str) -> Drawn {
        let plot = Plot {
            name: name.into(),
            title: title.into(),
            note: note.into(),
            svg: line_plot(x, &Axis::error("relative RMSE"), &self.series),
        };
        (plot, (format!("{name}.csv"), lines(&format!("method,coefficients,{column},mean,median"), self.rows)))
    }
}

/// A plot and its data.
type Drawn = (Plot, (String, String));

/// Error over N: the first conditions of the training set.
fn conditions(inputs: &Inputs, progress: &dyn Progress) -> Result<Drawn, ReportError> {
    let own = &inputs.scenarios[0];
    let dataset = own.sets[0].dataset;
    let mut counts: Vec<usize> = (0..).map(|i| FEWEST << i).take_while(|&n| n < dataset.training).collect();
    counts.push(dataset.training);
    let mut sweep = Sweep::default();
    for &count in &counts {
        let picks: Vec<usize> = (0..count).chain(dataset.held_out()).collect();
        let some = Dataset::gather(&[(dataset, picks.clone())], count, progress)?;
        let set = Measured { dataset: &some, ..own.sets[0] };
        sweep.fit(count as f64, inputs, set, &own.gram.select(&picks), progress)?;
    }
    let here = "The more conditions, the better both basis and transfer know the light.";
    Ok(sweep.plot("sweep-conditions", "Conditions to train on", here, &Axis::at("conditions N", counts), "conditions"))
}

/// Error over P: points placed anew, direct light measured anew, the lightmaps as they are.
fn points(inputs: &Inputs, progress: &dyn Progress) -> Result<Drawn, ReportError> {
    let own = &inputs.scenarios[0];
    let sub_points = inputs.model.points.neighbours_per_point();
    let mut sweep = Sweep::default();
    for count in POINTS {
        // Places for as many points there are on any asset that has points at all.
        let Ok(points) = MeasurementPoints::place(&inputs.model.asset, count, sub_points, inputs.bake.seed) else {
            continue;
        };
        let dataset = own.sets[0].dataset.measured_at(inputs.tracer, &points);
        let set = Measured { dataset: &dataset, points: &points, tracer: inputs.tracer };
        sweep.fit(count as f64, inputs, set, own.gram, progress)?;
    }
    let here =
        format!("Each the mean of {sub_points} sub-points. The paper (5.1): their number trades quality for time.");
    Ok(sweep.plot("sweep-points", "Measurement points", &here, &Axis::at("measurement points P", POINTS), "points"))
}

/// Error over λ, for the global methods.
fn lambda(inputs: &Inputs) -> Result<Drawn, ReportError> {
    let own = &inputs.scenarios[0];
    let dataset = own.sets[0].dataset;
    let mut sweep = Sweep::default();
    for method in [Method::Belcour, Method::Linear] {
        let elements = SIZES[0].min(dataset.training);
        let settings = |lambda| TrainSettings { method, channels: inputs.recipe.channels, elements, lambda };
        let one = TrainSettings { elements: 1, ..settings(Lambda::LeaveOneOut) };
        let spectrum = Spectrum::of(dataset, own.gram, one)?;
        let label = super::Label { method: method.name(), size: elements, lambda_choice: "given" };
        for half_decade in -14..=2 {
            let value = 10f64.powf(half_decade as f64 / 2.0);
            let fit = match spectrum.fit(settings(Lambda::Relative(value))) {
                // Too many were dropped for as many elements.
                Err(TransferError::TooFewConditions { .. }) => break,
                other => other?,
            };
            let errors = HeldOutErrors::of(&fit, dataset, own.gram);
            sweep.add(value, &label, &errors.transfer);
        }
    }
    let here = "Relative to trace(DDᵀ)/P. All is learnt from lightmaps here, nothing known beforehand. The table above has the λ that each fit used.";
    let x = Axis { label: "λ, relative", log: true, ..Axis::default() };
    Ok(sweep.plot("sweep-lambda", "Ridge", here, &x, "lambda"))
}

/// Error on several held-out lights at once.
fn together(inputs: &Inputs, progress: &dyn Progress) -> Result<Drawn, ReportError> {
    let own = &inputs.scenarios[0];
    let dataset = own.sets[0].dataset;
    let fits = inputs.recipe.one_size(&SIZES, &LOCAL_SIZES).fit(own.sets[0], own.gram, progress)?;
    let mut sweep = Sweep::default();
    for fitted in &fits.list {
        let tested = fits.test(fitted, dataset, own.gram, progress)?;
        let lit = tested.lit();
        let counts = TOGETHER.into_iter().filter(|&count| count <= lit.len());
        for count in counts {
            let errors: Vec<f64> = (0..SUMS.min(lit.len() as u64))
                .map(|sum| {
                    // A walk through the lit conditions from a random one with a random step that has no factor in common: none twice.
                    let random = mix64(mix64(sum) ^ count as u64);
                    let first = if count == 1 { sum as usize } else { random as usize };
                    let step =
                        (1 + (random >> 32) as usize % lit.len()..).find(|&s| gcd(s, lit.len()) == 1).unwrap_or(1);
                    let parts = (0..count).map(|i| (lit[first.wrapping_add(i * step) % lit.len()], 1.0)).collect();
                    let (error, norm) = tested.squared_error(&Probe { parts, together: true });
                    (error / norm).sqrt()
                })
                .collect();
            sweep.add(count as f64, &fitted.label, &errors);
            let line = sweep.series.iter_mut().find(|s| s.label == series_of(&fitted.label).label);
            let error_of_mean = standard_deviation(&errors).unwrap_or(0.0) / (errors.len() as f64).sqrt();
            line.into_iter().for_each(|line| line.spreads.push(error_of_mean));
        }
    }
    let here = "Trained on the scenario's conditions, tested on random sums of held-out ones. Transport is linear; the baseline is not, \
                since it divides by the norm of x and adds a mean that is scaled by it. Bars: standard error of the mean.";
    Ok(sweep.plot(
        "sweep-together",
        "Lights together",
        here,
        &Axis::at("conditions that shine together", TOGETHER),
        "together",
    ))
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}
