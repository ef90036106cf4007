//! From lights to basis coefficients: the measure, downsample and transfer stages.

use super::bindings::{self, READ, READ_WRITE, UNIFORM};
use super::device::{Gpu, GpuError};
use super::layout::{SubPoint, TransferShape};
use super::point_textures::PointTextures;
use super::scene::Scene;
use super::shader::{Lookup, Stage};
use super::timer::Timer;
use crate::model::{Channels, Model, Transfer};

/// One compute stage and what it reads and writes.
struct Dispatch {
    pipeline: wgpu::ComputePipeline,
    bind_group: wgpu::BindGroup,
    /// Whether it traces rays: bind group 0 is then the scene's.
    traces: bool,
    workgroups: u32,
}

pub struct Measurement {
    /// Absent where there is no scene to trace rays against.
    measure: Option<Dispatch>,
    downsample: Dispatch,
    transfer: Dispatch,
    /// W/m², one vec4 a sub-point; whole rows of [`PointTextures`].
    pub exitance: wgpu::Buffer,
    /// x, W/m², one vec4 a point.
    pub direct: wgpu::Buffer,
    /// u, one vec4 an element, padded with zeros by as many as a layer of the basis has.
    pub coefficients: wgpu::Buffer,
}

/// Invocations of a workgroup in `measure.wgsl` and `downsample.wgsl`.
const WORKGROUP: usize = 64;

impl Measurement {
    pub fn new(gpu: &Gpu, model: &Model, scene: Option<&Scene>) -> Result<Self, GpuError> {
        let points = &model.points;
        let transfer = &model.transfer;
        let sub_points: Vec<SubPoint> = points
            .sub_points
            .iter()
            .map(|p| SubPoint {
                position: p.position.to_array(),
                normal: p.normal.to_array(),
                geometric_normal: p.geometric_normal.to_array(),
                albedo: p.albedo.to_array(),
                ..bytemuck::Zeroable::zeroed()
            })
            .collect();
        let shape = TransferShape {
            points: transfer.points as u32,
            interleaved: (transfer.channels == Channels::Multi) as u32,
            mean_scaled_by_norm: transfer.mean_scaled_by_norm as u32,
            inverse_gamma: 1.0 / transfer.gamma,
            scale: transfer.scale(),
        };
        let sub_point_buffer = gpu.storage("the sub-points", &sub_points)?;
        let neighbours = gpu.storage("the sub-points' neighbours", &points.neighbours)?;
        let matrix = gpu.storage("the transfer matrix", &packed_matrix(transfer))?;
        let shape = gpu.uniform("transfer shape", &shape);
        let exitance =
            gpu.written::<[f32; 4]>("the sub-points' light", PointTextures::texels(points.sub_points.len()))?;
        let direct = gpu.written::<[f32; 4]>("the direct vector", points.points.len())?;
        let padded = transfer.elements + model.basis.elements_per_layer();
        let coefficients = gpu.written::<[f32; 4]>("the coefficients", padded)?;

        let layout = |stage: Stage, types| bindings::layout(gpu, stage.name(), wgpu::ShaderStages::COMPUTE, types);
        let workgroups = |count: usize| count.div_ceil(WORKGROUP) as u32;

        let pipeline = |stage: Stage, groups: &[&wgpu::BindGroupLayout]| {
            bindings::compute_pipeline(gpu, stage, stage.source(&model.basis, Lookup::Texture), groups)
        };

        let own = layout(Stage::Measure, &[READ, READ_WRITE]);
        let resources = [sub_point_buffer.as_entire_binding(), exitance.as_entire_binding()];
        let measure = scene.map(|scene| Dispatch {
            pipeline: pipeline(Stage::Measure, &[&scene.layout, &own]),
            bind_group: bindings::bind(gpu, "measure", &own, resources),
            traces: true,
            workgroups: workgroups(sub_points.len()),
        });
        let own = layout(Stage::Downsample, &[READ, READ, READ_WRITE]);
        let resources = [exitance.as_entire_binding(), neighbours.as_entire_binding(), direct.as_entire_binding()];
        let downsample = Dispatch {
            pipeline: pipeline(Stage::Downsample, &[&own]),
            bind_group: bindings::bind(gpu, "downsample", &own, resources),
            traces: false,
            workgroups: workgroups(points.points.len()),
        };
        let own = layout(Stage::Transfer, &[UNIFORM, READ, READ, READ_WRITE]);
        let resources = [
            shape.as_entire_binding(),
            matrix.as_entire_binding(),
            direct.as_entire_binding(),
            coefficients.as_entire_binding(),
        ];
        let transfer = Dispatch {
            pipeline: pipeline(Stage::Transfer, &[&own]),
            bind_group: bindings::bind(gpu, "transfer", &own, resources),
            traces: false,
            workgroups: transfer.elements as u32,
        };
        Ok(Self { measure, downsample, transfer, exitance, direct, coefficients })
    }

    /// Records one of [`Stage::Measure`], [`Stage::Downsample`] and [`Stage::Transfer`].
    pub fn encode(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        stage: Stage,
        scene: Option<&Scene>,
        timer: Option<&Timer>,
    ) {
        let dispatch = match stage {
            Stage::Measure => self.measure.as_ref().expect("rays are traced where there is a scene"),
            Stage::Downsample => &self.downsample,
            _ => &self.transfer,
        };
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(stage.name()),
            timestamp_writes: timer.map(|timer| timer.compute_pass(stage)),
        });
        pass.set_pipeline(&dispatch.pipeline);
        if let Some(scene) = scene.filter(|_| dispatch.traces) {
            pass.set_bind_group(0, &scene.bind_group, &[]);
        }
        pass.set_bind_group(dispatch.traces as u32, &dispatch.bind_group, &[]);
        pass.dispatch_workgroups(dispatch.workgroups, 1, 1);
    }
}

/// M over its scale, `[element][channel][pair of points]`, which serves mono and multi alike: u is Σ M ⊙ x, summed over channels for
/// multi. Two halves a word; an odd last point has a zero beside it.
fn packed_matrix(transfer: &Transfer) -> Vec<u32> {
    let halves = transfer.halves();
    let points = transfer.points;
    let half = |element: usize, channel: usize, point: usize| -> u32 {
        if point >= points {
            return 0;
        }
        let value = match transfer.channels {
            Channels::Mono => halves[channel][element * points + point],
            Channels::Multi => halves[0][3 * (element * points + point) + channel],
        };
        value.to_bits() as u32
    };
    let rows = (0..transfer.elements).flat_map(|element| (0..3).map(move |channel| (element, channel)));
    let words = rows.flat_map(|row| (0..points.div_ceil(2)).map(move |pair| (row, 2 * pair)));
    words.map(|((e, c), point)| half(e, c, point) | half(e, c, point + 1) << 16).collect()
}
