//! Puts the report of one model together: errors of every method, plots, and pictures under three held-out lights.

use glam::Vec3;

use super::comparison::{Comparison, Row};
use super::figures;
use super::page::{Image, Page, Plate, Plot, method_label};
use super::plot::{Series, line_plot};
use super::views::{ViewRow, views_csv};
use crate::dataset::{Bytes, Dataset, DatasetError};
use crate::light::{EmissionFacets, LightingCondition};
use crate::model::{Model, ViewError};
use crate::progress::Progress;
use crate::prt::{PrtError, PrtSettings, bake_texels, bake_vertices};
use crate::scene::{Finish, Lightmap, Tracer};
use crate::transfer::{Fit, Gram, HeldOutErrors, Precision, Prior, TransferError};
use crate::transport::reference::ReferenceError;
use crate::transport::{BakeError, BakeSettings, Bias, bake_direct};

/// The largest order of spherical harmonics that is compared.
const ORDER: usize = 6;

#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    #[error(transparent)]
    Transfer(#[from] TransferError),
    #[error(transparent)]
    View(#[from] ViewError),
    #[error(transparent)]
    Bake(#[from] BakeError),
    #[error(transparent)]
    Dataset(#[from] DatasetError),
}

impl From<PrtError> for ReportError {
    fn from(_: PrtError) -> Self {
        // The order is a constant of this file, in range.
        BakeError::Cancelled.into()
    }
}

impl From<ReferenceError> for ReportError {
    fn from(error: ReferenceError) -> Self {
        match error {
            ReferenceError::View(error) => error.into(),
            ReferenceError::Stopped(error) => error.into(),
        }
    }
}

/// A dataset under the name of its scenario, with its Gram matrix and its prior.
pub struct Scenery<'a> {
    pub name: &'a str,
    pub dataset: &'a Dataset,
    pub gram: &'a Gram,
    /// For fits of `linear` and `local`.
    pub prior: Option<&'a Prior>,
}

/// What a report is made from.
pub struct Inputs<'a> {
    pub model: &'a Model,
    pub tracer: &'a Tracer<'a>,
    pub lightmap: &'a Lightmap,
    pub finish: &'a Finish,
    pub bake: BakeSettings,
    /// λ given by the user, relative.
    pub lambda: Option<f64>,
    /// Position and normal of each texel.
    pub places: &'a [(Vec3, Vec3)],
    /// Anchors of local bases, and how their channels are stored.
    pub anchors: usize,
    pub precision: Precision,
    /// Paths per pixel of the reference pictures.
    pub reference_paths: u32,
    /// Ceiling of the process's resident memory.
    pub memory: Bytes,
    /// The model's global fit, and the errors of the model.
    pub fit: &'a Fit,
    pub errors: &'a HeldOutErrors,
    /// The model's own scenario first.
    pub scenarios: Vec<Scenery<'a>>,
}

/// A report, ready to be written.
pub struct Report {
    pub page: Page,
    /// Of the bake, where it gathers.
    pub bias: Option<Bias>,
    /// How different relit pictures look from path traced ones.
    pub views: Vec<ViewRow>,
    /// File name and PNG bytes.
    pub images: Vec<(String, Vec<u8>)>,
    /// File name and text.
    pub tables: Vec<(String, String)>,
}

impl Inputs<'_> {
    /// Compares, plots and renders.
    ///
    /// # Errors
    /// When a fit fails, the camera is unusable, or `progress` cancels.
    pub fn assemble(&self, progress: &dyn Progress) -> Result<Report, ReportError> {
        let settings =
            |paths: u32| PrtSettings { order: ORDER, paths, max_bounces: self.bake.max_bounces, seed: self.bake.seed };
        // The high bands are noisier than the light itself: they are given more paths than the bake, so that what is
        // compared is the method and not its noise.
        let vertices = bake_vertices(self.tracer, self.lightmap, &settings(16 * self.bake.paths), progress)?;
        let texels = bake_texels(self.tracer, self.lightmap, &settings(4 * self.bake.paths), progress)?;
        let centre = self.model.asset.mesh.bounds().centre();
        let emission = EmissionFacets::of(&self.model.asset);

        let mut rows = Vec::new();
        for scenery in &self.scenarios {
            let comparison = Comparison {
                scenario: scenery.name.to_owned(),
                dataset: scenery.dataset,
                gram: scenery.gram,
                prior: scenery.prior,
                channels: self.fit.settings.channels,
                lambda: self.lambda,
                places: self.places,
                anchors: self.anchors,
                precision: self.precision,
                classical: &[("sh_prt_vertex", &vertices), ("sh_prt_texel", &texels)],
                centre,
                emission: &emission,
                at_once: self.lightmaps_at_once(),
            };
            let direct_of = |conditions: &[LightingCondition]| -> Result<Vec<f32>, ReportError> {
                Ok(bake_direct(self.tracer, self.lightmap, conditions, self.bake.seed, progress)?)
            };
            rows.extend(comparison.rows(&direct_of, progress)?);
        }

        let own = &self.scenarios[0];
        let held_out = &own.dataset.conditions[own.dataset.held_out()];
        let bias = Bias::measure(self.tracer, self.lightmap, held_out, &self.bake, progress)?;
        let (mut plates, views) = self.relit(own, &vertices, &texels, centre, progress)?;
        plates.push(self.points()?);
        plates.push(self.basis());
        let mut images = Vec::new();
        for plate in &plates {
            for (k, image) in plate.rows.iter().flatten().enumerate() {
                let name = format!("{}-{:02}-{}.png", file_part(&plate.title), k + 1, file_part(&image.caption));
                images.push((name, image.png.clone()));
            }
        }
        let plots = self.plots(&rows);
        let tables = vec![
            ("errors.csv".to_owned(), csv(&rows)),
            ("views.csv".to_owned(), views_csv(&views)),
            ("singular_values.csv".to_owned(), singular_values_csv(&self.fit.singular_values)),
        ];
        let page = Page {
            title: format!("{}: direct-to-indirect transfer", self.model.asset.name),
            facts: self.facts(own, bias),
            rows,
            plots,
            plates,
        };
        Ok(Report { page, bias, views, images, tables })
    }

    /// How many held-out lightmaps, direct and indirect, may be in memory together.
    fn lightmaps_at_once(&self) -> usize {
        let lightmap = self.lightmap.texels.len() as u64 * 12;
        // Each thread compares one reconstruction, direct and indirect, with them.
        let taken = Bytes::resident().0 + 3 * lightmap * rayon::current_num_threads() as u64;
        (self.memory.0.saturating_sub(taken) / (2 * lightmap).max(1)).max(1) as usize
    }

    fn facts(&self, own: &Scenery, bias: Option<Bias>) -> Vec<(String, String)> {
        let record = &self.model.record;
        let fact = |name: &str, value: String| (name.to_owned(), value);
        let noise = |noise: f64| format!("{:.1} % (part of every error below)", 100.0 * noise);
        let noise = record.held_out.noise.map_or("not known".into(), noise);
        vec![
            fact("triangles", self.model.asset.mesh.triangles.len().to_string()),
            fact("lightmap", format!("{0} x {0}, {1} texels", self.lightmap.size, self.lightmap.texels.len())),
            fact(
                "measurement points",
                format!(
                    "{} of {} sub-points each",
                    self.model.points.points.len(),
                    self.model.points.neighbours_per_point()
                ),
            ),
            fact("conditions", format!("{} to train, {} held out", own.dataset.training, own.dataset.held_out().len())),
            fact("paths per texel", self.bake.paths.to_string()),
            fact("noise of the lightmaps", noise),
            fact(
                "integrator",
                bias.map_or("path".into(), |b| {
                    let (relative, at_most) = (100.0 * b.relative, 100.0 * b.at_most);
                    format!("gather; bias against path tracing {relative:.2} %, at most {at_most:.2} %")
                }),
            ),
            fact("seed", self.bake.seed.to_string()),
        ]
    }

    fn plots(&self, rows: &[Row]) -> Vec<Plot> {
        let mut plots = Vec::new();
        for scenery in &self.scenarios {
            plots.push(Plot {
                title: format!("Error against size, {}", scenery.name),
                note: "Held-out error (plain) and the oracle of the same basis (dashed), as Figure 14 of the paper. SH PRT of order l has l² coefficients.".into(),
                svg: line_plot("coefficients per texel and channel", "relative RMSE", true, true, &error_series(rows, scenery.name)),
            });
        }
        let first = self.fit.singular_values.first().copied().unwrap_or(1.0);
        let points: Vec<(f64, f64)> = (self.fit.singular_values.iter().enumerate())
            .take(256)
            .map(|(i, s)| ((i + 1) as f64, (s / first).powi(2)))
            .filter(|p| p.1 > 1e-9)
            .collect();
        let series = Series { label: "σ² / σ₁²".into(), colour: 0, dashed: false, points };
        plots.push(Plot {
            title: "Relative eigenvalues of the indirect light".into(),
            note: "Of the Gram matrix that the basis comes from, as Figure 3 of the paper.".into(),
            svg: line_plot("element", "relative eigenvalue", true, true, &[series]),
        });
        plots
    }

    fn points(&self) -> Result<Plate, ReportError> {
        let images = figures::point_images(self.tracer, &self.model.points)?;
        Ok(Plate {
            title: "Measurement points".into(),
            note: "Where direct light is measured (Figure 4 of the paper).".into(),
            rows: vec![images],
            pixelated: false,
        })
    }

    fn basis(&self) -> Plate {
        let mut rows: Vec<Vec<Image>> = Vec::new();
        for image in figures::basis_images(self.lightmap, &self.model.basis) {
            match rows.last_mut() {
                Some(row) if row.len() < 4 => row.push(image),
                _ => rows.push(vec![image]),
            }
        }
        Plate {
            title: "Basis".into(),
            note: "The first elements (channels of a local basis) as lightmaps: red positive, blue negative, square-root scale.".into(),
            rows,
            pixelated: true,
        }
    }
}

