//! Pictures put together as they are shown: `shaders/display.wgsl`.

use eframe::wgpu;
use wgpu::util::DeviceExt;

/// What a side of the split shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum What {
    /// Relit.
    Picture,
    /// Path traced.
    Reference,
    /// Of the one from the other.
    Difference,
}

/// How the pictures are shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    pub exposure: f32,
    pub tone_curve: bool,
    /// Radiance that is the brightest of a difference's scale.
    pub difference: f32,
    /// Where the right side begins, 0 to 1.
    pub split: f32,
}

/// What there is to show.
pub struct Frame {
    /// Left and right.
    pub what: [What; 2],
    /// Radiance, each of any size.
    pub pictures: [wgpu::Texture; 2],
    /// Path traced.
    pub reference: wgpu::Texture,
    /// The first column of the right side.
    pub split: u32,
}

/// `shaders/display.wgsl`: Display.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Uniforms {
    size: [u32; 2],
    split: u32,
    tone_curve: u32,
    left: u32,
    right: u32,
    exposure: f32,
    difference: f32,
}

const DISPLAY: &str = include_str!("../../shaders/display.wgsl");
const SHOWN: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

pub struct Display {
    pipeline: wgpu::ComputePipeline,
}

impl Display {
    pub fn new(device: &wgpu::Device) -> Self {
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("display"),
            source: wgpu::ShaderSource::Wgsl(DISPLAY.into()),
        });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("display"),
            layout: Some(&pipeline_layout(device)),
            module: &module,
            entry_point: Some("show"),
            compilation_options: Default::default(),
            cache: None,
        });
        Self { pipeline }
    }

    /// A texture to show in.
    pub fn output(device: &wgpu::Device, [width, height]: [u32; 2]) -> wgpu::Texture {
        device.create_texture(&wgpu::TextureDescriptor {
            label: Some("display"),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: SHOWN,
            usage: wgpu::TextureUsages::STORAGE_BINDING
                | wgpu::TextureUsages::TEXTURE_BINDING
                | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        })
    }

    /// Fills `output`.
    pub fn show(&self, device: &wgpu::Device, queue: &wgpu::Queue, frame: &Frame, look: &Look, output: &wgpu::Texture) {
        let size = [output.width(), output.height()];
        let uniforms = Uniforms {
            size,
            split: frame.split,
            tone_curve: look.tone_curve as u32,
            left: frame.what[0] as u32,
            right: frame.what[1] as u32,
            exposure: look.exposure,
            difference: look.difference.max(f32::MIN_POSITIVE),
        };
        let uniforms = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("display"),
            contents: bytemuck::bytes_of(&uniforms),
            usage: wgpu::BufferUsages::UNIFORM,
        });
        let textures = [&frame.pictures[0], &frame.pictures[1], &frame.reference, output];
        let views = textures.map(|texture| texture.create_view(&Default::default()));
        let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        let texture = |i: usize| entry(i as u32 + 1, wgpu::BindingResource::TextureView(&views[i]));
        let bind_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("display"),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &[entry(0, uniforms.as_entire_binding()), texture(0), texture(1), texture(2), texture(3)],
        });
        let mut encoder = device.create_command_encoder(&Default::default());
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &bind_group, &[]);
        pass.dispatch_workgroups(size[0].div_ceil(8), size[1].div_ceil(8), 1);
        drop(pass);
        queue.submit([encoder.finish()]);
    }
}

/// 32-bit floats are not filterable everywhere, which a layout that follows from the shader would ask for.
fn pipeline_layout(device: &wgpu::Device) -> wgpu::PipelineLayout {
    let picture = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Float { filterable: false },
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let uniforms = wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Uniform,
        has_dynamic_offset: false,
        min_binding_size: None,
    };
    let shown = wgpu::BindingType::StorageTexture {
        access: wgpu::StorageTextureAccess::WriteOnly,
        format: SHOWN,
        view_dimension: wgpu::TextureViewDimension::D2,
    };
    let entries: Vec<_> = [uniforms, picture, picture, picture, shown]
        .into_iter()
        .zip(0..)
        .map(|(ty, binding)| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty,
            count: None,
        })
        .collect();
    let layout =
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("display"), entries: &entries });
    device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("display"),
        bind_group_layouts: &[Some(&layout)],
        immediate_size: 0,
    })
}
