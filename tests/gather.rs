//! The gather integrator against closed forms and against path tracing.

use std::f32::consts::PI;

use glam::Vec3;
use relight::light::{Light, LightingCondition};
use relight::progress::Silent;
use relight::scene::{Asset, Lightmap, Material, Mesh, Tracer, UvPolicy, lay_out};
use relight::transport::{BakeError, BakeSettings, Baked, Baker, Integrator, bake};

/// The inside of a box of 2 × 2 × 2 m, each face divided into 2 × 2 quads, unwrapped for a lightmap of `size`.
fn room(material: Material, size: u32) -> (Asset, Lightmap) {
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        for side in [-1.0f32, 1.0] {
            let axes = [Vec3::X, Vec3::Y, Vec3::Z];
            let (u, v) = (axes[(axis + 1) % 3], axes[(axis + 2) % 3]);
            for (a, b) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
                let corner = axes[axis] * side + u * (a - 1.0) + v * (b - 1.0);
                let first = mesh.positions.len() as u32;
                mesh.positions.extend([corner, corner + u, corner + u + v, corner + v]);
                mesh.normals.extend([axes[axis] * -side; 4]);
                let quad = if side < 0.0 { [0, 1, 2, 3] } else { [0, 3, 2, 1] }.map(|i| first + i);
                mesh.triangles.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
                mesh.triangle_materials.extend([0; 2]);
            }
        }
    }
    laid_out(asset(mesh, vec![material]), size)
}

fn asset(mesh: Mesh, materials: Vec<Material>) -> Asset {
    Asset { name: "test".into(), mesh, materials, textures: vec![], lights: vec![], cameras: vec![], warnings: vec![] }
}

fn laid_out(mut asset: Asset, size: u32) -> (Asset, Lightmap) {
    lay_out(&mut asset, size, UvPolicy::Unwrap).unwrap();
    let lightmap = Lightmap::new(&asset.mesh, size as usize);
    (asset, lightmap)
}

fn settings(integrator: Integrator, paths: u32, seed: u64) -> BakeSettings {
    BakeSettings { paths, max_bounces: 64, seed, integrator }
}

fn of_light(light: Light) -> LightingCondition {
    LightingCondition { lights: vec![light] }
}

fn point(x: f32, y: f32, z: f32) -> LightingCondition {
    of_light(Light::Point { position: Vec3::new(x, y, z), color: Vec3::ONE, intensity: 3.0, range: None })
}

fn spot(x: f32, direction: Vec3, color: Vec3) -> LightingCondition {
    of_light(Light::Spot {
        position: Vec3::new(x, 0.2, 0.1),
        direction: direction.normalize(),
        color,
        intensity: 5.0,
        range: None,
        inner_cone_angle: 0.3,
        outer_cone_angle: 0.7,
    })
}

/// Closed box, albedo a, uniform emission 1: every texel receives π directly and π·a/(1−a) indirectly. Every ray meets the same
/// light, so that all noise is that of the direct light, found by next-event estimation: eight seeds give its standard error,
/// which a true law exceeds sixfold once in 2,000 runs (Student's t, 7 degrees of freedom). Of light
/// that is dropped once it has faded to 1e-3 at most 1e-3/(1−a) is missed.
#[test]
fn furnace_indirect_is_pi_a_over_one_minus_a() {
    for albedo in [0.0f32, 0.5, 0.8] {
        let material = Material { emissive: Vec3::ONE, ..Material::lambert("glow", Vec3::splat(albedo)) };
        let (asset, lightmap) = room(material, 32);
        let tracer = Tracer::new(&asset);
        let conditions = [of_light(Light::Emissive { scale: 1.0 })];
        let run =
            |seed| bake(&tracer, &lightmap, &conditions, &settings(Integrator::Gather, 32, seed), &Silent).unwrap();
        let means: Vec<f64> = (0..8).map(|seed| weighted_mean(&run(seed), &lightmap, 0) as f64).collect();
        let (got, sigma) = mean_and_error(&means);
        let expected = (PI * albedo / (1.0 - albedo)) as f64;
        let tolerance = expected * 1e-3 / (1.0 - albedo as f64) + 6.0 * sigma;
        assert!((got - expected).abs() <= tolerance, "albedo {albedo}: {got} ± {sigma} instead of {expected}");
        assert!(albedo == 0.0 || (got * 1.1 - expected).abs() > tolerance, "a tenth more would be told: {sigma}");
    }
}

