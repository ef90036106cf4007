//! Every kind of light against closed forms, its sampling against its density, and what stands for it where light is measured.

use std::f32::consts::{PI, TAU};

use glam::{DVec3, Vec2, Vec3};
use relight::light::area::{AreaTable, Placed};
use relight::light::{
    EmissionFacets, EnvironmentImage, EnvironmentMap, Light, LightSet, LightTable, LightingCondition, Sky,
};
use relight::math::{LANES, Rgb, Sampler, colour::luminance, quadrature};
use relight::scene::{Asset, Bsdf, Material, Mesh, Reflectance, Surface, Tracer};
use relight::transport::{LightSums, Walk};

const SEED: u64 = 5;

fn quads(quads: &[[Vec3; 3]], material: Material) -> Asset {
    let mut mesh = Mesh::default();
    for &[corner, e0, e1] in quads {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend([corner, corner + e0, corner + e0 + e1, corner + e1]);
        mesh.normals.extend([e0.cross(e1).normalize(); 4]);
        mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        mesh.triangle_materials.extend([0; 2]);
    }
    let materials = vec![material];
    Asset { name: "test".into(), mesh, materials, textures: vec![], lights: vec![], cameras: vec![], warnings: vec![] }
}

/// A floor at y = 0, of albedo a, `half` metres to each side, that sees nothing but light.
fn floor(half: f32, albedo: f32) -> Asset {
    let corner = Vec3::new(-half, 0.0, half);
    quads(&[[corner, Vec3::X * 2.0 * half, Vec3::NEG_Z * 2.0 * half]], Material::lambert("white", Vec3::splat(albedo)))
}

fn receiver(position: Vec3, normal: Vec3) -> Surface {
    let bsdf = Bsdf { diffuse: Vec3::ONE, f0: Vec3::ZERO, alpha: 1.0, specular: false };
    Surface { position, geometric_normal: normal, normal, bsdf, emitted: Vec3::ZERO, back: false }
}

fn rect(position: Vec3, direction: Vec3, size: [f32; 2]) -> Light {
    Light::Rect { position, direction, up: Vec3::Y, size, color: Vec3::ONE, radiance: 1.0 }
}

fn disk(position: Vec3, direction: Vec3, radius: f32) -> Light {
    Light::Disk { position, direction, radius, color: Vec3::ONE, radiance: 1.0 }
}

fn sphere(position: Vec3, radius: f32) -> Light {
    Light::Sphere { position, radius, color: Vec3::ONE, radiance: 1.0 }
}

fn environment(map: EnvironmentMap) -> Light {
    Light::Environment {
        image: EnvironmentImage::from_map("map", map),
        rotation: 0.0,
        color: Vec3::ONE,
        intensity: 1.0,
    }
}

/// Half red, half green, one texel of them a hundred times as bright.
fn uneven() -> EnvironmentMap {
    let mut texels: Vec<Rgb> = (0..16 * 8)
        .map(|i| Vec3::new(1.0 + (i % 16) as f32 * 0.1, 2.0 - (i / 16) as f32 * 0.1, 0.3 + (i % 3) as f32))
        .collect();
    texels[2 * 16 + 5] *= 100.0;
    EnvironmentMap::new(16, 8, texels)
}

#[derive(Clone, Copy, Debug)]
struct Estimate {
    mean: f64,
    sigma: f64,
}

impl Estimate {
    /// Mean of `runs` independent means of 64 samples, and its standard error.
    fn of(runs: u32, mut one: impl FnMut(u64, u32) -> f64) -> Self {
        let means: Vec<f64> =
            (0..runs).map(|run| (0..64).map(|sample| one(run as u64, sample)).sum::<f64>() / 64.0).collect();
        let n = runs as f64;
        let mean = means.iter().sum::<f64>() / n;
        let variance = means.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
        Self { mean, sigma: (variance / n).sqrt() }
    }

    /// Four standard errors, and the rounding of f32 sums.
    fn is(&self, expected: f64) -> bool {
        (self.mean - expected).abs() <= 4.0 * self.sigma + 3e-5 * expected.abs()
    }

    /// The law holds, and the test is fine enough to tell it from one that is `control` off.
    #[track_caller]
    fn assert_is(&self, expected: f64, control: f64) {
        assert!(self.is(expected), "{self:?}, expected {expected}");
        assert!(!self.is(expected * (1.0 + control)), "{self:?} cannot tell {control}");
    }
}

/// Red light that `light` sends to `from` directly.
fn direct(asset: &Asset, light: &Light, from: &Surface) -> Estimate {
    let tracer = Tracer::new(asset);
    let set = LightSet::new([light]);
    let walk = Walk { tracer: &tracer, emitters: None, max_bounces: 8 };
    let mut sums = LightSums::new(&set, &tracer);
    Estimate::of(64, |run, sample| {
        let mut sampler = Sampler::new(SEED, run, sample);
        let [u0, u1, ..] = sampler.next_4d();
        sums.clear();
        sums.add_direct(&walk, from, Vec2::new(u0, u1), &mut sampler);
        sums.direct.lights.iter().enumerate().map(|(l, sum)| (*sum * set.colour(l)).x as f64).sum()
    })
}

