//! Puts the report of one model together: errors of every method, the paper's figures, and pictures under held-out lights.

use super::comparison::{Comparison, Row};
use super::figures;
use super::fits::{Fits, Recipe};
use super::page::{Block, Chapter, Image, Page, Plate, Section};
use super::pictures;
use super::table;
use super::temporal::{Measured, Moving};
use super::views::{ViewRow, views_csv};
use crate::dataset::{Bytes, Dataset, DatasetError};
use crate::light::{EmissionFacets, LightingCondition, Scenario, ScenarioError};
use crate::model::{Model, ViewError};
use crate::progress::Progress;
use crate::prt::{PrtError, PrtSettings, ShPrt, bake_texels, bake_vertices};
use crate::scene::{Finish, Lightmap, Tracer};
use crate::transfer::{Fit, Gram, HeldOutErrors, TransferError};
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
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
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

/// Training sets of one scenario, with the same held-out conditions.
pub struct Scenery<'a> {
    pub name: &'a str,
    /// That of the model, or the first one, before those of other seeds.
    pub sets: Vec<Measured<'a>>,
    /// Of the first set.
    pub gram: &'a Gram,
    /// That they are drawn from.
    pub scenario: &'a Scenario,
}

/// A few conditions of one kind of light, to train and to test on.
pub struct KindSet {
    pub name: String,
    pub scenario: Scenario,
    pub dataset: Dataset,
}

/// What a report is made from.
pub struct Inputs<'a> {
    pub model: &'a Model,
    pub tracer: &'a Tracer<'a>,
    pub lightmap: &'a Lightmap,
    pub finish: &'a Finish,
    pub bake: BakeSettings,
    /// For the own scenario.
    pub recipe: Recipe<'a>,
    /// Paths per pixel of the reference pictures.
    pub reference_paths: u32,
    /// The model's global fit, and the errors of the model.
    pub fit: &'a Fit,
    pub errors: &'a HeldOutErrors,
    /// The model's own scenario first, then that of distant lights.
    pub scenarios: Vec<Scenery<'a>>,
    /// Lights of the own scenario that move.
    pub moving: Option<&'a Moving>,
    /// Several kinds of light, the model's own first.
    pub kinds: &'a [KindSet],
    /// Whether figures that take long are left out.
    pub quick: bool,
}

/// What figures are drawn from.
pub struct Results {
    pub rows: Vec<Row>,
    /// Of the first set of each scenario.
    pub fits: Vec<Fits>,
    /// Classical transfer, by vertex and by texel.
    pub vertices: Option<ShPrt>,
    pub texels: Option<ShPrt>,
    /// Of what changes from frame to frame, relative.
    pub noise_of_change: Option<f64>,
}

/// A report, ready to be written.
pub struct Report {
    pub page: Page,
    pub rows: Vec<Row>,
    /// Of the bake, where it gathers.
    pub bias: Option<Bias>,
    /// Noise of what changes from frame to frame, relative: part of every error of it.
    pub noise_of_change: Option<f64>,
    /// How different relit pictures look from path traced ones.
    pub views: Vec<ViewRow>,
    /// File name and bytes.
    pub files: Vec<(String, Vec<u8>)>,
}

