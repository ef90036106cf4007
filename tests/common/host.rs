//! An application of its own: its device, its encoder, its shader, which asks for indirect light.

use glam::Vec2;
use relight::gpu::{Gpu, Relighter};
use relight::math::Rgb;
use wgpu::util::DeviceExt;

/// What a host's shader makes of `indirect_irradiance`: one answer for each question.
const ASK: &str = "
@group(0) @binding(0) var<storage, read> questions: array<vec2f>;
@group(0) @binding(1) var<storage, read_write> answers: array<vec4f>;

@compute @workgroup_size(64)
fn ask(@builtin(global_invocation_id) id: vec3u) {
    if id.x < arrayLength(&questions) {
        answers[id.x] = vec4f(indirect_irradiance(questions[id.x]), 1.0);
    }
}";

pub struct Host {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
}

impl Host {
    /// A device with no feature and WebGPU's default limits. A mistake in the use of wgpu panics: that is the default handler.
    pub fn new() -> Self {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
        let adapter = pollster::block_on(instance.request_adapter(&Default::default())).unwrap();
        let descriptor = wgpu::DeviceDescriptor { required_limits: wgpu::Limits::default(), ..Default::default() };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor)).unwrap();
        Self { device, queue }
    }

    pub fn gpu(&self) -> Gpu {
        Gpu::of_host(&self.device, &self.queue)
    }

    /// Runs the relighter's passes and then a shader of the host's that looks its light up at `uvs`, all in one encoder.
    pub fn look_up(&self, relighter: &Relighter, uvs: &[Vec2]) -> Vec<Rgb> {
        let device = &self.device;
        let types = [true, false].map(|read_only| wgpu::BufferBindingType::Storage { read_only });
        let entries: Vec<_> = (0..)
            .zip(types)
            .map(|(binding, ty)| wgpu::BindGroupLayoutEntry {
                binding,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
                count: None,
            })
            .collect();
        let own = device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("questions"), entries: &entries });
        // The relighter's group is the third, to show that any will do.
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            bind_group_layouts: &[Some(&own), None, Some(relighter.bind_group_layout())],
            ..Default::default()
        });
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("host"),
            source: wgpu::ShaderSource::Wgsl(format!("{}{ASK}", relighter.wgsl(2)).into()),
        });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("host"),
            layout: Some(&layout),
            module: &module,
            entry_point: Some("ask"),
            compilation_options: Default::default(),
            cache: None,
        });
        let buffer = |contents: &[u8], usage| {
            let usage = usage | wgpu::BufferUsages::STORAGE;
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: None, contents, usage })
        };
        let questions = buffer(bytemuck::cast_slice(uvs), wgpu::BufferUsages::empty());
        let answers = buffer(&vec![0; 16 * uvs.len()], wgpu::BufferUsages::COPY_SRC);
        let entries: Vec<_> = (0..)
            .zip([&questions, &answers])
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        let group =
            device.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout: &own, entries: &entries });
        let mut encoder = device.create_command_encoder(&Default::default());
        relighter.encode(&mut encoder);
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.set_bind_group(2, relighter.bind_group(), &[]);
        pass.dispatch_workgroups(uvs.len().div_ceil(64) as u32, 1, 1);
        drop(pass);
        self.queue.submit([encoder.finish()]);
        self.colours(&answers, uvs.len())
    }

    /// The first `count` colours of a buffer of vec4.
    pub fn colours(&self, buffer: &wgpu::Buffer, count: usize) -> Vec<Rgb> {
        let values: Vec<[f32; 4]> = self.gpu().download(buffer, count).unwrap();
        values.into_iter().map(|[r, g, b, _]| Rgb::new(r, g, b)).collect()
    }

    /// Writes colours into a buffer of vec4.
    pub fn write(&self, buffer: &wgpu::Buffer, colours: &[Rgb]) {
        self.queue.write_buffer(buffer, 0, bytemuck::cast_slice(&padded(colours)));
    }

    /// A texture as wide as [`relight::gpu::PointTextures`] that holds these colours, as a host's own pass would leave it.
    pub fn shaded(&self, like: &wgpu::Texture, colours: &[Rgb]) -> wgpu::Texture {
        let usage = wgpu::TextureUsages::COPY_SRC | wgpu::TextureUsages::COPY_DST;
        let texture = self.gpu().texture("shaded", like.size(), wgpu::TextureFormat::Rgba32Float, usage);
        let mut texels = padded(colours);
        texels.resize((like.width() * like.height()) as usize, [f32::NAN; 4]);
        let layout =
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(16 * like.width()), rows_per_image: None };
        self.queue.write_texture(texture.as_image_copy(), bytemuck::cast_slice(&texels), layout, like.size());
        texture
    }
}

fn padded(colours: &[Rgb]) -> Vec<[f32; 4]> {
    colours.iter().map(|c| c.extend(0.0).to_array()).collect()
}
