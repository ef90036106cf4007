//! Lights as spherical harmonics.

use glam::Vec3;

use crate::light::{EmissionFacets, Light, LightTable};
use crate::math::{LANES, Rgb, sh};

/// Coefficients, order², of the light that arrives at `centre`. Distant lights are projected exactly. Point and spot lights
/// count as distant ones that shine as they do at the centre, which is what the method takes all light for: a spot light
/// whose cone misses the centre is lost. Area lights, environments, skies and `emission` are projected by the points and
/// directions that stand for them (`light/facets.rs`).
pub fn light_coefficients(lights: &[Light], emission: &EmissionFacets, centre: Vec3, order: usize) -> Vec<Rgb> {
    let mut coefficients = vec![Rgb::ZERO; sh::count(order)];
    let table = LightTable::new(lights, emission);
    for i in 0..table.len {
        // The normal and the distance of directional lights bear on neither direction nor normal irradiance.
        let arrival = table.arrive(i / LANES, centre, Vec3::Y, 1.0);
        let towards = Vec3::from_array(arrival.direction.map(|axis| axis[i % LANES]));
        let irradiance = table.colour(i) * arrival.normal_irradiance[i % LANES];
        if irradiance != Rgb::ZERO {
            sh::add_directional(&mut coefficients, towards, irradiance);
        }
    }
    coefficients
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 20 lights span two blocks: 10 suns of 2 lux and 10 points of 18 candela at 3 m are as one of 40 lux.
    #[test]
    fn near_light_counts_as_at_the_centre() {
        let (centre, towards) = (Vec3::new(1.0, 2.0, 3.0), Vec3::new(0.48, 0.6, 0.64));
        let sun = Light::Directional { direction: -towards, color: Vec3::ONE, intensity: 2.0 };
        let point = Light::Point { position: centre + towards * 3.0, color: Vec3::ONE, intensity: 18.0, range: None };
        let lights: Vec<Light> = (0..20).map(|i| if i % 2 == 0 { sun.clone() } else { point.clone() }).collect();
        let coefficients = light_coefficients(&lights, &EmissionFacets::default(), centre, 6);
        let y = sh::evaluate(6, towards);
        for (c, y) in coefficients.iter().zip(y) {
            // Twenty f32 sums.
            assert!((*c - Rgb::splat(40.0 * y)).abs().max_element() < 1e-4, "{c} for {}", 40.0 * y);
        }
    }
}
