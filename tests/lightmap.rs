//! Lightmap layout and texels.

mod common;

use std::path::PathBuf;

use common::{asset_trial, trial};
use glam::{Vec2, Vec3};
use libtest_mimic::Arguments;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use relight::math::Rgb;
use relight::scene::{Asset, Lightmap, LightmapSource, Material, Mesh, UvPolicy, lay_out, load};

fn main() {
    let trials = vec![
        trial("texel_areas_sum_to_the_surface", texel_areas_sum_to_the_surface),
        trial("fragments_tile_each_triangle", fragments_tile_each_triangle),
        trial("samples_lie_in_their_texel", samples_lie_in_their_texel),
        trial("samples_are_uniform_by_area", samples_are_uniform_by_area),
        trial("sources_matches_brute_force", sources_matches_brute_force),
        trial("good_uv_set_is_used", good_uv_set_is_used),
        trial("shared_edges_do_not_overlap", shared_edges_do_not_overlap),
        trial("bad_uv_sets_are_refused_with_reasons", bad_uv_sets_are_refused_with_reasons),
        trial("unwrap_keeps_the_surface", unwrap_keeps_the_surface),
        asset_trial("cornell_whose_objects_each_fill_the_page_is_unwrapped", "CornellBox/CornellBox.glb", |p| {
            assert!(matches!(real(p, 128), LightmapSource::Unwrapped { .. }));
        }),
        asset_trial("viking_room_overlaps_and_is_unwrapped", "viking_room/viking_room.obj", |p| {
            let mut asset = load(&p).unwrap();
            let error = lay_out(&mut asset, 1024, UvPolicy::Texcoord0).unwrap_err().to_string();
            // 37.8 % by an independent count.
            assert!(error.contains("TEXCOORD_0 overlaps itself on 37.") && error.contains("uv = \"auto\""), "{error}");
            assert!(matches!(real(p, 512), LightmapSource::Unwrapped { .. }));
        }),
        asset_trial("mixed_lighting", "MixedLightingExample/MixedLightingExample.gltf", |p| _ = real(p, 512)),
        asset_trial("barn_lamp", "AnisotropyBarnLamp/AnisotropyBarnLamp.gltf", |p| {
            assert!(matches!(real(p, 512), LightmapSource::Unwrapped { .. }));
        }),
        asset_trial("flight_helmet", "FlightHelmet/FlightHelmet.gltf", |p| _ = real(p, 512)),
        asset_trial("fox", "Fox/Fox.glb", |p| _ = real(p, 256)),
        asset_trial("living_room", "godot_living_room/living_room.glb", |p| _ = real(p, 512)),
        asset_trial("spot", "spot/spot_triangulated.obj", |p| _ = real(p, 256)),
        asset_trial("embree_cornell_box", "embree_models/cornell_box.obj", |p| {
            assert!(matches!(real(p, 128), LightmapSource::Unwrapped { .. }));
        }),
    ];
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}

/// Lays out a real asset; all but a thousandth of its surface must lie on texels or inside a wall.
fn real(path: PathBuf, size: u32) -> LightmapSource {
    let mut asset = load(&path).unwrap_or_else(|e| panic!("{e}"));
    let start = std::time::Instant::now();
    let choice = lay_out(&mut asset, size, UvPolicy::Auto).unwrap_or_else(|e| panic!("{e}"));
    let laid_out = start.elapsed();
    let lightmap = Lightmap::new(&asset.mesh, size as usize);
    let name = path.file_name().unwrap().to_string_lossy();
    println!("{name}: {size}²: {:?}, {laid_out:?}, texels {:?}", choice.reasons, start.elapsed() - laid_out);
    assert_eq!(asset.mesh.lightmap_uvs.len(), asset.mesh.positions.len());
    let (texels, surface) = (texel_area(&lightmap), surface_area(&asset.mesh));
    let inside = match choice.source {
        LightmapSource::Unwrapped { inside, .. } => f64::from(inside) * surface,
        _ => 0.0,
    };
    assert!((texels + inside - surface).abs() < 1e-3 * surface, "{texels} and {inside} inside of {surface}");
    choice.source
}

