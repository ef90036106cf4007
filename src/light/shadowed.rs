//! Direct light at one surface point from many lights, shadows included.

use glam::Vec3;

use super::LightTable;
use crate::math::LANES;
use crate::scene::Tracer;
use crate::scene::tracer::lanes;

/// Irradiance at a surface point from each light of `table` with unit colour, behind shadows; multiply by
/// [`LightTable::colour`] for watts per square metre.
///
/// - `normal`: unit shading normal, which the cosine refers to
/// - `geometric_normal`: unit; shadow rays start [`Tracer::offset`] off the surface on its side
/// - `irradiance`: one entry a light, overwritten
///
/// Shadow rays are traced LANES at a time and only where light would arrive. GPU twin: `shaders/measure.wgsl`.
pub fn shadowed_irradiance(
    tracer: &Tracer,
    table: &LightTable,
    position: Vec3,
    normal: Vec3,
    geometric_normal: Vec3,
    irradiance: &mut [f32],
) {
    assert_eq!(irradiance.len(), table.len, "one entry a light");
    let origin = position + geometric_normal * tracer.offset;
    let rays = tracer.shadow_rays(origin);
    for (block, irradiance) in irradiance.chunks_mut(LANES).enumerate() {
        // The light's distance is taken from the origin of the shadow ray, so that the ray ends at the light.
        let arrival = table.arrive(block, origin, normal, tracer.extent);
        let reached = (0..irradiance.len()).fold(0, |mask, i| mask | ((arrival.irradiance[i] > 0.0) as u32) << i);
        irradiance.fill(0.0);
        if reached != 0 {
            for lane in lanes(rays.unoccluded(&arrival.segment, reached)) {
                irradiance[lane] = arrival.irradiance[lane];
            }
        }
    }
}
