// Direct light at the sub-points, shadows included (METHOD eq. 1). One invocation a sub-point.
// CPU twin: MeasurementPoints::sub_point_exitance.
struct SubPoint {
    position: vec3f,          // metres, world space
    normal: vec3f,            // unit shading normal
    geometric_normal: vec3f,  // unit; shadow rays start on its side
    albedo: vec3f,
}

@group(1) @binding(0) var<storage, read> sub_points: array<SubPoint>;
@group(1) @binding(1) var<storage, read_write> exitance: array<vec4f>; // W/m², RGB

@compute @workgroup_size(64)
fn measure(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= arrayLength(&sub_points) {
        return;
    }
    let point = sub_points[id.x];
    // Light is evaluated where its shadow rays start, so that they end at the lights.
    let origin = point.position + point.geometric_normal * frame.shadow_offset;
    var irradiance = vec3f(0.0);
    for (var i = 0u; i < frame.light_count; i++) {
        let arrival = arrive(lights[i], origin, point.normal);
        if reaches(arrival, origin, point.geometric_normal) {
            irradiance += arrival.irradiance;
        }
    }
    exitance[id.x] = vec4f(point.albedo * irradiance, 0.0);
}
