//! The stages' WGSL, each composed of the files that it builds on.

use crate::model::Basis;

/// One pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    Measure,
    Downsample,
    Transfer,
    Reconstruct,
    Shade,
    Resolve,
}

const FRAME: &str = include_str!("../../shaders/frame.wgsl");
const LIGHT: &str = include_str!("../../shaders/light.wgsl");
const SCENE: &str = include_str!("../../shaders/scene.wgsl");
const TRACE: &str = include_str!("../../shaders/trace.wgsl");
const BSDF: &str = include_str!("../../shaders/bsdf.wgsl");
const MEASURE: &str = include_str!("../../shaders/measure.wgsl");
const DOWNSAMPLE: &str = include_str!("../../shaders/downsample.wgsl");
const TRANSFER: &str = include_str!("../../shaders/transfer.wgsl");
const BASIS_GLOBAL: &str = include_str!("../../shaders/basis_global.wgsl");
const BASIS_LOCAL: &str = include_str!("../../shaders/basis_local.wgsl");
const RECONSTRUCT: &str = include_str!("../../shaders/reconstruct.wgsl");
const LOOKUP_TEXTURE: &str = include_str!("../../shaders/lookup_texture.wgsl");
const LOOKUP_BILINEAR: &str = include_str!("../../shaders/lookup_bilinear.wgsl");
const LOOKUP_FILTERED: &str = include_str!("../../shaders/lookup_filtered.wgsl");
const SHADE: &str = include_str!("../../shaders/shade.wgsl");
const RESOLVE: &str = include_str!("../../shaders/resolve.wgsl");
const BENCH: &str = include_str!("../../shaders/bench.wgsl");
pub const COPY: &str = include_str!("../../shaders/copy.wgsl");

/// Where a fragment shader gets indirect light from.
///
/// Both give the same light. Counted in reads of four values, a fragment costs 4 with [`Lookup::Texture`], a layer of a global
/// basis each with [`Lookup::Fragment`], and for a local basis 4 · (2 layers and anchors, 4 coefficients for each channel); a
/// texture costs all its texels once for each change of light. `relight bench` times both.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lookup {
    /// From the basis itself: nothing is done for light that nobody looks at.
    Fragment,
    /// From a texture that one more pass makes for each change of light.
    Texture,
}

impl Lookup {
    /// What is likely the cheaper one where about `fragments` are shaded for each change of light.
    pub fn cheaper(basis: &Basis, fragments: usize) -> Self {
        let layers = basis.layers();
        let texels = basis.size * basis.size;
        let (texel, fragment) = match basis.anchors {
            None => (layers, layers),
            Some(_) => (layers + 2 + 4 * basis.elements, 4 * (layers + 2 + 4 * basis.elements)),
        };
        if fragment * fragments <= texel * texels + 4 * fragments { Lookup::Fragment } else { Lookup::Texture }
    }
}

impl Stage {
    pub const ALL: [Stage; 6] =
        [Stage::Measure, Stage::Downsample, Stage::Transfer, Stage::Reconstruct, Stage::Shade, Stage::Resolve];

    pub fn name(self) -> &'static str {
        match self {
            Stage::Measure => "measure",
            Stage::Downsample => "downsample",
            Stage::Transfer => "transfer",
            Stage::Reconstruct => "reconstruct",
            Stage::Shade => "shade",
            Stage::Resolve => "resolve",
        }
    }

    /// The whole module, for a basis of this shape.
    pub fn source(self, basis: &Basis, lookup: Lookup) -> String {
        match self {
            Stage::Measure => [FRAME, LIGHT, SCENE, TRACE, MEASURE].join("\n"),
            Stage::Downsample => DOWNSAMPLE.to_owned(),
            Stage::Transfer => TRANSFER.to_owned(),
            Stage::Reconstruct => [&shape(basis), texel(basis), RECONSTRUCT].join("\n"),
            Stage::Shade => {
                let indirect = indirect_irradiance(basis, lookup, 1);
                [FRAME, LIGHT, SCENE, TRACE, BSDF, &indirect, SHADE].join("\n")
            }
            Stage::Resolve => [FRAME, RESOLVE].join("\n"),
        }
    }
}

/// The WGSL function `indirect_irradiance(lightmap_uv: vec2f) -> vec3f`, W/m², not under zero, and what it is made of, whose names
/// begin with `relight_`. Its bindings are in bind group `group`.
pub fn indirect_irradiance(basis: &Basis, lookup: Lookup, group: u32) -> String {
    let shape = shape(basis);
    let parts = match (lookup, &basis.anchors) {
        (Lookup::Texture, _) => [&shape, LOOKUP_TEXTURE, LOOKUP_BILINEAR],
        (Lookup::Fragment, None) => [&shape, BASIS_GLOBAL, LOOKUP_FILTERED],
        (Lookup::Fragment, Some(_)) => [&shape, BASIS_LOCAL, LOOKUP_BILINEAR],
    };
    parts.join("\n").replace("@group(0)", &format!("@group({group})"))
}

/// The module of what is timed in the place of [`Stage::Shade`].
pub fn bench(basis: &Basis, lookup: Lookup) -> String {
    [Stage::Shade.source(basis, lookup).as_str(), BENCH].join("\n")
}

fn texel(basis: &Basis) -> &'static str {
    if basis.anchors.is_some() { BASIS_LOCAL } else { BASIS_GLOBAL }
}

/// Constants, so that compilers unroll loops over layers.
fn shape(basis: &Basis) -> String {
    let (layers, per_layer) = (basis.layers(), basis.elements_per_layer());
    [
        ("RELIGHT_SIZE", "texels along a side", basis.size),
        ("RELIGHT_ELEMENTS", "coefficients, or those of an anchor", basis.elements),
        ("RELIGHT_COMPONENTS", "1: four scalar elements a layer; 3: one RGB element a layer", basis.components),
        ("RELIGHT_LAYERS", "of the basis texture", layers),
        ("RELIGHT_COEFFICIENTS", "of all layers", layers * per_layer),
    ]
    .map(|(name, what, value)| format!("const {name} = {value}u; // {what}\n"))
    .concat()
        + &format!("const RELIGHT_GAMMA = {:?}f; // what values and coefficients make is raised to this\n", basis.gamma)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Anchors, Values};

    /// What is looked at by few is not made for all; a texture that many look at is.
    #[test]
    fn the_cheaper_lookup_follows_the_counts() {
        let basis = |elements: usize, anchors: bool| {
            let anchors = anchors.then(|| Anchors { count: 1, indices: vec![], shares: vec![] });
            Basis { size: 256, elements, components: 1, values: Values::Byte(vec![]), anchors, gamma: 1.0 }
        };
        let pixels = 1920 * 1080;
        assert_eq!(Lookup::cheaper(&basis(16, false), pixels), Lookup::Fragment);
        assert_eq!(Lookup::cheaper(&basis(64, false), pixels), Lookup::Texture);
        assert_eq!(Lookup::cheaper(&basis(64, false), 10_000), Lookup::Fragment);
        assert_eq!(Lookup::cheaper(&basis(4, true), pixels), Lookup::Texture);
        assert_eq!(Lookup::cheaper(&basis(4, true), 10_000), Lookup::Fragment);
    }
}
