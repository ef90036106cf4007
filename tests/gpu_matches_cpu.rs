//! Every stage on the GPU against its twin on the CPU. Without an adapter these tests are reported as ignored.
//!
//! Each comparison returns what differs, so that its control, a comparison that must fail, runs the same code.

#[path = "common/host.rs"]
mod host;
#[path = "common/room.rs"]
mod room;

use std::f32::consts::FRAC_1_PI;

use glam::{Vec2, Vec3};
use libtest_mimic::{Arguments, Failed, Trial};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use relight::dataset::Draw;
use relight::gpu::{Gpu, GpuError, Lookup, Measure, Relighter, Runtime, Settings};
use relight::light::{EmissionFacets, EnvironmentImage, EnvironmentMap, Light, LightTable, Sky};
use relight::math::Rgb;
use relight::measure::MeasurementPoints;
use relight::model::{Channels, LightmapImage, Model, Picture, Shown, Values, View, ViewError};
use relight::scene::{Camera, Tracer, lay_out};
use relight::scene_file::SceneFile;

const EPSILON: f32 = f32::EPSILON;

fn main() {
    // Any other failure is the tests' to report.
    let absent = match Gpu::new() {
        Err(error @ GpuError::NoAdapter { .. }) => {
            eprintln!("GPU tests are ignored: {error}");
            true
        }
        _ => false,
    };
    let trial = |name: &str, body: fn()| {
        let run = move || -> Result<(), Failed> {
            body();
            Ok(())
        };
        Trial::test(name, run).with_ignored_flag(absent)
    };
    let trials = vec![
        trial("measure_matches_direct_light_of_every_kind", measure),
        trial("measure_matches_for_lights_of_many_parts", measure_parts),
        trial("downsample_averages_the_same_neighbours", downsample),
        trial("transfer_matches_for_mono_multi_and_mean", transfer),
        trial("reconstruct_matches_for_global_and_local_bases", reconstruct),
        trial("basis_lookup_matches", basis_lookup),
        trial("whole_picture_matches", whole_picture),
        trial("a_hosts_shader_gets_the_light_of_the_texture_and_the_cpu", embedded),
        trial("a_host_may_measure_by_itself", host_measures),
        trial("sixty_four_elements_fit_default_limits", sixty_four_elements),
        trial("every_stage_matches_on_every_scene", scenes),
        trial("many_lights_fit_after_few", many_lights),
        trial("absurd_views_are_refused_and_leave_the_runtime_usable", absurd_views),
    ];
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}

