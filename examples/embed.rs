//! A plain wgpu program that draws an asset with its own shader and takes the indirect light from a trained model:
//! `cargo run --release --no-default-features --features gpu --example embed -- out/cornell.relight out/embed.png`

use std::error::Error;
use std::path::Path;

use glam::Vec3;
use relight::gpu::{Gpu, Lookup, Measure, Relighter, Settings};
use relight::light::Light;
use relight::model::{Model, Picture, View};
use relight::scene::Camera;
use wgpu::util::DeviceExt;

/// The host's own shading; a real one would have shadow maps. `indirect_irradiance` is relight's.
const SHADER: &str = "
struct Frame { @location(4) x: vec4f, @location(5) y: vec4f, @location(6) z: vec4f, @location(7) w: vec4f,
    @location(8) light: vec3f, @location(9) axis: vec3f }
struct Corner { @location(0) at: vec3f, @location(1) normal: vec3f, @location(2) albedo: vec3f, @location(3) uv: vec2f }
struct Fragment { @builtin(position) clip: vec4f, @location(0) at: vec3f, @location(1) normal: vec3f,
    @location(2) albedo: vec3f, @location(3) lightmap_uv: vec2f,
    @location(4) @interpolate(flat) light: vec3f, @location(5) @interpolate(flat) axis: vec3f }

@vertex fn place(in: Corner, frame: Frame) -> Fragment {
    let clip = mat4x4f(frame.x, frame.y, frame.z, frame.w) * vec4f(in.at, 1.0);
    return Fragment(clip, in.at, in.normal, in.albedo, in.uv, frame.light, frame.axis);
}

@fragment fn shade(in: Fragment) -> @location(0) vec4f {
    let to_light = in.light - in.at;
    let cone = saturate((dot(-normalize(to_light), in.axis) - 0.8253356) / (1.0 - 0.8253356));
    let cosine = max(dot(normalize(in.normal), normalize(to_light)), 0.0);
    let direct = cone * cone * cosine / dot(to_light, to_light);
    return vec4f(in.albedo / 3.14159265 * (direct + indirect_irradiance(in.lightmap_uv)), 1.0);
}";

