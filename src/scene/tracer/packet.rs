//! The closest hits of LANES rays with origins of their own.
//!
//! A small mesh is tested piece by piece, all rays at once: the arithmetic of [`super::pieces`], lanes being rays instead of
//! pieces, so that nothing is sought across lanes.

use glam::Vec3;

use super::lanes::lanes;
use super::{Segments, Structure, Tracer};
use crate::math::LANES;
use crate::scene::Hit;

/// What LANES rays hit, structure of arrays.
#[repr(align(64))]
pub struct Hits {
    pub t: [f32; LANES],
    pub u: [f32; LANES],
    pub v: [f32; LANES],
    pub triangle: [u32; LANES],
    /// Bit i is set where ray i hits anything; the rest of its lane says nothing elsewhere.
    pub hit: u32,
}

impl Hits {
    pub const NONE: Self = Self { t: [0.0; LANES], u: [0.0; LANES], v: [0.0; LANES], triangle: [0; LANES], hit: 0 };

    #[inline(always)]
    pub fn get(&self, ray: usize) -> Hit {
        Hit { t: self.t[ray], triangle: self.triangle[ray], u: self.u[ray], v: self.v[ray] }
    }

    #[inline(always)]
    pub fn set(&mut self, ray: usize, hit: Option<Hit>) {
        self.hit &= !(1 << ray);
        if let Some(Hit { t, triangle, u, v }) = hit {
            (self.t[ray], self.triangle[ray], self.u[ray], self.v[ray]) = (t, triangle, u, v);
            self.hit |= 1 << ray;
        }
    }
}

impl Tracer<'_> {
    /// [`Self::closest_hit`] of the rays of `active`, however far; to within rounding.
    #[inline]
    pub fn closest_hits(&self, origins: &Segments, directions: &Segments, active: u32) -> Hits {
        let ray = |of: &Segments, ray: usize| Vec3::new(of[0][ray], of[1][ray], of[2][ray]);
        let (mut hits, one_by_one) = match &self.structure {
            // However few they are: what a ray hits depends on no other, to the bit.
            Structure::Brute(brute) if !brute.any_masked => brute.pieces.closest_of_each(origins, directions, active),
            _ => (Hits::NONE, active),
        };
        for i in lanes(one_by_one) {
            hits.set(i, self.closest_hit(ray(origins, i), ray(directions, i), f32::INFINITY));
        }
        hits
    }
}
