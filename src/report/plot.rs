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
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        // The backend writes to memory, which does not fail.
        let x = x.start / 1.12..x.end * 1.12;
        let drawn = if log_y {
            draw(
                &root,
                x.log_scale(),
                (labelled(y.start / LEGEND_ROOM)..y.end * 1.3).log_scale(),
                x_label,
                y_label,
                percent,
                series,
            )
        } else {
            draw(&root, x.log_scale(), 0.0..y.end * 1.08, x_label, y_label, percent, series)
        };
        drawn.and_then(|()| root.present().map_err(|e| e.to_string())).expect("plotting to memory");
    }
    // Scales with the page, and takes its text from the page's fonts.
    svg.replacen("<svg ", "<svg class=\"plot\" ", 1)
}

/// How far a logarithmic axis goes on below the lowest value, so that the legend covers no line.
const LEGEND_ROOM: f64 = 4.0;

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
            let line = DashedLineSeries::new(s.points.iter().copied(), 6, 4, style);
            chart.draw_series(line).map_err(error)?.label(&s.label).legend(move |(x, y)| {
                // A legend takes one element: the middle dash of a short line.
                PathElement::new(vec![(x + 6, y), (x + 14, y)], style)
            });
        } else {
            let line = LineSeries::new(s.points.iter().copied(), style);
            chart
                .draw_series(line)
                .map_err(error)?
                .label(&s.label)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 20, y)], style));
            if s.points.len() < 24 {
                chart.draw_series(s.points.iter().map(|&p| Circle::new(p, 3, colour.filled()))).map_err(error)?;
            }
        }
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerLeft)
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.2))
        .label_font(("sans-serif", TEXT - 3))
        .draw()
        .map_err(error)
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