/// One line per method and choice of λ, with its oracle dashed where it has one.
fn error_series(rows: &[Row], scenario: &str) -> Vec<Series> {
    let mut series: Vec<Series> = Vec::new();
    let mut groups: Vec<(&str, Option<&str>)> = rows.iter().map(|r| (r.method, r.lambda_choice)).collect();
    groups.sort();
    groups.dedup();
    // This program's own method comes first.
    groups.sort_by_key(|(method, _)| !["linear", "local"].contains(method));
    for (colour, (method, choice)) in groups.into_iter().enumerate() {
        let own: Vec<&Row> =
            rows.iter().filter(|r| r.scenario == scenario && r.method == method && r.lambda_choice == choice).collect();
        let label = method_label(method, choice);
        let line = |value: &dyn Fn(&Row) -> Option<f64>| -> Vec<(f64, f64)> {
            own.iter().filter_map(|r| value(r).map(|v| (r.coefficients as f64, v))).collect()
        };
        let oracle = line(&|r| r.oracle_mean);
        series.push(Series { label: label.clone(), colour, dashed: false, points: line(&|r| Some(r.mean)) });
        // The baseline's basis, and so its oracle, is the same for every λ.
        if !oracle.is_empty() && (method != "belcour" || choice != Some("leave-one-out")) {
            series.push(Series { label: format!("{label}: oracle"), colour, dashed: true, points: oracle });
        }
    }
    series
}

