//! The direct vector x: radiant exitance at the measurement points (METHOD eq. 2). Training and the CPU run time both
//! measure here. GPU twins: `shaders/measure.wgsl` and `shaders/downsample.wgsl`.

use rayon::prelude::*;

use super::{MeasurementPoint, MeasurementPoints};
use crate::light::{LightGather, LightTable};
use crate::math::{LANES, Rgb};
use crate::scene::{Bsdf, Surface, Tracer, lanes};

impl MeasurementPoints {
    /// x under the lights of one condition, one RGB a point.
    pub fn direct(&self, tracer: &Tracer, lights: &LightTable) -> Vec<Rgb> {
        self.average(&self.sub_point_exitance(tracer, lights))
    }

    /// Radiant exitance of each sub-point under the lights of one condition. GPU twin: `shaders/measure.wgsl`.
    pub fn sub_point_exitance(&self, tracer: &Tracer, lights: &LightTable) -> Vec<Rgb> {
        assert_eq!(lights.condition_count(), 1, "lights of one condition");
        self.sub_point_matrix(tracer, lights).chunks_exact(3).map(Rgb::from_slice).collect()
    }

    /// Mean over each point's sub-points of `sub_point_values`, `[sub-point]`. GPU twin: `shaders/downsample.wgsl`.
    pub fn average(&self, sub_point_values: &[Rgb]) -> Vec<Rgb> {
        assert_eq!(sub_point_values.len(), self.sub_points.len(), "values of another point set");
        let rows: &[f32] = bytemuck::cast_slice(sub_point_values);
        self.average_rows(rows, 3).chunks_exact(3).map(Rgb::from_slice).collect()
    }

    /// D under all conditions of `table`: `[point][channel][condition]`.
    pub fn direct_matrix(&self, tracer: &Tracer, table: &LightTable) -> Vec<f32> {
        self.average_rows(&self.sub_point_matrix(tracer, table), 3 * table.condition_count())
    }

    /// Means of the sub-points' rows of `row` values each: `[point][value]`.
    pub fn average_rows(&self, sub_points: &[f32], row: usize) -> Vec<f32> {
        let count = self.neighbours_per_point().max(1);
        let share = 1.0 / count as f32;
        let mut out = vec![0f32; self.points.len() * row];
        out.par_chunks_mut(row.max(1)).zip(self.neighbours.par_chunks(count)).for_each(|(x, neighbours)| {
            for &s in neighbours {
                for (x, e) in x.iter_mut().zip(&sub_points[s as usize * row..]) {
                    *x += e;
                }
            }
            x.iter_mut().for_each(|x| *x *= share);
        });
        out
    }

    /// Radiant exitance of every sub-point under all conditions: `[sub-point][channel][condition]`.
    pub fn sub_point_matrix(&self, tracer: &Tracer, table: &LightTable) -> Vec<f32> {
        let mut exitance = Vec::new();
        self.fill_sub_point_matrix(tracer, table, &mut exitance);
        exitance
    }

    /// The same, in place of what `exitance` holds.
    pub fn fill_sub_point_matrix(&self, tracer: &Tracer, table: &LightTable, exitance: &mut Vec<f32>) {
        let n = table.condition_count();
        exitance.clear();
        exitance.resize(self.sub_points.len() * 3 * n, 0.0);
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

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::light::{EmissionFacets, Light};
    use crate::measure::MeasurementPoint;
    use crate::scene::{Asset, Material, Mesh, Tracer};

    /// A floor of 8 m at y = 0 and a blocker of 2 m at y = 1, above the floor's middle.
    fn floor_and_blocker() -> Asset {
        let mut mesh = Mesh::default();
        for (half, y) in [(4.0, 0.0), (1.0, 1.0)] {
            let first = mesh.positions.len() as u32;
            for (x, z) in [(-half, half), (half, half), (half, -half), (-half, -half)] {
                mesh.positions.push(Vec3::new(x, y, z));
                mesh.normals.push(Vec3::Y);
            }
            mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            mesh.triangle_materials.extend([0, 0]);
        }
        Asset {
            name: "floor".to_owned(),
            mesh,
            materials: vec![Material::lambert("white", Vec3::ONE)],
            textures: Vec::new(),
            lights: Vec::new(),
            cameras: Vec::new(),
            warnings: Vec::new(),
        }
    }

    fn on_floor(x: f32, albedo: f32) -> MeasurementPoint {
        MeasurementPoint {
            position: Vec3::new(x, 0.0, 0.0),
            normal: Vec3::Y,
            geometric_normal: Vec3::Y,
            albedo: Vec3::splat(albedo),
        }
    }

    /// A point light of intensity I at height h: E = I h / d³ in the open, 0 behind the blocker; exitance is albedo · E.
    #[test]
    fn point_light_lights_what_the_blocker_leaves_open() {
        let asset = floor_and_blocker();
        let tracer = Tracer::new(&asset);
        let points = MeasurementPoints {
            points: vec![on_floor(0.0, 0.5), on_floor(3.0, 0.5)],
            sub_points: vec![on_floor(0.1, 0.5), on_floor(3.0, 0.5), on_floor(3.5, 0.25)],
            neighbours: vec![0, 1, 1, 2],
        };
        let light = Light::Point {
            position: Vec3::new(0.0, 2.0, 0.0),
            color: Vec3::new(1.0, 0.5, 0.0),
            intensity: 10.0,
            range: None,
        };
        let table = LightTable::new([&light], &EmissionFacets::default());
        let exitance = points.sub_point_exitance(&tracer, &table);
        let open = |x: f32, albedo: f32| albedo * 10.0 * 2.0 / (x * x + 4.0).powf(1.5);
        assert_eq!(exitance[0], Vec3::ZERO);
        // The origin lies one part in 1e5 of the extent off the floor; d³ triples that relative difference.
        for (got, want) in [(exitance[1], open(3.0, 0.5)), (exitance[2], open(3.5, 0.25))] {
            assert!((got - want * Vec3::new(1.0, 0.5, 0.0)).abs().max_element() < 1e-3 * want, "{got} {want}");
        }
        let x = points.direct(&tracer, &table);
        assert_eq!(x[0], exitance[1] * 0.5);
        assert_eq!(x[1], (exitance[1] + exitance[2]) * 0.5);
    }
}
