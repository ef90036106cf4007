// Indirect light for a fragment shader, from a global basis: the light is linear in the values, so that the texture unit
// filters those.
@group(0) @binding(4) var relight_sampler: sampler;

// Indirect irradiance at lightmap coordinates in [0, 1]², W/m², bilinear between texel centres as precisely as texture units
// are: 1/256 of a texel. CPU twin: LightmapImage::sample.
fn indirect_irradiance(lightmap_uv: vec2f) -> vec3f {
    var sum = vec3f(0.0);
    for (var layer = 0u; layer < RELIGHT_LAYERS; layer++) {
        sum += relight_layer(layer, textureSampleLevel(relight_basis, relight_sampler, lightmap_uv, layer, 0.0));
    }
    // A truncated basis may ring below zero; light does not.
    let light = max(sum, vec3f(0.0));
    if RELIGHT_GAMMA == 1.0 {
        return light;
    }
    return pow(light, vec3f(RELIGHT_GAMMA));
}
