//! A small mesh, tested whole.

use glam::Vec3;

use super::block::{Areas, Corner, Nearest};
use super::lanes::lanes;
use super::ray::ShearedRay;
use super::simd::{F32x8, WIDTH};
use crate::scene::Hit;

/// All triangles in their order, WIDTH at a time.
pub struct Brute {
    blocks: Vec<Corners>,
}

/// WIDTH triangles, structure of arrays: `[corner][axis][lane]`, metres.
#[repr(align(64))]
pub struct Corners([[[f32; WIDTH]; 3]; 3]);

impl Brute {
    pub fn new(triangles: &[[Vec3; 3]]) -> Self {
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
        Self { blocks: triangles.chunks(WIDTH).map(block).collect() }
    }

    /// Brings `nearest` up to date. No branch depends on where the ray goes before all triangles are tested: at this size
    /// mispredictions would cost more than the tests.
    #[inline]
    pub fn closest(&self, origin: Vec3, direction: Vec3, nearest: &mut Nearest) {
        let ray = ShearedRay::new(origin, direction);
        let mut t = F32x8::splat(nearest.hit.t);
        let mut block_of = F32x8::splat(0.0);
        let [mut b, mut c, mut sum] = [F32x8::splat(0.0); 3];
        for (i, block) in self.blocks.iter().enumerate() {
            let (areas, distance) = block.meet(&ray);
            let zero = F32x8::splat(0.0);
            // Of equal distances the first triangle's is kept.
            let nearer =
                zero.lanes_at_most(areas.agreement()).and(zero.lanes_below(distance)).and(distance.lanes_below(t));
            t = t.replace(distance, nearer);
            // Exact: a mesh of so many blocks is not tested whole.
            block_of = block_of.replace(F32x8::splat(i as f32), nearer);
            b = b.replace(areas.b, nearer);
            c = c.replace(areas.c, nearer);
            sum = sum.replace(areas.sum, nearer);
        }
        let (found, best) = (t.below(F32x8::splat(nearest.hit.t)), t.least());
        if found == 0 {
            return;
        }
        let block_of = block_of.to_array();
        let index = |lane: usize| block_of[lane] as usize * WIDTH + lane;
        let lane = lanes(t.at_most(F32x8::splat(best))).min_by_key(|&lane| index(lane)).expect("a lane has the least");
        let sum = sum.to_array()[lane];
        let (u, v) = (b.to_array()[lane] / sum, c.to_array()[lane] / sum);
        nearest.hit = Hit { t: best, triangle: index(lane) as u32, u, v };
    }

    /// Hands the hits with 0 < t < `t_max` to `visit`, in no order, until it returns true; whether it did.
    #[inline]
    pub fn any(&self, origin: Vec3, direction: Vec3, t_max: f32, mut visit: impl FnMut(Hit) -> bool) -> bool {
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

    pub fn blocks(&self) -> &[Corners] {
        &self.blocks
    }
}

impl Corners {
    /// The corners relative to `origin`: `[corner][axis]`.
    #[inline(always)]
    pub fn from(&self, origin: &[F32x8; 3]) -> [[F32x8; 3]; 3] {
        let relative = |[x, y, z]: &[[f32; WIDTH]; 3]| {
            [F32x8::load(x) - origin[0], F32x8::load(y) - origin[1], F32x8::load(z) - origin[2]]
        };
        [relative(&self.0[0]), relative(&self.0[1]), relative(&self.0[2])]
    }

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
