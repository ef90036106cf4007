//! Light of the area lights and environments of a set at one surface point, from one sample of each, shadows included.

use glam::{Vec2, Vec3};

use super::LightSet;
use super::area::slot_shift;
use super::environment::{self, EnvironmentSample, turned};
use crate::math::{LANES, Rgb, Sampler};
use crate::scene::{ShadowRays, Surface, Tracer, lanes};

/// Samples the area lights and environments of a set.
pub struct SampledGather<'t, 'a> {
    set: &'t LightSet,
    tracer: &'t Tracer<'a>,
    shadows: ShadowRays<'t, 'a>,
    packet: Packet,
    points: Vec<Vec2>,
    drawn: Vec<Option<EnvironmentSample>>,
    /// Shadow rays cast so far.
    pub rays: u64,
}

/// A sample of one light that nothing hides.
pub struct Sampled {
    /// The light's number in the set.
    pub light: usize,
    /// Unit vector towards it.
    pub direction: Vec3,
    /// Radiance, of the light with unit colour, over the density.
    pub radiance_over_pdf: Rgb,
    /// Steradians.
    pub inverse_pdf: f32,
    /// Whether it is an environment.
    pub distant: bool,
}

/// Samples that wait for their shadow rays.
#[repr(align(64))]
struct Packet {
    segment: [[f32; LANES]; 3],
    direction: [[f32; LANES]; 3],
    radiance_over_pdf: [Rgb; LANES],
    inverse_pdf: [f32; LANES],
    light: [u32; LANES],
    len: usize,
}

impl<'t, 'a> SampledGather<'t, 'a> {
    /// `None` where the set holds lights of single points and directions alone.
    pub fn new(set: &'t LightSet, tracer: &'t Tracer<'a>) -> Option<Self> {
        if set.areas.is_empty() && set.environments.entries.is_empty() {
            return None;
        }
        let targets = if set.environments.entries.is_empty() { set.areas.bounds() } else { None };
        let packet = Packet {
            segment: [[0.0; LANES]; 3],
            direction: [[0.0; LANES]; 3],
            radiance_over_pdf: [Rgb::ZERO; LANES],
            inverse_pdf: [0.0; LANES],
            light: [0; LANES],
            len: 0,
        };
        let shadows = tracer.shadow_rays(targets);
        Some(Self { set, tracer, shadows, packet, points: Vec::new(), drawn: Vec::new(), rays: 0 })
    }

    /// Whether the set holds environments.
    pub fn has_environments(&self) -> bool {
        !self.set.environments.entries.is_empty()
    }

    /// Hands a sample of every light that reaches the surface to `arrived`. Two of `sampler`'s numbers are for area lights,
    /// two for environments.
    pub fn gather(&mut self, surface: &Surface, sampler: &mut Sampler, mut arrived: impl FnMut(Sampled)) {
        let [u0, u1, u2, u3] = sampler.next_4d();
        let origin = self.tracer.leave(surface, surface.geometric_normal);
        self.shadows.start_from(origin);
        let (set, g, n) = (self.set, surface.geometric_normal, surface.normal);
        let faces = |w: Vec3| w.dot(g) > 0.0 && w.dot(n) > 0.0;

        let mut points = std::mem::take(&mut self.points);
        set.areas.points(Vec2::new(u0, u1), &mut points);
        for block in 0..set.areas.block_count() {
            let sample = set.areas.sample(block, &points, origin);
            for lane in 0..LANES {
                let direction = Vec3::from_array(sample.direction.map(|axis| axis[lane]));
                if sample.inverse_pdf[lane] > 0.0 && faces(direction) {
                    let segment = Vec3::from_array(sample.segment.map(|axis| axis[lane]));
                    let solid_angle = sample.inverse_pdf[lane];
                    let light = set.areas.numbers(block)[lane];
                    self.push(light, direction, segment, Rgb::splat(solid_angle), solid_angle, &mut arrived);
                }
            }
        }
        self.points = points;

        let environments = &set.environments;
        let mut drawn = std::mem::take(&mut self.drawn);
        drawn.clear();
        for &(map, slot) in &environments.draws {
            drawn.push(environments.maps[map as usize].sample(slot_shift(Vec2::new(u2, u3), slot)));
        }
        let first = set.first_environment();
        for (i, entry) in environments.entries.iter().enumerate() {
            let Some(sample) = &drawn[entry.draw as usize] else { continue };
            let direction = turned(sample.towards, entry.turn);
            if sample.pdf > 0.0 && faces(direction) {
                let inverse_pdf = 1.0 / sample.pdf;
                let radiance = sample.radiance * inverse_pdf;
                let segment = direction * self.tracer.extent;
                self.push((first + i) as u32, direction, segment, radiance, inverse_pdf, &mut arrived);
            }
        }
        self.drawn = drawn;
        if self.packet.len > 0 {
            self.flush(&mut arrived);
        }
    }

    #[inline]
    fn push(
        &mut self,
        light: u32,
        direction: Vec3,
        segment: Vec3,
        radiance_over_pdf: Rgb,
        inverse_pdf: f32,
        arrived: &mut impl FnMut(Sampled),
    ) {
        let p = &mut self.packet;
        for axis in 0..3 {
            p.segment[axis][p.len] = segment[axis];
            p.direction[axis][p.len] = direction[axis];
        }
        p.radiance_over_pdf[p.len] = radiance_over_pdf;
        p.inverse_pdf[p.len] = inverse_pdf;
        p.light[p.len] = light;
        p.len += 1;
        if p.len == LANES {
            self.flush(arrived);
        }
    }

    fn flush(&mut self, arrived: &mut impl FnMut(Sampled)) {
        let p = &mut self.packet;
        let active = ((1u64 << p.len) - 1) as u32;
        let open = self.shadows.unoccluded(&p.segment, active);
        let first_environment = self.set.first_environment();
        for i in lanes(open) {
            arrived(Sampled {
                light: p.light[i] as usize,
                direction: Vec3::from_array(p.direction.map(|axis| axis[i])),
                radiance_over_pdf: p.radiance_over_pdf[i],
                inverse_pdf: p.inverse_pdf[i],
                distant: p.light[i] as usize >= first_environment,
            });
        }
        self.rays += p.len as u64;
        p.len = 0;
    }

    /// Tells `seen` what every environment, with unit colour, sends from `direction`: number, radiance, and the density with
    /// which [`Self::gather`] draws it.
    pub fn look(&self, direction: Vec3, mut seen: impl FnMut(usize, Rgb, f32)) {
        let environments = &self.set.environments;
        let (turn, first) = (environment::turn(direction), self.set.first_environment());
        let (mut map_index, mut row) = (u32::MAX, 0);
        for (i, entry) in environments.entries.iter().enumerate() {
            let map = &environments.maps[entry.map as usize];
            if entry.map != map_index {
                (map_index, row) = (entry.map, map.row(direction.y));
            }
            // The angle from −z towards +x falls as the map turns.
            let (radiance, pdf) = map.look_up(row, (turn + entry.turns).fract());
            seen(first + i, radiance, pdf);
        }
    }

    /// Tells `met` of every area light that a ray meets within `reach` metres: number, and inverse of the density with which
    /// [`Self::gather`] draws it.
    pub fn meet(&self, origin: Vec3, direction: Vec3, reach: f32, mut met: impl FnMut(usize, f32)) {
        self.set.areas.meet(origin, direction, reach, |light, inverse_pdf| met(light as usize, inverse_pdf));
    }
}
