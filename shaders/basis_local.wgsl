// A local basis: what a texel makes of the coefficients, b · Σₖ φₖ uₖ (METHOD eq. 10). Written before it for each model: the RELIGHT_
// constants of its shape. CPU twin: Basis::reconstruct.
@group(0) @binding(0) var<storage, read> relight_coefficients: array<vec4f>; // u, RGB: [anchor][channel], padded by a layer's
@group(0) @binding(1) var relight_basis: texture_2d_array<f32>; // four scalar channels a layer, or one RGB channel
@group(0) @binding(2) var relight_anchors: texture_2d<u32>;
@group(0) @binding(3) var relight_shares: texture_2d<f32>; // of the first three; then the scale of the texel's values, (code − 255)/16 octaves

// Coefficient of a channel between the anchors. One past the last is multiplied by a value of zero.
fn relight_between(channel: u32, anchors: vec4u, shares: vec4f) -> vec3f {
    let at = anchors + channel;
    return relight_coefficients[at.x].rgb * shares.x + relight_coefficients[at.y].rgb * shares.y
        + relight_coefficients[at.z].rgb * shares.z + relight_coefficients[at.w].rgb * shares.w;
}

// Irradiance of a texel, W/m², of either sign.
fn relight_texel(at: vec2i) -> vec3f {
    let anchors = textureLoad(relight_anchors, at, 0) * RELIGHT_ELEMENTS;
    let stored = textureLoad(relight_shares, at, 0);
    let shares = vec4f(stored.rgb, 1.0 - (stored.r + stored.g + stored.b));
    let scale = exp2((stored.a - 1.0) * (255.0 / 16.0));
    var sum = vec3f(0.0);
    for (var layer = 0u; layer < RELIGHT_LAYERS; layer++) {
        let value = textureLoad(relight_basis, at, layer, 0);
        if RELIGHT_COMPONENTS == 3u {
            sum += relight_between(layer, anchors, shares) * value.rgb;
        } else {
            for (var channel = 0u; channel < 4u; channel++) {
                sum += relight_between(4u * layer + channel, anchors, shares) * value[channel];
            }
        }
    }
    return sum * scale;
}
