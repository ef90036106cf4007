// A global basis: what a texel makes of the coefficients, Σⱼ uⱼ Uⱼ (METHOD eq. 8). Written before it for each model: the RELIGHT_
// constants of its shape. CPU twin: Basis::reconstruct.
@group(0) @binding(0) var<uniform> relight_coefficients: array<vec4f, RELIGHT_COEFFICIENTS>; // u, RGB, padded to whole layers
@group(0) @binding(1) var relight_basis: texture_2d_array<f32>; // four scalar elements a layer, or one RGB element

// What one layer's values add.
fn relight_layer(layer: u32, value: vec4f) -> vec3f {
    if RELIGHT_COMPONENTS == 3u {
        return relight_coefficients[layer].rgb * value.rgb;
    }
    let at = 4u * layer;
    return relight_coefficients[at].rgb * value.r + relight_coefficients[at + 1u].rgb * value.g
        + relight_coefficients[at + 2u].rgb * value.b + relight_coefficients[at + 3u].rgb * value.a;
}

// Irradiance of a texel, W/m², of either sign.
fn relight_texel(at: vec2i) -> vec3f {
    var sum = vec3f(0.0);
    for (var layer = 0u; layer < RELIGHT_LAYERS; layer++) {
        sum += relight_layer(layer, textureLoad(relight_basis, at, layer, 0));
    }
    return sum;
}
