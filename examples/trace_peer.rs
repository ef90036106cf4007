//! This program's side of `tests/peers/embree_trace.py`, which documents the file and the lines.
//!
//!     trace_peer write MESH FILE RAYS
//!     trace_peer time MESH FILE

use std::error::Error;
use std::io::Write;
use std::time::Instant;

use glam::Vec3;
use relight::math::LANES;
use relight::scene::Tracer;
use relight::scene::tracer::Segments;

#[path = "../benches/rays/mod.rs"]
mod rays;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["write", mesh, file, count] => write(mesh, file, count.parse()?),
        ["time", mesh, file] => time(mesh, file),
        _ => Err("usage: trace_peer write MESH FILE RAYS | time MESH FILE".into()),
    }
}

fn write(mesh: &str, file: &str, count: usize) -> Result<(), Box<dyn Error>> {
    let asset = rays::mesh(mesh);
    let triangles = asset.mesh.triangles.len();
    let mut bytes = [(triangles as u32).to_le_bytes(), (count as u32).to_le_bytes()].concat();
    let mut push = |v: Vec3| bytes.extend(v.to_array().iter().flat_map(|f| f.to_le_bytes()));
    (0..triangles).for_each(|t| asset.mesh.triangle_positions(t).into_iter().for_each(&mut push));
    for ray in rays::rays(&asset, count, 1) {
        [ray.origin, ray.direction, ray.segment].into_iter().for_each(&mut push);
    }
    Ok(std::fs::write(file, bytes)?)
}

fn time(mesh: &str, file: &str) -> Result<(), Box<dyn Error>> {
    // The mesh is made anew, with its materials; the rays are read.
    let asset = rays::mesh(mesh);
    let bytes = std::fs::read(file)?;
    let triangles = u32::from_le_bytes(bytes[..4].try_into()?) as usize;
    assert_eq!(triangles, asset.mesh.triangles.len(), "{file} holds another mesh");
    let (numbers, _) = bytes[8 + triangles * 36..].as_chunks::<4>();
    let numbers: Vec<f32> = numbers.iter().map(|&four| f32::from_le_bytes(four)).collect();
    let rays: Vec<[Vec3; 3]> =
        numbers.as_chunks::<9>().0.iter().map(|r| [0, 3, 6].map(|i| Vec3::from_slice(&r[i..]))).collect();
    let tracer = Tracer::new(&asset);
    println!("ready");
    for line in std::io::stdin().lines() {
        let (mut hits, mut sum) = (0, 0.0);
        let start = Instant::now();
        match line?.as_str() {
            "closest" => {
                for [origin, direction, _] in &rays {
                    if let Some(hit) = tracer.closest_hit(*origin, *direction, f32::INFINITY) {
                        hits += 1;
                        sum += f64::from(hit.t);
                    }
                }
            }
            // To LIGHTS points from each origin, together.
            "shadows" => hits = shadows(&tracer, &rays),
            _ => hits = rays.iter().filter(|[origin, _, segment]| tracer.occluded(*origin, *segment)).count(),
        }
        println!("{} {hits} {sum}", start.elapsed().as_secs_f64());
        std::io::stdout().flush()?;
    }
    Ok(())
}

const LIGHTS: usize = 128;

/// Segments that something hides: one origin in LIGHTS casts shadow rays to the ends of all their segments.
fn shadows(tracer: &Tracer, rays: &[[Vec3; 3]]) -> usize {
    let mut shadows = tracer.shadow_rays(Some(tracer.asset().mesh.bounds()));
    let mut hidden = 0;
    for group in rays.chunks_exact(LIGHTS) {
        let origin = group[0][0];
        shadows.start_from(origin);
        for packet in group.as_chunks::<LANES>().0 {
            let ends = packet.map(|[from, _, segment]| from + segment - origin);
            let segments: Segments = [0, 1, 2].map(|axis| ends.map(|end| end[axis]));
            hidden += LANES - shadows.unoccluded(&segments, (1 << LANES) - 1).count_ones() as usize;
        }
    }
    hidden
}
