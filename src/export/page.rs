//! The page in an exported folder.

use crate::model::{Channels, Model, Values};

/// How to shade with the folder, for this very model.
pub fn page(model: &Model) -> String {
    let (basis, transfer, points) = (&model.basis, &model.transfer, &model.points);
    let (n, size, layers, p) = (basis.elements, basis.size, basis.layers(), points.points.len());
    let per_layer = if basis.components == 1 { "four scalar elements" } else { "one RGB element, alpha unused" };
    let format = if matches!(basis.values, Values::Half(_)) { "RGBA16F" } else { "RGBA8 SNORM" };
    let per_point = points.neighbours_per_point();
    let sub_points = points.sub_points.len();
    let matrices = match transfer.channels {
        Channels::Mono => {
            "`matrices[c][j][i]`, a matrix for each channel c: `u[j][c] = Σᵢ matrices[c][j][i] · x[i][c]`"
        }
        Channels::Multi => {
            "`matrices[0][j][3 i + c]`, one matrix for all channels c: `u[j] = Σᵢ Σ_c matrices[0][j][3 i + c] · x[i][c]`, \
             the same for red, green and blue"
        }
    };
    let mean = match (transfer.mean_scaled_by_norm, transfer.channels) {
        (false, _) => "",
        (true, Channels::Mono) => {
            "\n   `u[0][c]` is the norm of the channel instead, `sqrt(Σᵢ x[i][c]²)`: element 0 is the mean."
        }
        (true, Channels::Multi) => {
            "\n   `u[0]` is the norm of x instead, `sqrt(Σᵢ Σ_c x[i][c]²)`: element 0 is the mean."
        }
    };
    let shading = match &basis.anchors {
        None => "`E(uv) = Σⱼ u[j] · Uⱼ(uv)`, with Uⱼ sampled bilinearly from `basis.ktx2` (clamp to edge): channel j mod 4 of layer\n   \
             j / 4 where there is one scalar an element, layer j where there is RGB."
            .to_owned(),
        Some(anchors) => format!(
            "A texel t has {n} values bⱼ(t) in `basis.ktx2`, four anchors aₖ(t) of {count} in `anchors.ktx2` (RGBA8 UINT), and\n   \
             in `shares.ktx2` (RGBA8 UNORM) the shares φ₁, φ₂, φ₃; φ₄ = 1 − φ₁ − φ₂ − φ₃, and its alpha a is a scale:\n   \
             `E(t) = 2^((a − 1) · 255/16) · Σⱼ bⱼ(t) · Σₖ φₖ(t) · u[{n} · aₖ(t) + j]`. Interpolate E between texels, not what is stored.",
            count = anchors.count
        ),
    };
    let local = if basis.anchors.is_some() {
        "| `anchors.ktx2`, `shares.ktx2` | which coefficients a texel takes, and its scale |\n"
    } else {
        ""
    };
    let gamma = transfer.gamma;
    let (root, raised) = match gamma {
        1.0 => (String::new(), "max(E, 0)".to_owned()),
        _ => (format!(" First raise x to 1/{gamma}."), format!("max(E, 0)^{gamma}")),
    };
    let linear = if transfer.mean_scaled_by_norm || gamma != 1.0 { "" } else { ", linear in the light" };
    format!(
        "# Indirect light for {name}

Written by relight {version}. Direct light at {p} points in, indirect light of the whole asset out{linear}; no rays at run time but the
shadows at the points.

| file | holds |
|---|---|
| `asset.glb` | the asset; its lightmap coordinates are TEXCOORD_1 |
| `basis.ktx2` | the basis: {size} x {size}, layers of {per_layer}, {layers} in all, {format} |
{local}| `basis.exr` | the same, a channel an element, with scales applied: to look at, or to bake into other formats |
| `transfer.json`, `transfer.safetensors` | points, sub-points, matrices, twice: as text and as named tensors |
| `downsample.wgsl`, `transfer.wgsl`, `reconstruct.wgsl` | compute shaders of steps 2, 3 and 4; bindings are at their heads |
| `indirect_from_basis.wgsl`, `indirect_from_texture.wgsl` | `indirect_irradiance(lightmap_uv)` for your fragment shader |

## Whenever lights change

1. **Measure.** At each of the {sub_points} sub-points (`sub_points.position`, metres, +y up; `normal`; `albedo`, linear RGB) shade the direct light as
   you shade pixels, shadows included: `e = albedo · irradiance`, W/m², with lights in glTF's units (candela, lux) and no factor of
   1/π. A row of pixels whose G-buffer holds these points does it with the shaders that you have. Start shadow rays on the
   side of `geometric_normal`.
2. **Downsample.** `x[i]` is the mean of `e` over the {per_point} sub-points in `neighbours[i]`.
3. **Transfer.**{root} {matrices}.{mean}

## At each pixel, or once into a texture of {size} x {size}

4. {shading}
5. Indirect radiance is `albedo / π · {raised}`. A truncated basis may ring below zero; light does not.

`lightmap_uv` is TEXCOORD_1, row 0 of the textures is at v = 0, elements and points count from 0. There is light on fronts alone; the
back of a two-sided surface has none. In WGSL, step 4 of either kind is `indirect_irradiance(lightmap_uv)`; `indirect_from_basis.wgsl` reads
the basis for each pixel, `indirect_from_texture.wgsl` what `reconstruct.wgsl` made of it. In Rust with wgpu, `relight::gpu::Relighter` does all
steps with the model file.
",
        name = model.asset.name,
        version = env!("CARGO_PKG_VERSION"),
    )
}