/// Lambert's formula: irradiance of a point at the origin, with `normal`, under a polygon of radiance 1 that is all above its
/// horizon: ½ Σ Θᵢ Γᵢ·n (Arvo, *Analytic Methods for Simulated Light Transport*, 1995, equation 2.7).
fn polygon_irradiance(corners: &[Vec3], normal: Vec3) -> f64 {
    let unit: Vec<DVec3> = corners.iter().map(|c| c.as_dvec3().normalize()).collect();
    let edges = (0..unit.len()).map(|i| (unit[i], unit[(i + 1) % unit.len()]));
    let sum: f64 = edges.map(|(a, b)| a.dot(b).acos() * a.cross(b).normalize().dot(normal.as_dvec3())).sum();
    (0.5 * sum).abs()
}

fn corners(light: &Light, seen_from: Vec3) -> Vec<Vec3> {
    let Light::Rect { position, .. } = *light else { panic!("a rectangle") };
    let ([u, v], _) = light.half_axes().unwrap();
    [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(a, b)| position + u * a + v * b - seen_from).to_vec()
}

#[test]
fn rectangle_sends_what_lamberts_formula_says() {
    let asset = floor(10.0, 0.5);
    for (direction, size) in [(Vec3::NEG_Y, [1.0, 2.0]), (Vec3::new(0.6, -0.8, 0.0), [0.7, 0.4])] {
        let light = rect(Vec3::new(-0.3, 1.5, 0.4), direction, size);
        for at in [Vec3::ZERO, Vec3::new(0.4, 0.0, -0.2)] {
            // Light is gathered just off the surface.
            let off = at + Vec3::Y * Tracer::new(&asset).offset;
            let expected = polygon_irradiance(&corners(&light, off), Vec3::Y);
            direct(&asset, &light, &receiver(at, Vec3::Y)).assert_is(expected, 0.01);
        }
    }
    // Its back is dark.
    let turned = rect(Vec3::new(0.0, 1.5, 0.0), Vec3::Y, [1.0, 1.0]);
    assert_eq!(direct(&asset, &turned, &receiver(Vec3::ZERO, Vec3::Y)).mean, 0.0);
}

/// E = π L r² / (r² + h²) below a disk's middle.
#[test]
fn disk_sends_pi_r2_over_r2_plus_h2() {
    let asset = floor(10.0, 0.5);
    for (radius, height) in [(0.5f64, 1.0f64), (2.0, 0.7)] {
        let light = disk(Vec3::Y * height as f32, Vec3::NEG_Y, radius as f32);
        let expected = std::f64::consts::PI * radius * radius / (radius * radius + height * height);
        // The offset off the surface moves h by 3e-4 m at most.
        let moved = Tracer::new(&asset).offset as f64 / height;
        let estimate = direct(&asset, &light, &receiver(Vec3::NEG_Y * Tracer::new(&asset).offset, Vec3::Y));
        assert!(moved < 1e-3);
        estimate.assert_is(expected, 0.05);
    }
}

/// E = π L (r/d)² cos θ for a sphere above the horizon, at any distance.
#[test]
fn sphere_sends_pi_r2_over_d2() {
    let asset = floor(10.0, 0.5);
    let offset = Tracer::new(&asset).offset;
    for (centre, radius) in [(Vec3::new(0.0, 1.0, 0.0), 0.9), (Vec3::new(1.0, 2.0, -0.5), 0.3), (Vec3::Y * 5.0, 0.01)] {
        let d2 = centre.length_squared() as f64;
        let expected = std::f64::consts::PI * (radius as f64).powi(2) / d2 * centre.y as f64 / d2.sqrt();
        let estimate = direct(&asset, &sphere(centre, radius), &receiver(Vec3::NEG_Y * offset, Vec3::Y));
        estimate.assert_is(expected, 0.01);
    }
    // From inside, nothing is seen.
    let around = sphere(Vec3::ZERO, 3.0);
    assert_eq!(direct(&asset, &around, &receiver(Vec3::ZERO, Vec3::Y)).mean, 0.0);
}

/// E = π L under a uniform environment, whatever the normal; and with half of it black, what the lit half sends.
#[test]
fn uniform_environment_sends_pi() {
    let asset = floor(0.01, 0.5);
    let light = environment(EnvironmentMap::new(8, 4, vec![Vec3::ONE; 32]));
    for normal in [Vec3::Y, Vec3::new(0.6, 0.8, 0.0)] {
        let at = Vec3::new(50.0, 3.0, 0.0);
        direct(&asset, &light, &receiver(at, normal)).assert_is(PI as f64, 0.01);
    }
}

