//! How long each pass takes, by the GPU's own clock.

use std::cell::{Cell, RefCell};

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

/// A beginning and an end for each [`Stage`] of each of some frames.
pub struct Timer {
    queries: wgpu::QuerySet,
    ticks: wgpu::Buffer,
    /// The frame that passes are recorded for.
    pub frame: Cell<u32>,
    /// Whether each pass of each frame was recorded since the last [`Timer::read`]: only what is written may be read.
    recorded: RefCell<Vec<bool>>,
}

const STAGES: u32 = Stage::ALL.len() as u32;

/// Ticks in the alignment of a resolved range.
const ALIGNMENT: u64 = wgpu::QUERY_RESOLVE_BUFFER_ALIGNMENT / size_of::<u64>() as u64;

impl Timer {
    pub fn new(gpu: &Gpu, frames: u32) -> Self {
        let passes = frames * STAGES;
        let queries = gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("pass times"),
            ty: wgpu::QueryType::Timestamp,
            count: 2 * passes,
        });
        let ticks = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("pass times"),
            size: passes as u64 * wgpu::QUERY_RESOLVE_BUFFER_ALIGNMENT,
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        Self { queries, ticks, frame: Cell::new(0), recorded: RefCell::new(vec![false; passes as usize]) }
    }

    /// The first query of a stage in the present frame.
    fn record(&self, stage: Stage) -> u32 {
        let pass = self.frame.get() * STAGES + stage as u32;
        self.recorded.borrow_mut()[pass as usize] = true;
        2 * pass
    }

    pub fn compute_pass(&self, stage: Stage) -> wgpu::ComputePassTimestampWrites<'_> {
        let first = self.record(stage);
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        }
    }

    /// The first half of [`Stage::Shade`].
    pub fn depth_pass(&self) -> wgpu::RenderPassTimestampWrites<'_> {
        self.render_pass(true, false)
    }

    /// The second half of [`Stage::Shade`].
    pub fn shade_pass(&self) -> wgpu::RenderPassTimestampWrites<'_> {
        self.render_pass(false, true)
    }

    /// [`Stage::Shade`] in one pass.
    pub fn only_shade_pass(&self) -> wgpu::RenderPassTimestampWrites<'_> {
        self.render_pass(true, true)
    }

    fn render_pass(&self, begins: bool, ends: bool) -> wgpu::RenderPassTimestampWrites<'_> {
        let first = self.record(Stage::Shade);
        wgpu::RenderPassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: begins.then_some(first),
            end_of_pass_write_index: ends.then_some(first + 1),
        }
    }

    /// Waits for the GPU; one entry a frame. A pass that was not recorded since the last time took no time.
    pub fn read(&self, gpu: &Gpu) -> Result<Vec<PassTimes>, GpuError> {
        let recorded = self.recorded.take();
        let passes = recorded.len();
        self.recorded.replace(vec![false; passes]);
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        for pass in (0..passes as u32).filter(|&pass| recorded[pass as usize]) {
            let to = pass as u64 * wgpu::QUERY_RESOLVE_BUFFER_ALIGNMENT;
            encoder.resolve_query_set(&self.queries, 2 * pass..2 * pass + 2, &self.ticks, to);
        }
        gpu.queue.submit([encoder.finish()]);
        let ticks: Vec<u64> = gpu.download(&self.ticks, passes * ALIGNMENT as usize)?;
        let microseconds_per_tick = gpu.queue.get_timestamp_period() as f64 * 1e-3;
        let microseconds = |frame: usize, stage: Stage| {
            let pass = frame * STAGES as usize + stage as usize;
            let at = pass * ALIGNMENT as usize;
            let taken = ticks[at + 1].saturating_sub(ticks[at]) as f64 * microseconds_per_tick;
            if recorded[pass] { taken } else { 0.0 }
        };
        let times = (0..passes / STAGES as usize).map(|frame| PassTimes {
            measure: microseconds(frame, Stage::Measure),
            downsample: microseconds(frame, Stage::Downsample),
            transfer: microseconds(frame, Stage::Transfer),
            reconstruct: microseconds(frame, Stage::Reconstruct),
            shade: microseconds(frame, Stage::Shade),
            resolve: microseconds(frame, Stage::Resolve),
        });
        Ok(times.collect())
    }
}
