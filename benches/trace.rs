//! Ray tracing in millions of rays a second on one thread, over the number of triangles: single rays, and shadow rays that
//! share an origin. What `BRUTE_FORCE_LIMIT` in `src/scene/tracer/mod.rs` is set by: meshes near it are searched in both ways.
//!
//!     cargo bench --bench trace [MESH ...]
//!
//! The best of several passes counts, ways and passes taking turns. `tests/peers/embree_trace.py` holds the same rays against
//! Embree.

use std::hint::black_box;
use std::time::Instant;

use glam::{Mat3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use relight::math::LANES;
use relight::scene::tracer::Segments;
use relight::scene::{Aabb, Asset, Search, Tracer};

#[path = "rays/mod.rs"]
mod rays;
use rays::{MESHES, Ray, mesh, of_triangles, triple};

/// Single rays a pass.
const RAYS: usize = 50_000;
const PASSES: usize = 5;
/// Lights that shadow rays from one origin go to.
const LIGHTS: [usize; 4] = [1, 16, 128, 1024];
/// Larger meshes are not tested whole.
const BOTH_WAYS: usize = 600;

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let mut assets: Vec<Asset> = [10, 21, 42].map(boxes).into();
    assets.extend(MESHES.iter().filter(|name| wanted.is_empty() || wanted.iter().any(|w| w == *name)).map(|n| mesh(n)));
    assets.retain(|asset| wanted.is_empty() || wanted.contains(&asset.name));
    assets.sort_by_key(|asset| asset.mesh.triangles.len());
    let lights = LIGHTS.map(|count| format!("{count:>8}")).concat();
    println!("Mrays/s                           closest occluded   to so many lights:{lights}");
    for asset in &assets {
        let rays = rays::rays(asset, RAYS, 1);
        let count = asset.mesh.triangles.len();
        let ways: &[Search] = if count > BOTH_WAYS { &[Search::Tree] } else { &[Search::Brute, Search::Tree] };
        let tracers: Vec<Tracer> = ways.iter().map(|&search| Tracer::with_search(asset, search)).collect();
        // Of each way the best rates: closest, occluded, and to LIGHTS.
        let mut best = vec![[0f64; 2 + LIGHTS.len()]; ways.len()];
        for _ in 0..PASSES {
            for (tracer, best) in tracers.iter().zip(&mut best) {
                best.iter_mut().enumerate().for_each(|(what, best)| *best = best.max(rate(tracer, &rays, what)));
            }
        }
        for (way, [closest, occluded, shadows @ ..]) in ways.iter().zip(best) {
            let shadows = shadows.map(|rate| format!("{rate:>8.2}")).concat();
            let name = format!("{} ({way:?})", asset.name);
            println!("{count:>8} triangles, {name:<16}{closest:>6.2} {occluded:>8.2}                     {shadows}");
        }
    }
}

/// Millions of rays a second.
fn rate(tracer: &Tracer, rays: &[Ray], what: usize) -> f64 {
    let start = Instant::now();
    let cast = match what {
        0 => {
            black_box(
                rays.iter().filter(|r| tracer.closest_hit(r.origin, r.direction, f32::INFINITY).is_some()).count(),
            );
            rays.len()
        }
        1 => {
            black_box(rays.iter().filter(|r| tracer.occluded(r.origin, r.segment)).count());
            rays.len()
        }
        what => shadows(tracer, rays, LIGHTS[what - 2]),
    };
    cast as f64 / start.elapsed().as_secs_f64() / 1e6
}

/// Shadow rays from the rays' origins to `count` points, which are the other rays' ends; how many were cast.
fn shadows(tracer: &Tracer, rays: &[Ray], count: usize) -> usize {
    let ends: Vec<Vec3> = rays.iter().take(count.max(LANES)).map(|r| r.origin + r.segment).collect();
    let mut shadows = tracer.shadow_rays(Some(Aabb::from_points(&ends)));
    // A single light stands in the packet's first lane.
    let active = if count < LANES { (1 << count) - 1 } else { (1 << LANES) - 1 };
    let origins = rays.iter().take((RAYS / count).max(50)).map(|r| r.origin);
    let packets = count.div_ceil(LANES);
    let mut cast = 0;
    for origin in origins {
        shadows.start_from(origin);
        for packet in ends.as_chunks::<LANES>().0.iter().take(packets) {
            let segments: Segments = [0, 1, 2].map(|axis| packet.map(|end| (end - origin)[axis]));
            black_box(shadows.unoccluded(&segments, active));
            cast += active.count_ones() as usize;
        }
    }
    cast
}

/// `count` boxes, turned at random in the unit cube: 12 triangles each.
fn boxes(count: usize) -> Asset {
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for _ in 0..count {
        let turn = Mat3::from_rotation_y(rng.random::<f32>()) * Mat3::from_rotation_x(rng.random::<f32>());
        let (centre, half) = (triple(&mut rng), (triple(&mut rng) + 0.2) * 0.1);
        for (normal, u) in [(Vec3::X, Vec3::Y), (Vec3::Y, Vec3::Z), (Vec3::Z, Vec3::X)] {
            for n in [normal, -normal] {
                let v = n.cross(u);
                let first = positions.len() as u32;
                positions.extend([n - u - v, n + u - v, n + u + v, n - u + v].map(|c| turn * (c * half) + centre));
                triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            }
        }
    }
    of_triangles("boxes", positions, triangles)
}
