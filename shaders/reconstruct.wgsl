// Indirect irradiance of every texel from the coefficients: Σⱼ bⱼ Σₖ φₖ uₖⱼ (METHOD eq. 8 and 10). One invocation a texel.
// CPU twin: Basis::reconstruct.
struct BasisShape {
    size: u32,       // texels along a side
    layers: u32,     // of the basis texture
    components: u32, // 1: four scalar elements a layer; 3: one RGB element a layer
    elements: u32,   // coefficients of an anchor
    anchors: u32,    // 0: one set of coefficients for all texels
}

@group(0) @binding(0) var<uniform> shape: BasisShape;
@group(0) @binding(1) var<storage, read> coefficients: array<vec4f>; // u, RGB: [anchor][element], padded by a layer's elements
@group(0) @binding(2) var basis: texture_2d_array<f32>;
@group(0) @binding(3) var anchor_indices: texture_2d<u32>;
@group(0) @binding(4) var anchor_shares: texture_2d<f32>; // of the first three; then the scale of the texel's values, (code − 255)/16 octaves
@group(0) @binding(5) var irradiance: texture_storage_2d<rgba32float, write>; // W/m², of either sign

// Coefficient of an element at a texel. One past the last is multiplied by a value of zero.
fn interpolated(element: u32, anchors: vec4u, shares: vec4f) -> vec3f {
    if shape.anchors == 0u {
        return coefficients[element].rgb;
    }
    let at = anchors * shape.elements + element;
    return coefficients[at.x].rgb * shares.x + coefficients[at.y].rgb * shares.y
        + coefficients[at.z].rgb * shares.z + coefficients[at.w].rgb * shares.w;
}

@compute @workgroup_size(8, 8)
fn reconstruct(@builtin(global_invocation_id) id: vec3u) {
    if any(id.xy >= vec2u(shape.size)) {
        return;
    }
    var anchors = vec4u(0u);
    var shares = vec4f(0.0);
    var scale = 1.0;
    if shape.anchors != 0u {
        anchors = textureLoad(anchor_indices, id.xy, 0);
        shares = textureLoad(anchor_shares, id.xy, 0);
        scale = exp2((shares.w - 1.0) * (255.0 / 16.0));
        shares.w = 1.0 - (shares.x + shares.y + shares.z);
    }
    var sum = vec3f(0.0);
    for (var layer = 0u; layer < shape.layers; layer++) {
        let value = textureLoad(basis, id.xy, layer, 0);
        if shape.components == 1u {
            for (var channel = 0u; channel < 4u; channel++) {
                sum += interpolated(4u * layer + channel, anchors, shares) * value[channel];
            }
        } else {
            sum += interpolated(layer, anchors, shares) * value.rgb;
        }
    }
    textureStore(irradiance, id.xy, vec4f(sum * scale, 0.0));
}