fn surface_area(mesh: &Mesh) -> f64 {
    (0..mesh.triangles.len()).map(|t| mesh.triangle_cross(t).as_dvec3().length() * 0.5).sum()
}

fn texel_area(lightmap: &Lightmap) -> f64 {
    lightmap.texels.iter().map(|t| t.area as f64).sum()
}

/// Triangles at random places, in space and in the page.
fn random_mesh(seed: u64, triangles: usize) -> Mesh {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut mesh = Mesh::default();
    for t in 0..triangles as u32 {
        let radius = 1e-3 + 0.3 * rng.random::<f32>().powi(3);
        let centre = radius + (1.0 - 2.0 * radius) * Vec2::new(rng.random(), rng.random());
        for _ in 0..3 {
            let offset = Vec2::new(rng.random(), rng.random()) * 2.0 - 1.0;
            mesh.positions.push(Vec3::new(rng.random(), rng.random(), rng.random()));
            mesh.normals.push(Vec3::Y);
            mesh.lightmap_uvs.push((centre + radius * offset).clamp(Vec2::ZERO, Vec2::ONE));
        }
        mesh.triangles.push([3 * t, 3 * t + 1, 3 * t + 2]);
        mesh.triangle_materials.push(0);
    }
    mesh
}

/// A grid of n² squares over the whole page, as its own texture coordinates: a UV set without fault.
fn grid_asset(n: u32) -> Asset {
    let mut mesh = Mesh::default();
    for y in 0..=n {
        for x in 0..=n {
            let uv = Vec2::new(x as f32, y as f32) / n as f32;
            mesh.positions.push(Vec3::new(uv.x, (uv.x * 3.0).sin() * 0.1, uv.y));
            mesh.normals.push(Vec3::Y);
            mesh.uvs[0].push(uv);
        }
    }
    for y in 0..n {
        for x in 0..n {
            let v = |dx: u32, dy: u32| (y + dy) * (n + 1) + x + dx;
            mesh.triangles.extend([[v(0, 0), v(0, 1), v(1, 1)], [v(0, 0), v(1, 1), v(1, 0)]]);
        }
    }
    mesh.triangle_materials = vec![0; mesh.triangles.len()];
    Asset {
        name: "grid".to_owned(),
        mesh,
        materials: vec![Material::lambert("grey", Rgb::splat(0.5))],
        textures: Vec::new(),
        lights: Vec::new(),
        cameras: Vec::new(),
        warnings: Vec::new(),
    }
}

fn texel_areas_sum_to_the_surface() {
    for (seed, triangles, size) in [(1, 1, 1), (2, 1, 64), (3, 50, 7), (4, 500, 64), (5, 20, 333)] {
        let mesh = random_mesh(seed, triangles);
        let (texels, surface) = (texel_area(&Lightmap::new(&mesh, size)), surface_area(&mesh));
        // Each texel's area is rounded to f32.
        assert!((texels - surface).abs() <= 1e-6 * surface, "seed {seed}: {texels} of {surface}");
    }
}

/// Fragments recomputed on demand are those that made the texel's area, and a triangle's fragments add up to it.
fn fragments_tile_each_triangle() {
    let mesh = random_mesh(11, 60);
    let lightmap = Lightmap::new(&mesh, 40);
    let mut areas = vec![0.0; mesh.triangles.len()];
    for (t, texel) in lightmap.texels.iter().enumerate() {
        let fragments = lightmap.fragments(&mesh, t);
        assert!(fragments.iter().map(|f| f.triangle).eq(lightmap.triangles(t).iter().copied()));
        let area: f64 = fragments.iter().map(|f| f.area_m2).sum();
        assert_eq!(area as f32, texel.area);
        fragments.iter().for_each(|f| areas[f.triangle as usize] += f.area_m2);
    }
    for (t, area) in areas.iter().enumerate() {
        let whole = mesh.triangle_cross(t).as_dvec3().length() * 0.5;
        assert!((area - whole).abs() < 1e-5 * whole, "triangle {t}: {area} of {whole}");
    }
}

