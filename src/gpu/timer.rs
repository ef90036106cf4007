//! How long each pass takes, by the GPU's own clock.

use super::device::{Gpu, GpuError};
use super::shader::Stage;

/// Microseconds of each pass, in the order they run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PassTimes {
    pub measure: f64,
    pub downsample: f64,
    pub transfer: f64,
    pub reconstruct: f64,
    /// Depth and shading together.
    pub shade: f64,
    pub resolve: f64,
}

/// A beginning and an end for each [`Stage`].
pub struct Timer {
    queries: wgpu::QuerySet,
    ticks: wgpu::Buffer,
}

const QUERIES: u32 = 2 * Stage::ALL.len() as u32;

impl Timer {
    pub fn new(gpu: &Gpu) -> Self {
        let queries = gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("pass times"),
            ty: wgpu::QueryType::Timestamp,
            count: QUERIES,
        });
        let ticks = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("pass times"),
            size: QUERIES as u64 * size_of::<u64>() as u64,
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        Self { queries, ticks }
    }

    pub fn compute_pass(&self, stage: Stage) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * stage as u32),
            end_of_pass_write_index: Some(2 * stage as u32 + 1),
        }
    }

    /// The first half of [`Stage::Shade`].
    pub fn depth_pass(&self) -> wgpu::RenderPassTimestampWrites<'_> {
        wgpu::RenderPassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * Stage::Shade as u32),
            end_of_pass_write_index: None,
        }
    }

    /// The second half of [`Stage::Shade`].
    pub fn shade_pass(&self) -> wgpu::RenderPassTimestampWrites<'_> {
        wgpu::RenderPassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: None,
            end_of_pass_write_index: Some(2 * Stage::Shade as u32 + 1),
        }
    }

    /// Waits for the GPU; a pass that has not run yet took no time.
    pub fn read(&self, gpu: &Gpu) -> Result<PassTimes, GpuError> {
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        encoder.resolve_query_set(&self.queries, 0..QUERIES, &self.ticks, 0);
        gpu.queue.submit([encoder.finish()]);
        let ticks: Vec<u64> = gpu.download(&self.ticks, QUERIES as usize)?;
        let nanoseconds_per_tick = gpu.queue.get_timestamp_period() as f64;
        let microseconds = |stage: Stage| {
            let at = 2 * stage as usize;
            ticks[at + 1].saturating_sub(ticks[at]) as f64 * nanoseconds_per_tick * 1e-3
        };
        Ok(PassTimes {
            measure: microseconds(Stage::Measure),
            downsample: microseconds(Stage::Downsample),
            transfer: microseconds(Stage::Transfer),
            reconstruct: microseconds(Stage::Reconstruct),
            shade: microseconds(Stage::Shade),
            resolve: microseconds(Stage::Resolve),
        })
    }
}
