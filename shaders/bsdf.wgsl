// Reflection: Lambert, or glTF 2.0's metallic-roughness model (specification, appendix B). CPU twin: Bsdf::evaluate.
struct Bsdf {
    diffuse: vec3f,  // Lambertian reflectance
    f0: vec3f,       // specular reflectance at normal incidence
    alpha: f32,      // GGX roughness
    specular: bool,
}

const INVERSE_PI = 0.3183098861837907;

// The BRDF in sr⁻¹, without the cosine; unit vectors that leave the surface.
fn evaluate_bsdf(bsdf: Bsdf, normal: vec3f, to_view: vec3f, to_light: vec3f) -> vec3f {
    if !bsdf.specular {
        return bsdf.diffuse * INVERSE_PI;
    }
    let half_vector = normalize(to_view + to_light);
    let grazing = saturate(1.0 - dot(to_view, half_vector));
    let grazing2 = grazing * grazing;
    let fresnel = bsdf.f0 + (1.0 - bsdf.f0) * (grazing2 * grazing2 * grazing);
    let a2 = bsdf.alpha * bsdf.alpha;
    let cos_half = dot(normal, half_vector);
    let d = cos_half * cos_half * (a2 - 1.0) + 1.0;
    let distribution = a2 * INVERSE_PI / max(d * d, 1e-20);
    let cos_view = max(dot(normal, to_view), 0.0);
    let cos_light = dot(normal, to_light);
    let view = cos_light * sqrt(cos_view * cos_view * (1.0 - a2) + a2);
    let light = cos_view * sqrt(cos_light * cos_light * (1.0 - a2) + a2);
    let visibility = 0.5 / max(view + light, 1e-7);
    return (1.0 - fresnel) * bsdf.diffuse * INVERSE_PI + fresnel * (distribution * visibility);
}

// Share of diffusely arriving light that leaves again.
fn albedo(bsdf: Bsdf) -> vec3f {
    return bsdf.diffuse * (1.0 - bsdf.f0) + bsdf.f0;
}
