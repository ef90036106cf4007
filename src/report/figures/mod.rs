//! The figures of the report, each with its data: those of the paper made anew for an asset, and what training needs.

mod channels;
mod classical;
mod eigenvalues;
mod gamma;
mod points;
mod scenarios;
mod sizes;
mod sweep;
mod temporal;

pub use sweep::sweeps;
pub use temporal::temporal;

use super::assemble::{Inputs, ReportError, Results};
use super::fits::Label;
use super::page::{Section, method_colour, method_label};
use super::plot::Series;
use crate::progress::Progress;

/// The paper's figures 3, 4, 5, 6, 8, 12, 13 and 14, in this order, and why the others are not here.
///
/// # Errors
/// When a fit fails, the camera is unusable, or `progress` cancels.
pub fn of_paper(inputs: &Inputs, results: &Results, progress: &dyn Progress) -> Result<Vec<Section>, ReportError> {
    let mut sections = vec![eigenvalues::eigenvalues(inputs)?, points::points(inputs, progress)?];
    if !inputs.quick {
        sections.push(channels::channels(inputs, progress)?);
        sections.extend(gamma::gamma(inputs, progress)?);
        sections.extend(scenarios::scenarios(inputs, progress)?);
    }
    sections.extend(classical::classical(inputs, results, progress)?);
    sections.push(sizes::pictures(inputs, results, progress)?);
    sections.push(sizes::errors(inputs, results));
    sections.push(elsewhere(inputs));
    Ok(sections)
}

/// Figures that have another place, or none.
fn elsewhere(inputs: &Inputs) -> Section {
    let left_out = "Left out here, since they take longer: figures 5 (colour channels), 6 (gamma) and 8 (changed lights), and what \
                    training needs; relight compare makes them. ";
    let here = "Figure 2 is an outline and figure 7 (a frame put together from direct and indirect light) is below, under held-out \
                lights. Figures 1, 9, 10 and 11 show hair and media that light goes through: this asset has neither, and this program \
                bakes surfaces only.";
    Section {
        title: "Other figures".into(),
        here: format!("{}{here}", if inputs.quick { left_out } else { "" }),
        ..Section::default()
    }
}

/// Name and colour of a fit's line.
fn series_of(label: &Label) -> Series {
    let choice = Some(label.lambda_choice);
    Series {
        label: method_label(label.method, choice),
        colour: method_colour(label.method, choice),
        ..Series::default()
    }
}