/// Area-weighted mean over texels and channels under one condition.
fn weighted_mean(baked: &Baked, lightmap: &Lightmap, condition: usize) -> f32 {
    let n = baked.conditions;
    let (mut sum, mut area) = (0.0, 0.0);
    for (row, texel) in baked.indirect.chunks_exact(3 * n).zip(&lightmap.texels) {
        sum += (0..3).map(|c| row[c * n + condition] as f64).sum::<f64>() / 3.0 * texel.area as f64;
        area += texel.area as f64;
    }
    (sum / area) as f32
}

/// In a closed room of uniform albedo a, (1−a) ∫E dA = Φ, of which Φ is direct: the indirect flux is Φ·a/(1−a), Φ = 4πI.
/// Twelve seeds give the standard error; a true law fails once in 4,000 runs at 4.5 of them (Student's t, 11 degrees of freedom:
/// 4.4). The bias of texels is in the distribution of light, not in its sum: allowed 0.3 %.
#[test]
fn flux_of_a_point_light_in_a_closed_room() {
    let albedo = 0.6;
    let (asset, lightmap) = room(Material::lambert("grey", Vec3::splat(albedo)), 32);
    let tracer = Tracer::new(&asset);
    let estimates: Vec<f64> = (0..12)
        .map(|seed| {
            let settings = settings(Integrator::Gather, 16, seed);
            let baked = bake(&tracer, &lightmap, &[point(0.3, -0.2, 0.1)], &settings, &Silent).unwrap();
            weighted_mean(&baked, &lightmap, 0) as f64
        })
        .collect();
    let area: f32 = lightmap.texels.iter().map(|t| t.area).sum();
    let expected = (4.0 * PI * 3.0 * albedo / (1.0 - albedo) / area) as f64;
    let (mean, sigma) = mean_and_error(&estimates);
    assert!((mean - expected).abs() < 4.5 * sigma + 0.003 * expected, "{mean} ± {sigma} instead of {expected}");
    assert!((mean * 1.03 - expected).abs() > 4.5 * sigma + 0.003 * expected, "three percent more would be told");
}

/// Mean and its standard error.
fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0) / n).sqrt())
}

/// Tiles of texels: their means by `gather` and by `path` over seeds of each, as Welch's t. Šidák-corrected over about 900
/// comparisons, Student's t with 15 degrees of freedom stays under 7.5 with probability 0.998; the bias of texels may add
/// `bias` of the value.
fn largest_t(asset: &Asset, lightmap: &Lightmap, conditions: &[LightingCondition], bias: f64, factor: f64) -> f64 {
    const SEEDS: u64 = 16;
    const TILES: usize = 64;
    let tracer = Tracer::new(asset);
    let n = conditions.len();
    let tiles = |integrator, paths, seed| -> Vec<f64> {
        let baked = bake(&tracer, lightmap, conditions, &settings(integrator, paths, seed), &Silent).unwrap();
        let per_tile = lightmap.texels.len().div_ceil(TILES);
        let mut sums = Vec::new();
        for (rows, texels) in baked.indirect.chunks(per_tile * 3 * n).zip(lightmap.texels.chunks(per_tile)) {
            let area: f64 = texels.iter().map(|t| t.area as f64).sum();
            for i in 0..3 * n {
                let light = rows.chunks_exact(3 * n).zip(texels).map(|(row, t)| row[i] as f64 * t.area as f64);
                sums.push(light.sum::<f64>() / area);
            }
        }
        sums
    };
    let gathered: Vec<Vec<f64>> = (0..SEEDS).map(|seed| tiles(Integrator::Gather, 32, seed)).collect();
    let traced: Vec<Vec<f64>> = (0..SEEDS).map(|seed| tiles(Integrator::Path, 64, 100 + seed)).collect();
    let mut largest: f64 = 0.0;
    for i in 0..gathered[0].len() {
        let column = |of: &[Vec<f64>]| mean_and_error(&of.iter().map(|tile| tile[i]).collect::<Vec<_>>());
        let ((g, g_error), (p, p_error)) = (column(&gathered), column(&traced));
        let excess = ((g * factor - p).abs() - bias * p).max(0.0);
        largest = largest.max(excess / (g_error.hypot(p_error) + 1e-9));
    }
    largest
}