/// An uneven environment's light is the sum over its texels, however it is turned.
#[test]
fn turned_environment_sends_the_sum_of_its_texels() {
    let asset = floor(0.01, 0.5);
    let map = uneven();
    for (rotation, normal) in [(0.0f32, Vec3::Y), (0.7, Vec3::new(0.8, 0.6, 0.0)), (4.0, Vec3::new(-0.6, 0.0, 0.8))] {
        let (sin, cos) = rotation.sin_cos();
        // The map turns one way as the normal turns the other.
        let local = Vec3::new(normal.x * cos - normal.z * sin, normal.y, normal.z * cos + normal.x * sin);
        // The sum's midpoint rule in finer texels of the same radiance.
        let fine: Vec<Rgb> =
            (0..256 * 128).map(|i| map.radiances().nth(i / 256 / 16 * 16 + i % 256 / 16).unwrap()).collect();
        let expected = EnvironmentMap::new(256, 128, fine).irradiance(local).x as f64;
        let light = Light::Environment {
            image: EnvironmentImage::from_map("map", map.clone()),
            rotation,
            color: Vec3::ONE,
            intensity: 1.0,
        };
        // 2e-4: the midpoint rule at the horizon, which cuts texels of 1.4°.
        let estimate = direct(&asset, &light, &receiver(Vec3::new(50.0, 0.0, 0.0), normal));
        assert!((estimate.mean - expected).abs() < 4.0 * estimate.sigma + 2e-4 * expected, "{estimate:?} {expected}");
        assert!(!estimate.is(expected * 1.02));
    }
}

/// A box without a lid under uniform light of radiance 1, albedo a: the flux through the opening is what the walls absorb and
/// what leaves again. In the limit of a box of mirrors none is known, but with albedo 1 nothing is absorbed: radiance 1
/// everywhere, so that the walls receive π in all, and of it π − direct by reflection.
#[test]
fn open_white_box_in_a_uniform_environment_is_a_furnace() {
    let h = 0.5;
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    let c = Vec3::new(-h, 0.0, -h);
    let walls = [[c + z, x, -z], [c, x, y], [c + x + z, -x, y], [c + z, -z, y], [c + x, z, y]];
    for specular in [false, true] {
        let mut material = Material::lambert("white", Vec3::ONE);
        if specular {
            // A metal this smooth reflects nearly all: single scattering loses under two percent at α = 0.04.
            (material.reflectance, material.metallic, material.roughness) = (Reflectance::MetallicRoughness, 1.0, 0.2);
        }
        let asset = quads(&walls, material);
        let tracer = Tracer::new(&asset);
        let light = environment(EnvironmentMap::new(8, 4, vec![Vec3::ONE; 32]));
        let set = LightSet::new([&light]);
        let walk = Walk { tracer: &tracer, emitters: None, max_bounces: 400 };
        let mut sums = LightSums::new(&set, &tracer);
        let from = receiver(Vec3::new(0.1, 1e-5, 0.2), Vec3::Y);
        let total = Estimate::of(1024, |run, sample| {
            let mut sampler = Sampler::new(SEED, run, sample);
            let [u0, u1, ..] = sampler.next_4d();
            sums.clear();
            sums.add_direct(&walk, &from, Vec2::new(u0, u1), &mut sampler);
            let direct = sums.direct.lights[0].x;
            sums.clear();
            walk.from_receiver(&from, Vec2::new(u0, u1), &mut sampler, &mut sums);
            (direct + sums.indirect.lights[0].x) as f64
        });
        if specular {
            assert!(total.mean < PI as f64 + 4.0 * total.sigma && total.mean > 0.93 * PI as f64, "{total:?}");
        } else {
            total.assert_is(PI as f64, 0.02);
        }
    }
}

/// The sky's table sends what the model's closed form integrates to, on level and on tilted surfaces.
#[test]
fn sky_sends_the_integral_of_its_closed_form() {
    for (elevation, turbidity) in [(0.2f32, 2.5f32), (0.8, 3.0), (1.5, 6.0)] {
        let sky = Sky { sun_azimuth: 0.9, turbidity, ground_albedo: 0.0, sun: 0.0, ..Sky::at(elevation) };
        let points = quadrature::sphere(160);
        for normal in [Vec3::Y, Vec3::new(0.6, 0.8, 0.0), Vec3::new(0.0, 0.5, -0.866_025_4)] {
            let above = points.iter().filter(|(d, _)| d.y > 0.0 && d.dot(normal) > 0.0);
            let expected: f64 = above.map(|(d, w)| luminance(sky.radiance(*d)) as f64 * d.dot(normal) as f64 * w).sum();
            let (sin, cos) = sky.rotation().sin_cos();
            let local = Vec3::new(normal.x * cos - normal.z * sin, normal.y, normal.z * cos + normal.x * sin);
            let got = luminance(sky.tabulate().irradiance(local)) as f64;
            // The table is constant over 5.6°, whose square over 24 is 4e-4 of the second derivatives; tilted surfaces cut
            // texels at the horizon, too.
            assert!((got / expected - 1.0).abs() < 5e-3, "{elevation} {normal}: {got} for {expected}");
        }
    }
}

