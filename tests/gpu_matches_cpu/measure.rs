//! Direct light at the sub-points, and its mean at the points.

use glam::Vec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use relight::gpu::Runtime;
use relight::light::{EmissionFacets, EnvironmentImage, EnvironmentMap, Light, LightTable, Sky};
use relight::math::Rgb;
use relight::model::{Channels, Model};
use relight::scene::Tracer;

use crate::{EPSILON, room};

/// Random lights of all kinds, in and around the room.
pub fn random_lights(count: usize) -> Vec<Light> {
    let mut rng = Pcg64::seed_from_u64(17);
    (0..count)
        .map(|i| {
            let mut cube = || Vec3::new(rng.random(), rng.random(), rng.random());
            let position = (cube() - 0.5) * Vec3::new(2.6, 2.2, 2.6) + Vec3::Y;
            let (direction, color) = ((cube() - 0.5).normalize(), cube());
            let intensity = 1.0 + 4.0 * rng.random::<f32>();
            let range = rng.random_bool(0.5).then(|| 1.0 + 2.0 * rng.random::<f32>());
            let inner = rng.random::<f32>() * 0.7;
            match i % 3 {
                0 => Light::Point { position, color, intensity, range },
                1 => Light::Spot {
                    position,
                    direction,
                    color,
                    intensity,
                    range,
                    inner_cone_angle: inner,
                    outer_cone_angle: inner + 0.1 + 0.7 * rng.random::<f32>(),
                },
                _ => Light::Directional { direction, color, intensity },
            }
        })
        .collect()
}

/// CPU exitance of each sub-point under each light alone: `[light][sub_point]`.
pub fn exitance_of_each(model: &Model, tracer: &Tracer, lights: &[Light]) -> Vec<Vec<Rgb>> {
    lights
        .iter()
        .map(|light| model.points.sub_point_exitance(tracer, &LightTable::new([light], &EmissionFacets::default())))
        .collect()
}

/// Irradiance is I/d² times factors of at most one, each a few roundings away from its twin; the ramp between a spot's cones
/// multiplies the rounding of its cosine by the ramp's scale. 32 ε covers the roundings of WGSL's divisions and roots.
pub fn measure_tolerance(light: &Light, position: Vec3, albedo: Rgb) -> f32 {
    let (reach, scale) = match *light {
        Light::Point { position: from, intensity, .. } => (intensity / from.distance_squared(position), 0.0),
        Light::Spot { position: from, intensity, inner_cone_angle: inner, outer_cone_angle: outer, .. } => {
            (intensity / from.distance_squared(position), 1.0 / (inner.cos() - outer.cos()))
        }
        Light::Directional { intensity, .. } => (intensity, 0.0),
        _ => unreachable!("{light:?}"),
    };
    32.0 * EPSILON * (1.0 + scale) * reach * albedo.max_element()
}

pub fn measure() {
    let model = room::model(Channels::Mono, 4, false);
    let [lit, dark] = measure_matches(&model, &random_lights(48));
    // Both answers occur.
    assert!(lit > 1000 && dark > 1000, "{lit} lit, {dark} dark");
}

/// Holds the exitance of each sub-point under each light alone against the CPU's. Returns how many are lit and dark.
pub fn measure_matches(model: &Model, lights: &[Light]) -> [usize; 2] {
    let mut runtime = Runtime::new(model).unwrap();
    let tracer = Tracer::new(&model.asset);
    let cpu = exitance_of_each(model, &tracer, lights);
    // A shadow ray that grazes an edge may fall on either side of it. Such a ray changes its mind when its origin moves a
    // hundred times farther than rounding does.
    let mut farther = Tracer::new(&model.asset);
    farther.offset *= 2.0;
    let moved = exitance_of_each(model, &farther, lights);

    let (mut lit, mut dark, mut grazing) = (0, 0, 0);
    let mut misses = Vec::new();
    let mut control = 0;
    for (l, light) in lights.iter().enumerate() {
        let gpu = runtime.sub_point_exitance(std::slice::from_ref(light)).unwrap();
        for (s, point) in model.points.sub_points.iter().enumerate() {
            let (want, got) = (cpu[l][s], gpu[s]);
            if (want == Vec3::ZERO) != (moved[l][s] == Vec3::ZERO) {
                grazing += 1;
                continue;
            }
            if want == Vec3::ZERO {
                dark += 1
            } else {
                lit += 1
            }
            let tolerance = measure_tolerance(light, point.position, point.albedo);
            if (got - want).abs().max_element() > tolerance {
                misses.push(format!("light {l} sub-point {s}: GPU {got}, CPU {want}, tolerance {tolerance}"));
            }
            control += ((got - want * 1.001).abs().max_element() > tolerance) as usize;
        }
    }
    let name = &model.asset.name;
    assert!(misses.is_empty(), "{name}: {} of {}: {:#?}", misses.len(), lit + dark, &misses[..misses.len().min(5)]);
    // Few rays graze.
    assert!(grazing < (lit + dark) / 100, "{name}: {grazing} graze");
    assert!(control > lit / 2, "{name}: a light a thousandth brighter goes unnoticed: {control} of {lit}");
    [lit, dark]
}

