//! The stages' WGSL, each composed of the files that it builds on.

/// One stage's module.
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
const RECONSTRUCT: &str = include_str!("../../shaders/reconstruct.wgsl");
const SHADE: &str = include_str!("../../shaders/shade.wgsl");
const RESOLVE: &str = include_str!("../../shaders/resolve.wgsl");

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

    /// The whole module.
    pub fn source(self) -> String {
        match self {
            Stage::Measure => [FRAME, LIGHT, SCENE, TRACE, MEASURE].join("\n"),
            Stage::Downsample => DOWNSAMPLE.to_owned(),
            Stage::Transfer => TRANSFER.to_owned(),
            Stage::Reconstruct => RECONSTRUCT.to_owned(),
            Stage::Shade => [FRAME, LIGHT, SCENE, TRACE, BSDF, SHADE].join("\n"),
            Stage::Resolve => [FRAME, RESOLVE].join("\n"),
        }
    }
}
