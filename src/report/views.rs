//! Relit pictures of held-out lights beside path traced ones, and how different they look.

use glam::{Vec2, Vec3};

use super::assemble::{Inputs, ReportError, Results, elements_word};
use super::flip;
use super::page::{Block, Image, Plate, Section, percent};
use super::pictures;
use crate::light::{EmissionFacets, LightTable, LightingCondition};
use crate::math::Rgb;
use crate::math::colour::tone_map;
use crate::math::sampler::mix64;
use crate::model::render::render;
use crate::model::{Basis, LightmapImage, Picture, Shown, Transfer, View};
use crate::progress::Progress;
use crate::prt::{ShPrt, light_coefficients};
use crate::transfer::{Fit, Lambda, Method, PUBLISHED_LAMBDA, TrainSettings};
use crate::transport::reference::{Reference, ReferenceSettings};

/// The order whose pictures are shown: 16 coefficients, as many as the paper's basis.
pub const SHOWN_ORDER: usize = 4;

/// Elements of the baseline that a local basis is shown beside: those that the paper finds plausible.
const BASELINE: usize = 16;

/// Size of the pictures, pixels.
const PICTURE: (u32, u32) = (320, 260);

/// Difference, relative to the picture's mean, at which false colour is brightest.
pub const FULL_SCALE: f32 = 0.5;

/// How different a relit picture looks from the path traced one ([`flip`]), direct light included, from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ViewRow {
    /// Which held-out light.
    pub light: &'static str,
    /// Of the row, or `reference_halves`: the two halves of the reference's paths against each other, which tells its noise.
    pub method: &'static str,
    pub flip_ldr: f64,
    pub flip_hdr: f64,
}

/// One line a picture.
pub fn views_csv(views: &[ViewRow]) -> String {
    let lines = views.iter().map(|v| format!("{},{},{},{}\n", v.light, v.method, v.flip_ldr, v.flip_hdr));
    std::iter::once("light,method,flip_ldr,flip_hdr\n".to_owned()).chain(lines).collect()
}

/// A condition, path traced, that relit pictures are compared with.
pub struct Shot<'i> {
    inputs: &'i Inputs<'i>,
    view: View,
    pub condition: LightingCondition,
    table: LightTable,
    emission: EmissionFacets,
    pub direct: Picture,
    /// Indirect light; the same from each half of the paths; and all light.
    pub reference: Picture,
    halves: [Picture; 2],
    pub truth: Picture,
    exposure: f32,
}

impl<'i> Shot<'i> {
    pub fn take(
        inputs: &'i Inputs<'i>,
        condition: &LightingCondition,
        progress: &dyn Progress,
    ) -> Result<Self, ReportError> {
        let view = View::new(inputs.model.asset.cameras[0].clone(), PICTURE.0, PICTURE.1);
        let emission = EmissionFacets::of(&inputs.model.asset);
        let table = LightTable::new(&condition.lights, &emission);
        // In two halves, whose difference tells the noise.
        let traced = |half: u64| -> Result<Picture, ReportError> {
            let settings = ReferenceSettings {
                samples: inputs.reference_paths.div_ceil(2),
                max_bounces: inputs.bake.max_bounces,
                seed: mix64(inputs.bake.seed ^ half),
            };
            Ok(Reference::trace(inputs.tracer, &view, &condition.lights, &settings, progress)?.indirect)
        };
        let halves = [traced(1)?, traced(2)?];
        let mut reference = pictures::sum(&halves[0], &halves[1]);
        reference.pixels.iter_mut().for_each(|p| *p *= 0.5);
        let direct = render(inputs.tracer, &view, &table, Shown::Direct, &|_| Rgb::ZERO)?;
        // The reference's direct light is noisy at shadow edges only; its sum with the indirect light sets the exposure.
        let truth = pictures::sum(&direct, &reference);
        let exposure = pictures::exposure_for(&truth);
        let condition = condition.clone();
        Ok(Self { inputs, view, condition, table, emission, direct, reference, halves, truth, exposure })
    }