/// Random lights of all kinds, in and around the room.
fn random_lights(count: usize) -> Vec<Light> {
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
fn exitance_of_each(model: &Model, tracer: &Tracer, lights: &[Light]) -> Vec<Vec<Rgb>> {
    lights
        .iter()
        .map(|light| model.points.sub_point_exitance(tracer, &LightTable::new([light], &EmissionFacets::default())))
        .collect()
}

/// Irradiance is I/d² times factors of at most one, each a few roundings away from its twin; the ramp between a spot's cones
/// multiplies the rounding of its cosine by the ramp's scale. 32 ε covers the roundings of WGSL's divisions and roots.
fn measure_tolerance(light: &Light, position: Vec3, albedo: Rgb) -> f32 {
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

fn measure() {
    let model = room::model(Channels::Mono, 4, false);
    let [lit, dark] = measure_matches(&model, &random_lights(48));
    // Both answers occur.
    assert!(lit > 1000 && dark > 1000, "{lit} lit, {dark} dark");
}

/// Holds the exitance of each sub-point under each light alone against the CPU's. Returns how many are lit and dark.
fn measure_matches(model: &Model, lights: &[Light]) -> [usize; 2] {
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
fn measure_parts() {
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

fn measure_parts_match(model: &Model, lights: &[Light]) {
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

fn downsample() {
    downsample_matches(&room::model(Channels::Mono, 4, false), &room::lights());
}

fn downsample_matches(model: &Model, lights: &[Light]) {
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

/// Elements whose GPU and CPU coefficients differ by more than a sum of P (or 3P) products may round.
fn transfer_misses(model: &Model, direct: &[Rgb], gpu: &[Rgb]) -> usize {
    let transfer = &model.transfer;
    let terms = if transfer.channels == Channels::Mono { transfer.points } else { 3 * transfer.points };
    let cpu = transfer.coefficients(direct);
    // The same sum of magnitudes bounds the rounding of any order of summation.
    let mut magnitudes = transfer.clone();
    magnitudes.matrices.iter_mut().flatten().for_each(|m| *m = m.abs());
    let magnitudes = magnitudes.coefficients(direct);
    (0..transfer.elements)
        .filter(|&j| {
            let tolerance = (terms + 4) as f32 * EPSILON * magnitudes[j];
            !(gpu[j] - cpu[j]).abs().cmple(tolerance).all()
        })
        .count()
}

fn transfer() {
    let mut rng = Pcg64::seed_from_u64(2);
    for channels in [Channels::Mono, Channels::Multi] {
        for mean in [false, true] {
            let mut model = room::model(channels, 7, mean);
            let direct: Vec<Rgb> =
                (0..model.points.points.len()).map(|_| Rgb::new(rng.random(), rng.random(), rng.random())).collect();
            let gpu = Runtime::new(&model).unwrap().coefficients(&direct).unwrap();
            assert_eq!(transfer_misses(&model, &direct, &gpu), 0, "{channels:?}, mean {mean}");
            let at = model.transfer.matrices[0].len() / 2;
            model.transfer.matrices[0][at] += 0.01;
            assert_eq!(transfer_misses(&model, &direct, &gpu), 1, "{channels:?}: a changed matrix goes unnoticed");
        }
    }
}

/// A view of nothing but the back wall.
fn wall_view() -> View {
    let camera = Camera {
        eye: Vec3::new(0.75, 1.75, -0.6),
        target: Vec3::new(0.78, 1.72, -1.0),
        up: Vec3::Y,
        vertical_fov: 20.0,
    };
    View { samples_per_axis: 1, ..View::new(camera, 96, 64) }
}

/// A global and a local basis, mono and multi; the last layer of each is full or not.
fn bases() -> [Model; 4] {
    [
        room::model(Channels::Mono, 6, false),
        room::model(Channels::Multi, 5, false),
        room::local_model(Channels::Mono, 5),
        room::local_model(Channels::Multi, 4),
    ]
}

fn reconstruct() {
    bases().iter().for_each(reconstruct_matches);
}

fn reconstruct_matches(model: &Model) {
    let coefficients = room::coefficients(model.basis.coefficients());
    let mut runtime = Runtime::new(model).unwrap();
    runtime.set_coefficients(&coefficients);
    let gpu = runtime.irradiance().unwrap();
    // n sums of four products each, and their product with the value: a rounding of the sum of magnitudes each. WGSL's
    // exp2 is off by at most 3 + 2·16 units in the last place.
    let magnitudes = model.basis.elements as f32 * 1.4 * 0.7;
    let tolerance = (4 * model.basis.elements + 40) as f32 * EPSILON * magnitudes;
    let misses = |cpu: &[Rgb]| {
        assert_eq!(cpu.len(), gpu.len());
        gpu.iter().zip(cpu).filter(|(g, c)| !(**g - **c).abs().cmple(Vec3::splat(tolerance)).all()).count()
    };
    let what = format!("{:?}, anchors: {}", model.transfer.channels, model.basis.anchors.is_some());
    assert_eq!(misses(&model.basis.reconstruct(&coefficients).values), 0, "{what}");
    let mut wrong = coefficients.clone();
    wrong[model.basis.elements - 1] += 0.01;
    assert!(misses(&model.basis.reconstruct(&wrong).values) > 100, "{what}: a changed coefficient goes unnoticed");
}

fn basis_lookup() {
    for model in bases() {
        let coefficients = room::coefficients(model.basis.coefficients());
        let mut runtime = Runtime::new(&model).unwrap();
        let tracer = Tracer::new(&model.asset);
        let no_lights = LightTable::new(&[], &EmissionFacets::default());
        let mut differences = |coefficients: &[Rgb], scale: f32| {
            let scaled: Vec<Rgb> = coefficients.iter().map(|u| *u * scale).collect();
            runtime.set_coefficients(&scaled);
            runtime.draw(&wall_view(), Shown::IndirectOnWhite).unwrap();
            let gpu = runtime.read_picture(&wall_view()).unwrap();
            let cpu =
                model.render_with(&tracer, &wall_view(), &no_lights, coefficients, Shown::IndirectOnWhite).unwrap();
            gpu.pixels.iter().zip(&cpu.pixels).map(|(g, c)| (*g - *c).abs().max_element()).fold(0.0, f32::max)
        };
        // The rasteriser places vertices to 1/256 of a pixel, and a pixel is less than a texel: so much of the largest
        // difference of two texels along each axis.
        let values = model.basis.reconstruct(&coefficients).values;
        let brightest = |of: fn(&Rgb) -> f32| values.iter().map(of).fold(0.0, f32::max);
        let span = brightest(|v| v.max_element()) + brightest(|v| (-*v).max_element());
        let tolerance = 2.0 / 256.0 * span * FRAC_1_PI;
        let what = format!("{:?}, anchors: {}", model.transfer.channels, model.basis.anchors.is_some());
        // What is under zero is shown as nothing: of the coefficients and their opposites one lights the wall.
        let opposite: Vec<Rgb> = coefficients.iter().map(|u| -*u).collect();
        for coefficients in [&coefficients, &opposite] {
            let largest = differences(coefficients, 1.0);
            println!("{what}: largest difference {largest:e}, tolerance {tolerance:e}");
            assert!(largest <= tolerance, "{what}: {largest} over {tolerance}");
        }
        let control = differences(&coefficients, 1.2).max(differences(&opposite, 1.2));
        assert!(control > tolerance, "{what}: a fifth more light goes unnoticed");
    }
}

/// Samples that a rasteriser may give to another surface than a ray: it rounds vertices to 1/256 of a sample, which moves
/// an outline by at most half of that along each axis. Outlines of shadows on the surfaces move as much, once a light.
/// The count is nearly Poisson; five sigmas above its mean.
fn flipped_samples(model: &Model, view: &View, lights: usize) -> f32 {
    let clip_from_world = view.pinhole().unwrap().clip_from_world(1e-3);
    let size = Vec2::from_array(view.samples().map(|s| s as f32));
    let mesh = &model.asset.mesh;
    let on_screen = |vertex: u32| {
        let clip = clip_from_world * mesh.positions[vertex as usize].extend(1.0);
        Vec2::new(clip.x, clip.y) / clip.w * 0.5 * size
    };
    let edges = |t: &[u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
    let all: std::collections::HashSet<[u32; 2]> = mesh.triangles.iter().flat_map(edges).collect();
    // An edge that two triangles of one surface share is no outline.
    let outlines = all.iter().filter(|[a, b]| !all.contains(&[*b, *a]));
    let length: f32 = outlines.map(|&[a, b]| on_screen(a).distance(on_screen(b))).sum();
    let width = 2.0 * std::f32::consts::SQRT_2 / 512.0;
    let mean = length * width * (1 + lights) as f32;
    mean + 5.0 * mean.sqrt()
}

/// Pixels that differ by more than rounding: what the picture changes over 1/64 of a pixel, and 1e-4 of its brightest light
/// for the specular lobe, which magnifies the rounding of its half vector by about 1/α².
fn differing_pixels(gpu: &Picture, cpu: &Picture) -> Vec<(u32, u32, f32)> {
    let brightest = cpu.pixels.iter().map(|p| p.max_element()).fold(0.0, f32::max);
    let mut differing = Vec::new();
    for y in 0..cpu.height {
        for x in 0..cpu.width {
            let here = cpu.pixel(x, y);
            let mut change = 0f32;
            for ny in y.saturating_sub(1)..(y + 2).min(cpu.height) {
                for nx in x.saturating_sub(1)..(x + 2).min(cpu.width) {
                    change = change.max((cpu.pixel(nx, ny) - here).abs().max_element());
                }
            }
            let difference = (gpu.pixel(x, y) - here).abs().max_element();
            if difference.is_nan() || difference > change / 64.0 + 1e-4 * brightest {
                differing.push((x, y, difference));
            }
        }
    }
    differing
}

fn whole_picture() {
    let view = room::view(160, 120);
    let lights = room::lights();
    let local = room::local_model(Channels::Mono, 4);
    for model in [room::model(Channels::Mono, 6, false), room::model(Channels::Multi, 3, false), local] {
        let channels = model.transfer.channels;
        let tracer = Tracer::new(&model.asset);
        // A local basis is looked up texel by texel by either; a global one is filtered otherwise by the texture unit.
        let lookup = if model.basis.anchors.is_some() { Lookup::Fragment } else { Lookup::Texture };
        let mut runtime = Runtime::with(Gpu::new().unwrap(), &model, lookup).unwrap();
        for shown in [Shown::Full, Shown::Direct, Shown::Indirect, Shown::IndirectOnWhite] {
            let cpu = model.render(&tracer, &view, &lights, shown).unwrap();
            let gpu = runtime.render(&view, &lights, shown).unwrap();
            let allowed = flipped_samples(&model, &view, lights.len());
            let differing = differing_pixels(&gpu, &cpu);
            println!("{channels:?} {shown:?}: {} pixels differ, {allowed:.0} may", differing.len());
            if differing.len() as f32 > allowed {
                panic!("{shown:?}: {} differ, {allowed} may; see {}", differing.len(), evidence(&gpu, &cpu));
            }
            let mut brighter = gpu.clone();
            brighter.pixels.iter_mut().for_each(|p| *p *= 1.05);
            assert!(differing_pixels(&brighter, &cpu).len() as f32 > allowed, "5 % more light goes unnoticed");
        }
    }
}

/// Leaves both pictures and their difference beside each other.
fn evidence(gpu: &Picture, cpu: &Picture) -> String {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR"));
    let pixels = gpu.pixels.iter().zip(&cpu.pixels).map(|(g, c)| (*g - *c).abs()).collect();
    let difference = Picture { pixels, ..*gpu };
    for (name, picture) in [("gpu", gpu), ("cpu", cpu), ("difference", &difference)] {
        picture.write_exr(&folder.join(format!("{name}.exr"))).unwrap();
    }
    folder.display().to_string()
}

/// Places all over the page, on its borders and beyond the middle of the border's texels.
fn places() -> Vec<Vec2> {
    let mut rng = Pcg64::seed_from_u64(8);
    let mut places: Vec<Vec2> = (0..2000).map(|_| Vec2::new(rng.random(), rng.random())).collect();
    for along in [0.0, 0.003, 0.4, 0.999, 1.0] {
        places.extend([(along, 0.0), (along, 1.0), (0.0, along), (1.0, along)].map(Vec2::from));
    }
    places
}

/// What a host's shader reads at `places` that is not what the CPU reads there, given x; and the light's span.
///
/// Coefficients are sums of `P` products (3 P for multi), each of which is rounded; the texel's sum rounds n times more, and
/// the interpolation a few. Texture units interpolate between 256 places in a texel, so off by half of that along each axis.
fn lookup_misses(model: &Model, lookup: Lookup, direct: &[Rgb], places: &[Vec2], gpu: &[Rgb]) -> (usize, f32) {
    let coefficients = model.transfer.coefficients(direct);
    let image = model.basis.reconstruct(&coefficients);
    let mut magnitudes = model.transfer.clone();
    magnitudes.matrices.iter_mut().flatten().for_each(|m| *m = m.abs());
    let largest = magnitudes.coefficients(direct).iter().map(|u| u.max_element()).fold(0.0, f32::max);
    let value = (0..model.basis.values.len()).map(|i| model.basis.values.get(i).abs()).fold(0.0, f32::max);
    let magnitude = model.basis.elements as f32 * largest * value;
    let terms = model.transfer.matrices[0].len() / model.transfer.elements + 4 * model.basis.elements + 48;
    let rounding = terms as f32 * EPSILON * magnitude;
    let filtered = lookup == Lookup::Fragment && model.basis.anchors.is_none();
    let span = values_span(&image);
    let misses = places.iter().zip(gpu).filter(|(place, gpu)| {
        let want = image.sample(**place).max(Vec3::ZERO);
        let steps = if filtered { 2.0 / 512.0 * span_around(&image, **place) * 1.01 } else { 0.0 };
        // Between texels the place itself is rounded.
        let placed = 4.0 * EPSILON * image.size as f32 * span_around(&image, **place);
        let difference = (**gpu - want).abs().max_element();
        difference.is_nan() || difference > rounding + placed + steps
    });
    (misses.count(), span)
}

fn values_span(image: &LightmapImage) -> f32 {
    let of = |pick: fn(&Rgb) -> f32| image.values.iter().map(pick).fold(0.0, f32::max);
    of(|v| v.max_element()) + of(|v| (-*v).max_element())
}

/// Largest difference between the four texels that a place lies between, and those next to them, as texture units may round
/// a place to a neighbouring texel.
fn span_around(image: &LightmapImage, place: Vec2) -> f32 {
    let size = image.size as i64;
    let p = place * image.size as f32 - 0.5;
    let texel = |x: i64, y: i64| image.values[(y.clamp(0, size - 1) * size + x.clamp(0, size - 1)) as usize];
    let (x, y) = (p.x.floor() as i64, p.y.floor() as i64);
    let all: Vec<Rgb> = (-1..3).flat_map(|i| (-1..3).map(move |j| (i, j))).map(|(i, j)| texel(x + i, y + j)).collect();
    let (low, high) = all.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    (high - low).max_element()
}

/// The bases, one in half floats with a mean, and one in bytes without anchors.
fn embedded_models() -> Vec<Model> {
    let mut models = Vec::from(bases());
    models.push(room::model(Channels::Mono, 16, true));
    let mut bytes = room::model(Channels::Multi, 7, false);
    let values = &bytes.basis.values;
    bytes.basis.values = Values::Byte((0..values.len()).map(|i| (values.get(i) * 90.0) as i8).collect());
    models.push(bytes);
    models
}

/// In one encoder of a host with WebGPU's default limits: measure by rays, downsample, transfer, and the host's own shader
/// asks for the light; from the basis, and from the texture.
fn embedded() {
    let host = host::Host::new();
    let places = places();
    for model in embedded_models() {
        for lookup in [Lookup::Fragment, Lookup::Texture] {
            let what = format!("{lookup:?}, {:?}, anchors: {}", model.transfer.channels, model.basis.anchors.is_some());
            let settings = Settings { measure: Measure::Rays, lookup };
            let mut relighter = Relighter::new(&host.device, &host.queue, &model, settings).unwrap();
            relighter.set_lights(&room::lights()).unwrap();
            let gpu = host.look_up(&relighter, &places);
            // What was measured is the measure stage's own test's concern.
            let direct = host.colours(relighter.direct(), model.points.points.len());
            assert!(direct.iter().any(|x| x.max_element() > 0.1), "{what}: no light");
            let (misses, span) = lookup_misses(&model, lookup, &direct, &places, &gpu);
            assert_eq!(misses, 0, "{what}: of {}, light of up to {span}", places.len());
            assert_eq!(relighter.irradiance().is_some(), lookup == Lookup::Texture);

            let elsewhere: Vec<Vec2> = places.iter().map(|p| *p + 0.25 / model.basis.size as f32).collect();
            let (misses, _) = lookup_misses(&model, lookup, &direct, &elsewhere, &gpu);
            assert!(misses > places.len() / 4, "{what}: a quarter of a texel goes unnoticed: {misses}");
            let brighter: Vec<Rgb> = direct.iter().map(|x| *x * 1.02).collect();
            let (misses, _) = lookup_misses(&model, lookup, &brighter, &places, &gpu);
            assert!(misses > places.len() / 4, "{what}: a fiftieth more light goes unnoticed: {misses}");
        }
    }
}

/// The host writes what sub-points send out, as a buffer and as a picture of the points, or x itself.
fn host_measures() {
    let host = host::Host::new();
    let places = places();
    let model = room::local_model(Channels::Mono, 4);
    let tracer = Tracer::new(&model.asset);
    let exitance =
        model.points.sub_point_exitance(&tracer, &LightTable::new(&room::lights(), &EmissionFacets::default()));
    let direct = model.points.average(&exitance);
    let lookup = Lookup::Texture;
    let new = |measure| Relighter::new(&host.device, &host.queue, &model, Settings { measure, lookup }).unwrap();

    let relighter = new(Measure::Points);
    host.write(relighter.direct(), &direct);
    assert_eq!(lookup_misses(&model, lookup, &direct, &places, &host.look_up(&relighter, &places)).0, 0);

    let relighter = new(Measure::SubPoints);
    host.write(relighter.exitance(), &exitance);
    assert_eq!(lookup_misses(&model, lookup, &direct, &places, &host.look_up(&relighter, &places)).0, 0);

    // The picture of the points has their places, normals and albedos, and gives back what a host draws into one like it.
    let relighter = new(Measure::SubPoints);
    let points = relighter.points();
    for (texture, value) in [
        (&points.position, (|p| p.position) as fn(&relight::measure::MeasurementPoint) -> Vec3),
        (&points.normal, |p| p.normal),
        (&points.albedo, |p| p.albedo),
    ] {
        let texels = host.gpu().read_texture(texture).unwrap();
        assert!(model.points.sub_points.iter().zip(&texels).all(|(p, texel)| value(p) == *texel));
    }
    let mut encoder = host.device.create_command_encoder(&Default::default());
    relighter.encode_exitance(&mut encoder, &host.shaded(&points.position, &exitance));
    host.queue.submit([encoder.finish()]);
    let gpu = host.look_up(&relighter, &places);
    assert_eq!(lookup_misses(&model, lookup, &direct, &places, &gpu).0, 0);
    let other: Vec<Rgb> = direct.iter().map(|x| *x * 1.02).collect();
    assert!(lookup_misses(&model, lookup, &other, &places, &gpu).0 > 500, "a fiftieth more light goes unnoticed");
}

/// 16 layers for mono, 64 for multi, and a local basis with as many channels as 64 anchors have.
fn sixty_four_elements() {
    let host = host::Host::new();
    let places = places();
    let local = room::local(room::model(Channels::Mono, 64 * room::ANCHORS, false), 64);
    for model in [room::model(Channels::Mono, 64, true), room::model(Channels::Multi, 64, false), local] {
        let direct = vec![Rgb::new(0.5, 0.2, 0.1); model.points.points.len()];
        for lookup in [Lookup::Fragment, Lookup::Texture] {
            let settings = Settings { measure: Measure::Points, lookup };
            let relighter = Relighter::new(&host.device, &host.queue, &model, settings).unwrap();
            host.write(relighter.direct(), &direct);
            let gpu = host.look_up(&relighter, &places);
            assert_eq!(lookup_misses(&model, lookup, &direct, &places, &gpu).0, 0, "{lookup:?}");
            // Each element counts, the last too.
            let mut fewer = model.clone();
            let last = fewer.transfer.matrices[0].len() / fewer.transfer.elements;
            for matrix in &mut fewer.transfer.matrices {
                let at = matrix.len() - last;
                matrix[at..].fill(0.0);
            }
            assert!(lookup_misses(&fewer, lookup, &direct, &places, &gpu).0 > 100, "{lookup:?}: one element less");
        }
    }
}

/// Every scene's asset, unwrapped at a small size, under lights of its own scenario.
fn scenes() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let mut seen = 0;
    for entry in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
        for file in std::fs::read_dir(&entry).unwrap().map(|e| e.unwrap().path()) {
            if file.extension().is_some_and(|e| e == "toml") {
                println!("{}", file.display());
                scene(&file);
                seen += 1;
            }
        }
    }
    assert!(seen >= 3, "{seen} scenes");
}

fn scene(file: &std::path::Path) {
    const SIZE: usize = 64;
    let scene = SceneFile::read(file).unwrap();
    let mut asset = scene.load_asset(&file.display().to_string()).unwrap();
    lay_out(&mut asset, SIZE as u32, scene.lightmap.uv).unwrap();
    let points = MeasurementPoints::place(&asset, 64, 8, 1).unwrap();
    let (channels, elements) = (Channels::Mono, 16);
    let global = room::model_of(asset, points, SIZE, channels, elements, false);
    let tracer = Tracer::new(&global.asset);
    let draw = Draw { scenario: &scene.scenario, training: 6, held_out: 0 };
    let mut lights: Vec<Light> = Vec::new();
    for condition in draw.conditions(&tracer, 3).unwrap() {
        lights.extend(condition.lights);
    }
    let (single, parts): (Vec<Light>, Vec<Light>) = lights
        .iter()
        .cloned()
        .partition(|l| matches!(l, Light::Point { .. } | Light::Spot { .. } | Light::Directional { .. }));
    if !single.is_empty() {
        let [lit, _] = measure_matches(&global, &single);
        assert!(lit > 100, "{}: {lit} lit", file.display());
    }
    measure_parts_match(&global, &parts);
    downsample_matches(&global, &lights);
    let mut local = global.clone();
    local.transfer =
        room::model_of(local.asset.clone(), local.points.clone(), SIZE, channels, 4 * room::ANCHORS, false).transfer;
    let host = host::Host::new();
    let places = places();
    for model in [global.clone(), room::local(local, 4)] {
        let mut runtime = Runtime::new(&model).unwrap();
        let direct = model.points.direct(&tracer, &LightTable::new(&lights, &EmissionFacets::of(&model.asset)));
        let gpu = runtime.coefficients(&direct).unwrap();
        assert_eq!(transfer_misses(&model, &direct, &gpu), 0);
        reconstruct_matches(&model);
        for lookup in [Lookup::Fragment, Lookup::Texture] {
            let settings = Settings { measure: Measure::Points, lookup };
            let relighter = Relighter::new(&host.device, &host.queue, &model, settings).unwrap();
            host.write(relighter.direct(), &direct);
            let gpu = host.look_up(&relighter, &places);
            assert_eq!(lookup_misses(&model, lookup, &direct, &places, &gpu).0, 0, "{lookup:?}");
        }
    }
}

/// The list of lights grows when it must: a light split in 40 shines like one.
fn many_lights() {
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
    assert_eq!(runtime.sub_point_exitance(&[]).unwrap(), vec![Vec3::ZERO; one.len()]);
}

fn absurd_views() {
    let model = room::model(Channels::Mono, 4, false);
    let mut runtime = Runtime::new(&model).unwrap();
    let mut render = |width, height| runtime.render(&room::view(width, height), &room::lights(), Shown::Full);
    assert!(matches!(render(0, 0), Err(GpuError::View(ViewError::Size { width: 0, height: 0 }))));
    assert!(matches!(render(32768, 1), Err(GpuError::TooLarge { .. })));
    assert_eq!(render(16, 9).unwrap().pixels.len(), 16 * 9);
}