fn samples_lie_in_their_texel() {
    let mut rng = Pcg64Mcg::seed_from_u64(21);
    for (seed, triangles, size) in [(21, 3, 5), (22, 100, 32), (23, 30, 200)] {
        let mesh = random_mesh(seed, triangles);
        let lightmap = Lightmap::new(&mesh, size);
        for t in (0..lightmap.texels.len()).step_by(7) {
            let sampler = lightmap.sampler(&mesh, t);
            let index = lightmap.texels[t].index as usize;
            let corner = Vec2::new((index % size) as f32, (index / size) as f32);
            for _ in 0..16 {
                let p = sampler.sample([rng.random(), rng.random()]);
                assert!(p.u >= 0.0 && p.v >= 0.0 && p.u + p.v <= 1.0 + 1e-6);
                let uv = mesh.interpolate(&mesh.lightmap_uvs, p.triangle as usize, p.u, p.v) * size as f32;
                // f32 barycentric coordinates of a triangle that may be as wide as the page.
                let tolerance = 1e-6 * size as f32;
                assert!((uv - corner).cmpge(Vec2::splat(-tolerance)).all(), "{uv} {corner}");
                assert!((uv - corner).cmple(Vec2::splat(1.0 + tolerance)).all(), "{uv} {corner}");
            }
        }
    }
}

/// The page as one texel: sampled triangles follow their areas, and points inside the largest one its four congruent
/// quarters. χ² with k − 1 degrees of freedom exceeds k − 1 + 5 √(2 (k − 1)) with a probability under 10⁻⁵.
fn samples_are_uniform_by_area() {
    let mesh = random_mesh(31, 12);
    let lightmap = Lightmap::new(&mesh, 1);
    let sampler = lightmap.sampler(&mesh, 0);
    const N: usize = 100_000;
    let mut counts = [0usize; 12];
    let mut quarters = vec![[0usize; 4]; 12];
    let mut rng = Pcg64Mcg::seed_from_u64(32);
    for _ in 0..N {
        let p = sampler.sample([rng.random(), rng.random()]);
        counts[p.triangle as usize] += 1;
        let quarter = if p.u > 0.5 {
            1
        } else if p.v > 0.5 {
            2
        } else if p.u + p.v < 0.5 {
            0
        } else {
            3
        };
        quarters[p.triangle as usize][quarter] += 1;
    }
    let total = surface_area(&mesh);
    let expected: Vec<f64> =
        (0..12).map(|t| N as f64 * mesh.triangle_cross(t).as_dvec3().length() * 0.5 / total).collect();
    assert_chi_squared(&counts, &expected);
    let largest = (0..12).max_by_key(|&t| counts[t]).unwrap();
    assert_chi_squared(&quarters[largest], &[counts[largest] as f64 / 4.0; 4]);
    // Control: shares that are off by a tenth are found out.
    let mut wrong = expected.clone();
    wrong[largest] *= 0.9;
    assert!(chi_squared(&counts, &wrong) > limit(12));
}

fn chi_squared(counts: &[usize], expected: &[f64]) -> f64 {
    counts.iter().zip(expected).map(|(&c, &e)| (c as f64 - e).powi(2) / e).sum()
}

fn limit(cells: usize) -> f64 {
    let freedom = (cells - 1) as f64;
    freedom + 5.0 * (2.0 * freedom).sqrt()
}

fn assert_chi_squared(counts: &[usize], expected: &[f64]) {
    let value = chi_squared(counts, expected);
    assert!(value < limit(counts.len()), "χ² = {value}: {counts:?} for {expected:?}");
}

fn sources_matches_brute_force() {
    for (seed, triangles, size) in [(41, 1, 17), (42, 3, 40), (43, 40, 33)] {
        let mesh = random_mesh(seed, triangles);
        let lightmap = Lightmap::new(&mesh, size);
        let nearest = lightmap.sources();
        let at = |index: usize| ((index % size) as i64, (index / size) as i64);
        for (index, &found) in nearest.iter().enumerate() {
            let distance = |t: usize| {
                let ((x, y), (cx, cy)) = (at(index), at(lightmap.texels[t].index as usize));
                (x - cx).pow(2) + (y - cy).pow(2)
            };
            let least = (0..lightmap.texels.len()).map(distance).min().unwrap();
            assert_eq!(distance(found as usize), least, "seed {seed} at {:?}", at(index));
        }
    }
}

