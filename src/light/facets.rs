//! The entries that stand for a light in a table: one for a point, spot or directional light, a fixed set of points or
//! directions for the others.

use glam::Vec3;

use super::environment::turned;
use super::table::cone_ramp;
use super::{EmissionFacets, EnvironmentMap, Light, LightEntry};
use crate::math::Rgb;
use crate::math::quadrature::gauss_legendre;

/// Points along each side of a rectangle.
const SIDE: usize = 4;
/// Points around a disk, on each of two circles.
const AROUND: usize = 8;

impl Light {
    /// Hands what stands for this light to `add`, entry by entry with its colour. `emission` stands for the asset's own.
    ///
    /// - A rectangle: the 4 × 4 Gauss–Legendre points, each a facet with the share of the area that is its weight.
    /// - A disk: two circles of eight facets at the Gauss–Legendre points of the squared radius.
    /// - A sphere: twelve points of equal intensity, the corners of an icosahedron of radius √¾ r. A sphere shines on a point
    ///   that sees all of it as a point light at its centre does; irradiance is harmonic in the light's position, so the mean
    ///   over the corners, which integrates harmonics up to degree five, is the centre's value. The radius makes the spread
    ///   of the points, seen from anywhere, that of the sphere's disk: r²/4 along each axis.
    /// - An environment or a sky: the directional lights of [`EnvironmentMap::facets`], turned, and the sun.
    pub fn stand_ins(&self, emission: &EmissionFacets, add: &mut dyn FnMut(LightEntry, Rgb)) {
        match *self {
            Light::Rect { position, direction, .. } => {
                let ([u, v], area) = self.half_axes().expect("a rectangle has axes");
                let nodes = gauss_legendre(SIDE);
                for &(x, wx) in &nodes {
                    for &(y, wy) in &nodes {
                        let at = position + u * x as f32 + v * y as f32;
                        add(LightEntry::facet(at, direction), self.radiant() * (area * (0.25 * wx * wy) as f32));
                    }
                }
            }
            Light::Disk { position, direction, .. } => {
                let ([u, v], area) = self.half_axes().expect("a disk has axes");
                let share = area / (2 * AROUND) as f32;
                for (circle, &(x, _)) in gauss_legendre(2).iter().enumerate() {
                    let radius = (0.5 + 0.5 * x as f32).sqrt();
                    for i in 0..AROUND {
                        let turn = (i as f32 + 0.5 * circle as f32) * std::f32::consts::TAU / AROUND as f32;
                        let (sin, cos) = turn.sin_cos();
                        let at = position + (u * cos + v * sin) * radius;
                        add(LightEntry::facet(at, direction), self.radiant() * share);
                    }
                }
            }
            Light::Sphere { position, radius, .. } => {
                let share = std::f32::consts::PI * radius * radius / 12.0;
                for corner in icosahedron() {
                    let at = position + corner * (radius * 0.75f32.sqrt());
                    add(LightEntry::point(at, None), self.radiant() * share);
                }
            }
            Light::Environment { ref image, rotation, .. } => {
                distant(image.map(), rotation, self.radiant(), add);
            }
            Light::Sky(sky) => {
                distant(&sky.tabulate(), sky.rotation(), self.radiant(), add);
                self.punctual(add);
            }
            Light::Emissive { scale } => {
                for facet in &emission.0 {
                    add(LightEntry::facet(facet.position, facet.normal), facet.intensity * scale);
                }
            }
            Light::Point { .. } | Light::Spot { .. } | Light::Directional { .. } => self.punctual(add),
        }
    }

    /// Hands the part of this light that comes from single points or directions to `add`: all of a point, spot or
    /// directional light, the sun of a sky, nothing else.
    pub fn punctual(&self, add: &mut dyn FnMut(LightEntry, Rgb)) {
        match *self {
            Light::Point { position, range, .. } => add(LightEntry::point(position, range), self.radiant()),
            Light::Spot { position, direction, range, inner_cone_angle, outer_cone_angle, .. } => {
                let (cone_scale, cone_offset) = cone_ramp(inner_cone_angle, outer_cone_angle);
                let spot = LightEntry { direction, cone_scale, cone_offset, ..LightEntry::point(position, range) };
                add(spot, self.radiant());
            }
            Light::Directional { direction, .. } => add(LightEntry::distant(-direction), self.radiant()),
            Light::Sky(sky) if sky.sun > 0.0 => {
                add(LightEntry::distant(sky.towards_sun()), self.radiant() * sky.sun_illuminance());
            }
            _ => {}
        }
    }
}

fn distant(map: &EnvironmentMap, rotation: f32, colour: Rgb, add: &mut dyn FnMut(LightEntry, Rgb)) {
    let turn = rotation.sin_cos();
    for facet in map.facets() {
        add(LightEntry::distant(turned(facet.towards, turn.into())), colour * facet.irradiance);
    }
}

/// The corners of an icosahedron, unit vectors.
fn icosahedron() -> impl Iterator<Item = Vec3> {
    let golden = 0.5 * (1.0 + 5f32.sqrt());
    let corner = move |i: usize| {
        let (a, b) = (if i & 1 == 0 { 1.0 } else { -1.0 }, if i & 2 == 0 { golden } else { -golden });
        Vec3::new(0.0, a, b).normalize()
    };
    (0..12).map(move |i| {
        let c = corner(i % 4);
        [c, Vec3::new(c.y, c.z, c.x), Vec3::new(c.z, c.x, c.y)][i / 4]
    })
}
