//! Figure 6: transfer in gamma space.

use rayon::prelude::*;

use super::super::assemble::{Inputs, ReportError};
use super::super::page::{Block, Plot, Section, method_colour, method_label, percent};
use super::super::plot::{Axis, Series, line_plot};
use super::super::table::lines;
use crate::dataset::{Dataset, Indirect};
use crate::math::Rgb;
use crate::model::Transfer;
use crate::progress::Progress;
use crate::transfer::error::mean_median_worst;
use crate::transfer::gamma::GAMMA;
use crate::transfer::{Fit, Gram, Lambda, Method, PUBLISHED_LAMBDA, TrainSettings, TransferError};

const SIZES: [usize; 5] = [4, 8, 16, 32, 64];

/// Texels that the comparison looks at, evenly spread: their light is held in memory.
const MOST_TEXELS: usize = 4096;

/// None where the lightmaps would not fit into memory.
pub fn gamma(inputs: &Inputs, progress: &dyn Progress) -> Result<Option<Section>, ReportError> {
    let dataset = inputs.scenarios[0].sets[0].dataset;
    let stride = dataset.texels().div_ceil(MOST_TEXELS).max(1);
    let row = 3 * dataset.conditions.len();
    // The lightmaps as they are and raised, and what is reconstructed.
    if !inputs.fits_memory((3 * 4 * row * dataset.texels().div_ceil(stride)) as u64) {
        return Ok(None);
    }
    let plain = dataset.thinned(stride, progress)?;
    let raised = plain.roots(GAMMA);
    let (mut series, mut rows) = (Vec::new(), Vec::new());
    let mut said = Vec::new();
    for (method, lambda) in [(Method::Belcour, PUBLISHED_LAMBDA), (Method::Linear, Lambda::LeaveOneOut)] {
        let mut of_space = Vec::new();
        for (space, set, gamma) in [("linear light", &plain, 1.0), ("gamma 2.2", &raised, GAMMA)] {
            let gram = Gram::of(set, progress)?;
            let mut points = Vec::new();
            for elements in SIZES {
                let lambda = inputs.recipe.lambda.map_or(lambda, Lambda::Relative);
                let settings = TrainSettings { method, channels: inputs.recipe.channels, elements, lambda };
                let fit = match Fit::train(set, &gram, settings) {
                    Err(TransferError::TooFewConditions { .. }) => break,
                    other => other?,
                };
                let (values, transfer) = fit.expand(set, progress)?;
                let [linear, seen] = errors(&plain, set, &values, &transfer, gamma, &gram);
                points.push((elements as f64, linear, seen));
                rows.push([
                    method.name().to_owned(),
                    space.to_owned(),
                    elements.to_string(),
                    linear.to_string(),
                    seen.to_string(),
                ]);
            }
            of_space.push(points.iter().find(|p| p.0 == 16.0).copied());
            let choice = if method == Method::Belcour { Some("published") } else { None };
            for k in 0..2 {
                series.push((
                    k,
                    Series {
                        label: format!("{}, {space}", method_label(method.name(), None)),
                        colour: method_colour(method.name(), choice) + if gamma == 1.0 { 0 } else { 1 },
                        points: points.iter().map(|p| (p.0, if k == 0 { p.1 } else { p.2 })).collect(),
                        ..Series::default()
                    },
                ));
            }
        }
        if let [Some(plain), Some(raised)] = of_space[..] {
            said.push(format!(
                "{}: {} → {} in light, {} → {} in gamma-coded light",
                method_label(method.name(), None),
                percent(plain.1),
                percent(raised.1),
                percent(plain.2),
                percent(raised.2)
            ));
        }
    }
    let plot = |k: usize, name: &str, title: &str, y: &str| Plot {
        name: format!("figure-06-{name}"),
        title: title.into(),
        note: "Negative light is cut off before it is compared.".into(),
        svg: line_plot(
            &Axis::at("elements", SIZES),
            &Axis::error(y),
            &series.iter().filter(|s| s.0 == k).map(|s| s.1.clone()).collect::<Vec<_>>(),
        ),
    };
    Ok(Some(Section {
        title: "Figure 6: gamma space".into(),
        paper: Some(
            "for subsurface scattering, whose contrast is high, transfer between gamma-corrected values looks closer to the reference.",
        ),
        here: format!(
            "D and I raised to 1 / {GAMMA} before training, the result raised back; with 16 elements, linear → gamma space: {}. In gamma \
             space two lights do not add.",
            said.join("; ")
        ),
        blocks: vec![Block::Plots(vec![
            plot(0, "light", "Error of the light", "relative RMSE"),
            plot(1, "seen", "Error of the light as it is coded for display", "relative RMSE of light^(1/2.2)"),
        ])],
        data: vec![(
            "figure-06-gamma.csv".into(),
            lines("method,space,elements,mean_of_light,mean_of_gamma_coded_light", rows),
        )],
    }))
}

fn values_of(dataset: &Dataset) -> &[f32] {
    match &dataset.indirect {
        Indirect::Memory(values) => values,
        _ => unreachable!("thinned into memory"),
    }
}

/// Mean relative RMSE over held-out conditions of what a basis gives for the direct light of `set`, raised to `gamma`: of the light
/// itself, and of its 2.2th root.
fn errors(plain: &Dataset, set: &Dataset, values: &[f32], transfer: &Transfer, gamma: f32, gram: &Gram) -> [f64; 2] {
    let (texels, n) = (plain.texels(), plain.conditions.len());
    let components = transfer.channels.components();
    let truth = values_of(plain);
    let lit: Vec<usize> = plain.held_out().filter(|&h| gram.is_lit(h)).collect();
    let of_condition = |&h: &usize| {
        let u = transfer.coefficients(&set.direct(h));
        let (mut errors, mut norms) = ([0.0; 2], [0.0; 2]);
        for (t, &area) in plain.texel_areas.iter().enumerate() {
            let value = |j: usize, c: usize| values[(j * components + c % components) * texels + t];
            for channel in 0..3 {
                let sum: f32 = u.iter().enumerate().map(|(j, u): (usize, &Rgb)| u[channel] * value(j, channel)).sum();
                let (light, truth) = (sum.max(0.0).powf(gamma), truth[(t * 3 + channel) * n + h].max(0.0));
                for (k, power) in [1.0, 1.0 / GAMMA].into_iter().enumerate() {
                    let (light, truth) = (light.powf(power), truth.powf(power));
                    errors[k] += (area * (light - truth) * (light - truth)) as f64;
                    norms[k] += (area * truth * truth) as f64;
                }
            }
        }
        [0, 1].map(|k| (errors[k] / norms[k]).sqrt())
    };
    let each: Vec<[f64; 2]> = lit.par_iter().map(of_condition).collect();
    [0, 1].map(|k| mean_median_worst(&each.iter().map(|e| e[k]).collect::<Vec<_>>()).0)
}
