//! Line plots as SVG.

use std::collections::BTreeSet;
use std::ops::Range;

use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};
use plotters::element::Drawable;
use plotters::prelude::*;

/// One line of a plot.
#[derive(Clone, Debug, Default)]
pub struct Series {
    pub label: String,
    /// Index into the palette and the list of markers; lines that belong together share it.
    pub colour: usize,
    pub dashed: bool,
    pub points: Vec<(f64, f64)>,
    /// Standard deviation of each point, drawn as a bar; empty where there is none.
    pub spreads: Vec<f64>,
}

/// An axis. Labels name what is on it, with its unit.
#[derive(Clone, Debug, Default)]
pub struct Axis<'l> {
    pub label: &'l str,
    pub log: bool,
    /// Whether values are fractions that are read as percent.
    pub percent: bool,
    /// Values that are labelled; chosen where there are none.
    pub ticks: Vec<f64>,
    /// Whether it begins at zero where it is not logarithmic.
    pub from_zero: bool,
}

impl<'l> Axis<'l> {
    /// Logarithmic, with a label at each of the values.
    pub fn at(label: &'l str, ticks: impl IntoIterator<Item = usize>) -> Self {
        let ticks: BTreeSet<usize> = ticks.into_iter().collect();
        Self { label, log: true, ticks: ticks.into_iter().map(|t| t as f64).collect(), ..Self::default() }
    }

    /// An error as a fraction, logarithmic.
    pub fn error(label: &'l str) -> Self {
        Self { label, log: true, percent: true, ..Self::default() }
    }
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
const TEXT: u32 = 22;
/// Height of a line of the legend, which stands under the plot in two columns and covers nothing.
const LEGEND_LINE: u32 = 30;

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

/// A plot of `series`; nothing where they hold nothing that can be shown.
pub fn line_plot(x: &Axis, y: &Axis, series: &[Series]) -> String {
    let shown = |axis: &Axis, v: f64| v.is_finite() && (!axis.log || v > 0.0);
    let scaled = |axis: &Axis, v: f64| if axis.log { v.log10() } else { v };
    // All is drawn on linear axes; logarithmic ones have the logarithms on them.
    let scaled_series: Vec<Scaled> = series
        .iter()
        .map(|s| {
            let points = s.points.iter().enumerate().filter(|(_, p)| shown(x, p.0) && shown(y, p.1));
            let marks = points.map(|(i, p)| {
                let spread = s.spreads.get(i).copied().unwrap_or(0.0);
                // A bar that reaches down to nothing ends where it is cut off in any case.
                let low = if y.log { (p.1 - spread).max(0.05 * p.1) } else { p.1 - spread };
                (scaled(x, p.0), scaled(y, p.1), scaled(y, low)..scaled(y, p.1 + spread))
            });
            Scaled { series: s, marks: marks.collect() }
        })
        .collect();
    let bounds = |values: &mut dyn Iterator<Item = f64>| {
        values.fold(None, |range, v| Some(range.map_or(v..v, |r: Range<f64>| r.start.min(v)..r.end.max(v))))
    };
    let marks = || scaled_series.iter().flat_map(|s| &s.marks);
    let ends = marks().flat_map(|m| [m.2.start, m.2.end]);
    let (Some(x_range), Some(y_range)) = (bounds(&mut marks().map(|m| m.0)), bounds(&mut ends.into_iter())) else {
        return String::new();
    };
    let (x_range, y_range) = (x.padded(x_range, 0.03), y.padded(y_range, 0.06));
    let mut svg = String::new();
    {
        // One line needs no legend: the axis says what it is.
        let lines = if series.len() > 1 { series.len().div_ceil(2) as u32 } else { 0 };
        let root = SVGBackend::with_string(&mut svg, (SIZE.0, SIZE.1 + lines * LEGEND_LINE)).into_drawing_area();
        let (above, below) = root.split_vertically(SIZE.1);
        // The backend writes to memory, which does not fail.
        let drawn = draw(&above, (x, x_range), (y, y_range), &scaled_series);
        let drawn = drawn.and_then(|()| if lines > 0 { draw_legend(&below, series) } else { Ok(()) });
        drawn.and_then(|()| root.present().map_err(|e| e.to_string())).expect("plotting to memory");
    }
    // Scales with the page, and takes its text from the page's fonts.
    svg.replacen("<svg ", "<svg class=\"plot\" ", 1)
}

/// A series on linear axes: x, y and the bar about it.
struct Scaled<'s> {
    series: &'s Series,
    marks: Vec<(f64, f64, Range<f64>)>,
}

