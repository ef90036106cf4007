//! Figure 5: one basis for all colours (mono), or a coloured one (multi).

use glam::Vec3;

use super::super::assemble::{Inputs, ReportError};
use super::super::fits::Recipe;
use super::super::page::{Block, Cell, Plate, Section, Table, method_label, percent};
use super::super::table::lines;
use super::super::temporal::Measured;
use super::super::views::Shot;
use crate::dataset::Dataset;
use crate::light::{Light, LightingCondition};
use crate::math::Rgb;
use crate::math::sampler::mix64;
use crate::model::Channels;
use crate::progress::Progress;
use crate::transfer::Gram;

const SIZES: [usize; 1] = [16];

/// A light of which colour is shown: a blue that no white light contains alone.
const SHOWN: Vec3 = Vec3::new(0.15, 0.35, 1.0);

/// A fit by its label, tested on each set of lights.
struct Line {
    name: String,
    method: &'static str,
    channels: Channels,
    trained_on: &'static str,
    /// On the lights as they are, and on those of other colours.
    errors: [f64; 2],
}

pub fn channels(inputs: &Inputs, progress: &dyn Progress) -> Result<Section, ReportError> {
    let own = &inputs.scenarios[0];
    let dataset = own.sets[0].dataset;
    // Light of another colour needs no bake: transport is linear in each channel. Training conditions keep the colours that they
    // were trained in, since the basis is made of their lightmaps.
    let set = |trained: bool, tested: bool| {
        let is_tinted = |c: usize| if c < dataset.training { trained } else { tested };
        let of = |c: usize| if is_tinted(c) { tint(c as u64) } else { Rgb::ONE };
        let tints: Vec<Rgb> = (0..dataset.conditions.len()).map(of).collect();
        (with_direct(dataset, &tints), own.gram.tinted(&tints))
    };
    let mut found: Vec<Line> = Vec::new();
    let mut pictures = Vec::new();
    let shown = inputs.held_out_at(0.5).and_then(|(condition, _)| coloured(condition));
    let shot = shown.map(|condition| Shot::take(inputs, &condition, progress)).transpose()?;
    if let Some(shot) = &shot {
        pictures.push(shot.dim(&shot.reference, "reference, indirect"));
    }
    for channels in [Channels::Mono, Channels::Multi] {
        // Paths know nothing of colours that lightmaps were multiplied with.
        let recipe = Recipe { channels, prior: None, ..inputs.recipe.one_size(&SIZES, &[]) };
        for (trained_on, coloured) in [("lights as they are", false), ("coloured lights", true)] {
            let tested = [set(coloured, false), set(coloured, true)];
            let set = Measured { dataset: &tested[0].0, ..own.sets[0] };
            let fits = recipe.fit(set, &tested[0].1, progress)?;
            for fitted in &fits.list {
                let on = |(dataset, gram): &(Dataset, Gram)| -> Result<f64, ReportError> {
                    Ok(fits.test(fitted, dataset, gram, progress)?.errors().summary().mean)
                };
                let name = method_label(fitted.label.method, Some(fitted.label.lambda_choice));
                if let (Some(shot), false) = (&shot, coloured) {
                    let picture = shot.by_basis(&fits.model(fitted, dataset, inputs.finish, progress)?)?;
                    let (ldr, _) = shot.flip(&picture);
                    pictures.push(shot.dim(&picture, format!("{name}, {}: FLIP {ldr:.3}", word(channels))));
                }
                found.push(Line {
                    errors: [on(&tested[0])?, on(&tested[1])?],
                    method: fitted.label.method,
                    name,
                    channels,
                    trained_on,
                });
            }
        }
    }
    found.sort_by_key(|line| (line.method, line.trained_on != "lights as they are"));
    let table = Table {
        title: format!("Mean error, {} elements, all learnt from lightmaps", SIZES[0]),
        header: ["method", "channels", "trained on", "on lights as they are", "on coloured lights"]
            .map(str::to_owned)
            .into(),
        rows: found
            .iter()
            .map(|line| {
                let shaded = |error: f64| Cell { shade: Some(error), ..Cell::percent(error) };
                let [first, second] = line.errors.map(shaded);
                vec![
                    Cell::name(line.name.clone()),
                    Cell::name(word(line.channels)),
                    Cell::name(line.trained_on),
                    first,
                    second,
                ]
            })
            .collect(),
    };
    let of = |channels| {
        found.iter().find(|l| l.method == "linear" && l.channels == channels && l.trained_on == "lights as they are")
    };
    let said = [Channels::Mono, Channels::Multi].map(|channels| {
        of(channels).map_or(String::new(), |l| {
            format!("{}: {} → {}", word(channels), percent(l.errors[0]), percent(l.errors[1]))
        })
    });
    let rows = found.iter().map(|l| {
        [
            l.method.to_owned(),
            word(l.channels).to_owned(),
            l.trained_on.to_owned(),
            l.errors[0].to_string(),
            l.errors[1].to_string(),
        ]
    });
    let data = lines("method,channels,trained_on,mean_as_they_are,mean_coloured", rows);
    let mut blocks = vec![Block::Table(table)];
    if pictures.len() > 1 {
        blocks.push(Block::Plate(Plate { rows: vec![pictures], pixelated: false }));
    }
    Ok(Section {
        title: "Figure 5: colours together or apart".into(),
        paper: Some(
            "a basis with the colours in it (multi) fails where lights have colours that were not in the dataset; colours as vectors of their own (mono), with a matrix each, do not.",
        ),
        here: format!(
            "the lights of the scenario against the same in random vivid colours (linear, trained on the scenario's: {}). Pictures: the \
             median held-out light in blue.",
            said.join("; ")
        ),
        blocks,
        data: vec![("figure-05-channels.csv".into(), data)],
    })
}

fn word(channels: Channels) -> &'static str {
    match channels {
        Channels::Mono => "mono",
        Channels::Multi => "multi",
    }
}

/// A vivid colour, largest channel 1.
fn tint(index: u64) -> Rgb {
    let unit = |k: u64| (mix64(mix64(index) ^ k) >> 40) as f32 / (1 << 24) as f32;
    let colour = Vec3::new(unit(0), unit(1), unit(2)).powf(2.0) + 0.02;
    colour / colour.max_element()
}

/// D as it is under lights whose colours are multiplied.
fn with_direct(dataset: &Dataset, tints: &[Rgb]) -> Dataset {
    let n = dataset.conditions.len();
    let mut tinted = dataset.clone();
    tinted.direct.iter_mut().enumerate().for_each(|(i, x)| *x *= tints[i % n][i / n % 3]);
    tinted
}

/// None where a light has no colour of its own.
fn coloured(condition: &LightingCondition) -> Option<LightingCondition> {
    let lights: Option<Vec<Light>> = condition.lights.iter().map(|light| light.tinted(SHOWN)).collect();
    Some(LightingCondition { lights: lights? })
}
