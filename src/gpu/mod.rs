//! The run time on the GPU: measure, downsample, transfer, reconstruct, shade, resolve.
//!
//! An engine takes a [`Relighter`], which works on its device, in its encoder, for its shaders; `examples/embed.rs` is one.
//! A [`Runtime`] draws pictures by itself.
//!
//! One WGSL file a stage in `shaders/`, each held against its CPU twin by `tests/gpu_matches_cpu.rs`. Everything stays
//! within WebGPU's default limits on bindings and needs no optional feature.
//!
//! Shadows are rays against a BVH in a storage buffer, at the measurement points and at the pixels alike: the direct light
//! of the run time is then that of training and of the CPU's pictures, for every kind of light, without a bias to tune.
//! At the points this is all but free. At the pixels shadow maps would be faster where rays run in software: on Mesa's
//! llvmpipe a frame with four lights took 6 to 19 times as long as one depth map of 1024² a light with 3 × 3 lookups.

pub mod bench;
mod bindings;
mod bvh;
mod device;
mod layout;
mod measurement;
mod point_textures;
mod reconstruction;
mod relighter;
mod runtime;
mod scene;
pub mod shader;
mod shading;
mod stored;
mod textures;
mod timer;

pub use device::{Gpu, GpuError};
pub use layout::{
    Blocker, FrameUniforms, GpuLight, GpuMaterial, Node, SubPoint, TextureUse, TransferShape, Triangle, Vertex,
};
pub use point_textures::PointTextures;
pub use relighter::{Measure, Relighter, Settings};
pub use runtime::Runtime;
pub use shader::Lookup;
pub use textures::basis_layer;
pub use timer::PassTimes;