/// Coloured walls, white and coloured lights of two kinds, and a shelf whose back is met: one-sided, so that the lightmap knows
/// its front only.
#[test]
fn gathering_agrees_with_path_tracing() {
    let (mut asset, _) = room(Material::lambert("left", Vec3::new(0.8, 0.3, 0.2)), 64);
    asset.materials.push(Material::lambert("white", Vec3::splat(0.7)));
    let triangles = asset.mesh.triangles.len();
    asset.mesh.triangle_materials.iter_mut().enumerate().for_each(|(t, m)| *m = u32::from(t >= triangles / 6));
    let first = asset.mesh.positions.len() as u32;
    let mesh = &mut asset.mesh;
    for (x, z) in [(-0.5, -0.5), (-0.5, 0.5), (0.5, 0.5), (0.5, -0.5)] {
        mesh.positions.push(Vec3::new(x, -0.4, z));
        mesh.normals.push(Vec3::Y);
    }
    mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    mesh.triangle_materials.extend([1, 1]);
    let (asset, lightmap) = laid_out(asset, 64);
    let conditions = [
        point(0.4, 0.5, -0.3),
        spot(-0.5, Vec3::new(0.2, -1.0, 0.3), Vec3::new(1.0, 0.5, 0.2)),
        // Up at the shelf's back, past it at the floor.
        point(0.0, -0.8, 0.0),
        of_light(Light::Directional { direction: Vec3::NEG_Y, color: Vec3::ONE, intensity: 1.0 }),
    ];
    // The sun does not enter the closed room: both must say so.
    let t = largest_t(&asset, &lightmap, &conditions, 0.01, 1.0);
    assert!(t < 7.5, "largest t {t}");
    let control = largest_t(&asset, &lightmap, &conditions, 0.01, 1.1);
    assert!(control > 7.5, "a tenth more would be told: {control}");
}

/// A condition's bits depend on no other condition of any kind, no range of texels and no number of threads.
#[test]
fn a_condition_is_the_same_in_any_company() {
    let grey = Material { emissive: Vec3::new(1.0, 0.5, 0.2), ..Material::lambert("glow", Vec3::splat(0.5)) };
    let (mut asset, _) = room(grey, 24);
    // Without its first side, so that the sky is seen.
    asset.mesh.triangles.drain(..8);
    asset.mesh.triangle_materials.drain(..8);
    let (asset, lightmap) = laid_out(asset, 24);
    let tracer = Tracer::new(&asset);
    // Light has faded, or its bounces end before.
    for max_bounces in [64, 4] {
        let settings = BakeSettings { max_bounces, ..settings(Integrator::Gather, 8, 3) };
        the_same_in_any_company(&tracer, &lightmap, &settings);
    }
}

