// Rasterises the asset and lights it: direct light behind shadow rays, indirect light by one of the lookups, in group 1.
// CPU twin: Model::render_with.
struct Fragment {
    @builtin(position) @invariant position: vec4f,
    @location(0) position_ws: vec3f,
    @location(1) normal: vec3f,
    @location(2) colour: vec3f,
    @location(3) uv0: vec2f,
    @location(4) uv1: vec2f,
    @location(5) lightmap_uv: vec2f,
    @location(6) @interpolate(flat) geometric_normal: vec3f,
    @location(7) @interpolate(flat) material: u32,
}

@vertex
fn place(@builtin(vertex_index) index: u32) -> Fragment {
    let triangle = triangles[index / 3u];
    let v = vertices[triangle.vertices[index % 3u]];
    let a = vertices[triangle.vertices.x].position;
    let b = vertices[triangle.vertices.y].position;
    let c = vertices[triangle.vertices.z].position;
    let doubled_area = cross(b - a, c - a);
    let clip = frame.clip_from_world * vec4f(v.position, 1.0);
    let geometric_normal = doubled_area / max(length(doubled_area), 1e-30);
    return Fragment(
        clip, v.position, v.normal, v.colour, v.uv0, v.uv1, v.lightmap_uv, geometric_normal, triangle.material
    );
}

// Depth of alpha-masked triangles.
@fragment
fn cut_out(in: Fragment) {
    if is_cut_out_at(in.material, in.uv0, in.uv1) {
        discard;
    }
}

@fragment
fn shade(in: Fragment) -> @location(0) vec4f {
    let to_view = normalize(frame.eye_ws - in.position_ws);
    let back = dot(in.geometric_normal, to_view) < 0.0;
    let side = select(1.0, -1.0, back);
    let material = in.material;
    let bsdf = bsdf_of(material, in);
    var radiance = vec3f(0.0);
    if (frame.shown & SHOW_DIRECT) != 0u {
        radiance += direct_radiance(in.position_ws, in.geometric_normal * side, shading_normal(in) * side, to_view, bsdf);
        // Backs are drawn for two-sided materials only, and those shine both ways.
        radiance += materials[material].emissive
            * sample_texture(materials[material].emissive_texture, in.uv0, in.uv1).rgb;
    }
    // The lightmap holds the light of the front.
    if (frame.shown & SHOW_INDIRECT) != 0u && !back {
        let reflectance = select(albedo(bsdf), vec3f(1.0), (frame.shown & SHOW_WHITE) != 0u);
        radiance += indirect_irradiance(in.lightmap_uv) * reflectance * INVERSE_PI;
    }
    return vec4f(radiance, 1.0);
}

fn shading_normal(in: Fragment) -> vec3f {
    let length_squared = dot(in.normal, in.normal);
    // Shading normals that point below the surface are not usable as such.
    if length_squared < 1e-30 || dot(in.normal, in.geometric_normal) <= 0.0 {
        return in.geometric_normal;
    }
    return in.normal / sqrt(length_squared);
}

fn bsdf_of(material: u32, in: Fragment) -> Bsdf {
    let texel = sample_texture(materials[material].base_colour_texture, in.uv0, in.uv1);
    let base = saturate(materials[material].base_colour.rgb * texel.rgb * in.colour);
    if materials[material].metallic_roughness == 0u {
        return Bsdf(base, vec3f(0.0), 1.0, false);
    }
    let factors = sample_texture(materials[material].metallic_roughness_texture, in.uv0, in.uv1);
    let metallic = materials[material].metallic * factors.b;
    let roughness = materials[material].roughness * factors.g;
    // A dielectric of index 1.5 reflects 4 % (glTF 2.0, appendix B.2.4).
    return Bsdf(base * (1.0 - metallic), mix(vec3f(0.04), base, metallic), max(roughness * roughness, 1e-3), true);
}

fn direct_radiance(position: vec3f, geometric_normal: vec3f, normal: vec3f, to_view: vec3f, bsdf: Bsdf) -> vec3f {
    let origin = position + geometric_normal * frame.shadow_offset;
    var sum = vec3f(0.0);
    for (var i = 0u; i < frame.light_count; i++) {
        let arrival = arrive(lights[i], origin, normal);
        if reaches(arrival, origin, geometric_normal) {
            sum += evaluate_bsdf(bsdf, normal, to_view, arrival.direction) * arrival.irradiance;
        }
    }
    return sum;
}