/// Luminances that Preetham's coefficients give, from an implementation of its own in double precision at turbidity 3 and the
/// sun 45° high: at the zenith Yz = (4.0453·3 − 4.971) tan χ − 0.2155·3 + 2.4192 with χ = (4/9 − 3/120) π/2.
#[test]
fn sky_zenith_has_the_published_luminance() {
    let chi = (4.0 / 9.0 - 3.0 / 120.0) * std::f64::consts::FRAC_PI_2;
    let expected = 1000.0 * ((4.0453 * 3.0 - 4.971) * chi.tan() - 0.2155 * 3.0 + 2.4192);
    let sky = Sky::at(std::f32::consts::FRAC_PI_4);
    let got = luminance(sky.radiance(Vec3::Y)) as f64;
    assert!((got / expected - 1.0).abs() < 2e-3, "{got} for {expected}");
    // The sky is blue, and brightest about the sun; a low sun is red.
    let zenith = sky.radiance(Vec3::Y);
    assert!(zenith.z > 1.5 * zenith.x, "{zenith}");
    assert!(luminance(sky.radiance(sky.towards_sun())) > 2.0 * luminance(zenith));
    let low = Sky::at(0.05).sun_illuminance();
    assert!(low.x > 4.0 * low.z && low.max_element() < 0.3 * sky.sun_illuminance().max_element(), "{low}");
}

/// Indirect light in a closed room of albedo a is a/(1 − a) of the flux: π A L from a rectangle or disk, 4 π² r² L from a sphere.
#[test]
fn indirect_flux_in_a_closed_room_is_a_over_one_minus_a_of_the_light() {
    let h = 1.0f32;
    let mut walls = Vec::new();
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let axes = [Vec3::X, Vec3::Y, Vec3::Z];
            let (u, v) = (axes[(axis + 1) % 3] * 2.0 * h, axes[(axis + 2) % 3] * 2.0 * h);
            let corner = axes[axis] * h * side - (u + v) / 2.0;
            walls.push(if side < 0.0 { [corner, u, v] } else { [corner, v, u] });
        }
    }
    let albedo = 0.5f32;
    let asset = quads(&walls, Material::lambert("grey", Vec3::splat(albedo)));
    let tracer = Tracer::new(&asset);
    let at = Vec3::new(0.1, 0.2, -0.1);
    let down = Vec3::new(0.6, -0.8, 0.0);
    let lights = [
        (rect(at, down, [0.5, 0.8]), PI * 0.4),
        (disk(at, down, 0.3), PI * PI * 0.09),
        (sphere(at, 0.3), 4.0 * PI * PI * 0.09),
    ];
    for (light, flux) in lights {
        let set = LightSet::new([&light]);
        let walk = Walk { tracer: &tracer, emitters: None, max_bounces: 100 };
        let mut sums = LightSums::new(&set, &tracer);
        let estimate = Estimate::of(400, |run, sample| {
            let mut sampler = Sampler::new(SEED, run, sample);
            let [u0, u1, u2, u3] = sampler.next_4d();
            let triangle = ((u0 * 12.0) as usize).min(11);
            let from =
                asset.surface(triangle, (u0 * 12.0).fract().sqrt() * u1, 1.0 - (u0 * 12.0).fract().sqrt(), Vec3::ZERO);
            sums.clear();
            walk.from_receiver(&from, Vec2::new(u2, u3), &mut sampler, &mut sums);
            (sums.indirect.lights[0].x * 24.0) as f64
        });
        estimate.assert_is((flux * albedo / (1.0 - albedo)) as f64, 0.05);
    }
}

