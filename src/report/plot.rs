//! Line plots as SVG.

use std::ops::Range;

use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;

/// One line of a plot.
pub struct Series {
    pub label: String,
    /// Index into the palette; lines that belong together share it.
    pub colour: usize,
    pub dashed: bool,
    pub points: Vec<(f64, f64)>,
}

/// Okabe and Ito's palette, told apart by colour-blind readers; black last.
const PALETTE: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(120, 120, 120),
    RGBColor(0, 0, 0),
];

const SIZE: (u32, u32) = (760, 460);
const TEXT: u32 = 20;
/// Height of a line of the legend, which stands under the plot in two columns and covers nothing.
const LEGEND_LINE: u32 = 28;

/// A plot of `series` with a logarithmic x axis; y logarithmic, too, if `log_y`. Labels name the axes with their units.
pub fn line_plot(x_label: &str, y_label: &str, log_y: bool, percent: bool, series: &[Series]) -> String {
    let finite = |range: Option<Range<f64>>| range.filter(|r| r.start.is_finite() && r.end.is_finite());
    let usable = |y: f64| y.is_finite() && (!log_y || y > 0.0);
    let points = || series.iter().flat_map(|s| &s.points).filter(|(_, y)| usable(*y));
    let bounds = |values: &mut dyn Iterator<Item = f64>| {
        finite(values.fold(None, |range, v| Some(range.map_or(v..v, |r: Range<f64>| r.start.min(v)..r.end.max(v)))))
    };
    let mut svg = String::new();
    let (Some(x), Some(y)) = (bounds(&mut points().map(|p| p.0)), bounds(&mut points().map(|p| p.1))) else {
        return svg;
    };
    {
        // One line needs no legend: the axis says what it is.
        let lines = if series.len() > 1 { series.len().div_ceil(2) as u32 } else { 0 };
        let root = SVGBackend::with_string(&mut svg, (SIZE.0, SIZE.1 + lines * LEGEND_LINE)).into_drawing_area();
        let (root, below) = root.split_vertically(SIZE.1);
        // The backend writes to memory, which does not fail.
        let x = x.start / 1.12..x.end * 1.12;
        let drawn = if log_y {
            draw(
                &root,
                x.log_scale(),
                (labelled(y.start / 1.3)..y.end * 1.3).log_scale(),
                x_label,
                y_label,
                percent,
                series,
            )
        } else {
            draw(&root, x.log_scale(), 0.0..y.end * 1.08, x_label, y_label, percent, series)
        };
        let drawn = drawn.and_then(|()| if lines > 0 { draw_legend(&below, series) } else { Ok(()) });
        drawn.and_then(|()| root.present().map_err(|e| e.to_string())).expect("plotting to memory");
    }
    // Scales with the page, and takes its text from the page's fonts.
    svg.replacen("<svg ", "<svg class=\"plot\" ", 1)
}

/// A lower end of a logarithmic axis that reaches down to a decade where one is near, so that it is labelled.
fn labelled(low: f64) -> f64 {
    let decade = 10f64.powf(low.log10().floor());
    if low < 2.5 * decade { decade * 0.97 } else { low }
}

