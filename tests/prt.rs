//! Classical PRT against closed forms and an independent quadrature.

use std::f32::consts::PI;

use glam::Vec3;
use relight::math::{Rgb, quadrature, sh};
use relight::progress::Silent;
use relight::prt::{PrtSettings, ShPrt, bake_texels, bake_vertices};
use relight::scene::generate::{MeshBuilder, generate};
use relight::scene::{Asset, Camera, Lightmap, Tracer};

const ORDER: usize = 6;
const COUNT: usize = sh::count(ORDER);

fn settings(paths: u32, seed: u64) -> PrtSettings {
    PrtSettings { order: ORDER, paths, max_bounces: 32, seed }
}

/// An asset of rectangles, each a corner and two edges; it faces edge 0 × edge 1.
fn rectangles(rectangles: &[[Vec3; 3]], reflectance: Rgb) -> Asset {
    let mut mesh = MeshBuilder::default();
    let material = mesh.lambert("grey", reflectance);
    for &[corner, e0, e1] in rectangles {
        mesh.polygon(&[corner, corner + e0, corner + e0 + e1, corner + e1], material);
    }
    let camera = Camera { eye: Vec3::Z, target: Vec3::ZERO, up: Vec3::Y, vertical_fov: 40.0 };
    with_lightmap(mesh.finish("test", camera))
}

fn with_lightmap(mut asset: Asset) -> Asset {
    asset.mesh.lightmap_uvs = asset.mesh.uvs[1].clone();
    asset
}

/// The six faces of a unit cube about the origin, which face outwards or inwards.
fn cube(outwards: bool) -> Vec<[Vec3; 3]> {
    let mut faces = Vec::new();
    for axis in 0..3 {
        let [a, u, v] = [0, 1, 2].map(|i| Vec3::AXES[(axis + i) % 3]);
        for side in [1.0, -1.0] {
            let corner = 0.5 * side * a - 0.5 * (u + v);
            faces.push(if (side > 0.0) == outwards { [corner, u, v] } else { [corner, v, u] });
        }
    }
    faces
}

fn bake(asset: &Asset, size: usize, paths: u32, seed: u64) -> (Lightmap, ShPrt) {
    let lightmap = Lightmap::new(&asset.mesh, size);
    let prt = bake_texels(&Tracer::new(asset), &lightmap, &settings(paths, seed), &Silent).unwrap();
    (lightmap, prt)
}

/// Light of radiance 1 from everywhere: l₀ = ∫ Y₀ dω = √(4π).
fn constant_light() -> Vec<Rgb> {
    let mut light = vec![Rgb::ZERO; COUNT];
    light[0] = Rgb::splat((4.0 * PI).sqrt());
    light
}

/// An unshadowed receiver with normal n: t_lm = A_l Y_lm(n), and no indirect light.
#[test]
fn open_plane_transfers_the_cosine_lobe() {
    const PATHS: u32 = 1 << 14;
    let normal = Vec3::new(0.6, 0.64, 0.48);
    let u = normal.any_orthonormal_vector();
    let asset = rectangles(&[[Vec3::ZERO, u, normal.cross(u)]], Vec3::splat(0.8));
    let (_, prt) = bake(&asset, 8, PATHS, 1);
    let y = sh::evaluate(ORDER, normal);
    // Each path contributes π Y(ω), with ω cosine-distributed: its variance is at most π² E[Y²].
    let mut mean_square = [0f64; COUNT];
    for (direction, weight) in quadrature::sphere(32) {
        let cos = direction.dot(normal).max(0.0) as f64;
        let y = sh::evaluate(ORDER, direction);
        (0..COUNT).for_each(|j| mean_square[j] += weight * cos / std::f64::consts::PI * (y[j] * y[j]) as f64);
    }
    for (direct, indirect) in prt.direct.chunks_exact(COUNT).zip(prt.indirect.chunks_exact(COUNT)).step_by(7) {
        for j in 0..COUNT {
            let expected = sh::cosine_lobe((j as f32).sqrt() as usize) * y[j];
            let sigma = PI * (mean_square[j] as f32 / PATHS as f32).sqrt();
            assert!((direct[j] - expected).abs() < 4.0 * sigma, "{j}: {} for {expected} ± {sigma}", direct[j]);
            assert_eq!(indirect[j], Rgb::ZERO);
        }
    }
}

