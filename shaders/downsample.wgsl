// The direct vector x: each point averages its sub-points (METHOD eq. 2). One invocation a point.
// CPU twin: MeasurementPoints::average.
@group(0) @binding(0) var<storage, read> exitance: array<vec4f>;        // W/m², one a sub-point
@group(0) @binding(1) var<storage, read> neighbours: array<u32>;        // [point][neighbour]
@group(0) @binding(2) var<storage, read_write> direct: array<vec4f>;    // W/m², one a point

@compute @workgroup_size(64)
fn downsample(@builtin(global_invocation_id) id: vec3u) {
    let points = arrayLength(&direct);
    if id.x >= points {
        return;
    }
    let count = arrayLength(&neighbours) / points;
    var sum = vec3f(0.0);
    for (var i = 0u; i < count; i++) {
        sum += exitance[neighbours[id.x * count + i]].rgb;
    }
    direct[id.x] = vec4f(sum * (1.0 / f32(count)), 0.0);
}