/// Area lights, environments, skies: what stands for them is the same on both sides.
pub fn measure_parts() {
    let model = room::model(Channels::Mono, 4, false);
    let (position, direction, color) = (Vec3::new(0.2, 1.6, 0.3), Vec3::NEG_Y, Vec3::new(1.0, 0.8, 0.6));
    let map = EnvironmentMap::new(8, 4, (0..32).map(|i| Vec3::new(1.0, 0.1 * i as f32, 0.5)).collect());
    let image = EnvironmentImage::from_map("map", map);
    let lights = [
        Light::Rect { position, direction, up: Vec3::Y, size: [0.5, 0.3], color, radiance: 10.0 },
        Light::Disk { position, direction: Vec3::new(0.6, -0.8, 0.0), radius: 0.2, color, radiance: 10.0 },
        Light::Sphere { position, radius: 0.15, color, radiance: 10.0 },
        Light::Environment { image, rotation: 1.0, color, intensity: 1.0 },
        Light::Sky(Sky { sun_azimuth: 2.5, intensity: 1e-4, ..Sky::at(0.6) }),
    ];
    measure_parts_match(&model, &lights);
}

pub fn measure_parts_match(model: &Model, lights: &[Light]) {
    let mut runtime = Runtime::new(model).unwrap();
    let tracer = Tracer::new(&model.asset);
    let cpu = exitance_of_each(model, &tracer, lights);
    let mut farther = Tracer::new(&model.asset);
    farther.offset *= 2.0;
    let moved = exitance_of_each(model, &farther, lights);
    for (l, light) in lights.iter().enumerate() {
        let gpu = runtime.sub_point_exitance(std::slice::from_ref(light)).unwrap();
        let (mut compared, mut lit, mut control) = (0, 0, 0);
        for s in 0..gpu.len() {
            let (want, got) = (cpu[l][s], gpu[s]);
            // A part of at least a hundredth of what arrives is seen or hidden by the ray's offset alone.
            if (want - moved[l][s]).abs().max_element() > 2e-3 * want.max_element() {
                continue;
            }
            // Sums of at most 65 parts, each with the roundings of one light: they cancel as those of a random walk do.
            let tolerance = 64.0 * EPSILON * want.max_element() + 1e-9;
            compared += 1;
            lit += (want != Vec3::ZERO) as usize;
            assert!((got - want).abs().max_element() <= tolerance, "light {l}, {s}: GPU {got}, CPU {want}");
            control += ((got - want * 1.001).abs().max_element() > tolerance) as usize;
        }
        // The sub-points of partial light see many parts: some of these graze.
        assert!(compared > gpu.len() * 4 / 5 && lit > gpu.len() / 10, "light {l}: {compared} compared, {lit} lit");
        assert!(control == lit, "light {l}: a light a thousandth brighter goes unnoticed");
    }
}

pub fn downsample() {
    downsample_matches(&room::model(Channels::Mono, 4, false), &room::lights());
}

pub fn downsample_matches(model: &Model, lights: &[Light]) {
    let mut runtime = Runtime::new(model).unwrap();
    let tracer = Tracer::new(&model.asset);
    let exitance = model.points.sub_point_exitance(&tracer, &LightTable::new(lights, &EmissionFacets::default()));
    let cpu = model.points.average(&exitance);
    // A mean of k positive numbers: k roundings, one more for the division.
    let tolerance = (model.points.neighbours_per_point() + 1) as f32 * EPSILON;
    let agrees =
        |gpu: &[Rgb]| gpu.iter().zip(&cpu).all(|(g, c)| (*g - *c).abs().max_element() <= tolerance * c.max_element());
    assert!(agrees(&runtime.average(&exitance).unwrap()));
    let mut shifted = exitance.clone();
    shifted.rotate_left(1);
    assert!(!agrees(&runtime.average(&shifted).unwrap()), "other sub-points go unnoticed");
}

/// The list of lights grows when it must: a light split in 40 shines like one.
pub fn many_lights() {
    let model = room::model(Channels::Mono, 4, false);
    let mut runtime = Runtime::new(&model).unwrap();
    let one = runtime.sub_point_exitance(&room::lights()[..1]).unwrap();
    let Light::Point { position, color, intensity, range } = room::lights()[0] else { unreachable!() };
    let split = vec![Light::Point { position, color, intensity: intensity / 40.0, range }; 40];
    let many = runtime.sub_point_exitance(&split).unwrap();
    assert!(one.iter().any(|e| e.max_element() > 0.0));
    for (a, b) in one.iter().zip(&many) {
        // 40 additions.
        assert!((*a - *b).abs().max_element() <= 41.0 * EPSILON * a.max_element(), "{a} {b}");
    }
    // Two environments shine together, as do they and a lamp.
    let map = |blue: f32| EnvironmentMap::new(8, 4, (0..32).map(|i| Vec3::new(1.0, 0.1 * i as f32, blue)).collect());
    let environment = |blue: f32, rotation: f32| {
        let image = EnvironmentImage::from_map(&format!("{blue}"), map(blue));
        Light::Environment { image, rotation, color: Vec3::ONE, intensity: 1.0 }
    };
    let lights = [environment(0.2, 0.0), environment(3.0, 2.0), room::lights()[0].clone()];
    let together = runtime.sub_point_exitance(&lights).unwrap();
    let alone = lights.map(|light| runtime.sub_point_exitance(&[light]).unwrap());
    for (s, all) in together.iter().enumerate() {
        let sum: Rgb = alone.iter().map(|one| one[s]).sum();
        // 129 additions.
        assert!((*all - sum).abs().max_element() <= 130.0 * EPSILON * sum.max_element(), "{all} {sum}");
        assert!(sum.max_element() == 0.0 || alone[0][s] != *all, "one of three goes unnoticed");
    }
    assert_eq!(runtime.sub_point_exitance(&[]).unwrap(), vec![Vec3::ZERO; one.len()]);
}
