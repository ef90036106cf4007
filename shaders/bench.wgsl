// What a renderer with shadows of its own draws, to be timed: direct light of all lights without a shadow ray. Built on shade.wgsl.
fn plain_direct(in: Fragment, to_view: vec3f, bsdf: Bsdf) -> vec3f {
    let normal = shading_normal(in);
    var radiance = materials[in.material].emissive;
    for (var i = 0u; i < frame.light_count; i++) {
        let arrival = arrive(lights[i], in.position_ws, normal);
        radiance += evaluate_bsdf(bsdf, normal, to_view, arrival.direction) * arrival.irradiance;
    }
    return radiance;
}

@fragment
fn plain(in: Fragment) -> @location(0) vec4f {
    return vec4f(plain_direct(in, normalize(frame.eye_ws - in.position_ws), bsdf_of(in.material, in)), 1.0);
}

@fragment
fn with_indirect(in: Fragment) -> @location(0) vec4f {
    let bsdf = bsdf_of(in.material, in);
    let indirect = indirect_irradiance(in.lightmap_uv) * albedo(bsdf) * INVERSE_PI;
    return vec4f(plain_direct(in, normalize(frame.eye_ws - in.position_ws), bsdf) + indirect, 1.0);
}