impl Axis<'_> {
    /// A range with some room at its ends.
    fn padded(&self, range: Range<f64>, share: f64) -> Range<f64> {
        let length = range.end - range.start;
        let room = if length > 0.0 {
            length * share
        } else if self.log {
            0.2
        } else {
            range.end.abs().max(1.0) * 0.1
        };
        let low = if self.from_zero && !self.log { 0.0 } else { range.start - room };
        low..range.end + room
    }

    /// Where labels stand, on the linear axis.
    fn labelled(&self, range: &Range<f64>) -> Vec<f64> {
        let within = |v: &f64| (range.start - 1e-9..=range.end + 1e-9).contains(v);
        if !self.ticks.is_empty() {
            let ticks = self.ticks.iter().map(|&t| if self.log { t.log10() } else { t });
            return ticks.filter(within).collect();
        }
        let decades = range.end - range.start;
        if self.log {
            // Every second decade over many; 1, 2 and 5 in each over few; over a part of one all digits that are not crowded.
            let digits: &[f64] = match decades {
                d if d > 2.2 => &[1.0],
                d if d > 0.75 => &[1.0, 2.0, 5.0],
                d if d > 0.4 => &[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0],
                _ => &[1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.2, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 5.5, 6.0, 6.5, 7.0, 8.0, 9.0],
            };
            let every = if decades > 6.5 { 2 } else { 1 };
            let powers = (range.start.floor() as i32..=range.end.ceil() as i32).filter(|p| p.rem_euclid(every) == 0);
            return powers.flat_map(|p| digits.iter().map(move |d| p as f64 + d.log10())).filter(within).collect();
        }
        // The step of 1, 2 or 5 times a power of ten that gives four to eight labels.
        let rough = decades / 6.0;
        let power = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].into_iter().find(|s| s * power >= rough).unwrap_or(10.0) * power;
        let first = (range.start / step).ceil() as i64;
        (first..).map(|i| i as f64 * step).take_while(|v| *v <= range.end).collect()
    }

    fn format(&self, v: f64) -> String {
        let v = if self.log { 10f64.powf(v) } else { v };
        if self.percent { format!("{} %", format_number(v * 100.0)) } else { format_number(v) }
    }
}

/// A linear axis that is labelled where it is told to.
struct Scale {
    range: Range<f64>,
    ticks: Vec<f64>,
}

impl Ranged for Scale {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (first, last): (i32, i32)) -> i32 {
        let share = (value - self.range.start) / (self.range.end - self.range.start);
        first + ((last - first) as f64 * share).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.ticks.clone()
    }

    fn range(&self) -> Range<f64> {
        self.range.clone()
    }
}

fn draw(
    root: &Area,
    (x, x_range): (&Axis, Range<f64>),
    (y, y_range): (&Axis, Range<f64>),
    series: &[Scaled],
) -> Result<(), String> {
    let error = |e: DrawingAreaErrorKind<std::io::Error>| e.to_string();
    let (x_ticks, y_ticks) = (x.labelled(&x_range), y.labelled(&y_range));
    root.fill(&WHITE).map_err(error)?;
    let mut chart = ChartBuilder::on(root)
        .margin(14)
        .x_label_area_size(62)
        .y_label_area_size(96)
        .build_cartesian_2d(Scale { range: x_range, ticks: x_ticks }, Scale { range: y_range, ticks: y_ticks })
        .map_err(error)?;
    chart
        .configure_mesh()
        .x_desc(x.label)
        .y_desc(y.label)
        .axis_desc_style(("sans-serif", TEXT))
        .label_style(("sans-serif", TEXT - 2))
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.12))
        .x_label_formatter(&|v| x.format(*v))
        .y_label_formatter(&|v| y.format(*v))
        .draw()
        .map_err(error)?;
    for Scaled { series: s, marks } in series {
        let style = style(s);
        let line = marks.iter().map(|m| (m.0, m.1));
        if s.dashed {
            chart.draw_series(DashedLineSeries::new(line, DASH, GAP, style)).map_err(error)?;
            continue;
        }
        chart.draw_series(LineSeries::new(line, style)).map_err(error)?;
        let area = chart.plotting_area();
        for (x, y, bar) in marks {
            if bar.end > bar.start {
                let (top, bottom) = (area.map_coordinate(&(*x, bar.end)), area.map_coordinate(&(*x, bar.start)));
                for (from, to) in [
                    (top, bottom),
                    ((top.0 - 5, top.1), (top.0 + 5, top.1)),
                    ((bottom.0 - 5, bottom.1), (bottom.0 + 5, bottom.1)),
                ] {
                    root.draw(&PathElement::new(vec![from, to], style)).map_err(error)?;
                }
            }
            if marks.len() < 24 {
                mark(root, area.map_coordinate(&(*x, *y)), s.colour)?;
            }
        }
    }
    Ok(())
}

fn style(s: &Series) -> ShapeStyle {
    ShapeStyle::from(PALETTE[s.colour % PALETTE.len()]).stroke_width(if s.dashed { 1 } else { 2 })
}

