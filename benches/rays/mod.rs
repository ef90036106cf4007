//! Meshes and rays to time ray tracing with: for `benches/trace.rs` and `examples/trace_peer.rs`.

use glam::{Mat3, Vec2, Vec3};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use relight::math::{Frame, warp};
use relight::scene::{Asset, Material, Mesh, generate};

/// A ray from just off a surface: as the bake casts them, so no two neighbours are alike.
#[derive(Clone, Copy)]
pub struct Ray {
    pub origin: Vec3,
    /// Unit, cosine-distributed about the surface's normal.
    pub direction: Vec3,
    /// To a point of the bounds, uniform by volume.
    pub segment: Vec3,
}

/// Small to large: the plainest and the measured Cornell box, a closed surface, and one that is all edges.
#[allow(dead_code, reason = "each program that includes this file uses its own part")]
pub const MESHES: [&str; 4] = ["room", "cornell", "statue", "hairball"];

/// A mesh of [`MESHES`]: 30, 42, about 200 thousand and 1.15 million triangles.
#[allow(dead_code, reason = "each program that includes this file uses its own part")]
pub fn mesh(name: &str) -> Asset {
    match name {
        "room" => room(),
        "statue" => fine_statue(),
        "hairball" => hairball(),
        name => generate(name).unwrap_or_else(|| panic!("no mesh is called {name}")),
    }
}

/// `count` rays from points of the surface, uniform by area.
pub fn rays(asset: &Asset, count: usize, seed: u64) -> Vec<Ray> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mesh = &asset.mesh;
    let mut area = 0.0;
    let areas = (0..mesh.triangles.len()).map(|t| {
        area += f64::from(mesh.triangle_cross(t).length());
        area
    });
    let cumulative: Vec<f64> = areas.collect();
    let bounds = mesh.bounds();
    let offset = bounds.diagonal() * 1e-5;
    (0..count)
        .map(|_| {
            let u = rng.random::<f64>() * cumulative[cumulative.len() - 1];
            let triangle = cumulative.partition_point(|&sum| sum <= u).min(cumulative.len() - 1);
            let b = warp::sample_uniform_triangle(pair(&mut rng));
            let [p0, p1, p2] = mesh.triangle_positions(triangle);
            let normal = mesh.triangle_cross(triangle).normalize();
            let direction = Frame::from_normal(normal).world_from_local(warp::sample_cosine_hemisphere(pair(&mut rng)));
            let origin = p0 * (1.0 - b.x - b.y) + p1 * b.x + p2 * b.y + normal * offset;
            let target = bounds.min + (bounds.max - bounds.min) * triple(&mut rng);
            Ray { origin, direction, segment: target - origin }
        })
        .collect()
}

/// A cube without a front and two turned blocks without bottoms: a Cornell box of 15 rectangles. That of the program is the measured
/// one, whose walls are no parallelograms and whose floor has holes.
fn room() -> Asset {
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    let mut rectangles = |turn: Mat3, centre: Vec3, half: Vec3, inside: f32, without: Vec3| {
        for (normal, u) in [(Vec3::X, Vec3::Y), (Vec3::Y, Vec3::Z), (Vec3::Z, Vec3::X)] {
            for n in [normal, -normal].into_iter().filter(|&n| n != without) {
                let v = n.cross(u) * inside;
                let first = positions.len() as u32;
                positions.extend([n - u - v, n + u - v, n + u + v, n - u + v].map(|c| turn * (c * half) + centre));
                triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            }
        }
    };
    rectangles(Mat3::IDENTITY, Vec3::ZERO, Vec3::ONE, -1.0, Vec3::Z);
    for (angle, x, z, height) in [(0.3, -0.35, -0.3, 0.6), (-0.3, 0.35, 0.35, 0.3)] {
        let (centre, half) = (Vec3::new(x, height - 1.0, z), Vec3::new(0.3, height, 0.3));
        rectangles(Mat3::from_rotation_y(angle), centre, half, 1.0, Vec3::NEG_Y);
    }
    of_triangles("room", positions, triangles)
}

/// The statue, each triangle divided into 25, new vertices pushed a little off the old surface so that no two triangles lie in
/// one plane.
fn fine_statue() -> Asset {
    const PARTS: u32 = 5;
    let coarse = generate("statue").expect("a scene of that name").mesh;
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    // Vertices by their weights, so that neighbours share those of their edge.
    let mut vertices = std::collections::HashMap::new();
    for corners in &coarse.triangles {
        let mut vertex = |i: u32, j: u32| {
            let mut weights = [(corners[0], PARTS - i - j), (corners[1], i), (corners[2], j)];
            weights.sort();
            let key: Vec<_> = weights.into_iter().filter(|&(_, weight)| weight > 0).collect();
            *vertices.entry(key).or_insert_with_key(|key| {
                let at: Vec3 = key.iter().map(|&(v, weight)| coarse.positions[v as usize] * weight as f32).sum();
                let cell = coarse.positions[corners[0] as usize].distance(coarse.positions[corners[1] as usize]);
                let push = if key.len() == 1 { 0.0 } else { 0.1 / PARTS as f32 * cell };
                positions.push(at / PARTS as f32 + (triple(&mut rng) - 0.5) * push);
                positions.len() as u32 - 1
            })
        };
        for (i, j) in (0..PARTS).flat_map(|i| (0..PARTS - i).map(move |j| (i, j))) {
            triangles.push([vertex(i, j), vertex(i + 1, j), vertex(i, j + 1)]);
            if i + j + 1 < PARTS {
                triangles.push([vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)]);
            }
        }
    }
    of_triangles("statue", positions, triangles)
}

/// 9,600 curled ribbons of 120 triangles, grown outwards from the middle of a ball.
fn hairball() -> Asset {
    const STRANDS: usize = 9_600;
    const SEGMENTS: usize = 60;
    let mut rng = Pcg64Mcg::seed_from_u64(4);
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for _ in 0..STRANDS {
        let mut along = warp::sample_uniform_sphere(pair(&mut rng));
        let mut at = along * 0.1;
        let mut across = along.any_orthonormal_vector();
        for segment in 0..=SEGMENTS {
            // Strands wander, and taper towards their tips.
            let width = 0.002 * (1.0 - 0.9 * segment as f32 / SEGMENTS as f32);
            positions.extend([at - across * width, at + across * width]);
            if segment < SEGMENTS {
                let first = positions.len() as u32 - 2;
                triangles.extend([[first, first + 1, first + 2], [first + 2, first + 1, first + 3]]);
            }
            at += along * 0.025;
            along = (along + 0.35 * warp::sample_uniform_sphere(pair(&mut rng))).normalize();
            across = (across - along * across.dot(along)).normalize();
        }
    }
    of_triangles("hairball", positions, triangles)
}

pub fn of_triangles(name: &str, positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Asset {
    let mesh = Mesh {
        normals: vec![Vec3::Y; positions.len()],
        triangle_materials: vec![0; triangles.len()],
        positions,
        triangles,
        ..Mesh::default()
    };
    let materials = vec![Material::lambert("grey", Vec3::splat(0.5))];
    Asset { name: name.into(), mesh, materials, textures: vec![], lights: vec![], cameras: vec![], warnings: vec![] }
}

pub fn pair(rng: &mut impl Rng) -> Vec2 {
    Vec2::new(rng.random(), rng.random())
}

pub fn triple(rng: &mut impl Rng) -> Vec3 {
    Vec3::new(rng.random(), rng.random(), rng.random())
}
