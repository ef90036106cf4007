//! Bind groups, their layouts and pipelines, with bindings counted from 0 where they are not numbered.

use super::device::Gpu;
use super::shader::Stage;

pub const UNIFORM: wgpu::BindingType = buffer(wgpu::BufferBindingType::Uniform);
pub const READ: wgpu::BindingType = buffer(wgpu::BufferBindingType::Storage { read_only: true });
pub const READ_WRITE: wgpu::BindingType = buffer(wgpu::BufferBindingType::Storage { read_only: false });

const fn buffer(ty: wgpu::BufferBindingType) -> wgpu::BindingType {
    wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None }
}

pub const fn texture(
    sample_type: wgpu::TextureSampleType,
    view_dimension: wgpu::TextureViewDimension,
) -> wgpu::BindingType {
    wgpu::BindingType::Texture { sample_type, view_dimension, multisampled: false }
}

pub fn layout(
    gpu: &Gpu,
    label: &str,
    visibility: wgpu::ShaderStages,
    types: &[wgpu::BindingType],
) -> wgpu::BindGroupLayout {
    let numbered: Vec<_> = (0..).zip(types.iter().copied()).collect();
    numbered_layout(gpu, label, visibility, &numbered)
}

pub fn numbered_layout(
    gpu: &Gpu,
    label: &str,
    visibility: wgpu::ShaderStages,
    types: &[(u32, wgpu::BindingType)],
) -> wgpu::BindGroupLayout {
    let entries: Vec<_> = types
        .iter()
        .map(|&(binding, ty)| wgpu::BindGroupLayoutEntry { binding, visibility, ty, count: None })
        .collect();
    gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries })
}

pub fn bind<const N: usize>(
    gpu: &Gpu,
    label: &str,
    layout: &wgpu::BindGroupLayout,
    resources: [wgpu::BindingResource; N],
) -> wgpu::BindGroup {
    bind_numbered(gpu, label, layout, (0..).zip(resources))
}

pub fn bind_numbered<'r>(
    gpu: &Gpu,
    label: &str,
    layout: &wgpu::BindGroupLayout,
    resources: impl IntoIterator<Item = (u32, wgpu::BindingResource<'r>)>,
) -> wgpu::BindGroup {
    let entries: Vec<_> =
        resources.into_iter().map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(label), layout, entries: &entries })
}

pub fn module(gpu: &Gpu, stage: Stage, source: String) -> wgpu::ShaderModule {
    gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(stage.name()),
        source: wgpu::ShaderSource::Wgsl(source.into()),
    })
}

pub fn pipeline_layout(gpu: &Gpu, label: &str, groups: &[&wgpu::BindGroupLayout]) -> wgpu::PipelineLayout {
    let groups: Vec<_> = groups.iter().map(|&group| Some(group)).collect();
    gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(label),
        bind_group_layouts: &groups,
        immediate_size: 0,
    })
}

/// The compute pipeline of a stage, whose entry point has the stage's name.
pub fn compute_pipeline(
    gpu: &Gpu,
    stage: Stage,
    source: String,
    groups: &[&wgpu::BindGroupLayout],
) -> wgpu::ComputePipeline {
    gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(stage.name()),
        layout: Some(&pipeline_layout(gpu, stage.name(), groups)),
        module: &module(gpu, stage, source),
        entry_point: Some(stage.name()),
        compilation_options: Default::default(),
        cache: None,
    })
}
