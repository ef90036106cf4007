//! From indirect light over the lightmap to a picture: rasterise, shade, resolve.
//!
//! Depth is drawn first, so that the shading that follows traces shadow rays for visible samples alone.

use super::bindings;
use super::device::{Gpu, GpuError};
use super::scene::{Batch, Scene};
use super::shader::{Lookup, Stage};
use super::timer::Timer;
use crate::model::Basis;

/// Radiance is kept in f32: a picture written as OpenEXR loses nothing.
const RADIANCE: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Float;
pub const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Side of a workgroup in `resolve.wgsl`.
const TILE: u32 = 8;

pub struct Shading {
    /// `[double_sided][masked]`
    depth: [[wgpu::RenderPipeline; 2]; 2],
    /// `[double_sided]`
    shade: [wgpu::RenderPipeline; 2],
    resolve: wgpu::ComputePipeline,
    resolve_layout: wgpu::BindGroupLayout,
    target: Option<Target>,
}

/// What one size of picture is drawn into.
struct Target {
    samples_size: [u32; 2],
    depth: wgpu::TextureView,
    samples: wgpu::TextureView,
    picture: wgpu::Texture,
    resolve: wgpu::BindGroup,
}

impl Shading {
    pub fn new(gpu: &Gpu, scene: &Scene, basis: &Basis, lookup: Lookup, indirect: &wgpu::BindGroupLayout) -> Self {
        let pipelines = Pipelines {
            gpu,
            module: bindings::module(gpu, Stage::Shade, Stage::Shade.source(basis, lookup)),
            layout: bindings::pipeline_layout(gpu, "shade", &[&scene.layout, indirect]),
        };

        let unfilterable = wgpu::TextureSampleType::Float { filterable: false };
        let types = [
            bindings::texture(unfilterable, wgpu::TextureViewDimension::D2),
            wgpu::BindingType::StorageTexture {
                access: wgpu::StorageTextureAccess::WriteOnly,
                format: RADIANCE,
                view_dimension: wgpu::TextureViewDimension::D2,
            },
        ];
        let resolve_layout = bindings::layout(gpu, "resolve", wgpu::ShaderStages::COMPUTE, &types);
        Self {
            depth: [false, true].map(|double_sided| [false, true].map(|masked| pipelines.depth(double_sided, masked))),
            shade: [false, true].map(|double_sided| pipelines.shade(double_sided, "shade", RADIANCE)),
            resolve: bindings::compute_pipeline(
                gpu,
                Stage::Resolve,
                Stage::Resolve.source(basis, lookup),
                &[&scene.layout, &resolve_layout],
            ),
            resolve_layout,
            target: None,
        }
    }

    /// Records a picture of `size` pixels with `samples_per_axis`; returns the texture that will hold it.
    #[expect(clippy::too_many_arguments, reason = "one of each kind")]
    pub fn encode(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        scene: &Scene,
        indirect: &wgpu::BindGroup,
        size: [u32; 2],
        samples_per_axis: u32,
        timer: Option<&Timer>,
    ) -> Result<&wgpu::Texture, GpuError> {
        let samples_size = size.map(|side| side * samples_per_axis);
        let fits = |t: &Target| t.samples_size == samples_size && t.picture.width() == size[0];
        if !self.target.as_ref().is_some_and(fits) {
            self.target = None;
            self.target = Some(Target::new(gpu, &self.resolve_layout, size, samples_size)?);
        }
        let target = self.target.as_ref().expect("made above");

        self.draw(encoder, scene, indirect, target, timer);

        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("resolve"),
            timestamp_writes: timer.map(|timer| timer.compute_pass(Stage::Resolve)),
        });
        pass.set_pipeline(&self.resolve);
        pass.set_bind_group(0, &scene.bind_group, &[]);
        pass.set_bind_group(1, &target.resolve, &[]);
        pass.dispatch_workgroups(size[0].div_ceil(TILE), size[1].div_ceil(TILE), 1);
        Ok(&target.picture)
    }

    /// What was drawn last.
    pub fn picture(&self) -> Option<&wgpu::Texture> {
        self.target.as_ref().map(|target| &target.picture)
    }

    fn draw(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &Scene,
        indirect: &wgpu::BindGroup,
        target: &Target,
        timer: Option<&Timer>,
    ) {
        let depth_ops = wgpu::Operations {
            // Infinitely far.
            load: wgpu::LoadOp::Clear(0.0),
            store: wgpu::StoreOp::Store,
        };
        let depth_attachment =
            |depth_ops| wgpu::RenderPassDepthStencilAttachment { view: &target.depth, depth_ops, stencil_ops: None };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("depth"),
            depth_stencil_attachment: Some(depth_attachment(Some(depth_ops))),
            timestamp_writes: timer.map(Timer::depth_pass),
            ..Default::default()
        });
        draw_batches(&mut pass, scene, indirect, |batch| {
            &self.depth[batch.double_sided as usize][batch.masked as usize]
        });
        drop(pass);

        let colour = wgpu::RenderPassColorAttachment {
            view: &target.samples,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store },
        };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shade"),
            color_attachments: &[Some(colour)],
            // Read only.
            depth_stencil_attachment: Some(depth_attachment(None)),
            timestamp_writes: timer.map(Timer::shade_pass),
            ..Default::default()
        });
        draw_batches(&mut pass, scene, indirect, |batch| &self.shade[batch.double_sided as usize]);
    }
}

