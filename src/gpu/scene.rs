//! The asset on the GPU: bind group 0 of the stages that trace or shade.

use std::ops::Range;

use glam::Vec2;

use super::bindings::{self, READ, UNIFORM};
use super::bvh::FlatBvh;
use super::device::{Gpu, GpuError};
use super::layout::{Blocker, FrameUniforms, GpuLight, GpuMaterial, Triangle, Vertex};
use super::textures::{Pages, srgb_table};
use crate::light::{EmissionFacets, Light, LightTable};
use crate::scene::tracer::RELATIVE_OFFSET;
use crate::scene::{Asset, Material, Mesh, Reflectance};

/// Vertices to draw with one pipeline: three a triangle.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    pub double_sided: bool,
    pub masked: bool,
    pub vertices: Range<u32>,
}

/// Buffers and textures of one asset, and the lights and frame constants that go with them.
pub struct Scene {
    pub layout: wgpu::BindGroupLayout,
    pub bind_group: wgpu::BindGroup,
    /// Written by [`Scene::write_frame`].
    pub frame: FrameUniforms,
    frame_buffer: wgpu::Buffer,
    pub batches: Vec<Batch>,
    buffers: [wgpu::Buffer; 6],
    pages: Pages,
    lights: wgpu::Buffer,
    /// What stands for the asset's own emission.
    emission: EmissionFacets,
}

impl Scene {
    pub fn new(gpu: &Gpu, asset: &Asset) -> Result<Self, GpuError> {
        let (order, batches) = drawing_order(asset);
        let triangles: Vec<Triangle> = order
            .iter()
            .map(|&t| Triangle { vertices: asset.mesh.triangles[t], material: asset.mesh.triangle_materials[t] })
            .collect();
        let corners: Vec<_> = order.iter().map(|&t| asset.mesh.triangle_positions(t)).collect();
        let bvh = FlatBvh::new(&corners);
        let blockers: Vec<Blocker> = bvh
            .triangle_order
            .iter()
            .map(|&triangle| {
                let [a, b, c] = corners[triangle as usize].map(|p| p.to_array());
                let material = &asset.materials[triangles[triangle as usize].material as usize];
                Blocker { a, triangle, b, masked: material.alpha_cutoff.is_some() as u32, c, _pad: 0 }
            })
            .collect();
        let pages = Pages::new(gpu, &asset.textures)?;
        let materials: Vec<GpuMaterial> = asset.materials.iter().map(|m| gpu_material(asset, &pages, m)).collect();
        let buffers = [
            gpu.storage("the mesh's vertices", &gpu_vertices(&asset.mesh))?,
            gpu.storage("the mesh's triangles", &triangles)?,
            gpu.storage("the materials", &materials)?,
            gpu.uniform("sRGB decoding", &srgb_table()),
            gpu.storage("the BVH's nodes", &bvh.nodes)?,
            gpu.storage("the BVH's triangles", &blockers)?,
        ];
        let extent = asset.mesh.bounds().diagonal();
        let frame = FrameUniforms { shadow_offset: extent * RELATIVE_OFFSET, extent, ..bytemuck::Zeroable::zeroed() };
        let frame_buffer = gpu.uniform("frame", &frame);
        let lights = gpu.storage::<GpuLight>("the lights", &[])?;
        let layout = layout(gpu);
        let bind_group = bind(gpu, &layout, &frame_buffer, &lights, &buffers, &pages);
        let emission = EmissionFacets::of(asset);
        Ok(Self { layout, bind_group, frame, frame_buffer, batches, buffers, pages, lights, emission })
    }

    /// Uploads what stands for `lights`.
    pub fn set_lights(&mut self, gpu: &Gpu, lights: &[Light]) -> Result<(), GpuError> {
        let entries = gpu_lights(lights, &self.emission);
        let bytes: &[u8] = bytemuck::cast_slice(&entries);
        if bytes.len() as u64 > self.lights.size() {
            self.lights = gpu.storage("the lights", &entries)?;
            self.bind_group = bind(gpu, &self.layout, &self.frame_buffer, &self.lights, &self.buffers, &self.pages);
        } else {
            gpu.queue.write_buffer(&self.lights, 0, bytes);
        }
        self.frame.light_count = entries.len() as u32;
        self.write_frame(gpu);
        Ok(())
    }

    /// Uploads [`Scene::frame`].
    pub fn write_frame(&self, gpu: &Gpu) {
        gpu.queue.write_buffer(&self.frame_buffer, 0, bytemuck::bytes_of(&self.frame));
    }
}

