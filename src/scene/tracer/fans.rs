//! A small mesh as seen from one point.
//!
//! On a ray from there, u and v of a piece ([`super::pieces`]), times the slope of g, are linear in the ray's direction: three
//! dot products a piece and ray tell whether it is hit. They err by less than 62u R|d|, which leaves the margin of
//! [`super::pieces`] for the rest: at the edges the exact test is asked here, too.

use glam::Vec3;

use super::lanes::lanes;
use super::pieces::{Block, Pieces, band};
use super::simd16::{F32x16, dot, splat};
use super::{SEGMENT_END, Segments};
use crate::math::LANES;
use crate::scene::Aabb;

/// The pieces that can hide a target from a point.
#[derive(Default)]
pub struct Fans {
    blocks: Vec<Fan>,
    /// What u and v can be off by, times the slope of g, per metre of a segment.
    band: f32,
}

/// LANES pieces seen from a point: `[axis][lane]`, each to be multiplied with a segment.
#[repr(align(64))]
struct Fan {
    /// u · slope, v · slope and slope, that of g where g is negative at the origin.
    planes: [[[f32; LANES]; 3]; 3],
    /// The slope of a segment that ends in the piece.
    least: [f32; LANES],
    /// Bit i is set where piece i is a triangle.
    triangles: u32,
    /// Bit i is set where piece i can hide a target.
    hiding: u32,
}

impl Fans {
    /// Looks from `origin`. `targets` bounds where rays go to, `None` where that is anywhere.
    pub fn see(&mut self, pieces: &Pieces, origin: Vec3, targets: Option<&Aabb>) {
        self.band = band(pieces.size, &splat(origin), &splat(Vec3::X)).to_array()[0];
        self.blocks.clear();
        self.blocks.extend(pieces.blocks.iter().map(|block| Fan::new(block, origin, self.band, targets)));
    }

    /// The lanes whose segment crosses a piece, and those of which the exact test must be asked.
    #[inline]
    pub fn hide(&self, segments: &Segments) -> (u32, u32) {
        let [x, y, z] = segments;
        let s = [F32x16::load(x), F32x16::load(y), F32x16::load(z)];
        // By how much the slope is above what u, v and the distance demand, in the piece where that is most.
        let mut margin = F32x16::splat(f32::NEG_INFINITY);
        for fan in &self.blocks {
            for lane in lanes(fan.hiding) {
                let plane = |[x, y, z]: &[[f32; LANES]; 3]| splat(Vec3::new(x[lane], y[lane], z[lane]));
                let [u, v, slope] = &fan.planes;
                let (u, v, slope) = (dot(&plane(u), &s), dot(&plane(v), &s), dot(&plane(slope), &s));
                let mut here = slope - u.abs().max(v.abs().max(F32x16::splat(fan.least[lane])));
                if fan.triangles >> lane & 1 != 0 {
                    here = here.min((u + v) * F32x16::splat(-0.5));
                }
                margin = margin.max(here);
            }
        }
        // No less than the segment's length.
        let length = s[0].abs() + s[1].abs() + s[2].abs();
        let band = length * F32x16::splat(self.band);
        (band.below(margin).bits(), F32x16::splat(0.0).at_most(margin + band).bits())
    }
}

impl Fan {
    fn new(block: &Block, origin: Vec3, band: f32, targets: Option<&Aabb>) -> Self {
        let from = splat(origin);
        let (u, v, g) = (block.value(0, &from), block.value(1, &from), block.value(2, &from));
        // Signs as if g were negative at the origin.
        let facing = F32x16::splat(-1.0).negate_where_negative(g);
        let [x, y, z] = block.gradient(2);
        let (distance, dg) = (g.abs(), [x * facing, y * facing, z * facing]);
        let times_slope = |value: F32x16, [x, y, z]: [F32x16; 3]| {
            let along = |of_g: F32x16, own: F32x16| value.mul_add(of_g, own * distance).to_array();
            [along(dg[0], x), along(dg[1], y), along(dg[2], z)]
        };
        // What g may be off by.
        let slack = (dg[0].abs() + dg[1].abs() + dg[2].abs()) * F32x16::splat(band);
        let mut hiding = block.present;
        if let Some(targets) = targets {
            let half = splat((targets.max - targets.min) * 0.5);
            let reach = dot(&[dg[0].abs(), dg[1].abs(), dg[2].abs()], &half);
            let centre = block.value(2, &splat(targets.centre())) * facing;
            hiding &= F32x16::splat(0.0).below(centre + reach + slack).bits();
        }
        Self {
            planes: [
                times_slope(u, block.gradient(0)),
                times_slope(v, block.gradient(1)),
                [dg[0].to_array(), dg[1].to_array(), dg[2].to_array()],
            ],
            least: (distance * F32x16::splat(1.0 / SEGMENT_END) - slack).to_array(),
            triangles: block.triangles,
            hiding,
        }
    }
}