fn csv(rows: &[Row]) -> String {
    let mut out = String::from(
        "scenario,method,lambda_choice,lambda,coefficients,bytes_per_texel,points,mean,median,worst,oracle_mean,total_mean\n",
    );
    for r in rows {
        let number = |v: Option<f64>| v.map_or(String::new(), |v| v.to_string());
        out += &format!(
            "{},{},{},{},{},{},{},{},{},{},{},{}\n",
            r.scenario,
            r.method,
            r.lambda_choice.unwrap_or(""),
            number(r.lambda),
            r.coefficients,
            r.bytes_per_texel.map_or(String::new(), |b| b.to_string()),
            r.points,
            r.mean,
            r.median,
            r.worst,
            number(r.oracle_mean),
            r.total_mean
        );
    }
    out
}

fn singular_values_csv(values: &[f64]) -> String {
    let lines = values.iter().enumerate().map(|(i, s)| format!("{},{s}\n", i + 1));
    std::iter::once("element,singular_value\n".to_owned()).chain(lines).collect()
}

/// Letters and digits of a caption, for a file name.
fn file_part(caption: &str) -> String {
    let words: Vec<String> = caption
        .split(|c: char| !c.is_ascii_alphanumeric())
        .filter(|w| !w.is_empty())
        .take(5)
        .map(str::to_lowercase)
        .collect();
    words.join("-")
}