pub fn draw_batches<'p>(
    pass: &mut wgpu::RenderPass,
    scene: &Scene,
    indirect: &wgpu::BindGroup,
    pipeline_of: impl Fn(&Batch) -> &'p wgpu::RenderPipeline,
) {
    pass.set_bind_group(0, &scene.bind_group, &[]);
    pass.set_bind_group(1, indirect, &[]);
    for batch in &scene.batches {
        pass.set_pipeline(pipeline_of(batch));
        pass.draw(batch.vertices.clone(), 0..1);
    }
}

impl Target {
    fn new(
        gpu: &Gpu,
        resolve_layout: &wgpu::BindGroupLayout,
        size: [u32; 2],
        samples_size: [u32; 2],
    ) -> Result<Self, GpuError> {
        gpu.check_target(samples_size)?;
        let extent = |[width, height]: [u32; 2]| wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
        let attachment = wgpu::TextureUsages::RENDER_ATTACHMENT;
        let readable = wgpu::TextureUsages::TEXTURE_BINDING;
        let depth = gpu.texture("depth", extent(samples_size), DEPTH, attachment);
        let samples = gpu.texture("samples", extent(samples_size), RADIANCE, attachment | readable);
        let written = wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_SRC;
        let picture = gpu.texture("picture", extent(size), RADIANCE, written | readable);
        let view = |texture: &wgpu::Texture| texture.create_view(&Default::default());
        let (samples, picture_view) = (view(&samples), view(&picture));
        let resources =
            [wgpu::BindingResource::TextureView(&samples), wgpu::BindingResource::TextureView(&picture_view)];
        let resolve = bindings::bind(gpu, "resolve", resolve_layout, resources);
        Ok(Self { samples_size, depth: view(&depth), samples, picture, resolve })
    }
}

/// What the pipelines of `shade.wgsl` have in common.
pub struct Pipelines<'a> {
    pub gpu: &'a Gpu,
    pub module: wgpu::ShaderModule,
    pub layout: wgpu::PipelineLayout,
}

impl Pipelines<'_> {
    pub fn depth(&self, double_sided: bool, masked: bool) -> wgpu::RenderPipeline {
        let cut_out = masked.then_some("cut_out");
        self.pipeline(double_sided, wgpu::CompareFunction::Greater, cut_out, &[])
    }

    /// Shades what is visible, by the entry point `fragment`, into `format`.
    pub fn shade(&self, double_sided: bool, fragment: &str, format: wgpu::TextureFormat) -> wgpu::RenderPipeline {
        self.pipeline(double_sided, wgpu::CompareFunction::Equal, Some(fragment), &[Some(format.into())])
    }

    fn pipeline(
        &self,
        double_sided: bool,
        depth_compare: wgpu::CompareFunction,
        fragment: Option<&str>,
        targets: &[Option<wgpu::ColorTargetState>],
    ) -> wgpu::RenderPipeline {
        self.gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(fragment.unwrap_or("depth")),
            layout: Some(&self.layout),
            vertex: wgpu::VertexState {
                module: &self.module,
                entry_point: Some("place"),
                compilation_options: Default::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState {
                front_face: wgpu::FrontFace::Ccw,
                cull_mode: (!double_sided).then_some(wgpu::Face::Back),
                ..Default::default()
            },
            depth_stencil: Some(wgpu::DepthStencilState {
                format: DEPTH,
                depth_write_enabled: Some(depth_compare == wgpu::CompareFunction::Greater),
                depth_compare: Some(depth_compare),
                stencil: Default::default(),
                bias: Default::default(),
            }),
            multisample: Default::default(),
            fragment: fragment.map(|entry_point| wgpu::FragmentState {
                module: &self.module,
                entry_point: Some(entry_point),
                compilation_options: Default::default(),
                targets,
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}
