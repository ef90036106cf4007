//! The direct vector x: radiant exitance at the measurement points (METHOD eq. 2). Training and the CPU run time both
//! measure here. GPU twins: `shaders/measure.wgsl` and `shaders/downsample.wgsl`.

use rayon::prelude::*;

use super::{MeasurementPoint, MeasurementPoints};
use crate::light::{Light, LightGather, LightTable};
use crate::math::{LANES, Rgb};
use crate::scene::{Bsdf, Surface, Tracer, lanes};

impl MeasurementPoints {
    /// x under one set of lights: radiant exitance (albedo × irradiance, in the lights' unit) of every point, the mean over
    /// its sub-points.
    pub fn direct(&self, tracer: &Tracer, lights: &[Light]) -> Vec<Rgb> {
        let matrix = self.direct_matrix(tracer, &LightTable::new(lights));
        matrix.chunks_exact(3).map(Rgb::from_slice).collect()
    }

    /// D under all conditions of `table`: `[point][channel][condition]`.
    pub fn direct_matrix(&self, tracer: &Tracer, table: &LightTable) -> Vec<f32> {
        let row = 3 * table.condition_count();
        let exitance = self.sub_point_exitance(tracer, table);
        let count = self.neighbours_per_point();
        let mut direct = vec![0f32; self.points.len() * row];
        for (x, neighbours) in direct.chunks_mut(row.max(1)).zip(self.neighbours.chunks(count.max(1))) {
            for &s in neighbours {
                for (x, e) in x.iter_mut().zip(&exitance[s as usize * row..]) {
                    *x += e / count as f32;
                }
            }
        }
        direct
    }

    /// Radiant exitance of every sub-point: `[sub-point][channel][condition]`.
    pub fn sub_point_exitance(&self, tracer: &Tracer, table: &LightTable) -> Vec<f32> {
        let n = table.condition_count();
        let mut exitance = vec![0f32; self.sub_points.len() * 3 * n];
        let rows = exitance.par_chunks_mut((3 * n).max(1)).zip(&self.sub_points);
        rows.for_each_init(
            || (LightGather::new(table, tracer), vec![0f32; table.block_count() * LANES]),
            |(gather, irradiance), (row, point)| {
                irradiance.fill(0.0);
                gather.gather(&point.receiver(), |a| {
                    for i in lanes(a.open) {
                        irradiance[a.light[i] as usize] = a.irradiance[i];
                    }
                });
                for light in 0..table.len {
                    let value = point.albedo * table.colour(light) * irradiance[light];
                    for channel in 0..3 {
                        row[channel * n + table.condition(light)] += value[channel];
                    }
                }
            },
        );
        exitance
    }
}

impl MeasurementPoint {
    /// The point as a surface that light arrives at.
    fn receiver(&self) -> Surface {
        Surface {
            position: self.position,
            geometric_normal: self.geometric_normal,
            normal: self.normal,
            bsdf: Bsdf { diffuse: self.albedo, f0: Rgb::ZERO, alpha: 1.0, specular: false },
            emitted: Rgb::ZERO,
            back: false,
        }
    }
}
