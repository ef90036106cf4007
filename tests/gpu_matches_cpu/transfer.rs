//! From direct light to coefficients, and from these to the lightmap.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use relight::gpu::Runtime;
use relight::light::{EmissionFacets, LightTable};
use relight::math::Rgb;
use relight::model::{Channels, Model, Shown, View};
use relight::scene::{Camera, Tracer};

use crate::{EPSILON, room};

/// Units in the last place by which a power may differ: WGSL's is exp2(y · log2 x), of which log2 is off by three and exp2 by
/// 3 + 2 · |y log2 x|, for values that lie within 2¹⁵ of 1.
pub fn power_rounding(gamma: f32) -> f32 {
    if gamma == 1.0 { 0.0 } else { 64.0 }
}

/// Elements whose GPU and CPU coefficients differ by more than a sum of P (or 3P) products may round.
pub fn transfer_misses(model: &Model, direct: &[Rgb], gpu: &[Rgb]) -> usize {
    let transfer = &model.transfer;
    let terms = if transfer.channels == Channels::Mono { transfer.points } else { 3 * transfer.points };
    let cpu = transfer.coefficients(direct);
    // The same sum of magnitudes bounds the rounding of any order of summation.
    let mut magnitudes = transfer.clone();
    magnitudes.matrices.iter_mut().flatten().for_each(|m| *m = m.abs());
    let magnitudes = magnitudes.coefficients(direct);
    (0..transfer.elements)
        .filter(|&j| {
            let tolerance = ((terms + 4) as f32 + power_rounding(transfer.gamma)) * EPSILON * magnitudes[j];
            !(gpu[j] - cpu[j]).abs().cmple(tolerance).all()
        })
        .count()
}

pub fn transfer() {
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
pub fn wall_view() -> View {
    let camera = Camera {
        eye: Vec3::new(0.75, 1.75, -0.6),
        target: Vec3::new(0.78, 1.72, -1.0),
        up: Vec3::Y,
        vertical_fov: 20.0,
    };
    View { samples_per_axis: 1, ..View::new(camera, 96, 64) }
}

/// A global and a local basis, mono and multi; the last layer of each is full or not.
pub fn bases() -> [Model; 4] {
    [
        room::model(Channels::Mono, 6, false),
        room::model(Channels::Multi, 5, false),
        room::local_model(Channels::Mono, 5),
        room::local_model(Channels::Multi, 4),
    ]
}

pub fn reconstruct() {
    bases().iter().for_each(reconstruct_matches);
}

pub fn reconstruct_matches(model: &Model) {
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

pub fn basis_lookup() {
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
