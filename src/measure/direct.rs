//! The direct vector x: what the lights send to the measurement points (METHOD eq. 2 and 3; Belcour et al. 2022, 4.1).
//!
//! x is radiant exitance: irradiance from all lights, shadows included, times the albedo of the point, in W/m². Each point
//! averages its nearest sub-points, so that a thin shadow or a small highlight is not measured as all or nothing.

use rayon::prelude::*;

use super::MeasurementPoints;
use crate::light::{LightTable, shadowed_irradiance};
use crate::math::Rgb;
use crate::scene::Tracer;

impl MeasurementPoints {
    /// x, one RGB a point, under all lights of `lights` together.
    pub fn direct(&self, tracer: &Tracer, lights: &LightTable) -> Vec<Rgb> {
        self.average(&self.sub_point_exitance(tracer, lights))
    }

    /// Radiant exitance of each sub-point, `[sub_point]`. GPU twin: `shaders/measure.wgsl`.
    pub fn sub_point_exitance(&self, tracer: &Tracer, lights: &LightTable) -> Vec<Rgb> {
        self.sub_points
            .par_iter()
            .map_init(
                || vec![0.0; lights.len],
                |irradiance, p| {
                    shadowed_irradiance(tracer, lights, p.position, p.normal, p.geometric_normal, irradiance);
                    let sum: Rgb = irradiance.iter().enumerate().map(|(i, &e)| lights.colour(i) * e).sum();
                    p.albedo * sum
                },
            )
            .collect()
    }

    /// Mean over each point's sub-points of `sub_point_values`, `[sub_point]`. GPU twin: `shaders/downsample.wgsl`.
    pub fn average(&self, sub_point_values: &[Rgb]) -> Vec<Rgb> {
        assert_eq!(sub_point_values.len(), self.sub_points.len(), "values of another point set");
        let count = self.neighbours_per_point().max(1);
        let share = 1.0 / count as f32;
        self.neighbours
            .chunks_exact(count)
            .map(|of_point| of_point.iter().map(|&s| sub_point_values[s as usize]).sum::<Rgb>() * share)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::light::Light;
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
        let table = LightTable::new([&light]);
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
