//! A small mesh, tested whole: as [`Pieces`] first, and exactly, triangle by triangle, where those are unsure.

use glam::Vec3;

use super::block::{Areas, Corner, Nearest};
use super::lanes::lanes;
use super::pieces::{Answer, Pieces};
use super::ray::ShearedRay;
use super::simd::{F32x8, WIDTH};
use crate::scene::Hit;

/// All triangles.
pub struct Brute {
    /// Those that are solid wherever they are hit.
    pub pieces: Pieces,
    /// Whether there are others.
    pub any_masked: bool,
    /// All in their order, WIDTH at a time, for the exact test.
    blocks: Vec<Corners>,
}

/// WIDTH triangles, structure of arrays: `[corner][axis][lane]`, metres.
#[repr(align(64))]
struct Corners([[[f32; WIDTH]; 3]; 3]);

impl Brute {
    /// `masked`: per triangle, whether it is not solid everywhere.
    pub fn new(triangles: &[[Vec3; 3]], masked: &[bool]) -> Self {
        let block = |triangles: &[[Vec3; 3]]| {
            // No ray hits a triangle that is not a number.
            let mut corners = [[[f32::NAN; WIDTH]; 3]; 3];
            for (lane, triangle) in triangles.iter().enumerate() {
                for corner in 0..3 {
                    (0..3).for_each(|axis| corners[corner][axis][lane] = triangle[corner][axis]);
                }
            }
            Corners(corners)
        };
        Self {
            pieces: Pieces::new(triangles, |t| !masked[t]),
            any_masked: masked.contains(&true),
            blocks: triangles.chunks(WIDTH).map(block).collect(),
        }
    }

    /// Brings `nearest` up to date.
    #[inline]
    pub fn closest(&self, origin: Vec3, direction: Vec3, nearest: &mut Nearest, solid: impl Fn(&Hit) -> bool + Copy) {
        match self.pieces.closest(origin, direction, nearest.hit.t) {
            Answer::Nothing if !self.any_masked => {}
            Answer::Hit(hit) if !self.any_masked => nearest.hit = hit,
            _ => {
                self.any_exactly(origin, direction, nearest.hit.t, |hit| {
                    nearest.update(hit, solid);
                    false
                });
            }
        }
    }

    /// Whether any hit with 0 < t < `t_max` is solid.
    #[inline]
    pub fn occluded(&self, origin: Vec3, direction: Vec3, t_max: f32, solid: impl Fn(&Hit) -> bool) -> bool {
        match self.pieces.any(origin, direction, t_max) {
            Some(true) => true,
            Some(false) if !self.any_masked => false,
            _ => self.any_exactly(origin, direction, t_max, |hit| solid(&hit)),
        }
    }

    /// Hands the hits with 0 < t < `t_max` to `visit`, in no order, until it returns true; whether it did.
    #[cold]
    #[inline(never)]
    pub fn any_exactly(&self, origin: Vec3, direction: Vec3, t_max: f32, mut visit: impl FnMut(Hit) -> bool) -> bool {
        let ray = ShearedRay::new(origin, direction);
        let zero = F32x8::splat(0.0);
        self.blocks.iter().enumerate().any(|(i, block)| {
            let (areas, t) = block.meet(&ray);
            let met = zero.at_most(areas.agreement()) & zero.below(t) & t.below(F32x8::splat(t_max));
            let hit = |lane: usize| {
                let sum = areas.sum.to_array()[lane];
                let (u, v) = (areas.b.to_array()[lane] / sum, areas.c.to_array()[lane] / sum);
                Hit { t: t.to_array()[lane], triangle: (i * WIDTH + lane) as u32, u, v }
            };
            met != 0 && lanes(met).any(|lane| visit(hit(lane)))
        })
    }
}

impl Corners {
    #[inline(always)]
    fn meet(&self, ray: &ShearedRay) -> (Areas, F32x8) {
        let [(a, az), (b, bz), (c, cz)] = [self.sheared(0, ray), self.sheared(1, ray), self.sheared(2, ray)];
        let areas = Areas::new(a, b, c);
        let distance = areas.distance(ray, [az, bz, cz]);
        (areas, distance)
    }

    /// A corner of each triangle in the ray's space, and its depth.
    #[inline(always)]
    fn sheared(&self, corner: usize, ray: &ShearedRay) -> (Corner, F32x8) {
        let [i, j, k] = ray.axes;
        let corner = &self.0[corner];
        let depth = F32x8::load(&corner[k]) - ray.origin[2];
        let x = depth.neg_mul_add(ray.shear[0], F32x8::load(&corner[i]) - ray.origin[0]);
        let y = depth.neg_mul_add(ray.shear[1], F32x8::load(&corner[j]) - ray.origin[1]);
        (Corner { x, y }, depth)
    }
}
