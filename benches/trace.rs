//! Brute force against the trees, over the number of triangles: what `BRUTE_FORCE_LIMIT` in `src/scene/tracer.rs` is set by.
//!
//! Times are per ray (closest hit) and per shadow ray; shadow rays come in packets of LANES, few or many from one origin.

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::{Mat3, Vec3};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use relight::math::{Frame, LANES, warp};
use relight::scene::tracer::Segments;
use relight::scene::{Aabb, Asset, Material, Mesh, Search, Tracer, generate};

/// Rays an iteration.
const RAYS: usize = 4096;

criterion_group! {
    name = benches;
    config = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(2));
    targets = trace
}
criterion_main!(benches);

fn trace(c: &mut Criterion) {
    let mut assets: Vec<Asset> = ["cornell", "interior", "statue"].map(|name| generate(name).unwrap()).into();
    assets.extend([5, 10, 21, 42].map(boxes));
    assets.sort_by_key(|asset| asset.mesh.triangles.len());
    for asset in &assets {
        let origins = origins(asset);
        let lights = lights(asset);
        for search in [Search::Brute, Search::Tree] {
            let tracer = Tracer::with_search(asset, search);
            let id = |what: &str| {
                BenchmarkId::new(format!("{what}/{search:?}"), format!("{}-{}", asset.mesh.triangles.len(), asset.name))
            };
            let mut group = c.benchmark_group("trace");
            group.throughput(Throughput::Elements(RAYS as u64));
            group.bench_function(id("closest"), |b| {
                b.iter(|| {
                    origins.iter().filter(|(p, _, d)| tracer.closest_hit(*p, *d, f32::INFINITY).is_some()).count()
                });
            });
            for packets in [1, 8] {
                let mut shadows = tracer.shadow_rays(Some(Aabb::from_points(&lights)));
                group.bench_function(id(&format!("shadow-{packets}")), |b| {
                    b.iter(|| {
                        let mut open = 0;
                        for (k, (p, _, _)) in origins.iter().take(RAYS / (packets * LANES)).enumerate() {
                            shadows.start_from(*p);
                            for packet in 0..packets {
                                let segments = towards(*p, &lights, (k + packet) * LANES);
                                open += shadows.unoccluded(black_box(&segments), (1 << LANES) - 1).count_ones();
                            }
                        }
                        open
                    });
                });
            }
        }
    }
}

/// LANES segments from `p` to as many lights, from the `first` on.
fn towards(p: Vec3, lights: &[Vec3], first: usize) -> Segments {
    let mut segments = [[0.0; LANES]; 3];
    for lane in 0..LANES {
        let to_light = lights[(first + lane) % lights.len()] - p;
        for axis in 0..3 {
            segments[axis][lane] = to_light[axis];
        }
    }
    segments
}

/// Points just off the surface, uniform by area, each with its normal and a cosine-distributed direction.
fn origins(asset: &Asset) -> Vec<(Vec3, Vec3, Vec3)> {
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mesh = &asset.mesh;
    let mut area = 0.0;
    let areas = (0..mesh.triangles.len()).map(|t| {
        area += mesh.triangle_cross(t).length();
        area
    });
    let cumulative: Vec<f32> = areas.collect();
    let offset = mesh.bounds().diagonal() * 1e-5;
    (0..RAYS)
        .map(|_| {
            let u = rng.random::<f32>() * cumulative[cumulative.len() - 1];
            let triangle = cumulative.partition_point(|&sum| sum <= u).min(cumulative.len() - 1);
            let b = warp::sample_uniform_triangle(pair(&mut rng));
            let [p0, p1, p2] = mesh.triangle_positions(triangle);
            let normal = mesh.triangle_cross(triangle).normalize();
            let direction = Frame::from_normal(normal).world_from_local(warp::sample_cosine_hemisphere(pair(&mut rng)));
            (p0 * (1.0 - b.x - b.y) + p1 * b.x + p2 * b.y + normal * offset, normal, direction)
        })
        .collect()
}

/// 128 points in the asset's bounds.
fn lights(asset: &Asset) -> Vec<Vec3> {
    let mut rng = Pcg64Mcg::seed_from_u64(2);
    let bounds = asset.mesh.bounds();
    (0..128).map(|_| bounds.min + (bounds.max - bounds.min) * triple(&mut rng)).collect()
}

/// `count` boxes, turned at random in the unit cube: 12 triangles each.
fn boxes(count: usize) -> Asset {
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let mut mesh = Mesh::default();
    for _ in 0..count {
        let turn = Mat3::from_rotation_y(rng.random::<f32>()) * Mat3::from_rotation_x(rng.random::<f32>());
        let (centre, half) = (triple(&mut rng), (triple(&mut rng) + 0.2) * 0.1);
        for (normal, u) in [(Vec3::X, Vec3::Y), (Vec3::Y, Vec3::Z), (Vec3::Z, Vec3::X)] {
            for n in [normal, -normal] {
                let v = n.cross(u);
                let first = mesh.positions.len() as u32;
                for corner in [n - u - v, n + u - v, n + u + v, n - u + v] {
                    mesh.positions.push(turn * (corner * half) + centre);
                    mesh.normals.push(turn * n);
                }
                mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
                mesh.triangle_materials.extend([0, 0]);
            }
        }
    }
    let materials = vec![Material::lambert("grey", Vec3::splat(0.5))];
    Asset { name: "boxes".into(), mesh, materials, textures: vec![], lights: vec![], cameras: vec![], warnings: vec![] }
}

fn pair(rng: &mut impl Rng) -> glam::Vec2 {
    glam::Vec2::new(rng.random(), rng.random())
}

fn triple(rng: &mut impl Rng) -> Vec3 {
    Vec3::new(rng.random(), rng.random(), rng.random())
}
