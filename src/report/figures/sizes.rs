//! Figures 13 and 14: more elements, seen and measured.

use super::super::assemble::{Inputs, ReportError, Results};
use super::super::comparison::Row;
use super::super::page::{Block, Image, Plate, Plot, Section, method_colour, method_label, percent};
use super::super::plot::{Axis, Series, line_plot};
use super::super::table;
use super::super::views::Shot;
use super::temporal::over_sizes;
use crate::progress::Progress;

/// Methods and sizes that are shown: the paper's, and local ones.
const SHOWN: [(&str, [usize; 3]); 3] = [("belcour", [4, 16, 64]), ("linear", [4, 16, 64]), ("local", [2, 4, 8])];

/// Figure 13: the median held-out light under bases of several sizes.
pub fn pictures(inputs: &Inputs, results: &Results, progress: &dyn Progress) -> Result<Section, ReportError> {
    let mut section = Section {
        title: "Figure 13: more elements".into(),
        paper: Some("quality rises from 4 over 16 to 64 elements, 64 being accurate for most assets and 16 plausible."),
        ..Section::default()
    };
    let (own, fits) = (&inputs.scenarios[0], &results.fits[0]);
    let Some((condition, _)) = inputs.held_out_at(0.5) else { return Ok(section) };
    let shot = Shot::take(inputs, condition, progress)?;
    let (mut rows, mut data, mut said) = (Vec::new(), Vec::new(), Vec::new());
    for (method, sizes) in SHOWN {
        let mut row = vec![shot.dim(&shot.reference, "reference, indirect")];
        let mut flips = Vec::new();
        let mut name = String::new();
        for fitted in sizes.iter().filter_map(|&size| fits.find(method, size)) {
            let model = fits.model(fitted, own.sets[0].dataset, inputs.finish, progress)?;
            let picture = shot.by_basis(&model)?;
            let (ldr, hdr) = shot.flip(&picture);
            let size = fitted.label.size;
            name = method_label(method, Some(fitted.label.lambda_choice));
            row.push(shot.dim(&picture, format!("{name}, {size}")));
            row.push(Image { caption: format!("its error: FLIP {ldr:.3}, HDR {hdr:.3}"), ..shot.error(&picture) });
            flips.push(format!("{ldr:.3}"));
            data.push([method.to_owned(), size.to_string(), ldr.to_string(), hdr.to_string()]);
        }
        if !flips.is_empty() {
            said.push(format!("{} ({name})", flips.join(" → ")));
            rows.push(row);
        }
    }
    section.here = format!("the median held-out light; FLIP with more elements: {}.", said.join(", "));
    section.blocks = vec![Block::Plate(Plate { rows, pixelated: false })];
    section.data = vec![("figure-13-sizes.csv".into(), table::lines("method,coefficients,flip_ldr,flip_hdr", data))];
    Ok(section)
}

/// Figure 14: error against size, and against what a texel reads.
pub fn errors(inputs: &Inputs, results: &Results) -> Section {
    let mut plots = Vec::new();
    for scenery in &inputs.scenarios {
        let rows: Vec<&Row> = results.rows.iter().filter(|r| r.scenario == scenery.name).collect();
        let mut series = over_sizes(&rows, &|r| Some((r.mean, r.spread)));
        let oracles = over_sizes(&rows, &|r| r.oracle_mean.map(|o| (o, None)));
        // The baseline's basis, and so its oracle, is nearly the same for every λ.
        let other = |s: &Series| s.colour != method_colour("belcour", Some("leave-one-out"));
        series.extend(oracles.into_iter().filter(other).map(|s| Series {
            dashed: true,
            label: s.label + ", oracle",
            ..s
        }));
        let part = if scenery.name == inputs.scenarios[0].name { "own" } else { "distant" };
        plots.push(Plot {
            name: format!("figure-14-{part}"),
            title: format!("Error against size: {}", scenery.name),
            note: "Mean over held-out lights, bars: standard deviation over training sets; dashed: the oracle. SH PRT of order l has l² coefficients.".into(),
            svg: line_plot(
                &Axis::at("coefficients per texel and channel", rows.iter().map(|r| r.coefficients).filter(|c| c.is_power_of_two())),
                &Axis::error("relative RMSE"),
                &series,
            ),
        });
        let by_bytes: Vec<Series> = over_sizes(&rows, &|r| Some((r.mean, r.spread)))
            .into_iter()
            .map(|s| {
                let bytes = |coefficients: f64| {
                    let row = rows.iter().find(|r| {
                        method_label(r.method, r.lambda_choice) == s.label && r.coefficients as f64 == coefficients
                    });
                    row.map_or(f64::NAN, |r| r.cost.bytes_per_texel as f64)
                };
                let points = s.points.iter().map(|&(c, v)| (bytes(c), v)).collect();
                Series { points, ..s }
            })
            .collect();
        plots.push(Plot {
            name: format!("figure-14-{part}-bytes"),
            title: format!("Error against what a texel reads: {}", scenery.name),
            note: "The same, over the bytes of the basis that are stored and read for each texel (for each vertex, SH PRT per vertex).".into(),
            svg: line_plot(
                &Axis::at("bytes per texel", [8, 16, 32, 64, 128, 256]),
                &Axis::error("relative RMSE"),
                &by_bytes,
            ),
        });
    }
    let own: Vec<&Row> = results.rows.iter().filter(|r| r.scenario == inputs.scenarios[0].name).collect();
    let gap = |method: &str| {
        let row = own.iter().rfind(|r| r.method == method && r.oracle_mean.is_some())?;
        Some(format!(
            "{} against {} ({}, {})",
            percent(row.mean),
            percent(row.oracle_mean?),
            method_label(method, row.lambda_choice),
            row.coefficients
        ))
    };
    let said: Vec<String> = ["belcour", "linear", "local"].into_iter().filter_map(gap).collect();
    Section {
        title: "Figure 14: error and its oracle".into(),
        paper: Some(
            "the error of the method (plain) falls with the number of elements, close to that of projecting the reference on the basis (dashed).",
        ),
        here: format!("at the largest sizes, error against oracle: {}.", said.join("; ")),
        blocks: vec![Block::Plots(plots)],
        data: vec![("figure-14-errors.csv".into(), table::csv(&results.rows))],
    }
}
