//! Light carried backwards: where the light of a texel comes from. What a path from a texel meets reflects its direct light
//! towards it, and direct light is what measurement points measure. So the vertices of paths tell, without any light, what
//! each sub-point contributes to a texel (METHOD eq. 11).

use glam::{Vec2, Vec3};

use super::path::{Collector, Walk};
use super::{BakeSettings, bake::PATHS_BETWEEN_CHECKS};
use crate::math::{Rgb, Sampler};
use crate::measure::{MeasurementPoint, MeasurementPoints, Nearest, normal_scale};
use crate::progress::Progress;
use crate::scene::{Lightmap, Surface, Tracer};

/// Traces paths from texels to the sub-points that stand for what they meet.
pub struct Adjoint<'t, 'a> {
    tracer: &'t Tracer<'a>,
    lightmap: &'t Lightmap,
    sub_points: &'t [MeasurementPoint],
    nearest: Nearest,
    settings: BakeSettings,
}

/// Irradiance of a texel for each unit of the exitance of a sub-point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deposit {
    pub sub_point: u32,
    pub weight: Rgb,
}

/// Separates these paths from those of the bake.
const STREAM: u64 = 0x0061_646a_6f69_6e74;

/// Paths of the bake for each of these.
const BAKE_PATHS: u32 = 4;

/// Paths of all texels together: what they tell is summed over texels. With three times as many, errors on held-out lights are
/// the same to 0.1 points (interior, 50,000 texels).
const MOST_PATHS: usize = 1 << 19;

/// Cosine between normals below which light on one surface tells nothing of that on the other. Perpendicular walls meet in
/// corners.
const OPPOSITE: f32 = -0.5;

/// Most that the reflectance of what a path meets counts against that of the sub-point that stands for it: what is measured
/// on a nearly black surface tells little of a bright one.
const MOST_RATIO: f32 = 20.0;

impl<'t, 'a> Adjoint<'t, 'a> {
    /// With a quarter of the paths that `settings` have for the bake, or fewer where there are many texels.
    pub fn new(
        tracer: &'t Tracer<'a>,
        lightmap: &'t Lightmap,
        points: &'t MeasurementPoints,
        settings: BakeSettings,
    ) -> Self {
        let nearest = Nearest::new(&points.sub_points, normal_scale(tracer.asset()));
        let most = MOST_PATHS.div_ceil(lightmap.texels.len().max(1)) as u32;
        let settings = BakeSettings { paths: settings.paths.div_ceil(BAKE_PATHS).min(most), ..settings };
        Self { tracer, lightmap, sub_points: &points.sub_points, nearest, settings }
    }

    /// How many sub-points there are.
    pub fn sub_points(&self) -> usize {
        self.sub_points.len()
    }

    /// What sub-points contribute to a texel, each once, in their order. Depends on the seed and the texel alone. Nothing when
    /// `progress` cancels.
    pub fn texel(&self, texel: usize, progress: &dyn Progress) -> Vec<Deposit> {
        let walk = Walk { tracer: self.tracer, emitters: None, max_bounces: self.settings.max_bounces };
        let points = self.lightmap.sampler(&self.tracer.asset().mesh, texel);
        let index = self.lightmap.texels[texel].index as u64;
        let share = std::f32::consts::FRAC_1_PI / self.settings.paths as f32;
        let mut vertices = Vertices { adjoint: self, share, deposits: Vec::new() };
        for path in 0..self.settings.paths {
            if path % PATHS_BETWEEN_CHECKS == 0 && progress.cancelled() {
                return Vec::new();
            }
            let mut sampler = Sampler::new(self.settings.seed ^ STREAM, index, path);
            let [u0, u1, u2, u3] = sampler.next_4d();
            let receiver = self.tracer.asset().front(points.sample([u0, u1]));
            walk.from_receiver(&receiver, Vec2::new(u2, u3), &mut sampler, &mut vertices);
        }
        merged(vertices.deposits)
    }
}

/// Notes the vertices of paths.
struct Vertices<'n, 't, 'a> {
    adjoint: &'n Adjoint<'t, 'a>,
    /// 1/π over the number of paths: a diffuse surface of exitance M has the radiance M/π.
    share: f32,
    deposits: Vec<Deposit>,
}

impl Collector for Vertices<'_, '_, '_> {
    fn vertex(&mut self, surface: &Surface, _: Vec3, throughput: Rgb, _: u32, _: impl FnOnce() -> Sampler) {
        let Some(sub_point) = self.adjoint.nearest.find(surface.position, surface.normal) else { return };
        let point = &self.adjoint.sub_points[sub_point];
        // Light on the back of a surface is not measured: what is nearest faces the other way.
        if point.normal.dot(surface.normal) < OPPOSITE {
            return;
        }
        // The two are taken to receive the same irradiance, of which each reflects its own share.
        let reflected = surface.bsdf.albedo();
        let ratio = Rgb::from_array(std::array::from_fn(|c| match point.albedo[c] {
            albedo if albedo > 0.0 => (reflected[c] / albedo).min(MOST_RATIO),
            _ => 0.0,
        }));
        let weight = throughput * ratio * self.share;
        self.deposits.push(Deposit { sub_point: sub_point as u32, weight });
    }
}

/// Deposits on one sub-point become one.
fn merged(mut deposits: Vec<Deposit>) -> Vec<Deposit> {
    // Stable: sums of the same numbers in the same order.
    deposits.sort_by_key(|d| d.sub_point);
    deposits.dedup_by(|next, kept| {
        let same = next.sub_point == kept.sub_point;
        if same {
            kept.weight += next.weight;
        }
        same
    });
    deposits
}