/// A glossy floor shows an area light the same however it is found: by light samples and by the paths that meet it.
#[test]
fn glossy_reflection_of_lights_does_not_depend_on_how_it_is_weighted() {
    let material = |roughness: f32| Material {
        reflectance: Reflectance::MetallicRoughness,
        metallic: 1.0,
        roughness,
        ..Material::lambert("metal", Vec3::ONE)
    };
    let lights = [
        rect(Vec3::new(0.5, 1.0, 0.0), Vec3::new(-0.4, -0.9, 0.0).normalize(), [0.6, 0.4]),
        sphere(Vec3::new(0.5, 1.0, 0.2), 0.25),
        disk(Vec3::new(0.5, 1.0, 0.2), Vec3::NEG_Y, 0.3),
        environment(uneven()),
    ];
    for roughness in [0.4, 0.8] {
        let corner = Vec3::new(-10.0, 0.0, 10.0);
        let asset = quads(&[[corner, Vec3::X * 20.0, Vec3::NEG_Z * 20.0]], material(roughness));
        let tracer = Tracer::new(&asset);
        let surface = asset.surface(0, 0.0, 0.5, Vec3::ZERO);
        let to_view = Vec3::new(-0.6, 0.8, 0.0);
        for light in &lights {
            let set = LightSet::new([light]);
            let walk = Walk { tracer: &tracer, emitters: None, max_bounces: 0 };
            let mut sums = LightSums::new(&set, &tracer);
            let both = Estimate::of(256, |run, sample| {
                let mut sampler = Sampler::new(SEED, run, sample);
                sampler.next_4d();
                sums.clear();
                sums.add_seen(&surface, to_view, &sampler);
                if let Some(s) = surface.bsdf.sample(surface.normal, to_view, sampler.next_4d()) {
                    walk.continue_along(&surface, s.direction, s.weight, s.pdf, &mut sampler, &mut sums);
                }
                sums.direct.lights[0].x as f64
            });
            // The truth: the reflection's own directions and the light's geometry, no weights.
            let shown = seen_along(light, surface.position + Vec3::Y * tracer.offset);
            let plain = Estimate::of(4096, |run, sample| {
                let u = Sampler::new(SEED + 1, run, sample).next_4d();
                let sampled = surface.bsdf.sample(surface.normal, to_view, u);
                sampled.map_or(0.0, |s| s.weight.x as f64 * shown(s.direction))
            });
            let sigma = both.sigma.hypot(plain.sigma);
            let agrees = |factor: f64| (both.mean - plain.mean * factor).abs() < 4.0 * sigma;
            assert!(agrees(1.0), "{light:?} {roughness}: {both:?}, {plain:?}");
            // Sixteen times as many samples: the plain way has four times this error at equal samples.
            assert!(both.sigma < 4.0 * plain.sigma, "{both:?} {plain:?}");
            assert!(!agrees(1.1), "{light:?}: the control passes, {both:?}, {plain:?}");
        }
    }
}

/// What `light` shows along a direction from `from`, by its geometry alone.
fn seen_along(light: &Light, from: Vec3) -> impl Fn(Vec3) -> f64 {
    move |d| match light {
        Light::Sphere { position, radius, .. } => {
            let to = *position - from;
            let along = to.dot(d);
            if along > 0.0 && (to - d * along).length() < *radius { 1.0 } else { 0.0 }
        }
        Light::Rect { position, direction, .. } | Light::Disk { position, direction, .. } => {
            let ([u, v], _) = light.half_axes().unwrap();
            let t = (*position - from).dot(*direction) / d.dot(*direction);
            let p = from + d * t - *position;
            let (a, b) = (p.dot(u) / u.length_squared(), p.dot(v) / v.length_squared());
            let inside =
                if matches!(light, Light::Disk { .. }) { a * a + b * b < 1.0 } else { a.abs().max(b.abs()) < 1.0 };
            if t > 0.0 && d.dot(*direction) < 0.0 && inside { 1.0 } else { 0.0 }
        }
        Light::Environment { image, .. } => image.map().look(d).0.x as f64,
        _ => unreachable!(),
    }
}

/// χ² of `seen` against `expected` counts, bins of under five pooled, and its degrees of freedom.
fn chi_squared(seen: &[f64], expected: &[f64]) -> (f64, f64) {
    let (mut statistic, mut bins, mut rest) = (0.0, 0.0, (0.0, 0.0));
    for (&s, &e) in seen.iter().zip(expected) {
        if e < 5.0 {
            rest = (rest.0 + s, rest.1 + e);
        } else {
            statistic += (s - e) * (s - e) / e;
            bins += 1.0;
        }
    }
    if rest.1 >= 5.0 {
        statistic += (rest.0 - rest.1).powi(2) / rest.1;
        bins += 1.0;
    }
    (statistic, bins - 1.0)
}

/// Five sigmas above the mean is a failure.
fn fits((statistic, freedom): (f64, f64)) -> bool {
    statistic < freedom + 5.0 * (2.0 * freedom).sqrt()
}

/// Random numbers without structure: χ² wants independent samples.
fn random(sample: u32) -> Vec2 {
    let [x, y, ..] = Sampler::new(SEED, sample as u64, 0).next_4d();
    Vec2::new(x, y)
}

