//! Relit pictures of held-out lights beside path traced ones, and how different they look.

use glam::Vec3;

use super::assemble::{Inputs, ReportError, Scenery};
use super::figures;
use super::flip;
use super::page::{Image, Plate};
use crate::light::{EmissionFacets, LightTable, LightingCondition};
use crate::math::Rgb;
use crate::math::colour::tone_map;
use crate::model::render::render;
use crate::model::{Basis, LightmapImage, Picture, Shown, Transfer, View};
use crate::progress::Progress;
use crate::prt::{ShPrt, light_coefficients};
use crate::transfer::{Fit, Lambda, Method, PUBLISHED_LAMBDA, TrainSettings};
use crate::transport::reference::{Reference, ReferenceSettings};

/// The order whose pictures are shown: 16 coefficients, as many as the default basis.
const SHOWN_ORDER: usize = 4;

/// Size of the pictures, pixels.
const PICTURE: (u32, u32) = (320, 260);

/// Difference, relative to the picture's mean, at which false colour is brightest.
const FULL_SCALE: f32 = 0.5;

/// How different a relit picture looks from the path traced one ([`flip`]), direct light included, from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ViewRow {
    /// Which held-out light.
    pub light: &'static str,
    pub method: &'static str,
    pub flip_ldr: f64,
    pub flip_hdr: f64,
}

