//! Lightmaps are clean: walls do not leak, charts join without a seam.

use glam::{Vec2, Vec3};
use relight::light::{Light, LightingCondition};
use relight::math::Rgb;
use relight::progress::Silent;
use relight::report::figures::LightmapImage;
use relight::scene::{Asset, Lightmap, Material, Mesh, Tracer};
use relight::transport::{BakeSettings, bake, bake_direct};

/// Page per metre in the lightmaps of the quads below.
const PAGE_PER_METRE: f32 = 0.08;

/// Quads, each with its own rectangle of the page, at a common density.
#[derive(Default)]
struct Quads {
    mesh: Mesh,
    shelf: Vec2,
    shelf_height: f32,
}

impl Quads {
    /// A rectangle that faces along `u` × `v`.
    fn quad(&mut self, corner: Vec3, u: Vec3, v: Vec3) {
        const GAP: f32 = 0.02;
        let size = Vec2::new(u.length(), v.length()) * PAGE_PER_METRE;
        if self.shelf.x + size.x + 2.0 * GAP > 1.0 {
            self.shelf = Vec2::new(0.0, self.shelf.y + self.shelf_height);
            self.shelf_height = 0.0;
        }
        let first = self.mesh.positions.len() as u32;
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            self.mesh.positions.push(corner + u * x + v * y);
            self.mesh.normals.push(u.cross(v).normalize());
            self.mesh.lightmap_uvs.push(self.shelf + GAP + size * Vec2::new(x, y));
        }
        self.shelf.x += size.x + GAP;
        self.shelf_height = self.shelf_height.max(size.y + GAP);
        self.mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        self.mesh.triangle_materials.extend([0, 0]);
    }

    fn finish(self) -> Asset {
        assert!(self.shelf.y + self.shelf_height < 1.0);
        Asset {
            name: "quads".to_owned(),
            mesh: self.mesh,
            materials: vec![Material::lambert("grey", Rgb::splat(0.6))],
            textures: Vec::new(),
            lights: Vec::new(),
            cameras: Vec::new(),
            warnings: Vec::new(),
        }
    }
}

/// Where the rooms' dividing wall stands, metres: between texel borders at most sizes.
const WALL_X: f32 = 2.033;

/// A box of 4 m × 2 m × 2 m whose floor, ceiling and long walls run on behind a wall across it at x = [`WALL_X`].
fn two_rooms(thickness: f32) -> Asset {
    let (x, y, z) = (4.0 * Vec3::X, 2.0 * Vec3::Y, 2.0 * Vec3::Z);
    let mut quads = Quads::default();
    quads.quad(Vec3::ZERO, z, x);
    quads.quad(Vec3::new(0.0, 2.0, 0.0), x, z);
    quads.quad(Vec3::ZERO, x, y);
    quads.quad(Vec3::new(0.0, 0.0, 2.0), y, x);
    quads.quad(Vec3::ZERO, y, z);
    quads.quad(Vec3::new(4.0, 0.0, 0.0), z, y);
    quads.quad(Vec3::new(WALL_X - 0.5 * thickness, 0.0, 0.0), z, y);
    quads.quad(Vec3::new(WALL_X + 0.5 * thickness, 0.0, 0.0), y, z);
    quads.finish()
}

/// All light under a lamp in the room at x < [`WALL_X`], looked up as a renderer does.
fn lit(tracer: &Tracer, lightmap: &Lightmap, paths: u32) -> LightmapImage {
    let lamp = Light::Point { position: Vec3::new(1.0, 1.3, 0.9), color: Vec3::ONE, intensity: 10.0, range: None };
    let conditions = [LightingCondition { lights: vec![lamp] }];
    let settings = BakeSettings { paths, max_bounces: 8, seed: 3 };
    let indirect = bake(tracer, lightmap, &conditions, &settings, &Silent).unwrap().indirect;
    let direct = bake_direct(tracer, lightmap, &conditions, 3, &Silent).unwrap();
    let values: Vec<Rgb> =
        indirect.chunks_exact(3).zip(direct.chunks_exact(3)).map(|(a, b)| Vec3::from_slice(a) + Vec3::from_slice(b)).collect();
    LightmapImage::new(lightmap, &values)
}

/// Irradiance (red) at points of the floor, ceiling and long walls whose x lies in a range, one a centimetre.
fn looked_up(asset: &Asset, image: &LightmapImage, x: std::ops::Range<f32>) -> Vec<f32> {
    let mesh = &asset.mesh;
    let mut values = Vec::new();
    for quad in 0..4usize {
        for i in 0..40_000 {
            let (u, v) = ((i % 200) as f32 / 200.0 + 0.0025, (i / 200) as f32 / 200.0 + 0.0025);
            let (triangle, b) = if u >= v { (2 * quad, (u - v, v)) } else { (2 * quad + 1, (u, v - u)) };
            let at = mesh.interpolate(&mesh.positions, triangle, b.0, b.1);
            if x.contains(&at.x) {
                values.push(image.sample(mesh.interpolate(&mesh.lightmap_uvs, triangle, b.0, b.1)).x);
            }
        }
    }
    values
}

#[test]
fn study() {
    for size in [64usize, 100] {
        let texel = 1.0 / (PAGE_PER_METRE * size as f32);
        for ratio in [0.0f32, 0.5, 1.0, 1.5, 1.8, 2.0, 2.2, 3.0] {
            let thickness = (ratio * texel).max(0.001);
            let asset = two_rooms(thickness);
            let tracer = Tracer::new(&asset);
            let reference = lit(&tracer, &Lightmap::open(&tracer, 320), 32);
            for (name, lightmap) in [("before", Lightmap::new(&asset.mesh, size)), ("after", Lightmap::open(&tracer, size))] {
                let image = lit(&tracer, &lightmap, 64);
                let (low, high) = (WALL_X - 0.5 * thickness, WALL_X + 0.5 * thickness);
                let bright = looked_up(&asset, &image, 0.0..low);
                let mean = bright.iter().sum::<f32>() / bright.len() as f32;
                let strip = low - 2.0 * texel..low;
                let (near, truth) = (looked_up(&asset, &image, strip.clone()), looked_up(&asset, &reference, strip));
                let rms = (near.iter().zip(&truth).map(|(a, b)| (a - b).powi(2)).sum::<f32>() / truth.iter().map(|b| b * b).sum::<f32>()).sqrt();
                let dark = looked_up(&asset, &image, high..4.0);
                let worst = dark.iter().fold(0f32, |m, &v| m.max(v)) / mean;
                let all = dark.iter().sum::<f32>() / dark.len() as f32 / mean;
                println!("{size} ratio {ratio} {name}: texels {} leak worst {:.4} mean {:.5}; lit strip {:.4}", lightmap.texels.len(), worst, all, rms);
            }
        }
    }
}
