//! What an application's own shader reads.

use glam::{Vec2, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use relight::gpu::{Lookup, Measure, Relighter, Settings};
use relight::light::{EmissionFacets, LightTable};
use relight::math::Rgb;
use relight::model::{Channels, LightmapImage, Model, Values};
use relight::scene::Tracer;

use crate::transfer::{bases, power_rounding};
use crate::{EPSILON, host, room};

/// Places all over the page, on its borders and beyond the middle of the border's texels.
pub fn places() -> Vec<Vec2> {
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
pub fn lookup_misses(model: &Model, lookup: Lookup, direct: &[Rgb], places: &[Vec2], gpu: &[Rgb]) -> (usize, f32) {
    let coefficients = model.transfer.coefficients(direct);
    let image = model.basis.reconstruct(&coefficients);
    let mut magnitudes = model.transfer.clone();
    magnitudes.matrices.iter_mut().flatten().for_each(|m| *m = m.abs());
    let largest = magnitudes.coefficients(direct).iter().map(|u| u.max_element()).fold(0.0, f32::max);
    let value = (0..model.basis.values.len()).map(|i| model.basis.values.get(i).abs()).fold(0.0, f32::max);
    let magnitude = model.basis.elements as f32 * largest * value;
    let terms = model.transfer.matrices[0].len() / model.transfer.elements + 4 * model.basis.elements + 48;
    let (gamma, power) = (model.basis.gamma, power_rounding(model.basis.gamma));
    let rounding = (terms as f32 + power) * EPSILON * magnitude;
    let filtered = lookup == Lookup::Fragment && model.basis.anchors.is_none();
    let span = values_span(&image);
    let misses = places.iter().zip(gpu).filter(|(place, gpu)| {
        let want = image.sample(**place).max(Vec3::ZERO);
        let steps = if filtered { 2.0 / 512.0 * span_around(&image, **place) * 1.01 } else { 0.0 };
        // Between texels the place itself is rounded.
        let placed = 4.0 * EPSILON * image.size as f32 * span_around(&image, **place);
        let off = rounding + placed + steps;
        // What is off in the root is off by its slope in the light.
        let slope = match gamma {
            1.0 => Vec3::ONE,
            _ => (want.powf(1.0 / gamma) + off).powf(gamma - 1.0) * gamma,
        };
        !(**gpu - want).abs().cmple(slope * off + power * EPSILON * want).all()
    });
    (misses.count(), span)
}

pub fn values_span(image: &LightmapImage) -> f32 {
    let of = |pick: fn(&Rgb) -> f32| image.values.iter().map(pick).fold(0.0, f32::max);
    of(|v| v.max_element()) + of(|v| (-*v).max_element())
}

/// Largest difference between the four texels that a place lies between, and those next to them, as texture units may round
/// a place to a neighbouring texel.
pub fn span_around(image: &LightmapImage, place: Vec2) -> f32 {
    let size = image.size as i64;
    let p = place * image.size as f32 - 0.5;
    let texel = |x: i64, y: i64| image.values[(y.clamp(0, size - 1) * size + x.clamp(0, size - 1)) as usize];
    let (x, y) = (p.x.floor() as i64, p.y.floor() as i64);
    let all: Vec<Rgb> = (-1..3).flat_map(|i| (-1..3).map(move |j| (i, j))).map(|(i, j)| texel(x + i, y + j)).collect();
    let (low, high) = all.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    (high - low).max_element()
}

/// The bases, one in half floats with a mean, and one in bytes without anchors.
pub fn embedded_models() -> Vec<Model> {
    let mut models = Vec::from(bases());
    models.push(room::model(Channels::Mono, 16, true));
    let mut bytes = room::model(Channels::Multi, 7, false);
    let values = &bytes.basis.values;
    bytes.basis.values = Values::Byte((0..values.len()).map(|i| (values.get(i) * 90.0) as i8).collect());
    models.push(bytes);
    models.push(room::raised(room::model(Channels::Multi, 5, false)));
    models.push(room::raised(room::local_model(Channels::Mono, 5)));
    models
}

/// In one encoder of a host with WebGPU's default limits: measure by rays, downsample, transfer, and the host's own shader
/// asks for the light; from the basis, and from the texture.
pub fn embedded() {
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
pub fn host_measures() {
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
pub fn sixty_four_elements() {
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
