//! Figure 12: classical PRT under the light that it is made for.

use super::super::assemble::{Inputs, ReportError, Results};
use super::super::page::{Block, Plate, Section, method_label, percent};
use super::super::table::lines;
use super::super::views::{SHOWN_ORDER, Shot};
use crate::progress::Progress;
use crate::transfer::error::mean_median_worst;

/// None where distant light hardly reaches the asset.
pub fn classical(inputs: &Inputs, results: &Results, progress: &dyn Progress) -> Result<Option<Section>, ReportError> {
    let paper = "classical PRT blurs the incident light, so that a directional light leaks behind the object, and is tied to the \
                 tessellation; the data-driven transfer is free of both.";
    let title = "Figure 12: classical PRT";
    // Where there is a second scenario it is that of distant light; a model of suns alone has it as its own.
    let (scenery, fits) = match (inputs.scenarios.last(), results.fits.last()) {
        (Some(scenery), Some(fits)) if inputs.scenarios.len() > 1 => (scenery, fits),
        _ => {
            return Ok(Some(Section {
                title: title.into(),
                paper: Some(paper),
                here: "left out: distant light hardly reaches this asset, or is the model's own scenario (see figure 14 and the \
                       held-out lights)."
                    .into(),
                ..Section::default()
            }));
        }
    };
    let dataset = scenery.sets[0].dataset;
    let Some(ours) = fits.find("linear", 16).or(fits.list.last()) else { return Ok(None) };
    let tested = fits.test(ours, dataset, scenery.gram, progress)?;
    let (errors, lit) = (tested.errors().transfer, tested.lit());
    let median = mean_median_worst(&errors).1;
    let nearest = (0..lit.len()).min_by(|&a, &b| (errors[a] - median).abs().total_cmp(&(errors[b] - median).abs()));
    let Some(k) = nearest else { return Ok(None) };
    let shot = Shot::take(inputs, &dataset.conditions[lit[k]], progress)?;
    let mut first =
        vec![shot.picture(&shot.truth, "reference, all light"), shot.dim(&shot.reference, "reference, indirect")];
    let (mut second, mut data, mut said) = (Vec::new(), Vec::new(), Vec::new());
    for fitted in [fits.find("belcour", 16), fits.find("linear", 16), fits.find("local", 4)].into_iter().flatten() {
        let picture = shot.by_basis(&fits.model(fitted, dataset, inputs.finish, progress)?)?;
        let (ldr, hdr) = shot.flip(&picture);
        let label = method_label(fitted.label.method, Some(fitted.label.lambda_choice));
        first.push(shot.dim(&picture, format!("{label}, {}: FLIP {ldr:.3}", fitted.label.size)));
        data.push([fitted.label.method.to_owned(), fitted.label.size.to_string(), ldr.to_string(), hdr.to_string()]);
        said.push(format!("{ldr:.3} ({label}, {})", fitted.label.size));
    }
    for (method, prt) in [("sh_prt_texel", &results.texels), ("sh_prt_vertex", &results.vertices)] {
        for order in [SHOWN_ORDER, 6] {
            let Some(prt) = prt.as_ref().filter(|prt| prt.order >= order) else { continue };
            let picture = shot.by_harmonics(prt, order)?;
            let (ldr, hdr) = shot.flip(&picture);
            let label = method_label(method, None);
            second.push(shot.dim(&picture, format!("{label}, order {order}: FLIP {ldr:.3}")));
            data.push([method.to_owned(), (order * order).to_string(), ldr.to_string(), hdr.to_string()]);
            if order == 6 {
                said.push(format!("{ldr:.3} ({label}, {} coefficients)", order * order));
            }
        }
    }
    Ok(Some(Section {
        title: title.into(),
        paper: Some(paper),
        here: format!(
            "a held-out sun whose error is the median ({}), all methods trained for suns. FLIP: {}.",
            percent(median),
            said.join(", ")
        ),
        blocks: vec![Block::Plate(Plate { rows: vec![first, second], pixelated: false })],
        data: vec![("figure-12-classical.csv".into(), lines("method,coefficients,flip_ldr,flip_hdr", data))],
    }))
}
