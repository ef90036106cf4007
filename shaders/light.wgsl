// Lights of single points and directions, and the facets that stand for all others: what arrives at a point, without shadow (METHOD eq. 1). CPU twin: LightTable::arrive.
struct Light {
    position: vec3f,      // metres, world space; for a directional light the unit vector towards it
    local: f32,           // 1 for a light at a point, 0 for a directional one
    direction: vec3f,     // unit axis of a spot or normal of a facet, world space
    inverse_range4: f32,  // m⁻⁴, 0 for an unbounded light
    radiant: vec3f,       // candela, or lux for a directional light
    cone_scale: f32,      // attenuation between the cones is saturate(cos · scale + offset)²
    cone_offset: f32,
    lobe: f32,            // 1: the attenuation is not squared, the cosine lobe of a facet; otherwise 0
}

struct Arrival {
    direction: vec3f,   // unit, towards the light
    segment: vec3f,     // metres, from the point to the light: the shadow ray
    irradiance: vec3f,  // W/m², cosine included
}

@group(0) @binding(1) var<storage, read> lights: array<Light>;

fn arrive(light: Light, point_ws: vec3f, normal_ws: vec3f) -> Arrival {
    let to_light = light.position - light.local * point_ws;
    // Not closer than a tenth of a millimetre, so that a light on the surface stays finite.
    let d2 = max(dot(to_light, to_light), 1e-8);
    let direction = to_light * (1.0 / sqrt(d2));
    let window = saturate(1.0 - d2 * d2 * light.inverse_range4);
    let falloff = light.local * window / d2 + (1.0 - light.local);
    let ramp = saturate(-dot(direction, light.direction) * light.cone_scale + light.cone_offset);
    let cos_surface = max(dot(direction, normal_ws), 0.0);
    let reach = light.local + (1.0 - light.local) * frame.extent;
    return Arrival(direction, to_light * reach, light.radiant * (falloff * ramp * max(ramp, light.lobe) * cos_surface));
}
