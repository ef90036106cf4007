// Indirect irradiance of every texel from the coefficients, once for each change of light. One invocation a texel. Built on
// basis_global.wgsl or basis_local.wgsl. CPU twin: Basis::reconstruct.
@group(0) @binding(4) var reconstructed: texture_storage_2d<rgba32float, write>; // W/m², of either sign

@compute @workgroup_size(8, 8)
fn reconstruct(@builtin(global_invocation_id) id: vec3u) {
    if any(id.xy >= textureDimensions(reconstructed)) {
        return;
    }
    textureStore(reconstructed, id.xy, vec4f(relight_texel(vec2i(id.xy)), 0.0));
}
