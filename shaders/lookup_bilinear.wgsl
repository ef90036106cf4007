// Indirect irradiance at lightmap coordinates in [0, 1]², W/m², bilinear between texel centres. CPU twin: LightmapImage::sample.
// Not by a sampler: not every GPU filters 32-bit floats, those that do round the weights, and what a local basis stores is not
// linear in the light.
fn indirect_irradiance(lightmap_uv: vec2f) -> vec3f {
    let last = vec2i(i32(RELIGHT_SIZE) - 1);
    let p = lightmap_uv * f32(RELIGHT_SIZE) - 0.5;
    let base = floor(p);
    let f = p - base;
    let low = clamp(vec2i(base), vec2i(0), last);
    let high = clamp(vec2i(base) + 1, vec2i(0), last);
    let top = mix(relight_texel(low), relight_texel(vec2i(high.x, low.y)), f.x);
    let bottom = mix(relight_texel(vec2i(low.x, high.y)), relight_texel(high), f.x);
    // A truncated basis may ring below zero; light does not.
    let light = max(mix(top, bottom, f.y), vec3f(0.0));
    if RELIGHT_GAMMA == 1.0 {
        return light;
    }
    return pow(light, vec3f(RELIGHT_GAMMA));
}