fn draw<X, Y>(
    root: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    x: X,
    y: Y,
    x_label: &str,
    y_label: &str,
    percent: bool,
    series: &[Series],
) -> Result<(), String>
where
    X: AsRangedCoord<Value = f64>,
    X::CoordDescType: ValueFormatter<f64>,
    Y: AsRangedCoord<Value = f64>,
    Y::CoordDescType: ValueFormatter<f64>,
{
    let error = |e: DrawingAreaErrorKind<std::io::Error>| e.to_string();
    root.fill(&WHITE).map_err(error)?;
    let mut chart = ChartBuilder::on(root)
        .margin(14)
        .x_label_area_size(58)
        .y_label_area_size(84)
        .build_cartesian_2d(x, y)
        .map_err(error)?;
    chart
        .configure_mesh()
        .y_labels(6)
        .x_desc(x_label)
        .y_desc(y_label)
        .axis_desc_style(("sans-serif", TEXT))
        .label_style(("sans-serif", TEXT - 2))
        .light_line_style(BLACK.mix(0.04))
        .bold_line_style(BLACK.mix(0.12))
        .x_label_formatter(&|v| format_number(*v))
        .y_label_formatter(&|v| if percent { format!("{} %", format_number(v * 100.0)) } else { format_number(*v) })
        .draw()
        .map_err(error)?;
    for s in series {
        let colour = PALETTE[s.colour % PALETTE.len()];
        let style = ShapeStyle::from(colour).stroke_width(if s.dashed { 1 } else { 2 });
        if s.dashed {
            chart.draw_series(DashedLineSeries::new(s.points.iter().copied(), DASH, GAP, style)).map_err(error)?;
        } else {
            chart.draw_series(LineSeries::new(s.points.iter().copied(), style)).map_err(error)?;
            if s.points.len() < 24 {
                chart.draw_series(s.points.iter().map(|&p| Circle::new(p, 3, colour.filled()))).map_err(error)?;
            }
        }
    }
    Ok(())
}

/// Pixels of dashes and of what is between them.
const DASH: i32 = 6;
const GAP: i32 = 4;

/// A short line and the label of each series, column by column.
fn draw_legend(area: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>, series: &[Series]) -> Result<(), String> {
    let error = |e: DrawingAreaErrorKind<std::io::Error>| e.to_string();
    area.fill(&WHITE).map_err(error)?;
    let lines = series.len().div_ceil(2);
    for (k, s) in series.iter().enumerate() {
        let style = ShapeStyle::from(PALETTE[s.colour % PALETTE.len()]).stroke_width(if s.dashed { 1 } else { 2 });
        let x = 40 + (k / lines) as i32 * (SIZE.0 as i32 - 40) / 2;
        let y = (k % lines) as i32 * LEGEND_LINE as i32 + LEGEND_LINE as i32 / 2;
        let parts: &[(i32, i32)] = if s.dashed { &[(0, 6), (10, 16), (20, 26)] } else { &[(0, 26)] };
        for (from, to) in parts {
            area.draw(&PathElement::new(vec![(x + from, y), (x + to, y)], style)).map_err(error)?;
        }
        if !s.dashed {
            area.draw(&Circle::new((x + 13, y), 3, style.filled())).map_err(error)?;
        }
        let label = Text::new(s.label.clone(), (x + 36, y - TEXT as i32 / 2 + 2), ("sans-serif", TEXT - 3));
        area.draw(&label).map_err(error)?;
    }
    Ok(())
}

/// As few digits as tell values apart.
fn format_number(v: f64) -> String {
    if v == 0.0 {
        "0".into()
    } else if v.abs() >= 1.0 {
        let text = format!("{v:.1}");
        text.strip_suffix(".0").map(str::to_owned).unwrap_or(text)
    } else if v.abs() >= 1e-3 {
        let text = format!("{v:.4}");
        text.trim_end_matches('0').to_owned()
    } else {
        format!("{v:.0e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plot_draws_every_series_and_its_label() {
        let series = |label: &str, dashed| Series {
            label: label.into(),
            colour: 0,
            dashed,
            points: vec![(4.0, 0.5), (16.0, 0.25), (64.0, 0.1)],
        };
        let svg = line_plot("elements", "error", true, true, &[series("plain", false), series("dashed", true)]);
        for text in ["plain", "dashed", "elements", "error", "<polyline"] {
            assert!(svg.contains(text), "{text} is missing");
        }
    }

    #[test]
    fn nothing_to_plot_is_an_empty_string() {
        assert_eq!(line_plot("x", "y", true, false, &[]), "");
        let nan = Series { label: "nan".into(), colour: 0, dashed: false, points: vec![(1.0, f64::NAN)] };
        assert_eq!(line_plot("x", "y", true, false, &[nan]), "");
    }
}