#[test]
fn environment_samples_follow_their_density() {
    // A bright patch of 4 × 3 texels, no two alike.
    let mut texels: Vec<Rgb> = uneven().radiances().collect();
    for (i, at) in (1..4).flat_map(|row| (3..7).map(move |column| row * 16 + column)).enumerate() {
        texels[at] = Vec3::splat(20.0 + 5.0 * i as f32);
    }
    let map = EnvironmentMap::new(16, 8, texels);
    const COUNT: u32 = 100_000;
    // Bins of the image in other cells than its texels: 24 × 10.
    let bin = |d: Vec3| {
        let turn = 0.5 + d.x.atan2(-d.z) / TAU;
        ((d.y.acos() / PI * 10.0) as usize).min(9) * 24 + ((turn * 24.0) as usize).min(23)
    };
    let mut seen = vec![0.0; 240];
    for i in 0..COUNT {
        let Some(s) = map.sample(random(i)) else { continue };
        let (radiance, pdf) = map.look(s.towards);
        // On a texel's border the look may find the neighbour.
        assert!((radiance, pdf) == (s.radiance, s.pdf) || map.look(s.towards * Vec3::new(1.0, 1.0, 1.0001)).1 > 0.0);
        seen[bin(s.towards)] += 1.0;
    }
    let density = |map: &EnvironmentMap| {
        let mut expected = vec![0.0; 240];
        const FINE: usize = 480;
        for row in 0..FINE {
            let theta = PI * (row as f32 + 0.5) / FINE as f32;
            for column in 0..2 * FINE {
                let phi = TAU * ((column as f32 + 0.5) / (2 * FINE) as f32 - 0.5);
                let d = Vec3::new(theta.sin() * phi.sin(), theta.cos(), -theta.sin() * phi.cos());
                let cell = (theta.sin() as f64) * std::f64::consts::PI.powi(2) / (FINE * FINE) as f64;
                expected[bin(d)] += map.look(d).1 as f64 * cell * COUNT as f64;
            }
        }
        expected
    };
    let expected = density(&map);
    // Some samples are spared, as many as the density says: a binomial count.
    let (drawn, share) = (seen.iter().sum::<f64>(), expected.iter().sum::<f64>() / COUNT as f64);
    let sigma = (COUNT as f64 * share * (1.0 - share)).sqrt();
    assert!((0.2..0.9).contains(&share), "{share}");
    assert!((drawn - share * COUNT as f64).abs() < 5.0 * sigma, "{drawn} of {COUNT}, {share}");
    assert!(fits(chi_squared(&seen, &expected)), "{:?}", chi_squared(&seen, &expected));
    // Control: the density of another map.
    let other = EnvironmentMap::new(16, 8, map.radiances().map(|c| c + 1.0).collect());
    assert!(!fits(chi_squared(&seen, &density(&other))));
}

/// Samples of area lights, binned over the sphere of directions, against the densities that they state and that a ray which
/// meets the light finds.
#[test]
fn area_samples_follow_their_density() {
    let from = Vec3::new(0.1, 0.2, 0.3);
    let lights = [
        rect(Vec3::new(0.6, 1.0, 0.0), Vec3::new(-0.3, -0.9, 0.1).normalize(), [1.6, 0.9]),
        disk(Vec3::new(-0.5, 0.9, 0.4), Vec3::NEG_Y, 0.8),
        sphere(Vec3::new(0.5, -1.0, 0.4), 0.8),
    ];
    const COUNT: u32 = 60_000;
    const CELLS: usize = 24;
    for light in &lights {
        let table = AreaTable::new(&[Placed { number: 0, slot: 0, light }]);
        let towards = match *light {
            Light::Rect { position, .. } | Light::Disk { position, .. } | Light::Sphere { position, .. } => {
                position - from
            }
            _ => unreachable!(),
        };
        let frame = relight::math::Frame::from_normal(towards.normalize());
        let (mut seen, mut expected) = (vec![0.0; CELLS * CELLS], vec![0.0; CELLS * CELLS]);
        // Cells of the tangent plane, out to 1.5.
        let bin = |d: Vec3| {
            let l = frame.local_from_world(d);
            let at = (Vec2::new(l.x, l.y) / l.z / 3.0 + 0.5) * CELLS as f32;
            (at.min_element() >= 0.0 && at.max_element() < CELLS as f32 && l.z > 0.0)
                .then(|| at.y as usize * CELLS + at.x as usize)
        };
        let mut points = Vec::new();
        for i in 0..COUNT {
            table.points(random(i), &mut points);
            let s = table.sample(0, &points, from);
            let direction = Vec3::from_array(s.direction.map(|axis| axis[0]));
            if s.inverse_pdf[0] > 0.0 {
                let mut met = 0.0;
                table.meet(from, direction, f32::INFINITY, |_, inverse_pdf| met = inverse_pdf);
                // At the very edge a ray may miss.
                assert!(met == 0.0 || (met / s.inverse_pdf[0] - 1.0).abs() < 1e-3, "{met} {}", s.inverse_pdf[0]);
                if let Some(bin) = bin(direction) {
                    seen[bin] += 1.0;
                }
            }
        }
        const FINE: usize = CELLS * 40;
        for y in 0..FINE {
            for x in 0..FINE {
                let at = (Vec2::new(x as f32 + 0.5, y as f32 + 0.5) / FINE as f32 - 0.5) * 3.0;
                let local = at.extend(1.0);
                let cell = (3.0 / FINE as f64).powi(2) / (local.length() as f64).powi(3);
                let direction = frame.world_from_local(local.normalize());
                table.meet(from, direction, f32::INFINITY, |_, inverse_pdf| {
                    expected[bin(direction).unwrap()] += cell / inverse_pdf as f64 * COUNT as f64;
                });
            }
        }
        let covered = expected.iter().sum::<f64>() / COUNT as f64;
        assert!((covered - 1.0).abs() < 0.01, "{light:?}: the density integrates to {covered}");
        // Where the light's edge cuts the grid's cells (an eightieth of a bin's side on average) counts are off by at most
        // 5 %: bins that hold an edge are compared with that slack.
        let statistic = chi_squared(&seen, &expected);
        assert!(fits(statistic), "{light:?}: {statistic:?}");
        // Control: a density that leans to one side by a third.
        let leaning: Vec<f64> =
            expected.iter().enumerate().map(|(i, e)| e * (0.67 + 0.67 * (i % CELLS) as f64 / CELLS as f64)).collect();
        assert!(!fits(chi_squared(&seen, &leaning)), "{light:?}");
    }
}