fn good_uv_set_is_used() {
    let mut asset = grid_asset(8);
    let choice = lay_out(&mut asset, 64, UvPolicy::Auto).unwrap();
    assert_eq!(choice.source, LightmapSource::Texcoord0);
    assert_eq!(asset.mesh.lightmap_uvs, asset.mesh.uvs[0]);
}

/// Neither edges through texel centres nor edges anywhere else are counted twice.
fn shared_edges_do_not_overlap() {
    for n in [1, 3, 64, 1000] {
        let mut asset = grid_asset(n);
        let choice = lay_out(&mut asset, 1024, UvPolicy::Texcoord0).unwrap();
        assert_eq!(choice.reasons, Vec::<String>::new(), "{n}");
    }
}

fn bad_uv_sets_are_refused_with_reasons() {
    let refused = |change: fn(&mut Vec<Vec2>)| {
        let mut asset = grid_asset(8);
        change(&mut asset.mesh.uvs[0]);
        let auto = lay_out(&mut asset.clone(), 64, UvPolicy::Auto).unwrap();
        assert!(matches!(auto.source, LightmapSource::Unwrapped { .. }), "{auto:?}");
        assert!(auto.reasons[0].starts_with("TEXCOORD_0 ") && auto.reasons[0].contains("; unwrapped anew into"));
        lay_out(&mut asset, 64, UvPolicy::Texcoord0).unwrap_err().to_string()
    };
    let folded = refused(|uvs| uvs.iter_mut().for_each(|uv| uv.x = (uv.x - 0.5).abs()));
    assert!(folded.contains("overlaps itself on 100.0 %"), "{folded}");
    let outside = refused(|uvs| uvs.iter_mut().for_each(|uv| *uv *= 1.5));
    assert!(outside.contains("leaves [0, 1]"), "{outside}");
    let flat = refused(|uvs| uvs.iter_mut().take(18).for_each(|uv| uv.y = 0.0));
    assert!(flat.contains("has no area for 12.") && flat.contains("uv = \"auto\""), "{flat}");
    let missing = lay_out(&mut grid_asset(2), 64, UvPolicy::Texcoord1).unwrap_err().to_string();
    assert!(missing.contains("TEXCOORD_1 does not exist"), "{missing}");
    // Wasteful, not useless: refused by auto alone.
    let mut small = grid_asset(8);
    small.mesh.uvs[0].iter_mut().for_each(|uv| *uv *= 0.2);
    let auto = lay_out(&mut small.clone(), 64, UvPolicy::Auto).unwrap();
    assert!(auto.reasons[0].contains("covers only 4.0 % of the page"), "{:?}", auto.reasons);
    assert_eq!(lay_out(&mut small, 64, UvPolicy::Texcoord0).unwrap().source, LightmapSource::Texcoord0);
}

fn unwrap_keeps_the_surface() {
    let mut asset = grid_asset(6);
    asset.mesh.colours = asset.mesh.positions.clone();
    let before = asset.mesh.clone();
    let choice = lay_out(&mut asset, 64, UvPolicy::Unwrap).unwrap();
    assert!(matches!(choice.source, LightmapSource::Unwrapped { coverage, .. } if coverage > 0.4), "{choice:?}");
    for t in 0..before.triangles.len() {
        assert_eq!(before.triangle_positions(t), asset.mesh.triangle_positions(t));
        let colours = asset.mesh.triangles[t].map(|v| asset.mesh.colours[v as usize]);
        assert_eq!(colours, before.triangle_positions(t));
    }
    // The same bits again.
    let mut again = grid_asset(6);
    lay_out(&mut again, 64, UvPolicy::Unwrap).unwrap();
    assert_eq!(again.mesh.lightmap_uvs, asset.mesh.lightmap_uvs);
}