#[test]
fn nothing_enters_a_closed_box() {
    let asset = rectangles(&cube(false), Vec3::splat(0.8));
    let (_, prt) = bake(&asset, 32, 64, 1);
    assert!(prt.direct.iter().all(|&t| t == 0.0));
    assert!(prt.indirect.iter().all(|&t| t == Rgb::ZERO));
}

/// White furnace: a convex body sees radiance 1 in its whole hemisphere, so direct irradiance is π and indirect is 0, at
/// every texel and, interpolated, between all vertices.
#[test]
fn convex_body_under_constant_light_receives_pi() {
    let asset = rectangles(&cube(true), Vec3::splat(0.7));
    let lightmap = Lightmap::new(&asset.mesh, 32);
    let tracer = Tracer::new(&asset);
    let at_texels = bake_texels(&tracer, &lightmap, &settings(64, 1), &Silent).unwrap();
    let at_vertices = bake_vertices(&tracer, &lightmap, &settings(64, 1), &Silent).unwrap();
    assert_eq!(at_vertices.direct.len(), 24 * COUNT);
    for prt in [at_texels, at_vertices] {
        let direct = prt.direct(&constant_light());
        assert_eq!(direct.len(), lightmap.texels.len());
        // Rounding of 64 equal summands and of 16 weights.
        assert!(direct.iter().all(|e| (*e - Rgb::splat(PI)).abs().max_element() < 1e-4));
        assert!(prt.indirect(&constant_light()).iter().all(|&e| e == Rgb::ZERO));
    }
}