/// A condition's bits do not depend on the conditions beside it, whatever kinds of light they hold.
#[test]
fn conditions_do_not_bear_on_each_other() {
    let material = Material {
        reflectance: Reflectance::MetallicRoughness,
        metallic: 0.0,
        roughness: 0.4,
        emissive: Vec3::splat(0.1),
        ..Material::lambert("plastic", Vec3::splat(0.6))
    };
    let c = Vec3::new(-1.0, 0.0, 1.0);
    let asset = quads(&[[c, Vec3::X * 2.0, Vec3::NEG_Z * 2.0], [c, Vec3::NEG_Z * 2.0, Vec3::Y * 2.0]], material);
    let tracer = Tracer::new(&asset);
    let sky = Light::Sky(Sky::at(0.7));
    let point = Light::Point { position: Vec3::new(0.2, 1.0, 0.1), color: Vec3::ONE, intensity: 1.0, range: None };
    let area = rect(Vec3::new(0.0, 1.0, 0.0), Vec3::NEG_Y, [0.5, 0.5]);
    let conditions: Vec<LightingCondition> = [
        vec![point],
        vec![area.clone(), sphere(Vec3::new(0.3, 1.2, 0.0), 0.1)],
        vec![sky],
        vec![Light::Emissive { scale: 2.0 }],
        vec![environment(uneven()), area],
    ]
    .map(|lights| LightingCondition { lights })
    .to_vec();
    let emitters = relight::light::Emitters::new(&asset);
    let rows = |conditions: &[LightingCondition]| {
        let set = LightSet::from_conditions(conditions);
        let walk =
            Walk { tracer: &tracer, emitters: emitters.as_ref().filter(|_| set.wants_emission()), max_bounces: 8 };
        let mut sums = LightSums::new(&set, &tracer);
        let from = receiver(Vec3::new(0.3, 0.0, 0.2), Vec3::Y);
        for sample in 0..200 {
            let mut sampler = Sampler::new(SEED, 1, sample);
            let [u0, u1, ..] = sampler.next_4d();
            sums.add_direct(&walk, &from, Vec2::new(u0, u1), &mut sampler);
            walk.from_receiver(&from, Vec2::new(u0, u1), &mut sampler, &mut sums);
        }
        let mut rows = [vec![0.0; 3 * conditions.len()], vec![0.0; 3 * conditions.len()]];
        sums.direct.mix(&set, 1.0, &mut rows[0]);
        sums.indirect.mix(&set, 1.0, &mut rows[1]);
        rows
    };
    let together = rows(&conditions);
    for (c, condition) in conditions.iter().enumerate() {
        let alone = rows(std::slice::from_ref(condition));
        for part in 0..2 {
            for channel in 0..3 {
                let (a, b) = (alone[part][channel], together[part][channel * conditions.len() + c]);
                // The walk's own direct light is added with what emission finds, whichever condition asked for it.
                assert_eq!(a.to_bits(), b.to_bits(), "condition {c}, part {part}, channel {channel}: {a} {b}");
                assert!(a > 0.0);
            }
        }
    }
}