/// A marker of its own shape for each colour, so that lines are told apart without it.
fn mark(area: &Area, (x, y): (i32, i32), colour: usize) -> Result<(), String> {
    let fill = PALETTE[colour % PALETTE.len()].filled();
    let polygon =
        |corners: &[(i32, i32)]| Polygon::new(corners.iter().map(|c| (x + c.0, y + c.1)).collect::<Vec<_>>(), fill);
    match colour % 6 {
        0 => put(area, &Circle::new((x, y), 4, fill)),
        1 => put(area, &polygon(&[(-4, -4), (4, -4), (4, 4), (-4, 4)])),
        2 => put(area, &polygon(&[(0, -6), (5, 4), (-5, 4)])),
        3 => put(area, &polygon(&[(0, -6), (6, 0), (0, 6), (-6, 0)])),
        4 => put(area, &polygon(&[(0, 6), (5, -4), (-5, -4)])),
        _ => put(area, &polygon(&[(-5, -2), (-2, -5), (5, 2), (2, 5)])),
    }
}

fn put<E>(area: &Area, element: &E) -> Result<(), String>
where
    for<'e> &'e E: plotters::element::PointCollection<'e, (i32, i32)>,
    for<'a> E: Drawable<SVGBackend<'a>>,
{
    area.draw(element).map_err(|e| e.to_string())
}

/// Pixels of dashes and of what is between them.
const DASH: i32 = 6;
const GAP: i32 = 4;

/// A short line and the label of each series, column by column.
fn draw_legend(area: &Area, series: &[Series]) -> Result<(), String> {
    let error = |e: DrawingAreaErrorKind<std::io::Error>| e.to_string();
    area.fill(&WHITE).map_err(error)?;
    let lines = series.len().div_ceil(2);
    for (k, s) in series.iter().enumerate() {
        let style = style(s);
        let x = 30 + (k / lines) as i32 * (SIZE.0 as i32 - 30) / 2;
        let y = (k % lines) as i32 * LEGEND_LINE as i32 + LEGEND_LINE as i32 / 2;
        let parts: &[(i32, i32)] = if s.dashed { &[(0, 6), (10, 16), (20, 26)] } else { &[(0, 26)] };
        for (from, to) in parts {
            area.draw(&PathElement::new(vec![(x + from, y), (x + to, y)], style)).map_err(error)?;
        }
        if !s.dashed {
            mark(area, (x + 13, y), s.colour)?;
        }
        let label = Text::new(s.label.clone(), (x + 36, y - TEXT as i32 / 2 + 2), ("sans-serif", TEXT - 1));
        area.draw(&label).map_err(error)?;
    }
    Ok(())
}

/// As few digits as tell values apart.
fn format_number(v: f64) -> String {
    let short = |text: String| match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    };
    match v.abs() {
        0.0 => "0".into(),
        a if a >= 1.0 => short(format!("{v:.1}")),
        a if a >= 1e-4 => short(format!("{v:.*}", (1.0 - a.log10().floor()) as usize)),
        _ => format!("{v:.0e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plot_draws_every_series_and_its_label() {
        let series = |label: &str, dashed| Series {
            label: label.into(),
            dashed,
            points: vec![(4.0, 0.5), (16.0, 0.25), (64.0, 0.1)],
            ..Series::default()
        };
        let x = Axis::at("elements", [4, 16, 64]);
        let svg = line_plot(&x, &Axis::error("error"), &[series("plain", false), series("dashed", true)]);
        for text in ["plain", "dashed", "elements", "error", "<polyline", "\n64\n", "10 %"] {
            assert!(svg.contains(text), "{text} is missing");
        }
        let bars = |spreads: Vec<f64>| {
            let with = Series { spreads, ..series("one", false) };
            // Labels where they are whatever the bars reach to.
            let y = Axis { ticks: vec![0.2], ..Axis::error("error") };
            line_plot(&x, &y, &[with]).matches("<polyline").count()
        };
        // A bar is a line with two ends.
        assert_eq!(bars(vec![0.1, 0.0, 0.05]), bars(vec![]) + 6);
    }

    #[test]
    fn nothing_to_plot_is_an_empty_string() {
        assert_eq!(line_plot(&Axis::at("x", []), &Axis::error("y"), &[]), "");
        let nan = Series { label: "nan".into(), points: vec![(1.0, f64::NAN)], ..Series::default() };
        assert_eq!(line_plot(&Axis::at("x", []), &Axis::default(), &[nan]), "");
    }

    #[test]
    fn axes_are_labelled_at_round_values() {
        let values = |axis: &Axis, range: Range<f64>| -> Vec<String> {
            axis.labelled(&range).into_iter().map(|v| axis.format(v)).collect()
        };
        assert_eq!(values(&Axis::default(), 0.0..63.0), ["0", "20", "40", "60"]);
        assert_eq!(values(&Axis::error("e"), -1.2..0.1), ["10 %", "20 %", "50 %", "100 %"]);
        assert_eq!(values(&Axis::at("n", [4, 16, 256]), 0.5..2.0), ["4", "16"]);
    }
}
