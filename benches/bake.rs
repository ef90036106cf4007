//! The bake over integrators, conditions, threads and texels, and the training after it, on the Cornell box.
//! `tests/peers/bake_speed.py` sets its speed beside other renderers'.

use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use relight::dataset::{Dataset, Draw};
use relight::light::{LightingCondition, Scenario};
use relight::measure::MeasurementPoints;
use relight::model::Channels;
use relight::progress::Silent;
use relight::scene::{Asset, Lightmap, Tracer, UvPolicy, generate, lay_out};
use relight::transfer::{Fit, Gram, Lambda, LocalFit, Method, Precision, Terms, TrainSettings};
use relight::transport::{BakeSettings, Integrator, bake};

const SETTINGS: BakeSettings = BakeSettings { paths: 16, max_bounces: 8, seed: 1, integrator: Integrator::Gather };
/// Texels on a side.
const SIZE: u32 = 64;
const CONDITIONS: usize = 128;
/// Paths a texel that bring each integrator to a relative RMSE of 0.15 under spot lights, as `bake_speed.py` finds them.
const EQUAL_ERROR: [(Integrator, u32); 2] = [(Integrator::Gather, 116), (Integrator::Path, 267)];

criterion_group! {
    name = benches;
    config = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(2));
    targets = equal_error, conditions, threads, texels, training
}
criterion_main!(benches);

fn cornell(size: u32) -> (Asset, Lightmap) {
    let mut asset = generate("cornell").unwrap();
    lay_out(&mut asset, size, UvPolicy::Auto).unwrap();
    let lightmap = Lightmap::new(&asset.mesh, size as usize);
    (asset, lightmap)
}

fn spots(tracer: &Tracer, count: usize) -> Vec<LightingCondition> {
    let draw = Draw { scenario: &Scenario::default(), training: count, held_out: 0 };
    draw.conditions(tracer, SETTINGS.seed).unwrap()
}

/// All conditions at once, and one of them by itself, which one at a time costs as many times as there are conditions.
fn equal_error(c: &mut Criterion) {
    let (asset, lightmap) = cornell(SIZE);
    let tracer = Tracer::new(&asset);
    let conditions = spots(&tracer, CONDITIONS);
    let mut group = c.benchmark_group("equal-error");
    for (integrator, paths) in EQUAL_ERROR {
        let settings = BakeSettings { paths, integrator, ..SETTINGS };
        for (name, conditions) in [("at-once", &conditions[..]), ("one-of-them", &conditions[..1])] {
            group.bench_function(BenchmarkId::new(format!("{integrator:?}"), name), |b| {
                b.iter(|| bake(&tracer, &lightmap, conditions, &settings, &Silent).unwrap());
            });
        }
    }
}

fn conditions(c: &mut Criterion) {
    let (asset, lightmap) = cornell(SIZE);
    let tracer = Tracer::new(&asset);
    let mut group = c.benchmark_group("conditions");
    for integrator in [Integrator::Gather, Integrator::Path] {
        let settings = BakeSettings { integrator, ..SETTINGS };
        for count in [1, 16, 128, 1024] {
            let conditions = spots(&tracer, count);
            group.bench_function(BenchmarkId::new(format!("{integrator:?}"), count), |b| {
                b.iter(|| bake(&tracer, &lightmap, &conditions, &settings, &Silent).unwrap());
            });
        }
    }
}

fn threads(c: &mut Criterion) {
    let (asset, lightmap) = cornell(SIZE);
    let tracer = Tracer::new(&asset);
    let conditions = spots(&tracer, CONDITIONS);
    let mut group = c.benchmark_group("threads");
    for integrator in [Integrator::Gather, Integrator::Path] {
        let settings = BakeSettings { integrator, ..SETTINGS };
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            group.bench_function(BenchmarkId::new(format!("{integrator:?}"), threads), |b| {
                b.iter(|| pool.install(|| bake(&tracer, &lightmap, &conditions, &settings, &Silent)).unwrap());
            });
        }
    }
}

/// Time for each path of each texel.
fn texels(c: &mut Criterion) {
    let mut group = c.benchmark_group("texels");
    for size in [64, 128, 256] {
        let (asset, lightmap) = cornell(size);
        let tracer = Tracer::new(&asset);
        let conditions = spots(&tracer, CONDITIONS);
        group.throughput(Throughput::Elements(lightmap.texels.len() as u64 * SETTINGS.paths as u64));
        group.bench_function(BenchmarkId::from_parameter(size), |b| {
            b.iter(|| bake(&tracer, &lightmap, &conditions, &SETTINGS, &Silent).unwrap());
        });
    }
}

/// Gram matrix, basis and transfer matrix of 256 conditions and 128 points, and local bases.
fn training(c: &mut Criterion) {
    let (asset, lightmap) = cornell(SIZE);
    let tracer = Tracer::new(&asset);
    let points = MeasurementPoints::place(&asset, 128, 8, 1).unwrap();
    let draw = Draw { scenario: &Scenario::default(), training: 256, held_out: 0 };
    let conditions = draw.conditions(&tracer, SETTINGS.seed).unwrap();
    let dataset = Dataset::bake(&tracer, &lightmap, &points, conditions, 256, &SETTINGS, &Silent).unwrap();
    let mut group = c.benchmark_group("train");
    group.bench_function("gram", |b| b.iter(|| Gram::of(&dataset, &Silent).unwrap()));
    let gram = Gram::of(&dataset, &Silent).unwrap();
    for channels in [Channels::Mono, Channels::Multi] {
        let settings = TrainSettings { method: Method::Linear, channels, elements: 16, lambda: Lambda::LeaveOneOut };
        let id = BenchmarkId::new("fit", format!("{channels:?}"));
        group.bench_function(id, |b| b.iter(|| Fit::train(&dataset, &gram, settings).unwrap()));
    }
    let settings =
        TrainSettings { method: Method::Local, channels: Channels::Mono, elements: 4, lambda: Lambda::LeaveOneOut };
    let fit = Fit::train(&dataset, &gram, settings).unwrap();
    let places: Vec<_> = lightmap.spots(&asset.mesh).into_iter().map(|spot| (spot.centre, spot.normal)).collect();
    let terms = || Terms::new(&fit, &dataset, &places, 128, &Silent).unwrap();
    group.bench_function("local/terms", |b| b.iter(terms));
    let terms = terms();
    for channels in [4, 8] {
        let id = BenchmarkId::new("local/fit", channels);
        group.bench_function(id, |b| b.iter(|| LocalFit::train(&terms, channels, Precision::Byte)));
    }
}