/// Twice the radiance is twice the light, and a condition of two lights has the light of both.
#[test]
fn light_is_linear() {
    let asset = floor(3.0, 0.5);
    let from = receiver(Vec3::ZERO, Vec3::Y);
    let light = |radiance: f32| Light::Disk {
        position: Vec3::Y,
        direction: Vec3::NEG_Y,
        radius: 0.5,
        color: Vec3::new(1.0, 0.5, 0.25),
        radiance,
    };
    let (one, two) = (direct(&asset, &light(1.0), &from), direct(&asset, &light(2.0), &from));
    assert!((two.mean - 2.0 * one.mean).abs() < 1e-6 * two.mean);
    let tracer = Tracer::new(&asset);
    let both = LightSet::new([&light(1.0), &light(3.0)]);
    let walk = Walk { tracer: &tracer, emitters: None, max_bounces: 0 };
    let mut sums = LightSums::new(&both, &tracer);
    let sum = Estimate::of(64, |run, sample| {
        sums.clear();
        sums.add_direct(&walk, &from, Vec2::ZERO, &mut Sampler::new(SEED, run, sample));
        (sums.direct.lights[0] * both.colour(0) + sums.direct.lights[1] * both.colour(1)).x as f64
    });
    sum.assert_is(4.0 * one.mean, 0.01);
}

/// Unshadowed irradiance of what stands for a light, red.
fn stand_in(light: &Light, at: Vec3, normal: Vec3) -> f64 {
    let table = LightTable::new([light], &EmissionFacets::default());
    let arrivals = (0..table.len).map(|i| (i, table.arrive(i / LANES, at, normal, 1.0)));
    arrivals.map(|(i, a)| (table.colour(i).x * a.irradiance[i % LANES]) as f64).sum()
}

/// What stands for area lights, from one size away on. Gauss–Legendre points leave terms of degree eight in size over
/// distance; the icosahedron's of degree six: (√¾ · 0.5)⁶ = 7e-3 at the nearest, times the harmonic's value, under one half.
#[test]
fn stand_ins_send_what_the_lights_send() {
    let mut worst = [0f64; 3];
    for i in 0..200 {
        let [x, y, z, w] = Sampler::new(SEED, i, 7).next_4d();
        let at = Vec3::new(x - 0.5, 0.0, z - 0.5);
        let height = 1.0 + 2.0 * y;
        let size = [0.2 + 0.8 * w, 0.9];
        let light = rect(Vec3::Y * height, Vec3::NEG_Y, size);
        let exact = polygon_irradiance(&corners(&light, at), Vec3::Y);
        worst[0] = worst[0].max((stand_in(&light, at, Vec3::Y) / exact - 1.0).abs());
        let radius = 0.5 * size[0];
        let light = disk(Vec3::Y * height, Vec3::NEG_Y, radius);
        let (r, h) = (radius as f64, height as f64);
        let exact = std::f64::consts::PI * r * r / (r * r + h * h);
        worst[1] = worst[1].max((stand_in(&light, Vec3::ZERO, Vec3::Y) / exact - 1.0).abs());
        let light = sphere(Vec3::new(0.3, height, 0.1), radius);
        let to = Vec3::new(0.3, height, 0.1) - at;
        let exact = std::f64::consts::PI * r * r / to.length_squared() as f64 * (to.y / to.length()) as f64;
        worst[2] = worst[2].max((stand_in(&light, at, Vec3::Y) / exact - 1.0).abs());
    }
    println!("largest relative errors of rectangle, disk, sphere: {worst:?}");
    assert!(worst[0] < 1e-4 && worst[1] < 1e-4 && worst[2] < 3.5e-3, "{worst:?}");
    // Control: one point in the place of a rectangle is told.
    let light = rect(Vec3::Y, Vec3::NEG_Y, [1.0, 0.9]);
    assert!((0.9 / polygon_irradiance(&corners(&light, Vec3::ZERO), Vec3::Y) - 1.0).abs() > 0.1);
}

/// What stands for environments and skies: the relative RMS error of irradiance over all normals.
#[test]
fn distant_stand_ins_send_nearly_what_their_maps_send() {
    let normals = quadrature::sphere(8);
    let error = |map: &EnvironmentMap| {
        let (mut square, mut norm) = (0.0, 0.0);
        for (normal, weight) in &normals {
            let exact = luminance(map.irradiance(*normal)) as f64;
            let facets = map.facets().iter();
            let got: f64 = facets.map(|f| (luminance(f.irradiance) * f.towards.dot(*normal).max(0.0)) as f64).sum();
            square += weight * (got - exact).powi(2);
            norm += weight * exact * exact;
        }
        (square / norm).sqrt()
    };
    for elevation in [0.1, 0.7, 1.4] {
        let map = Sky::at(elevation).tabulate();
        println!("sky at {elevation}: {} directions, {}", map.facets().len(), error(&map));
        assert!(error(&map) < 0.03);
    }
    let uniform = EnvironmentMap::new(64, 32, vec![Vec3::ONE; 64 * 32]);
    println!("uniform: {}", error(&uniform));
    assert!(error(&uniform) < 0.03);
    println!("uneven: {}", error(&uneven()));
    // A whole turn of light goes to the facets: the vector irradiance is kept exactly.
    let flux: Vec3 = uniform.facets().iter().map(|f| f.towards * f.irradiance.x).sum();
    assert!(flux.length() < 1e-4, "{flux}");
}
