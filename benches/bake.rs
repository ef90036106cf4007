//! The bake over the number of conditions and threads, and the training after it, on the Cornell box.

use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use relight::dataset::{Dataset, Draw};
use relight::light::Scenario;
use relight::measure::MeasurementPoints;
use relight::model::Channels;
use relight::progress::Silent;
use relight::scene::{Asset, Lightmap, Tracer, UvPolicy, generate, lay_out};
use relight::transfer::{Fit, Gram, Lambda, Method, TrainSettings};
use relight::transport::{BakeSettings, Integrator, bake};

const SETTINGS: BakeSettings = BakeSettings { paths: 16, max_bounces: 8, seed: 1, integrator: Integrator::Path };
/// Texels on a side.
const SIZE: u32 = 64;

criterion_group! {
    name = benches;
    config = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(2));
    targets = baking, training
}
criterion_main!(benches);

fn cornell() -> (Asset, Lightmap) {
    let mut asset = generate("cornell").unwrap();
    lay_out(&mut asset, SIZE, UvPolicy::Auto).unwrap();
    let lightmap = Lightmap::new(&asset.mesh, SIZE as usize);
    (asset, lightmap)
}

/// Time per path, shared by all conditions.
fn baking(c: &mut Criterion) {
    let (asset, lightmap) = cornell();
    let tracer = Tracer::new(&asset);
    let mut group = c.benchmark_group("bake");
    group.throughput(Throughput::Elements(lightmap.texels.len() as u64 * SETTINGS.paths as u64));
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        for conditions in [1, 16, 128, 512] {
            let draw = Draw { scenario: &Scenario::default(), training: conditions, held_out: 0 };
            let conditions = draw.conditions(&tracer, 1).unwrap();
            let id = BenchmarkId::new(format!("{threads}-threads"), conditions.len());
            group.bench_function(id, |b| {
                b.iter(|| pool.install(|| bake(&tracer, &lightmap, &conditions, &SETTINGS, &Silent)).unwrap());
            });
        }
    }
}

/// Gram matrix, basis and transfer matrix of 256 conditions and 128 points.
fn training(c: &mut Criterion) {
    let (asset, lightmap) = cornell();
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
}