/// A floor and a wall that meet, one bounce: the indirect transfer at a floor point is the integral over the wall of
/// ρ/π E_j cos cos'/r², where E_j is the direct transfer to the wall; both by quadrature that knows the two rectangles.
#[test]
fn one_bounce_between_floor_and_wall_is_the_double_integral() {
    const REFLECTANCE: Vec3 = Vec3::new(0.8, 0.5, 0.2);
    let floor = [Vec3::ZERO, Vec3::Z, Vec3::X];
    let wall = [Vec3::ZERO, Vec3::Y, Vec3::Z];
    let asset = rectangles(&[floor, wall], REFLECTANCE);
    let lightmap = Lightmap::new(&asset.mesh, 16);
    // A texel well inside the floor, and where it is.
    let (texel, points) = (0..lightmap.texels.len())
        .map(|t| (t, lightmap.sampler(&asset.mesh, t)))
        .find(|(_, points)| {
            let p = points.sample([0.5, 0.5]);
            let p = asset.surface(p.triangle as usize, p.u, p.v, Vec3::ZERO).position;
            p.y == 0.0 && (p.x - 0.4).abs() < 0.1 && (p.z - 0.5).abs() < 0.1
        })
        .unwrap();

    // Direct transfer to a wall point: directions that do not meet the floor. (0 < t: the floor is below.)
    let directions = quadrature::sphere(48);
    let to_wall = |q: Vec3| -> [f64; COUNT] {
        let mut transfer = [0f64; COUNT];
        for &(w, weight) in &directions {
            let on_floor = q + w * (q.y / -w.y);
            let hidden = w.y < 0.0 && (0.0..=1.0).contains(&on_floor.x) && (0.0..=1.0).contains(&on_floor.z);
            if w.x > 0.0 && !hidden {
                let y = sh::evaluate(ORDER, w);
                (0..COUNT).for_each(|j| transfer[j] += weight * (w.x * y[j]) as f64);
            }
        }
        transfer
    };
    let nodes: Vec<(f32, f64)> =
        quadrature::gauss_legendre(12).iter().map(|&(x, w)| ((0.5 + 0.5 * x) as f32, 0.5 * w)).collect();
    // The mean over the texel, by the middle of its points' range: the texel is small against the distance.
    let at = |u: [f32; 2]| {
        let p = points.sample(u);
        asset.surface(p.triangle as usize, p.u, p.v, Vec3::ZERO).position
    };
    let p = [[0.25, 0.25], [0.25, 0.75], [0.75, 0.25], [0.75, 0.75]].map(at).into_iter().sum::<Vec3>() / 4.0;
    let mut expected = [0f64; COUNT];
    for &(y, wy) in &nodes {
        for &(z, wz) in &nodes {
            let q = Vec3::new(0.0, y, z);
            let r = q - p;
            let form = (r.normalize().y * -r.normalize().x / r.length_squared() / PI) as f64;
            let transfer = to_wall(q);
            (0..COUNT).for_each(|j| expected[j] += wy * wz * form * transfer[j]);
        }
    }

    let tracer = Tracer::new(&asset);
    let runs: Vec<ShPrt> = (0..16)
        .map(|seed| {
            bake_texels(&tracer, &lightmap, &PrtSettings { max_bounces: 1, ..settings(2048, seed) }, &Silent).unwrap()
        })
        .collect();
    let mut significant = 0;
    for j in 0..COUNT {
        let values: Vec<Rgb> = runs.iter().map(|run| run.indirect[texel * COUNT + j]).collect();
        let mean = values.iter().copied().sum::<Rgb>() / 16.0;
        let sigma = (values.iter().map(|v| (v.x - mean.x).powi(2)).sum::<f32>() / (16.0 * 15.0)).sqrt();
        // Quadrature across the floor's edge as seen from the wall, 96 × 48 directions, and the texel's extent: one
        // hundredth of the greatest coefficient.
        let tolerance = 4.0 * sigma + 0.01 * expected[0] as f32 * REFLECTANCE.x;
        let expected = expected[j] as f32 * REFLECTANCE;
        significant += (expected.x.abs() > 5.0 * tolerance) as u32;
        assert!((mean.x - expected.x).abs() < tolerance, "{j}: {} ± {sigma} for {}", mean.x, expected.x);
        // One bounce tints by the reflectance, exactly.
        assert!((mean / REFLECTANCE - mean.x / REFLECTANCE.x).abs().max_element() < 1e-4 * mean.x.abs().max(1e-2));
    }
    assert!(significant >= 6, "only {significant} coefficients are told from nothing");
}

#[test]
fn relighting_is_linear_and_lower_orders_are_truncations() {
    let asset = with_lightmap(generate("cornell").unwrap());
    let (_, prt) = bake(&asset, 16, 64, 3);
    let light = |seed: f32| -> Vec<Rgb> {
        (0..COUNT).map(|j| Vec3::new((seed * j as f32).sin(), (seed + j as f32).cos(), 0.5)).collect()
    };
    let (a, b) = (light(0.7), light(2.3));
    let sum: Vec<Rgb> = a.iter().zip(&b).map(|(a, b)| *a * 2.0 + *b).collect();
    let (of_a, of_b, of_sum) = (prt.indirect(&a), prt.indirect(&b), prt.indirect(&sum));
    assert!(of_sum.iter().any(|e| e.length() > 0.1));
    for i in 0..of_sum.len() {
        assert!((of_a[i] * 2.0 + of_b[i] - of_sum[i]).abs().max_element() < 1e-4);
    }
    let mut padded = a[..9].to_vec();
    padded.resize(COUNT, Rgb::ZERO);
    for (short, long) in prt.indirect(&a[..9]).iter().zip(prt.indirect(&padded)) {
        assert!((*short - long).abs().max_element() < 1e-5);
    }
}

#[test]
fn transfer_is_the_same_on_any_number_of_threads() {
    let asset = with_lightmap(generate("cornell").unwrap());
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bake(&asset, 16, 16, 5).1)
    };
    let one = on(1);
    assert!(one.indirect.iter().any(|t| *t != Rgb::ZERO));
    assert_eq!(one, on(3));
    assert_ne!(one, bake(&asset, 16, 16, 6).1);
}
