//! Figure 3: eigenvalues of the indirect light.

use super::super::assemble::{Inputs, ReportError};
use super::super::page::{Block, Plot, Section};
use super::super::plot::{Axis, Series, line_plot};
use super::super::table::lines;
use crate::transfer::{Lambda, Method, Spectrum, TrainSettings};

/// Eigenvalues under this share of the first are not drawn.
const LEAST: f64 = 1e-9;

/// The paper's own threshold: "they drop quickly below 1%".
const SMALL: f64 = 0.01;

pub fn eigenvalues(inputs: &Inputs) -> Result<Section, ReportError> {
    let (mut series, mut rows, mut said) = (Vec::new(), Vec::new(), Vec::new());
    for (i, scenery) in inputs.scenarios.iter().enumerate() {
        for (method, name) in [(Method::Belcour, "as published"), (Method::Linear, "linear")] {
            let settings =
                TrainSettings { method, channels: inputs.recipe.channels, elements: 1, lambda: Lambda::LeaveOneOut };
            let spectrum = Spectrum::of(scenery.sets[0].dataset, scenery.gram, settings)?;
            let first = spectrum.singular_values()[0].max(f64::MIN_POSITIVE);
            let relative: Vec<f64> = spectrum.singular_values().iter().map(|s| (s / first).powi(2)).collect();
            for (element, value) in relative.iter().enumerate() {
                rows.push([
                    scenery.name.to_owned(),
                    method.name().to_owned(),
                    (element + 1).to_string(),
                    value.to_string(),
                ]);
            }
            let above = relative.iter().filter(|&&v| v >= SMALL).count();
            said.push(format!("{above} ({}, {name})", scenery.name));
            series.push(Series {
                label: format!("{}, {name}", scenery.name),
                colour: 2 * i + usize::from(method == Method::Belcour),
                points: (1..).map(f64::from).zip(relative.into_iter().take_while(|&v| v > LEAST)).collect(),
                ..Series::default()
            });
        }
    }
    let svg = line_plot(
        &Axis { log: true, label: "element", ..Axis::default() },
        &Axis::error("eigenvalue / largest"),
        &series,
    );
    Ok(Section {
        title: "Figure 3: eigenvalues of the indirect light".into(),
        paper: Some(
            "relative eigenvalues of the autocorrelation of the indirect light drop quickly below 1 %: few dimensions are relevant.",
        ),
        here: format!("as many elements are at or above 1 % of the largest: {}.", said.join(", ")),
        blocks: vec![Block::Plots(vec![Plot {
            name: "figure-03-eigenvalues".into(),
            title: String::new(),
            note: "Squared singular values of the training lightmaps, weighted and centred as each method does it."
                .into(),
            svg,
        }])],
        data: vec![("figure-03-eigenvalues.csv".into(), lines("scenario,method,element,relative_eigenvalue", rows))],
    })
}
