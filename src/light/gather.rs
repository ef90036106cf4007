//! Light of every light of a table at one surface point, shadows included: the dense inner loop of the bake.
//!
//! Cheap tests come first (cone, horizon, range), LANES lights at a time; those that pass are packed and cast their shadow
//! rays together, since all of them start at the same point.

use super::LightTable;
use crate::math::LANES;
use crate::scene::{ShadowRays, Surface, Tracer, lanes, mask_of};

/// Finds what every light of a table sends to a surface point, shadows included.
pub struct LightGather<'t, 'a> {
    table: &'t LightTable,
    tracer: &'t Tracer<'a>,
    shadows: ShadowRays<'t, 'a>,
    packet: Packet,
    /// Shadow rays cast so far.
    pub rays: u64,
}

/// Lights that passed the cheap tests and wait for their shadow rays.
#[repr(align(64))]
struct Packet {
    segment: [[f32; LANES]; 3],
    direction: [[f32; LANES]; 3],
    irradiance: [f32; LANES],
    light: [u32; LANES],
    len: usize,
}

/// LANES lights that reach the point, less those whose bit in `open` is not set.
pub struct Arrived<'p> {
    /// Indices into the table.
    pub light: &'p [u32; LANES],
    /// Unit vectors towards the lights.
    pub direction: &'p [[f32; LANES]; 3],
    /// Irradiance (cosine included) of the light with unit colour.
    pub irradiance: &'p [f32; LANES],
    pub open: u32,
}

impl<'t, 'a> LightGather<'t, 'a> {
    pub fn new(table: &'t LightTable, tracer: &'t Tracer<'a>) -> Self {
        let packet = Packet {
            segment: [[0.0; LANES]; 3],
            direction: [[0.0; LANES]; 3],
            irradiance: [0.0; LANES],
            light: [0; LANES],
            len: 0,
        };
        Self { table, tracer, shadows: tracer.shadow_rays(table.bounds()), packet, rays: 0 }
    }

    /// Hands every light that reaches the surface to `arrived`, up to LANES at a time.
    #[inline]
    pub fn gather(&mut self, surface: &Surface, mut arrived: impl FnMut(Arrived)) {
        // Light is evaluated where its shadow rays start, so that they end at the lights.
        let origin = self.tracer.leave(surface, surface.geometric_normal);
        self.shadows.start_from(origin);
        for block in 0..self.table.block_count() {
            let arrival = self.table.arrive(block, origin, surface.normal, self.tracer.extent);
            let g = surface.geometric_normal;
            let mut reached = [false; LANES];
            for i in 0..LANES {
                let [x, y, z] = [arrival.direction[0][i], arrival.direction[1][i], arrival.direction[2][i]];
                reached[i] = (arrival.irradiance[i] > 0.0) & (x * g.x + y * g.y + z * g.z > 0.0);
            }
            for lane in lanes(mask_of(&reached)) {
                let p = &mut self.packet;
                for axis in 0..3 {
                    p.segment[axis][p.len] = arrival.segment[axis][lane];
                    p.direction[axis][p.len] = arrival.direction[axis][lane];
                }
                p.irradiance[p.len] = arrival.irradiance[lane];
                p.light[p.len] = (block * LANES + lane) as u32;
                p.len += 1;
                if p.len == LANES {
                    self.flush(&mut arrived);
                }
            }
        }
        if self.packet.len > 0 {
            self.flush(&mut arrived);
        }
    }

    fn flush(&mut self, arrived: &mut impl FnMut(Arrived)) {
        let p = &mut self.packet;
        let active = ((1u64 << p.len) - 1) as u32;
        let open = self.shadows.unoccluded(&p.segment, active);
        arrived(Arrived { light: &p.light, direction: &p.direction, irradiance: &p.irradiance, open });
        self.rays += p.len as u64;
        p.len = 0;
    }
}
