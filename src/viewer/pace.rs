//! How finely a frame is drawn, so that the window answers while lights and camera move, and what frames took.

use std::collections::VecDeque;
use std::time::Duration;

use crate::gpu::PassTimes;

/// What a frame may take while something moves, and when all is still.
const MOVING: Duration = Duration::from_millis(40);
const STILL: Duration = Duration::from_millis(300);

/// Frames that the plots go back.
const HISTORY: usize = 240;

/// A picture's size, pixels, and its samples along each side of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grain {
    pub size: [u32; 2],
    pub samples_per_axis: u32,
}

impl Grain {
    pub fn samples(&self) -> f64 {
        self.size[0] as f64 * self.size[1] as f64 * (self.samples_per_axis as f64).powi(2)
    }
}

/// One frame that was drawn.
#[derive(Clone, Copy, Debug)]
pub struct FrameTime {
    /// Milliseconds until the picture was there, all sides.
    pub total: f64,
    pub passes: Option<PassTimes>,
}

/// What frames took, and so what the next one will.
#[derive(Default)]
pub struct Pace {
    /// Seconds a sample; none before the first frame.
    cost: Option<f64>,
    pub history: VecDeque<FrameTime>,
}

impl Pace {
    /// The finest grain that `size` pixels can be drawn with in time.
    pub fn grain(&self, size: [u32; 2], moving: bool) -> Grain {
        let budget = if moving { MOVING } else { STILL }.as_secs_f64();
        let samples = self.cost.map_or(0.25 * size[0] as f64 * size[1] as f64, |cost| budget / cost.max(1e-12));
        let share = samples / (size[0] as f64 * size[1] as f64).max(1.0);
        if share >= 4.0 {
            return Grain { size, samples_per_axis: 2 };
        }
        // Steps of √2, so that it does not flicker between sizes.
        let step = (share.min(1.0).log2()).floor().max(-8.0);
        let scale = (step * 0.5).exp2();
        Grain { size: size.map(|side| ((side as f64 * scale).round() as u32).max(1)), samples_per_axis: 1 }
    }

    pub fn drew(&mut self, grain: Grain, sides: usize, took: Duration, passes: Option<PassTimes>) {
        self.cost = Some(took.as_secs_f64() / (grain.samples() * sides.max(1) as f64).max(1.0) * sides.max(1) as f64);
        if self.history.len() == HISTORY {
            self.history.pop_front();
        }
        self.history.push_back(FrameTime { total: took.as_secs_f64() * 1e3, passes });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_frames_are_drawn_coarser_and_fast_ones_finer() {
        let mut pace = Pace::default();
        let size = [1280, 720];
        assert!(pace.grain(size, true).size[0] < 1280, "the first frame is a guess");
        // A microsecond a sample: 40 ms are 40,000 samples, a twenty-third of the pixels.
        pace.drew(Grain { size: [100, 100], samples_per_axis: 1 }, 1, Duration::from_millis(10), None);
        let (moving, still) = (pace.grain(size, true), pace.grain(size, false));
        assert!(moving.samples() <= 40_000.0 && moving.samples() > 18_000.0, "{moving:?}");
        assert!(still.samples() <= 300_000.0 && still.samples() > 140_000.0, "{still:?}");
        // A nanosecond a sample: nothing is left out.
        pace.drew(Grain { size, samples_per_axis: 1 }, 1, Duration::from_micros(900), None);
        assert_eq!(pace.grain(size, true), Grain { size, samples_per_axis: 2 });
    }
}
