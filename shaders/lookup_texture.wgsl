// Indirect light for a fragment shader, from the texture that reconstruct.wgsl made of the present lights.
@group(0) @binding(0) var relight_irradiance: texture_2d<f32>; // W/m², over the lightmap's page

fn relight_texel(at: vec2i) -> vec3f {
    return textureLoad(relight_irradiance, at, 0).rgb;
}