/// Triangles in the order they are drawn, and the batches that this makes: opaque ones first, one-sided ones first.
fn drawing_order(asset: &Asset) -> (Vec<usize>, Vec<Batch>) {
    let key = |t: usize| {
        let material = &asset.materials[asset.mesh.triangle_materials[t] as usize];
        (material.alpha_cutoff.is_some(), material.double_sided)
    };
    let mut order: Vec<usize> = (0..asset.mesh.triangles.len()).collect();
    order.sort_by_key(|&t| key(t));
    let mut first = 0;
    let batches = order
        .chunk_by(|&a, &b| key(a) == key(b))
        .map(|triangles| {
            let (masked, double_sided) = key(triangles[0]);
            let vertices = first..first + 3 * triangles.len() as u32;
            first = vertices.end;
            Batch { double_sided, masked, vertices }
        })
        .collect();
    (order, batches)
}

fn gpu_vertices(mesh: &Mesh) -> Vec<Vertex> {
    let uv = |set: &[Vec2], i: usize| set.get(i).copied().unwrap_or(Vec2::ZERO).to_array();
    (0..mesh.positions.len())
        .map(|i| Vertex {
            position: mesh.positions[i].to_array(),
            normal: mesh.normals[i].to_array(),
            colour: mesh.colours.get(i).map_or([1.0; 3], |c| c.to_array()),
            uv0: uv(&mesh.uvs[0], i),
            uv1: uv(&mesh.uvs[1], i),
            lightmap_uv: uv(&mesh.lightmap_uvs, i),
            ..bytemuck::Zeroable::zeroed()
        })
        .collect()
}

fn gpu_material(asset: &Asset, pages: &Pages, material: &Material) -> GpuMaterial {
    let texture_use = |reference: &Option<_>| pages.texture_use(&asset.textures, reference.as_ref());
    GpuMaterial {
        base_colour: material.base_colour.to_array(),
        emissive: material.emissive.to_array(),
        metallic: material.metallic,
        roughness: material.roughness,
        alpha_cutoff: material.alpha_cutoff.unwrap_or(-1.0),
        metallic_roughness: (material.reflectance == Reflectance::MetallicRoughness) as u32,
        _pad: 0,
        base_colour_texture: texture_use(&material.base_colour_texture),
        metallic_roughness_texture: texture_use(&material.metallic_roughness_texture),
        emissive_texture: texture_use(&material.emissive_texture),
    }
}

fn gpu_lights(lights: &[Light], emission: &EmissionFacets) -> Vec<GpuLight> {
    let table = LightTable::new(lights, emission);
    (0..table.len)
        .map(|i| {
            let entry = table.entry(i);
            GpuLight {
                position: entry.position.to_array(),
                local: entry.local,
                direction: entry.direction.to_array(),
                inverse_range4: entry.inverse_range4,
                radiant: table.colour(i).to_array(),
                cone_scale: entry.cone_scale,
                cone_offset: entry.cone_offset,
                lobe: entry.lobe,
                _pad: [0; 2],
            }
        })
        .collect()
}

fn layout(gpu: &Gpu) -> wgpu::BindGroupLayout {
    let pages = bindings::texture(wgpu::TextureSampleType::Uint, wgpu::TextureViewDimension::D2Array);
    // frame, lights, vertices, triangles, materials, textures, sRGB decoding, nodes, blockers
    let types = [UNIFORM, READ, READ, READ, READ, pages, UNIFORM, READ, READ];
    bindings::layout(gpu, "scene", wgpu::ShaderStages::VERTEX_FRAGMENT | wgpu::ShaderStages::COMPUTE, &types)
}

fn bind(
    gpu: &Gpu,
    layout: &wgpu::BindGroupLayout,
    frame: &wgpu::Buffer,
    lights: &wgpu::Buffer,
    [vertices, triangles, materials, srgb, nodes, blockers]: &[wgpu::Buffer; 6],
    pages: &Pages,
) -> wgpu::BindGroup {
    let resources = [
        frame.as_entire_binding(),
        lights.as_entire_binding(),
        vertices.as_entire_binding(),
        triangles.as_entire_binding(),
        materials.as_entire_binding(),
        wgpu::BindingResource::TextureView(&pages.view),
        srgb.as_entire_binding(),
        nodes.as_entire_binding(),
        blockers.as_entire_binding(),
    ];
    bindings::bind(gpu, "scene", layout, resources)
}