    /// Indirect light that a lightmap gives.
    fn indirect(&self, sample: &(dyn Fn(Vec2) -> Rgb + Sync)) -> Result<Picture, ReportError> {
        Ok(render(self.inputs.tracer, &self.view, &self.table, Shown::Indirect, sample)?)
    }

    /// Indirect light that the model gives.
    pub fn by_model(&self) -> Result<Picture, ReportError> {
        let model = self.inputs.model;
        let coefficients = model.transfer.coefficients(&model.points.direct(self.inputs.tracer, &self.table));
        Ok(model.render_with(self.inputs.tracer, &self.view, &self.table, &coefficients, Shown::Indirect)?)
    }

    /// Indirect light that a basis and a transfer of the model's measurement points give.
    pub fn by_basis(&self, (basis, transfer): &(Basis, Transfer)) -> Result<Picture, ReportError> {
        let x = self.inputs.model.points.direct(self.inputs.tracer, &self.table);
        let image = basis.reconstruct(&transfer.coefficients(&x));
        self.indirect(&|uv| image.sample(uv))
    }

    /// Indirect light that classical transfer of an order gives.
    pub fn by_harmonics(&self, prt: &ShPrt, order: usize) -> Result<Picture, ReportError> {
        let centre = self.inputs.model.asset.mesh.bounds().centre();
        let light = light_coefficients(&self.condition.lights, &self.emission, centre, order);
        let image = LightmapImage::new(self.inputs.finish, &prt.indirect(&light));
        self.indirect(&|uv| image.sample(uv))
    }

    /// A picture as it is seen.
    pub fn picture(&self, picture: &Picture, caption: impl Into<String>) -> Image {
        pictures::render(picture, self.exposure, caption)
    }

    /// Indirect light alone, which is darker: one stop brighter.
    pub fn dim(&self, indirect: &Picture, caption: impl Into<String>) -> Image {
        pictures::render(indirect, 2.0 * self.exposure, caption)
    }

    pub fn error(&self, indirect: &Picture) -> Image {
        pictures::error(indirect, &self.reference, &self.truth, FULL_SCALE, "error of the indirect light")
    }

    /// Mean FLIP between the reference's halves: about twice what its noise adds to each [`Self::flip`].
    fn flip_of_halves(&self) -> (f64, f64) {
        let [a, b] = &self.halves;
        self.flip_between(&pictures::sum(&self.direct, a), &pictures::sum(&self.direct, b))
    }

    /// Mean FLIP of the whole picture in low and in high dynamic range.
    pub fn flip(&self, indirect: &Picture) -> (f64, f64) {
        self.flip_between(&self.truth, &pictures::sum(&self.direct, indirect))
    }

    fn flip_between(&self, truth: &Picture, whole: &Picture) -> (f64, f64) {
        let shown = |p: &Picture| {
            let pixels = p.pixels.iter().map(|&c| tone_map(c * self.exposure).clamp(Vec3::ZERO, Vec3::ONE)).collect();
            Picture { pixels, ..*p }
        };
        (flip::mean(&flip::ldr(&shown(truth), &shown(whole))), flip::mean(&flip::hdr(truth, whole)))
    }
}

