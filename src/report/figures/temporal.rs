//! Temporal stability: error of what changes from frame to frame, over sizes and along one path.

use super::super::assemble::{Inputs, ReportError, Results};
use super::super::comparison::Row;
use super::super::page::{Block, Plot, Section, method_colour, method_label, percent};
use super::super::plot::{Axis, Series, line_plot};
use super::super::table::lines;
use super::super::temporal::changes;
use super::series_of;
use crate::progress::Progress;

/// Methods and sizes whose error is followed along a path.
const FOLLOWED: [(&str, usize); 3] = [("belcour", 16), ("linear", 16), ("local", 4)];

pub fn temporal(inputs: &Inputs, results: &Results, progress: &dyn Progress) -> Result<Section, ReportError> {
    let Some(moving) = inputs.moving else {
        return Ok(Section {
            here: "Not measured: no light of the scenario moves, or its lightmaps come from another renderer, which has not \
                   rendered lights that move."
                .into(),
            ..Section::default()
        });
    };
    let own = &inputs.scenarios[0];
    let rows: Vec<&Row> =
        results.rows.iter().filter(|r| r.scenario == own.name && !r.method.starts_with("sh_prt")).collect();
    let sizes = line_plot(
        &Axis::at("coefficients per texel and channel", rows.iter().map(|r| r.coefficients)),
        &Axis::error("frame-to-frame error"),
        &over_sizes(&rows, &|r| r.temporal.map(|t| (t, r.temporal_spread))),
    );

    // Along the first path: the change of each frame, relative to the mean change.
    let (dataset, gram) = moving.after(&own.sets[0], progress)?;
    let (mut followed, mut data) = (Vec::new(), Vec::new());
    for (method, size) in FOLLOWED {
        let Some(fitted) = results.fits[0].find(method, size) else { continue };
        let tested = results.fits[0].test(fitted, &dataset, &gram, progress)?;
        for (p, path) in moving.paths().enumerate() {
            let of_frames: Vec<(f64, f64)> = changes(&tested, path, dataset.training).collect();
            let mean = (of_frames.iter().map(|f| f.1).sum::<f64>() / of_frames.len().max(1) as f64).sqrt();
            let errors: Vec<f64> = of_frames.iter().map(|f| f.0.sqrt() / mean).collect();
            for (frame, (error, (_, change))) in (1..).zip(errors.iter().zip(&of_frames)) {
                let numbers = [p + 1, frame].map(|n| n.to_string());
                let values = [*error, change.sqrt() / mean].map(|v| v.to_string());
                data.push([vec![method.to_owned(), size.to_string()], numbers.to_vec(), values.to_vec()].concat());
            }
            if p == 0 {
                let mut series = series_of(&fitted.label);
                series.label += &format!(", {size}");
                series.points = (1..).map(f64::from).zip(errors).collect();
                followed.push(series);
            }
        }
    }
    let frames = Axis { label: "frame", ..Axis::default() };
    let error = Axis { label: "error / mean change", percent: true, from_zero: true, ..Axis::default() };
    let along = line_plot(&frames, &error, &followed);
    let steadiest = rows.iter().filter_map(|r| Some((r.temporal?, r))).min_by(|a, b| a.0.total_cmp(&b.0));
    let said = steadiest.map_or(String::new(), |(error, row)| {
        let label = method_label(row.method, row.lambda_choice);
        format!(" Least: {} ({label}, {}).", percent(error), row.coefficients)
    });
    let noise = results.noise_of_change.map_or(String::new(), |noise| {
        format!(
            " The noise of Δi itself, told by a second bake of the first path, is {} and part of every error.",
            percent(noise)
        )
    });
    Ok(Section {
        title: "Error of what changes from frame to frame".into(),
        here: format!(
            "{} paths of {} frames: a light of the scenario goes evenly from one of its places to another and turns on its way. All \
             frames are baked with the same paths, so that their noise hardly changes. Error: sqrt(Σ a |Δi − Δî|²) / sqrt(Σ a |Δi|²) \
             over the frames of a path, then the mean over paths. It is what is seen as flicker and swimming; figure 4 below shows \
             how averaging sub-points lowers it.{said}{noise}",
            moving.paths().count(),
            moving.frames
        ),
        blocks: vec![Block::Plots(vec![
            Plot {
                name: "temporal-sizes".into(),
                title: "Over sizes".into(),
                note: "SH PRT is in the table above.".into(),
                svg: sizes,
            },
            Plot {
                name: "temporal-path".into(),
                title: "Along the first path".into(),
                note: "Error of each frame's change, relative to the root mean square change of the path.".into(),
                svg: along,
            },
        ])],
        data: vec![("temporal.csv".into(), lines("method,coefficients,path,frame,error,change", data))],
        ..Section::default()
    })
}

/// A row's value and its spread.
type ValueOf<'v> = dyn Fn(&Row) -> Option<(f64, Option<f64>)> + 'v;

/// One line per method and choice of λ over its sizes: a value and its spread.
pub fn over_sizes(rows: &[&Row], value: &ValueOf) -> Vec<Series> {
    let mut groups: Vec<(&str, Option<&str>)> = Vec::new();
    for row in rows {
        let group = (row.method, row.lambda_choice);
        if !groups.contains(&group) {
            groups.push(group);
        }
    }
    // This program's own methods come first.
    groups.sort_by_key(|(method, _)| !["linear", "local"].contains(method));
    let line = |&(method, choice): &(&str, Option<&str>)| {
        let own = rows.iter().filter(|r| (r.method, r.lambda_choice) == (method, choice));
        let values: Vec<(f64, f64, f64)> =
            own.filter_map(|r| value(r).map(|(v, spread)| (r.coefficients as f64, v, spread.unwrap_or(0.0)))).collect();
        Series {
            label: method_label(method, choice),
            colour: method_colour(method, choice),
            points: values.iter().map(|v| (v.0, v.1)).collect(),
            spreads: values.iter().map(|v| v.2).collect(),
            ..Series::default()
        }
    };
    groups.iter().map(line).filter(|s| !s.points.is_empty()).collect()
}