/// A method, and the mean FLIP of its picture in low and in high dynamic range.
type Difference = (&'static str, f64, f64);

/// One line a picture.
pub fn views_csv(views: &[ViewRow]) -> String {
    let lines = views.iter().map(|v| format!("{},{},{},{}\n", v.light, v.method, v.flip_ldr, v.flip_hdr));
    std::iter::once("light,method,flip_ldr,flip_hdr\n".to_owned()).chain(lines).collect()
}

impl Inputs<'_> {
    /// Relit pictures of three held-out conditions: well, middling and badly reconstructed ones.
    pub(super) fn relit(
        &self,
        own: &Scenery,
        vertices: &ShPrt,
        texels: &ShPrt,
        centre: Vec3,
        progress: &dyn Progress,
    ) -> Result<(Vec<Plate>, Vec<ViewRow>), ReportError> {
        let errors = self.errors;
        let lit: Vec<usize> = own.dataset.held_out().filter(|&h| own.gram.is_lit(h)).collect();
        let mut order: Vec<usize> = (0..errors.transfer.len()).collect();
        order.sort_by(|&a, &b| errors.transfer[a].total_cmp(&errors.transfer[b]));
        let baseline = self.baseline(own, progress)?;
        let (mut plates, mut views) = (Vec::new(), Vec::new());
        for (share, name) in [(0.1, "one of the best tenth"), (0.5, "the median"), (0.9, "one of the worst tenth")] {
            let Some(&k) = order.get(((order.len() as f64 - 1.0) * share).round() as usize) else { continue };
            let condition = &own.dataset.conditions[lit[k]];
            let (rows, differences) = self.relit_rows(condition, &baseline, vertices, texels, centre, progress)?;
            views.extend(differences.map(|(method, ldr, hdr)| ViewRow {
                light: name,
                method,
                flip_ldr: ldr,
                flip_hdr: hdr,
            }));
            plates.push(Plate {
                title: format!("Held-out light: {name}"),
                note: format!(
                    "Relative RMSE of the lightmap {:.1} %. Path traced with {} paths a pixel. Error: difference over the mean of the reference, brightest at {:.0} %. FLIP: difference of the whole picture as it is seen, from 0 to 1, low and high dynamic range.",
                    100.0 * errors.transfer[k],
                    self.reference_paths,
                    100.0 * FULL_SCALE
                ),
                rows,
                pixelated: false,
            });
        }
        Ok((plates, views))
    }

    /// The paper's baseline with as many elements as the model; with the paper's 16 beside a local one.
    fn baseline(&self, own: &Scenery, progress: &dyn Progress) -> Result<(Basis, Transfer), ReportError> {
        let fit = self.fit.settings;
        let lambda = self.lambda.map_or(PUBLISHED_LAMBDA, Lambda::Relative);
        let kept = own.dataset.training - self.fit.dropped;
        let elements = if fit.method == Method::Local { kept.min(16) } else { fit.elements };
        let settings = TrainSettings { method: Method::Belcour, lambda, elements, ..fit };
        let (values, transfer) = Fit::train(own.dataset, own.gram, settings)?.expand(own.dataset, progress)?;
        Ok((Basis::from_texels(self.finish, transfer.elements, &values), transfer))
    }

    fn relit_rows(
        &self,
        condition: &LightingCondition,
        (baseline, baseline_transfer): &(Basis, Transfer),
        vertices: &ShPrt,
        texels: &ShPrt,
        centre: Vec3,
        progress: &dyn Progress,
    ) -> Result<(Vec<Vec<Image>>, [Difference; 4]), ReportError> {
        let model = self.model;
        let view = View::new(model.asset.cameras[0].clone(), PICTURE.0, PICTURE.1);
        let emission = EmissionFacets::of(&model.asset);
        let table = LightTable::new(&condition.lights, &emission);
        let settings = ReferenceSettings {
            samples: self.reference_paths,
            max_bounces: self.bake.max_bounces,
            seed: self.bake.seed,
        };
        let reference = Reference::trace(self.tracer, &view, &condition.lights, &settings, progress)?;
        let direct = render(self.tracer, &view, &table, Shown::Direct, &|_| Rgb::ZERO)?;
        let x = model.points.direct(self.tracer, &table);
        let ours = model.render_with(self.tracer, &view, &table, &model.transfer.coefficients(&x), Shown::Indirect)?;
        let baseline = baseline.reconstruct(&baseline_transfer.coefficients(&x));
        let published = render(self.tracer, &view, &table, Shown::Indirect, &|uv| baseline.sample(uv))?;
        let light = light_coefficients(&condition.lights, &emission, centre, SHOWN_ORDER);
        let classical = |prt: &ShPrt| {
            let image = LightmapImage::new(self.finish, &prt.indirect(&light));
            render(self.tracer, &view, &table, Shown::Indirect, &|uv| image.sample(uv))
        };
        let (by_vertex, by_texel) = (classical(vertices)?, classical(texels)?);

        // The reference's direct light is noisy at shadow edges only; its sum with the indirect light sets the exposure.
        let truth = figures::sum(&direct, &reference.indirect);
        let exposure = figures::exposure_for(&truth);
        // Indirect light alone is darker: all its pictures are shown one stop brighter.
        let picture = |p: &Picture, caption: String| figures::render(p, exposure, caption);
        let dim = |p: &Picture, caption: String| figures::render(p, 2.0 * exposure, caption);
        let error =
            |p: &Picture| figures::error(p, &reference.indirect, &truth, FULL_SCALE, "error of the indirect light");
        let shown = |p: &Picture| {
            let pixels = p.pixels.iter().map(|&c| tone_map(c * exposure).clamp(Vec3::ZERO, Vec3::ONE)).collect();
            Picture { pixels, ..*p }
        };
        let difference = |method: &'static str, indirect: &Picture| -> Difference {
            let whole = figures::sum(&direct, indirect);
            (method, flip::mean(&flip::ldr(&shown(&truth), &shown(&whole))), flip::mean(&flip::hdr(&truth, &whole)))
        };
        let differences = [
            difference(self.fit.settings.method.name(), &ours),
            difference("belcour", &published),
            difference("sh_prt_texel", &by_texel),
            difference("sh_prt_vertex", &by_vertex),
        ];
        let flips = |k: usize| format!("FLIP {:.3}, HDR {:.3}", differences[k].1, differences[k].2);
        let n = model.basis.elements;
        let elements = if model.basis.anchors.is_some() { "channels a texel" } else { "elements" };
        let prt = format!("order {SHOWN_ORDER}");
        let rows = vec![
            vec![
                picture(&direct, "direct".into()),
                dim(&ours, format!("indirect, {n} {elements} (one stop up)")),
                picture(&figures::sum(&direct, &ours), format!("sum: {}", flips(0))),
                picture(&truth, "reference, path traced".into()),
                error(&ours),
            ],
            vec![
                dim(&reference.indirect, "reference, indirect".into()),
                dim(&published, format!("Belcour 2022, {} elements: {}", baseline_transfer.elements, flips(1))),
                error(&published),
                dim(&by_texel, format!("SH PRT per texel, {prt}: {}", flips(2))),
                dim(&by_vertex, format!("SH PRT per vertex, {prt}: {}", flips(3))),
            ],
        ];
        Ok((rows, differences))
    }
}
