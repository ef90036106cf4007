//! Figure 4: measurement points, and what averaging over sub-points does for flicker.

use super::super::assemble::{Inputs, ReportError};
use super::super::page::{Block, Plate, Plot, Section, percent};
use super::super::pictures;
use super::super::plot::{Axis, Series, line_plot};
use super::super::table::lines;
use super::super::temporal::Measured;
use super::series_of;
use crate::measure::MeasurementPoints;
use crate::progress::Progress;
use crate::transfer::error::mean_median_worst;

/// The sizes whose stability is followed: the paper's 16, and 4 channels a texel.
const SIZE: [usize; 1] = [16];
const LOCAL_SIZE: [usize; 1] = [4];

pub fn points(inputs: &Inputs, progress: &dyn Progress) -> Result<Section, ReportError> {
    let points = &inputs.model.points;
    let images = pictures::point_images(inputs.tracer, points)?;
    let mut blocks = vec![Block::Plate(Plate { rows: vec![images], pixelated: false })];
    let mut here = format!("{} points of {} sub-points each.", points.points.len(), points.neighbours_per_point());
    let mut data = vec![("figure-04-points.csv".to_owned(), points_csv(points))];
    if let Some((series, rows)) = averaging(inputs, progress)? {
        let best = series.iter().filter_map(|s| Some((s.points.first()?.1, s.points.last()?.1, &s.label)));
        let said = best.map(|(one, all, label)| format!("{} → {} ({label})", percent(one), percent(all)));
        here += &format!(" Error from frame to frame, one sub-point → all: {}.", said.collect::<Vec<_>>().join(", "));
        let ticks = series.iter().flat_map(|s| s.points.iter().map(|p| p.0 as usize));
        let svg = line_plot(
            &Axis::at("sub-points averaged by each point", ticks),
            &Axis::error("frame-to-frame error"),
            &series,
        );
        blocks.push(Block::Plots(vec![Plot {
            name: "figure-04-averaging".into(),
            title: "What averaging is for".into(),
            note:
                "The same points, each the mean of its k nearest sub-points; trained anew for each k. Bars: standard \
                   deviation over the paths of lights."
                    .into(),
            svg,
        }]));
        data.push((
            "figure-04-averaging.csv".into(),
            lines("method,coefficients,sub_points,path,frame_to_frame_error", rows),
        ));
    }
    Ok(Section {
        title: "Figure 4: measurement points".into(),
        paper: Some(
            "points as blue noise (a); each averages its neighbours among 8 × as many, in the colour of their point, to reduce flickering (b).",
        ),
        here,
        blocks,
        data,
    })
}

/// Lines of a plot, and of its data.
type Averaging = (Vec<Series>, Vec<[String; 5]>);

/// Frame-to-frame error over the number of sub-points that are averaged.
fn averaging(inputs: &Inputs, progress: &dyn Progress) -> Result<Option<Averaging>, ReportError> {
    let Some(moving) = inputs.moving else { return Ok(None) };
    let (own, points) = (&inputs.scenarios[0], &inputs.model.points);
    let all = points.neighbours_per_point();
    let recipe = inputs.recipe.one_size(&SIZE, &LOCAL_SIZE);
    let mut counts: Vec<usize> = (0..).map(|i| 1 << i).take_while(|&k| k < all).collect();
    if inputs.quick {
        counts.truncate(1);
    }
    counts.push(all);
    let (mut series, mut rows) = (Vec::<Series>::new(), Vec::new());
    for count in counts {
        let points = points.averaging(count);
        let dataset = own.sets[0].dataset.measured_at(inputs.tracer, &points);
        let set = Measured { dataset: &dataset, points: &points, tracer: inputs.tracer };
        let fits = recipe.fit(set, own.gram, progress)?;
        for (i, (fitted, errors)) in fits.list.iter().zip(moving.errors(&fits, &set, progress)?).enumerate() {
            if series.len() == i {
                series.push(series_of(&fitted.label));
            }
            series[i].points.push((count as f64, mean_median_worst(&errors).0));
            series[i].spreads.push(super::super::comparison::standard_deviation(&errors).unwrap_or(0.0));
            rows.extend(errors.iter().enumerate().map(|(path, error)| {
                let label = &fitted.label;
                [
                    label.method.to_owned(),
                    label.size.to_string(),
                    count.to_string(),
                    (path + 1).to_string(),
                    error.to_string(),
                ]
            }));
        }
    }
    Ok(Some((series, rows)))
}

/// Position, normal and albedo of each sub-point, and the points that average it.
fn points_csv(points: &MeasurementPoints) -> String {
    let count = points.neighbours_per_point().max(1);
    let rows = points.neighbours.chunks(count).enumerate().flat_map(|(p, neighbours)| {
        neighbours.iter().enumerate().map(move |(rank, &s)| {
            let s = &points.sub_points[s as usize];
            let numbers = [s.position, s.normal, s.albedo].map(|v| v.to_array()).concat();
            let fields = [p, rank].map(|n| n.to_string()).into_iter().chain(numbers.iter().map(f32::to_string));
            fields.collect::<Vec<String>>()
        })
    });
    lines("point,rank,x,y,z,normal_x,normal_y,normal_z,albedo_r,albedo_g,albedo_b", rows)
}
