//! Figure 8: lights of another kind than those that were trained on.

use super::super::assemble::{Inputs, KindSet, ReportError};
use super::super::fits::Fits;
use super::super::page::{Block, Cell, Plate, Section, Table, method_label, percent};
use super::super::table::lines;
use super::super::temporal::Measured;
use super::super::views::Shot;
use crate::dataset::Dataset;
use crate::progress::Progress;
use crate::transfer::error::mean_median_worst;
use crate::transfer::{Gram, Probe};

const SIZES: [usize; 1] = [16];
const LOCAL_SIZES: [usize; 1] = [4];

/// Mean error of each fit where it was trained on `kind`, by the kind that it is tested on.
type Errors = Vec<(Vec<f64>, super::Label)>;

/// None where there is but one kind of light.
pub fn scenarios(inputs: &Inputs, progress: &dyn Progress) -> Result<Option<Section>, ReportError> {
    let kinds = inputs.kinds;
    if kinds.len() < 2 {
        return Ok(None);
    }
    let trained = (0..kinds.len()).map(|k| errors_of(inputs, k, progress)).collect::<Result<Vec<_>, _>>()?;
    let names = || kinds.iter().map(|kind| kind.name.clone());
    let (mut tables, mut data, mut said) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..trained[0].len() {
        let label = trained[0][i].1;
        let name = format!("{}, {}", method_label(label.method, Some(label.lambda_choice)), label.size);
        let mut rows = Vec::new();
        let (mut own, mut foreign) = (Vec::new(), Vec::new());
        for (k, of_kind) in trained.iter().enumerate() {
            let Some((errors, _)) = of_kind.get(i) else { continue };
            let cell = |(tested, &error): (usize, &f64)| {
                if tested == k {
                    own.push(error)
                } else {
                    foreign.push(error)
                };
                data.push([
                    label.method.to_owned(),
                    label.size.to_string(),
                    kinds[k].name.clone(),
                    kinds[tested].name.clone(),
                    error.to_string(),
                ]);
                // Dark where half the light is wrong, or more.
                Cell { shade: Some(error / 0.5), ..Cell::percent(error) }
            };
            let cells: Vec<Cell> = errors.iter().enumerate().map(cell).collect();
            rows.push([vec![Cell::name(format!("trained on {}", kinds[k].name))], cells].concat());
        }
        let (own, foreign) = (mean_median_worst(&own).0, mean_median_worst(&foreign).0);
        said.push(format!("{} → {} ({name})", percent(own), percent(foreign)));
        let header = std::iter::once("tested on".to_owned()).chain(names()).collect();
        tables.push(Block::Table(Table { title: name, header, rows }));
    }
    tables.extend(pictures(inputs, progress)?);
    let counts = &kinds[0].dataset;
    Ok(Some(Section {
        title: "Figure 8: changed lights".into(),
        paper: Some(
            "trained on spot lights, the method is close to the reference under spots and departs from it under another kind of light, while it stays coherent.",
        ),
        here: format!(
            "mean error on the diagonal → off it: {}. {} conditions of each kind to train on, {} to test on.",
            said.join(", "),
            counts.training,
            counts.held_out().len()
        ),
        blocks: tables,
        data: vec![("figure-08-scenarios.csv".into(), lines("method,coefficients,trained_on,tested_on,mean", data))],
    }))
}

/// The model under a light of its own and under one of another kind, as the paper shows it.
fn pictures(inputs: &Inputs, progress: &dyn Progress) -> Result<Option<Block>, ReportError> {
    let kinds = &inputs.kinds[1..];
    let Some(KindSet { name, dataset: foreign, .. }) = kinds.iter().find(|k| k.name == "directional").or(kinds.last())
    else {
        return Ok(None);
    };
    // Of the held-out ones that with the median x.
    let norm = |&h: &usize| foreign.direct(h).iter().map(|x| x.length_squared()).sum::<f32>();
    let mut held_out: Vec<usize> = foreign.held_out().collect();
    held_out.sort_by(|a, b| norm(a).total_cmp(&norm(b)));
    let (Some(&h), Some((own, _))) = (held_out.get(held_out.len() / 2), inputs.held_out_at(0.5)) else {
        return Ok(None);
    };
    let mut row = Vec::new();
    for (kind, condition) in [("the model's lights", own), (name.as_str(), &foreign.conditions[h])] {
        let shot = Shot::take(inputs, condition, progress)?;
        let picture = shot.by_model()?;
        let (ldr, _) = shot.flip(&picture);
        row.push(shot.dim(&shot.reference, format!("{kind}: reference, indirect")));
        row.push(shot.dim(&picture, format!("{kind}: the model, FLIP {ldr:.3}")));
        row.push(shot.error(&picture));
    }
    Ok(Some(Block::Plate(Plate { rows: vec![row], pixelated: false })))
}

/// Every fit trained on one kind, on the held-out conditions of each.
fn errors_of(inputs: &Inputs, kind: usize, progress: &dyn Progress) -> Result<Errors, ReportError> {
    let KindSet { scenario, dataset: trained_on, .. } = &inputs.kinds[kind];
    let training = trained_on.training;
    let mut parts: Vec<(&Dataset, Vec<usize>)> = vec![(trained_on, (0..training).collect())];
    parts.extend(inputs.kinds.iter().map(|kind| (&kind.dataset, kind.dataset.held_out().collect())));
    let dataset = Dataset::gather(&parts, training, progress)?;
    let gram = Gram::of(&dataset, progress)?;
    let set = Measured { dataset: &dataset, ..inputs.scenarios[0].sets[0] };
    let fits: Fits = inputs.recipe.under(scenario).one_size(&SIZES, &LOCAL_SIZES).fit(set, &gram, progress)?;
    let of_fit = |fitted| -> Result<_, ReportError> {
        let tested = fits.test(fitted, &dataset, &gram, progress)?;
        let mut first = training;
        let of_kind = |kind: &KindSet| {
            let own = first..first + kind.dataset.held_out().len();
            first = own.end;
            // What is dark is told among lights of its own kind.
            let norms: Vec<f64> = own.clone().map(|h| gram.squared_norm(h)).collect();
            let least = 1e-4 * mean_median_worst(&norms).1;
            let lit = own.zip(norms).filter(|&(_, norm)| norm > least).map(|(h, _)| h);
            let errors: Vec<f64> = lit
                .map(|h| {
                    let (error, norm) = tested.squared_error(&Probe::one(h));
                    (error / norm).sqrt()
                })
                .collect();
            mean_median_worst(&errors).0
        };
        Ok((inputs.kinds.iter().map(of_kind).collect(), fitted.label))
    };
    fits.list.iter().map(of_fit).collect()
}
