//! The structs that Rust and WGSL share. `tests/shader_layout.rs` holds their offsets together; units and spaces are in the
//! shaders.

use bytemuck::{Pod, Zeroable};
use glam::Mat4;

/// `shaders/frame.wgsl`: Frame.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct FrameUniforms {
    pub clip_from_world: Mat4,
    pub eye_ws: [f32; 3],
    pub shadow_offset: f32,
    pub extent: f32,
    pub light_count: u32,
    pub shown: u32,
    pub samples_per_axis: u32,
}

/// `shaders/light.wgsl`: Light.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct GpuLight {
    pub position: [f32; 3],
    pub local: f32,
    pub direction: [f32; 3],
    pub inverse_range4: f32,
    pub radiant: [f32; 3],
    pub cone_scale: f32,
    pub cone_offset: f32,
    pub lobe: f32,
    pub _pad: [u32; 2],
}

/// `shaders/scene.wgsl`: Vertex.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Vertex {
    pub position: [f32; 3],
    pub _pad0: u32,
    pub normal: [f32; 3],
    pub _pad1: u32,
    pub colour: [f32; 3],
    pub _pad2: u32,
    pub uv0: [f32; 2],
    pub uv1: [f32; 2],
    pub lightmap_uv: [f32; 2],
    pub _pad3: [u32; 2],
}

/// `shaders/scene.wgsl`: Triangle.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Triangle {
    pub vertices: [u32; 3],
    pub material: u32,
}

/// `shaders/scene.wgsl`: TextureUse.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct TextureUse {
    pub u_from_uv: [f32; 3],
    pub page: u32,
    pub v_from_uv: [f32; 3],
    pub uv_set: u32,
    pub origin: [u32; 2],
    pub size: [u32; 2],
    pub wrap: [u32; 2],
    pub srgb: u32,
    pub _pad: u32,
}

/// `shaders/scene.wgsl`: Material.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct GpuMaterial {
    pub base_colour: [f32; 4],
    pub emissive: [f32; 3],
    pub metallic: f32,
    pub roughness: f32,
    pub alpha_cutoff: f32,
    pub metallic_roughness: u32,
    pub _pad: u32,
    pub base_colour_texture: TextureUse,
    pub metallic_roughness_texture: TextureUse,
    pub emissive_texture: TextureUse,
}

/// `shaders/trace.wgsl`: Node.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Node {
    pub low: [f32; 3],
    pub after: u32,
    pub high: [f32; 3],
    pub primitives: u32,
}

/// `shaders/trace.wgsl`: Blocker.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Blocker {
    pub a: [f32; 3],
    pub triangle: u32,
    pub b: [f32; 3],
    pub masked: u32,
    pub c: [f32; 3],
    pub _pad: u32,
}

/// `shaders/measure.wgsl`: SubPoint.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct SubPoint {
    pub position: [f32; 3],
    pub _pad0: u32,
    pub normal: [f32; 3],
    pub _pad1: u32,
    pub geometric_normal: [f32; 3],
    pub _pad2: u32,
    pub albedo: [f32; 3],
    pub _pad3: u32,
}

/// `shaders/transfer.wgsl`: TransferShape.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct TransferShape {
    pub points: u32,
    pub interleaved: u32,
    pub mean_scaled_by_norm: u32,
    pub inverse_gamma: f32,
    pub scale: f32,
}
