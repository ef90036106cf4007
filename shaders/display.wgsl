// What the window shows: two pictures on both sides of a split, or their difference from a third one, exposed, tone mapped and
// encoded as sRGB. One invocation a pixel. CPU twin: Picture::srgb8.

// What a side shows.
const PICTURE: u32 = 0u;
const REFERENCE: u32 = 1u;
const DIFFERENCE: u32 = 2u;

struct Display {
    size: vec2u,      // pixels
    split: u32,       // the first column of the right side
    tone_curve: u32,  // 0: values are clamped
    left: u32,        // what the sides show
    right: u32,
    exposure: f32,
    difference: f32,  // radiance that is the brightest of the scale
}

@group(0) @binding(0) var<uniform> display: Display;
@group(0) @binding(1) var left_picture: texture_2d<f32>; // W/m²/sr
@group(0) @binding(2) var right_picture: texture_2d<f32>;
@group(0) @binding(3) var reference_picture: texture_2d<f32>;
@group(0) @binding(4) var shown: texture_storage_2d<rgba8unorm, write>;

@compute @workgroup_size(8, 8)
fn show(@builtin(global_invocation_id) id: vec3u) {
    if any(id.xy >= display.size) {
        return;
    }
    let uv = (vec2f(id.xy) + 0.5) / vec2f(display.size);
    let is_left = id.x < display.split;
    let what = select(display.right, display.left, is_left);
    var picture = vec3f(0.0);
    if what != REFERENCE {
        if is_left {
            picture = at(left_picture, uv);
        } else {
            picture = at(right_picture, uv);
        }
    }
    var colour: vec3f;
    if what == DIFFERENCE {
        let difference = abs(picture - at(reference_picture, uv));
        colour = false_colour(dot(difference, vec3f(0.2126, 0.7152, 0.0722)) / display.difference);
    } else {
        if what == REFERENCE {
            picture = at(reference_picture, uv);
        }
        picture *= display.exposure;
        if display.tone_curve != 0u {
            picture = tone_map(picture);
        }
        colour = srgb_from_linear(clamp(picture, vec3f(0.0), vec3f(1.0)));
    }
    textureStore(shown, id.xy, vec4f(colour, 1.0));
}

// A picture of any size, bilinear; of this size, its pixel.
fn at(picture: texture_2d<f32>, uv: vec2f) -> vec3f {
    let last = vec2i(textureDimensions(picture)) - 1;
    let p = uv * vec2f(last + 1) - 0.5;
    let base = floor(p + 1e-3);
    let f = clamp(p - base, vec2f(0.0), vec2f(1.0));
    let low = clamp(vec2i(base), vec2i(0), last);
    let high = clamp(vec2i(base) + 1, vec2i(0), last);
    let top = mix(textureLoad(picture, low, 0), textureLoad(picture, vec2i(high.x, low.y), 0), f.x);
    let bottom = mix(textureLoad(picture, vec2i(low.x, high.y), 0), textureLoad(picture, high, 0), f.x);
    return mix(top, bottom, f.y).rgb;
}

// Khronos PBR Neutral. CPU twin: tone_map.
fn tone_map(radiance: vec3f) -> vec3f {
    const START_COMPRESSION = 0.8 - 0.04;
    const DESATURATION = 0.15;
    var colour = max(radiance, vec3f(0.0));
    let low = min(colour.r, min(colour.g, colour.b));
    colour -= select(0.04, low - 6.25 * low * low, low < 0.08);
    let peak = max(colour.r, max(colour.g, colour.b));
    if peak < START_COMPRESSION {
        return colour;
    }
    let d = 1.0 - START_COMPRESSION;
    let new_peak = 1.0 - d * d / (peak + d - START_COMPRESSION);
    let g = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
    return mix(colour * (new_peak / peak), vec3f(new_peak), g);
}

fn srgb_from_linear(linear: vec3f) -> vec3f {
    let curved = 1.055 * pow(max(linear, vec3f(1e-6)), vec3f(1.0 / 2.4)) - 0.055;
    return select(curved, linear * 12.92, linear <= vec3f(0.0031308));
}

// Viridis. CPU twin: false_colour.
fn false_colour(value: f32) -> vec3f {
    let t = clamp(value, 0.0, 1.0);
    var c = vec3f(-5.435456, 4.6458526, 26.312435);
    c = c * t + vec3f(4.776385, -13.745145, -65.353033);
    c = c * t + vec3f(6.22827, 14.179933, 56.69055);
    c = c * t + vec3f(-4.6342305, -5.799101, -19.332441);
    c = c * t + vec3f(-0.33086183, 0.21484756, 0.095095165);
    c = c * t + vec3f(0.10509304, 1.4046135, 1.3845902);
    c = c * t + vec3f(0.2777273, 0.0054073445, 0.3340998);
    return clamp(c, vec3f(0.0), vec3f(1.0));
}