fn the_same_in_any_company(tracer: &Tracer, lightmap: &Lightmap, settings: &BakeSettings) {
    let all: Vec<LightingCondition> =
        (0..70).map(|i| point(0.01 * i as f32, 0.2, 0.0)).chain([spot(0.3, Vec3::X, Vec3::ONE)]).collect();
    let whole = bake(tracer, lightmap, &all, settings, &Silent).unwrap();
    let emission = of_light(Light::Emissive { scale: 1.0 });
    let sky = of_light(serde_json::from_str(r#"{"type": "sky", "sun_elevation": 0.7}"#).unwrap());
    let some = [emission, sky, all[3].clone(), all[70].clone()];
    let baked = bake(tracer, lightmap, &some, settings, &Silent).unwrap();
    assert!((0..2).all(|c| weighted_mean(&baked, lightmap, c) > 0.0), "emission and sky are there");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| {
        let baker = Baker::new(tracer, lightmap, &some, settings, &Silent).unwrap();
        let cut = lightmap.texels.len() / 3 + 1;
        let mut rows = baker.texels(0..cut, &Silent).unwrap().indirect;
        rows.extend(baker.texels(cut..lightmap.texels.len(), &Silent).unwrap().indirect);
        for (many, few) in whole.indirect.chunks(3 * all.len()).zip(rows.chunks(12)) {
            for channel in 0..3 {
                assert_eq!(many[channel * 71 + 3], few[channel * 4 + 2]);
                assert_eq!(many[channel * 71 + 70], few[channel * 4 + 3]);
            }
        }
    });
}

/// One bounce at most: what the walls reflect of the direct light, once. With albedo a it is linear in a.
#[test]
fn bounces_end_where_told() {
    let flux = |albedo: f32, max_bounces: u32| {
        let (asset, lightmap) = room(Material::lambert("grey", Vec3::splat(albedo)), 24);
        let tracer = Tracer::new(&asset);
        let settings = BakeSettings { max_bounces, ..settings(Integrator::Gather, 16, 1) };
        weighted_mean(&bake(&tracer, &lightmap, &[point(0.0, 0.0, 0.0)], &settings, &Silent).unwrap(), &lightmap, 0)
    };
    // The same rays read the same rows: equal to f32 rounding of the albedo's multiples.
    assert!((flux(0.8, 1) / flux(0.4, 1) - 2.0).abs() < 1e-3);
}

/// A closed room of albedo a loses no light: of flux Φ, m bounces bring Φ (a + a² + … + aᵐ), whatever the shape. In lightmaps as
/// coarse as these most rays end near, and none may read light that has bounced more often than it may, or lose what is left of
/// it. Six seeds: a true law exceeds eight standard errors once in 2,000 runs (Student's t, 5 degrees of freedom). Texels are of a
/// tenth and a twentieth of a wall: allowed 1 %; what is seen of it with one bounce is 0.1 % at
/// 128² and 0.02 % at 256².
#[test]
fn every_bounce_brings_its_flux() {
    let albedo = 0.8f64;
    let flux = 4.0 * std::f64::consts::PI * 3.0;
    for size in [32, 64] {
        let (asset, lightmap) = room(Material::lambert("grey", Vec3::splat(albedo as f32)), size);
        let tracer = Tracer::new(&asset);
        for max_bounces in [1, 2, 3, 5, 12, 100] {
            let estimates: Vec<f64> = (0..6)
                .map(|seed| {
                    let settings = BakeSettings { max_bounces, ..settings(Integrator::Gather, 128, seed) };
                    let baked = bake(&tracer, &lightmap, &[point(0.2, -0.1, 0.3)], &settings, &Silent).unwrap();
                    weighted_mean(&baked, &lightmap, 0) as f64
                })
                .collect();
            let (mean, error) = mean_and_error(&estimates);
            let expected = flux / 24.0 * (1..=max_bounces as i32).map(|j| albedo.powi(j)).sum::<f64>();
            let allowed = 8.0 * error + 0.01 * expected;
            let told = format!("{size}², {max_bounces} bounces: {mean} ± {error} instead of {expected}");
            assert!((mean - expected).abs() < allowed, "{told}");
            assert!((mean * 1.035 - expected).abs() > allowed, "3.5 percent more would not be told: {told}");
        }
    }
}

/// What a surface near a texel is lit with by a sky is in part found by the ray that leaves it, and so after the last bounce,
/// too. Twelve seeds of each integrator: their difference, as Welch's t, is under 4.5 but once in 4,000 runs. The bias of texels
/// as large as these is in the distribution of light, not in its sum: allowed 0.3 %.
#[test]
fn the_last_bounce_is_whole_under_a_sky() {
    let (mut asset, _) = room(Material::lambert("grey", Vec3::splat(0.8)), 16);
    asset.mesh.triangles.drain(..8);
    asset.mesh.triangle_materials.drain(..8);
    let (asset, lightmap) = laid_out(asset, 16);
    let tracer = Tracer::new(&asset);
    let sky = of_light(serde_json::from_str(r#"{"type": "sky", "sun_elevation": 0.7, "sun": 0}"#).unwrap());
    let flux = |integrator, paths| {
        let estimates: Vec<f64> = (0..12)
            .map(|seed| {
                let settings = BakeSettings { max_bounces: 1, ..settings(integrator, paths, seed) };
                let baked = bake(&tracer, &lightmap, std::slice::from_ref(&sky), &settings, &Silent).unwrap();
                weighted_mean(&baked, &lightmap, 0) as f64
            })
            .collect();
        mean_and_error(&estimates)
    };
    let ((g, g_error), (p, p_error)) = (flux(Integrator::Gather, 4096), flux(Integrator::Path, 4096));
    let allowed = 4.5 * g_error.hypot(p_error) + 0.003 * p;
    assert!((g - p).abs() < allowed, "{g} ± {g_error} instead of {p} ± {p_error}");
    assert!((g * 1.08 - p).abs() > allowed, "eight percent more would be told");
}

#[test]
fn glossy_materials_are_refused_by_name_or_path_traced() {
    let (mut asset, lightmap) = room(Material::lambert("chrome", Vec3::ONE), 24);
    asset.materials[0].reflectance = relight::scene::Reflectance::MetallicRoughness;
    let tracer = Tracer::new(&asset);
    let run = |integrator| bake(&tracer, &lightmap, &[point(0.0, 0.0, 0.0)], &settings(integrator, 2, 1), &Silent);
    let error = run(Integrator::Gather).err().unwrap();
    assert!(matches!(&error, BakeError::NotDiffuse { material } if material == "chrome"), "{error}");
    let (auto, path) = (run(Integrator::Auto).unwrap(), run(Integrator::Path).unwrap());
    assert_eq!(auto.indirect, path.indirect);
}
