// What all stages of one frame share.
struct Frame {
    clip_from_world: mat4x4f, // depth 1 at the near plane, 0 at infinity
    eye_ws: vec3f,            // metres
    shadow_offset: f32,       // metres by which a shadow ray starts off its surface
    extent: f32,              // metres: no segment between two points of the asset is longer
    light_count: u32,
    shown: u32,               // SHOW_ bits
    samples_per_axis: u32,    // samples along each side of a pixel
}

const SHOW_DIRECT = 1u;
const SHOW_INDIRECT = 2u;
const SHOW_WHITE = 4u; // indirect light as a white surface shows it

@group(0) @binding(0) var<uniform> frame: Frame;
