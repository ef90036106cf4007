//! Frames, sampling warps beside their pdfs, the sample generator, spherical harmonics, colour. Imports nothing of ours.

pub mod colour;
pub mod frame;
pub mod quadrature;
#[cfg(feature = "train")]
pub mod sampler;
pub mod sh;
pub mod warp;

/// Lights, triangles or rays handled together: one AVX-512 register of f32, two AVX, four SSE or NEON.
pub const LANES: usize = 16;

pub use frame::Frame;
#[cfg(feature = "train")]
pub use sampler::Sampler;

/// Linear RGB, Rec. 709 primaries.
pub type Rgb = glam::Vec3;