const COLOUR: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Float;
const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
const SIZE: wgpu::Extent3d = wgpu::Extent3d { width: 768, height: 768, depth_or_array_layers: 1 };

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, model, png] = &arguments[..] else { return Err("usage: embed MODEL PNG".into()) };
    let model = Model::load(Path::new(model))?;

    // The host's device, with WebGPU's default limits.
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
    let adapter = pollster::block_on(instance.request_adapter(&Default::default()))?;
    let (device, queue) = pollster::block_on(adapter.request_device(&Default::default()))?;
    let (gpu, wgpu::Extent3d { width, height, .. }) = (Gpu::of_host(&device, &queue), SIZE);

    let lookup = Lookup::cheaper(&model.basis, (width * height) as usize);
    let mut relighter = Relighter::new(&device, &queue, &model, Settings { measure: Measure::Rays, lookup })?;

    // The host's mesh: position, normal, albedo, lightmap coordinates.
    let (asset, mut vertices) = (&model.asset, Vec::<f32>::new());
    for (triangle, corners) in asset.mesh.triangles.iter().enumerate() {
        let material = &asset.materials[asset.mesh.triangle_materials[triangle] as usize];
        for (&corner, (u, v)) in corners.iter().zip([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]) {
            let (mesh, at) = (&asset.mesh, corner as usize);
            let albedo = asset.base_colour(material, triangle, u, v).truncate();
            vertices.extend_from_slice(bytemuck::cast_slice(&[mesh.positions[at], mesh.normals[at], albedo]));
            vertices.extend(mesh.lightmap_uvs[at].to_array());
        }
    }
    let buffer = |contents: &[f32]| {
        let (contents, usage) = (bytemuck::cast_slice(contents), wgpu::BufferUsages::VERTEX);
        device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: None, contents, usage })
    };
    let vertices = buffer(&vertices);

    // A spot light at one side of the asset that shines at the other.
    let bounds = asset.mesh.bounds();
    let (centre, size) = (bounds.centre(), bounds.max - bounds.min);
    let position = centre + size * Vec3::new(-0.25, 0.3, -0.45);
    let direction = (centre + size * Vec3::new(0.5, 0.1, 0.0) - position).normalize();
    let camera = asset.cameras.first().cloned().unwrap_or_else(|| Camera::that_sees(&bounds));
    let clip_from_world = View::new(camera, width, height).pinhole()?.clip_from_world(0.01);
    let frame = buffer(&[&clip_from_world.to_cols_array()[..], &position.to_array(), &direction.to_array()].concat());

    // The host's pipeline, with relight's function before its own code and relight's bind group as its own group 0.
    let source = wgpu::ShaderSource::Wgsl(format!("{}{SHADER}", relighter.wgsl(0)).into());
    let module = &device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source });
    let bind_group_layouts = &[Some(relighter.bind_group_layout())];
    let layout = wgpu::PipelineLayoutDescriptor { bind_group_layouts, ..Default::default() };
    let layout = device.create_pipeline_layout(&layout);
    let of_corner = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3, 2 => Float32x3, 3 => Float32x2];
    let of_frame = wgpu::vertex_attr_array![
        4 => Float32x4, 5 => Float32x4, 6 => Float32x4, 7 => Float32x4, 8 => Float32x3, 9 => Float32x3];
    let stream =
        |array_stride, step_mode, attributes| Some(wgpu::VertexBufferLayout { array_stride, step_mode, attributes });
    let corners = stream(44, wgpu::VertexStepMode::Vertex, &of_corner[..]);
    let buffers = &[corners, stream(88, wgpu::VertexStepMode::Instance, &of_frame[..])];
    let (entry_point, targets) = (None, &[Some(COLOUR.into())]);
    let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: None,
        layout: Some(&layout),
        vertex: wgpu::VertexState { module, entry_point, compilation_options: Default::default(), buffers },
        primitive: wgpu::PrimitiveState { cull_mode: Some(wgpu::Face::Back), ..Default::default() },
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: Default::default(),
            bias: Default::default(),
        }),
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState { module, entry_point, compilation_options: Default::default(), targets }),
        multiview_mask: None,
        cache: None,
    });

    // One frame: the light is set, relight's passes go into the host's encoder, and the host draws.
    let (color, range, inner_cone_angle, outer_cone_angle) = (Vec3::ONE, None, 0.0, 0.8253356f32.acos());
    let spot = Light::Spot { position, direction, color, intensity: 1.0, range, inner_cone_angle, outer_cone_angle };
    relighter.set_lights(&[spot])?;
    let mut encoder = device.create_command_encoder(&Default::default());
    relighter.encode(&mut encoder);

    let drawn = wgpu::TextureUsages::RENDER_ATTACHMENT;
    let picture = gpu.texture("picture", SIZE, COLOUR, drawn | wgpu::TextureUsages::COPY_SRC);
    let depth = gpu.texture("depth", SIZE, DEPTH, drawn);
    let [view, depth] = [&picture, &depth].map(|texture| texture.create_view(&Default::default()));
    let colour = wgpu::RenderPassColorAttachment {
        view: &view,
        depth_slice: None,
        resolve_target: None,
        ops: Default::default(),
    };
    let depth_ops = Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Discard });
    let depth = wgpu::RenderPassDepthStencilAttachment { view: &depth, depth_ops, stencil_ops: None };
    let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        color_attachments: &[Some(colour)],
        depth_stencil_attachment: Some(depth),
        ..Default::default()
    });
    pass.set_pipeline(&pipeline);
    pass.set_bind_group(0, relighter.bind_group(), &[]);
    pass.set_vertex_buffer(0, vertices.slice(..));
    pass.set_vertex_buffer(1, frame.slice(..));
    pass.draw(0..3 * asset.mesh.triangles.len() as u32, 0..1);
    drop(pass);
    queue.submit([encoder.finish()]);
    let picture = Picture { width, height, pixels: gpu.read_texture(&picture)? };
    let pixels = picture.srgb8(5.0 * size.length_squared());
    image::save_buffer(png, pixels.as_flattened(), width, height, image::ColorType::Rgb8)?;
    println!("wrote {png}: {lookup:?} lookup on {}", adapter.get_info().name);
    Ok(())
}
