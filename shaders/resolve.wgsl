// Averages the samples of each pixel: a box filter. One invocation a pixel. CPU twin: the sum in Model::render_with.
@group(1) @binding(0) var samples: texture_2d<f32>;
@group(1) @binding(1) var picture: texture_storage_2d<rgba32float, write>;

@compute @workgroup_size(8, 8)
fn resolve(@builtin(global_invocation_id) id: vec3u) {
    let size = textureDimensions(picture);
    if any(id.xy >= size) {
        return;
    }
    let grid = frame.samples_per_axis;
    var sum = vec3f(0.0);
    for (var y = 0u; y < grid; y++) {
        for (var x = 0u; x < grid; x++) {
            sum += textureLoad(samples, id.xy * grid + vec2u(x, y), 0).rgb;
        }
    }
    textureStore(picture, id.xy, vec4f(sum / f32(grid * grid), 1.0));
}
