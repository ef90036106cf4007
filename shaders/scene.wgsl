// The asset: triangles, materials, textures. CPU twins: Texture::sample, Asset::base_colour, Asset::surface.
struct Vertex {
    position: vec3f,     // metres, world space
    normal: vec3f,       // unit, world space
    colour: vec3f,       // linear, multiplies the base colour
    uv0: vec2f,
    uv1: vec2f,
    lightmap_uv: vec2f,  // [0, 1]²
}

struct Triangle {
    vertices: vec3u,
    material: u32,
}

// A texture as a material uses it: a rectangle of a page and how uv maps to it.
struct TextureUse {
    u_from_uv: vec3f,  // u = dot(u_from_uv, (uv, 1))
    page: u32,         // NO_TEXTURE where there is none
    v_from_uv: vec3f,
    uv_set: u32,
    origin: vec2u,     // texels in the page
    size: vec2u,       // texels
    wrap: vec2u,       // WRAP_ along u and v
    srgb: u32,         // 1 where RGB is sRGB-encoded
}

struct Material {
    base_colour: vec4f,    // linear RGB and alpha
    emissive: vec3f,       // W·m⁻²·sr⁻¹
    metallic: f32,
    roughness: f32,
    alpha_cutoff: f32,     // negative where nothing is cut out
    metallic_roughness: u32, // 0: Lambert
    base_colour_texture: TextureUse,
    metallic_roughness_texture: TextureUse,
    emissive_texture: TextureUse,
}

const NO_TEXTURE = 0xffffffffu;
const WRAP_REPEAT = 0u;
const WRAP_MIRROR = 1u;

@group(0) @binding(2) var<storage, read> vertices: array<Vertex>;
@group(0) @binding(3) var<storage, read> triangles: array<Triangle>;
@group(0) @binding(4) var<storage, read> materials: array<Material>;
// 8-bit codes, not unorm: the decode below is then the CPU's, to the bit.
@group(0) @binding(5) var pages: texture_2d_array<u32>;
// Linear value of each 8-bit sRGB code, four a vector.
@group(0) @binding(6) var<uniform> linear_from_srgb8: array<vec4f, 64>;

fn wrapped(x: i32, size: u32, wrap: u32) -> u32 {
    let n = i32(size);
    if wrap == WRAP_REPEAT {
        return u32((x % n + n) % n);
    }
    if wrap == WRAP_MIRROR {
        let m = (x % (2 * n) + 2 * n) % (2 * n);
        return u32(select(2 * n - 1 - m, m, m < n));
    }
    return u32(clamp(x, 0, n - 1));
}

fn linear_from_code(code: u32) -> f32 {
    return linear_from_srgb8[code / 4u][code % 4u];
}

fn texel(texture: TextureUse, x: i32, y: i32) -> vec4f {
    let at = texture.origin + vec2u(wrapped(x, texture.size.x, texture.wrap.x), wrapped(y, texture.size.y, texture.wrap.y));
    let code = textureLoad(pages, at, texture.page, 0);
    let linear = vec4f(code) / 255.0;
    if texture.srgb == 0u {
        return linear;
    }
    return vec4f(linear_from_code(code.r), linear_from_code(code.g), linear_from_code(code.b), linear.a);
}

// Bilinear lookup in linear RGBA; white where there is no texture.
fn sample_texture(texture: TextureUse, uv0: vec2f, uv1: vec2f) -> vec4f {
    if texture.page == NO_TEXTURE {
        return vec4f(1.0);
    }
    let uv = vec3f(select(uv0, uv1, texture.uv_set == 1u), 1.0);
    let p = vec2f(dot(texture.u_from_uv, uv), dot(texture.v_from_uv, uv)) * vec2f(texture.size) - 0.5;
    let base = floor(p);
    let f = p - base;
    let x = i32(base.x);
    let y = i32(base.y);
    let top = mix(texel(texture, x, y), texel(texture, x + 1, y), f.x);
    let bottom = mix(texel(texture, x, y + 1), texel(texture, x + 1, y + 1), f.x);
    return mix(top, bottom, f.y);
}

// Whether an alpha-masked triangle is absent at barycentric coordinates (u, v) of its second and third vertex.
fn is_cut_out(triangle: u32, u: f32, v: f32) -> bool {
    let t = triangles[triangle];
    let w = 1.0 - u - v;
    let a = t.vertices.x;
    let b = t.vertices.y;
    let c = t.vertices.z;
    let uv0 = vertices[a].uv0 * w + vertices[b].uv0 * u + vertices[c].uv0 * v;
    let uv1 = vertices[a].uv1 * w + vertices[b].uv1 * u + vertices[c].uv1 * v;
    return is_cut_out_at(t.material, uv0, uv1);
}

fn is_cut_out_at(material: u32, uv0: vec2f, uv1: vec2f) -> bool {
    let alpha = materials[material].base_colour.a * sample_texture(materials[material].base_colour_texture, uv0, uv1).a;
    return alpha < materials[material].alpha_cutoff;
}