impl Inputs<'_> {
    /// Compares, plots and renders.
    ///
    /// # Errors
    /// When a fit fails, the camera is unusable, or `progress` cancels.
    pub fn assemble(&self, progress: &dyn Progress) -> Result<Report, ReportError> {
        let results = self.results(progress)?;
        let own = &self.scenarios[0];
        let dataset = own.sets[0].dataset;
        let held_out = &dataset.conditions[dataset.held_out()];
        let bias = Bias::measure(self.tracer, self.lightmap, held_out, &self.bake, progress)?;
        let (relit, views) = self.relit(&results, progress)?;

        let chapters = vec![
            self.table_of_methods(&results.rows),
            Chapter {
                title: "Temporal stability".into(),
                note: String::new(),
                sections: vec![figures::temporal(self, &results, progress)?],
            },
            Chapter {
                title: "The paper's figures, for this asset".into(),
                note: "Numbers are those of Belcour, Deliot, Barbier and Soler, A Data-Driven Paradigm for Precomputed Radiance \
                       Transfer (2022)."
                    .into(),
                sections: figures::of_paper(self, &results, progress)?,
            },
            Chapter {
                title: "What training needs".into(),
                note: String::new(),
                sections: if self.quick { Vec::new() } else { vec![figures::sweeps(self, progress)?] },
            },
            Chapter {
                title: "Held-out lights, relit".into(),
                note: format!(
                    "Path traced with {} paths a pixel. Error: difference over the mean of the reference, brightest at {}. FLIP: \
                     difference of the whole picture as it is seen, from 0 to 1, low and high dynamic range; that of the reference's \
                     halves tells how much of each is noise of the reference.",
                    self.reference_paths,
                    super::page::percent(super::views::FULL_SCALE as f64)
                ),
                sections: relit,
            },
            Chapter { title: "Basis".into(), note: String::new(), sections: vec![self.basis()] },
        ];
        let page = Page {
            title: format!("{}: direct-to-indirect transfer", self.model.asset.name),
            facts: self.facts(bias),
            chapters: chapters.into_iter().filter(|c| !c.sections.is_empty()).collect(),
        };
        let mut files = page_files(&page);
        files.push(("views.csv".to_owned(), views_csv(&views).into_bytes()));
        Ok(Report { page, rows: results.rows, bias, noise_of_change: results.noise_of_change, views, files })
    }

    /// Classical transfer, and the rows of every scenario.
    fn results(&self, progress: &dyn Progress) -> Result<Results, ReportError> {
        let settings =
            |paths: u32| PrtSettings { order: ORDER, paths, max_bounces: self.bake.max_bounces, seed: self.bake.seed };
        // The high bands are noisier than the light itself: they are given more paths than the bake, so that what is
        // compared is the method and not its noise.
        let receivers = [self.model.asset.mesh.positions.len(), self.lightmap.texels.len()];
        let [by_vertex, by_texel] = receivers.map(|count| self.fits_memory(ShPrt::bytes_needed(count, ORDER)));
        let vertices = by_vertex
            .then(|| bake_vertices(self.tracer, self.lightmap, &settings(16 * self.bake.paths), progress))
            .transpose()?;
        let texels = by_texel
            .then(|| bake_texels(self.tracer, self.lightmap, &settings(4 * self.bake.paths), progress))
            .transpose()?;
        if vertices.is_none() || texels.is_none() {
            progress.note("classical transfer would not fit into --memory and is compared as far as it does");
        }
        let named = [("sh_prt_vertex", &vertices), ("sh_prt_texel", &texels)];
        let classical: Vec<(&'static str, &ShPrt)> =
            named.into_iter().filter_map(|(name, prt)| Some((name, prt.as_ref()?))).collect();
        let emission = EmissionFacets::of(&self.model.asset);
        let (mut rows, mut fits) = (Vec::new(), Vec::new());
        for (i, scenery) in self.scenarios.iter().enumerate() {
            let comparison = Comparison {
                scenario: scenery.name,
                sets: &scenery.sets,
                gram: scenery.gram,
                recipe: self.recipe.under(scenery.scenario),
                moving: self.moving.filter(|_| i == 0),
                classical: &classical,
                centre: self.model.asset.mesh.bounds().centre(),
                emission: &emission,
                at_once: self.lightmaps_at_once(),
            };
            let direct_of = |conditions: &[LightingCondition]| -> Result<Vec<f32>, ReportError> {
                Ok(bake_direct(self.tracer, self.lightmap, conditions, self.bake.seed, progress)?)
            };
            let (of_scenario, fits_of_scenario) = comparison.rows(&direct_of, progress)?;
            rows.extend(of_scenario);
            fits.push(fits_of_scenario);
        }
        let noise = self.moving.map(|m| m.noise(self.tracer, self.lightmap, &self.bake, self.recipe.memory, progress));
        let noise_of_change = noise.transpose()?.flatten();
        Ok(Results { rows, fits, vertices, texels, noise_of_change })
    }

    /// Whether as many bytes more fit into the ceiling of memory.
    pub fn fits_memory(&self, bytes: u64) -> bool {
        Bytes::resident().0 + bytes <= self.recipe.memory.0
    }

    /// How many held-out lightmaps, direct and indirect, may be in memory together.
    fn lightmaps_at_once(&self) -> usize {
        let lightmap = self.lightmap.texels.len() as u64 * 12;
        // Each thread compares one reconstruction, direct and indirect, with them.
        let taken = Bytes::resident().0 + 3 * lightmap * rayon::current_num_threads() as u64;
        (self.recipe.memory.0.saturating_sub(taken) / (2 * lightmap).max(1)).max(1) as usize
    }

    fn facts(&self, bias: Option<Bias>) -> Vec<(String, String)> {
        let record = &self.model.record;
        let set = &self.scenarios[0].sets[0];
        let fact = |name: &str, value: String| (name.to_owned(), value);
        let noise = |noise: f64| format!("{:.1} % (part of every error below)", 100.0 * noise);
        let noise = record.held_out.noise.map_or("not known".into(), noise);
        let points = &self.model.points;
        vec![
            fact("model", format!("{}, {} {}", record_method(self), self.model.basis.elements, elements_word(self))),
            fact("triangles", self.model.asset.mesh.triangles.len().to_string()),
            fact("lightmap", format!("{0} x {0}, {1} texels", self.lightmap.size, self.lightmap.texels.len())),
            fact(
                "measurement points",
                format!("{} of {} sub-points each", points.points.len(), points.neighbours_per_point()),
            ),
            fact("conditions", format!("{} to train, {} held out", set.dataset.training, set.dataset.held_out().len())),
            fact("training sets", self.scenarios[0].sets.len().to_string()),
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

    fn table_of_methods(&self, rows: &[Row]) -> Chapter {
        let sets = self.scenarios[0].sets.len();
        let spread = match sets {
            1 => String::new(),
            _ => format!(
                " Mean and standard deviation over {sets} training sets, each of lights and measurement points of its own, \
                 tested on the same lights."
            ),
        };
        let tables = self.scenarios.iter().map(|s| Block::Table(table::of_rows(s.name, rows)));
        Chapter {
            title: "Error on lights never seen, and what it costs".into(),
            note: format!(
                "Relative RMSE of indirect irradiance over the lightmap (area weighted), over held-out conditions.{spread} Oracle: the \
                 truth projected on the same basis, which no transfer can better. Total: direct and indirect light together; the \
                 data-driven methods take direct light from the renderer as it is, SH PRT reconstructs it, too. Frame to frame: \
                 error of what changes while a light moves. Bytes and multiply-adds are what a texel's indirect light takes once \
                 the coefficients are there (of a vertex, for SH PRT per vertex); model: basis and matrices. SH PRT knows \
                 distant light only: a light near the asset is projected as it is seen from the asset's centre, which is where \
                 the classical method ends."
            ),
            sections: vec![Section {
                blocks: tables.collect(),
                data: vec![("errors.csv".into(), table::csv(rows))],
                ..Section::default()
            }],
        }
    }

    fn basis(&self) -> Section {
        let mut rows: Vec<Vec<Image>> = Vec::new();
        for image in pictures::basis_images(self.lightmap, &self.model.basis) {
            match rows.last_mut() {
                Some(row) if row.len() < 4 => row.push(image),
                _ => rows.push(vec![image]),
            }
        }
        Section {
            here: "The first elements (channels of a local basis) as lightmaps: red positive, blue negative, square-root scale.".into(),
            blocks: vec![Block::Plate(Plate { rows, pixelated: true })],
            ..Section::default()
        }
    }
}

fn record_method(inputs: &Inputs) -> &'static str {
    inputs.fit.settings.method.name()
}

/// What a basis has n of.
pub fn elements_word(inputs: &Inputs) -> &'static str {
    if inputs.model.basis.anchors.is_some() { "channels a texel" } else { "elements" }
}

/// Pictures, plots and data of a page as files of their own.
fn page_files(page: &Page) -> Vec<(String, Vec<u8>)> {
    let mut files = Vec::new();
    for section in page.chapters.iter().flat_map(|c| &c.sections) {
        files.extend(section.data.iter().map(|(name, text)| (name.clone(), text.clone().into_bytes())));
        for block in &section.blocks {
            match block {
                Block::Plots(plots) => {
                    let shown = plots.iter().filter(|p| !p.svg.is_empty());
                    files.extend(shown.map(|p| (format!("plots/{}.svg", p.name), p.svg.clone().into_bytes())));
                }
                Block::Plate(plate) => {
                    for (k, image) in plate.rows.iter().flatten().enumerate() {
                        let (title, caption) = (file_part(&section.title), file_part(&image.caption));
                        let title = if title.is_empty() { "basis".to_owned() } else { title };
                        files.push((format!("images/{title}-{:02}-{caption}.png", k + 1), image.png.clone()));
                    }
                }
                Block::Table(_) => {}
            }
        }
    }
    files
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