impl Inputs<'_> {
    /// The held-out condition of the own scenario that the model reconstructs better than a share of them, and its error.
    pub fn held_out_at(&self, share: f64) -> Option<(&LightingCondition, f64)> {
        let own = &self.scenarios[0];
        let dataset = own.sets[0].dataset;
        let errors = &self.errors.transfer;
        let lit: Vec<usize> = dataset.held_out().filter(|&h| own.gram.is_lit(h)).collect();
        let mut order: Vec<usize> = (0..errors.len()).collect();
        order.sort_by(|&a, &b| errors[a].total_cmp(&errors[b]));
        let &k = order.get(((order.len() as f64 - 1.0) * share).round() as usize)?;
        Some((&dataset.conditions[lit[k]], errors[k]))
    }

    /// Relit pictures of three held-out conditions: well, middling and badly reconstructed ones.
    pub(super) fn relit(
        &self,
        results: &Results,
        progress: &dyn Progress,
    ) -> Result<(Vec<Section>, Vec<ViewRow>), ReportError> {
        let (baseline, elements) = self.baseline(progress)?;
        let (mut sections, mut views) = (Vec::new(), Vec::new());
        for (share, name) in [(0.1, "one of the best tenth"), (0.5, "the median"), (0.9, "one of the worst tenth")] {
            let Some((condition, error)) = self.held_out_at(share) else { continue };
            let shot = Shot::take(self, condition, progress)?;
            let (ldr, hdr) = shot.flip_of_halves();
            views.push(ViewRow { light: name, method: "reference_halves", flip_ldr: ldr, flip_hdr: hdr });
            let reference = format!("reference, path traced: its halves differ by FLIP {ldr:.3}, HDR {hdr:.3}");
            let mut seen = |method: &'static str, indirect: &Picture| {
                let (ldr, hdr) = shot.flip(indirect);
                views.push(ViewRow { light: name, method, flip_ldr: ldr, flip_hdr: hdr });
                format!("FLIP {ldr:.3}, HDR {hdr:.3}")
            };
            let (ours, published) = (shot.by_model()?, shot.by_basis(&baseline)?);
            let flip_ours = seen(self.fit.settings.method.name(), &ours);
            let n = self.model.basis.elements;
            let first = vec![
                shot.picture(&shot.direct, "direct"),
                shot.dim(&ours, format!("indirect, {n} {} (one stop up)", elements_word(self))),
                shot.picture(&pictures::sum(&shot.direct, &ours), format!("sum: {flip_ours}")),
                shot.picture(&shot.truth, reference),
                shot.error(&ours),
            ];
            let caption = format!("Belcour 2022, {elements} elements: {}", seen("belcour", &published));
            let mut second = vec![
                shot.dim(&shot.reference, "reference, indirect"),
                shot.dim(&published, caption),
                shot.error(&published),
            ];
            let classical =
                [("sh_prt_texel", "texel", &results.texels), ("sh_prt_vertex", "vertex", &results.vertices)];
            for (method, per, prt) in classical {
                if let Some(prt) = prt {
                    let picture = shot.by_harmonics(prt, SHOWN_ORDER)?;
                    let caption = format!("SH PRT per {per}, order {SHOWN_ORDER}: {}", seen(method, &picture));
                    second.push(shot.dim(&picture, caption));
                }
            }
            sections.push(Section {
                title: format!("Held-out light: {name}"),
                here: format!("Relative RMSE of the lightmap {}.", percent(error)),
                blocks: vec![Block::Plate(Plate { rows: vec![first, second], pixelated: false })],
                ..Section::default()
            });
        }
        Ok((sections, views))
    }

    /// The paper's baseline with as many elements as the model, or as the paper has where the model's basis is local.
    fn baseline(&self, progress: &dyn Progress) -> Result<((Basis, Transfer), usize), ReportError> {
        let (own, fit) = (&self.scenarios[0], self.fit.settings);
        let lambda = self.recipe.lambda.map_or(PUBLISHED_LAMBDA, Lambda::Relative);
        let local = fit.method == Method::Local;
        let dataset = own.sets[0].dataset;
        let most = dataset.training - self.fit.dropped;
        let elements = if local { BASELINE.min(most) } else { fit.elements };
        let settings = TrainSettings { method: Method::Belcour, lambda, elements, ..fit };
        let (values, transfer) = Fit::train(dataset, own.gram, settings)?.expand(dataset, progress)?;
        Ok(((Basis::from_texels(self.finish, transfer.elements, &values), transfer), elements))
    }
}
