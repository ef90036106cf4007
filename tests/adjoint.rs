//! Light carried backwards, and what it tells of a transfer before any lightmap is looked at.

use glam::Vec3;
use relight::dataset::{Dataset, Draw, OF_SCENARIO, Unbaked};
use relight::light::{Kind, KindWeights, Scenario};
use relight::math::Rgb;
use relight::measure::MeasurementPoints;
use relight::model::Channels;
use relight::progress::Silent;
use relight::scene::{Asset, Lightmap, Material, Mesh, Tracer, UvPolicy, lay_out};
use relight::transfer::{
    Fit, Gram, HeldOutErrors, Lambda, LocalFit, Method, Precision, Prior, PriorSums, Terms, TrainSettings,
};
use relight::transport::{Adjoint, BakeSettings, Integrator};

/// A box of side `side` around `centre`, seen from inside or from outside.
fn faces(mesh: &mut Mesh, centre: Vec3, side: f32, inside: bool) {
    for axis in 0..3 {
        for sign in [-1.0f32, 1.0] {
            let axes = [Vec3::X, Vec3::Y, Vec3::Z];
            let (u, v) = (axes[(axis + 1) % 3] * side, axes[(axis + 2) % 3] * side);
            let corner = centre + axes[axis] * sign * side / 2.0 - (u + v) / 2.0;
            let first = mesh.positions.len() as u32;
            mesh.positions.extend([corner, corner + u, corner + u + v, corner + v]);
            mesh.normals.extend([axes[axis] * if inside { -sign } else { sign }; 4]);
            let quad = if (sign < 0.0) == inside { [0, 1, 2, 3] } else { [0, 3, 2, 1] }.map(|i| first + i);
            mesh.triangles.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
            mesh.triangle_materials.extend([0; 2]);
        }
    }
}

fn room(albedo: f32, with_block: bool, size: u32) -> (Asset, Lightmap) {
    let mut mesh = Mesh::default();
    faces(&mut mesh, Vec3::ZERO, 2.0, true);
    if with_block {
        faces(&mut mesh, Vec3::new(0.2, -0.5, -0.1), 0.6, false);
    }
    let mut asset = Asset {
        name: "room".into(),
        mesh,
        materials: vec![Material::lambert("white", Vec3::splat(albedo))],
        textures: vec![],
        lights: vec![],
        cameras: vec![],
        warnings: vec![],
    };
    lay_out(&mut asset, size, UvPolicy::Unwrap).unwrap();
    let lightmap = Lightmap::new(&asset.mesh, size as usize);
    (asset, lightmap)
}

fn settings(paths: u32, max_bounces: u32) -> BakeSettings {
    BakeSettings { paths, max_bounces, seed: 5, integrator: Integrator::Auto }
}

/// In a closed box of albedo a with exitance M everywhere the light of a texel is M (1 + a + a² + …): its deposits add up to
/// 1/(1−a), whatever sub-points they lie on. Texels are independent, so that their spread gives the mean's standard error; 4.5 of
/// them are exceeded once in 10⁵. Paths that end where they first meet the box add up to 1, which is told.
#[test]
fn deposits_in_a_closed_box_add_up_to_the_sum_of_all_reflections() {
    for albedo in [0.3f32, 0.8] {
        let (asset, lightmap) = room(albedo, false, 16);
        let tracer = Tracer::new(&asset);
        let points = MeasurementPoints::place(&asset, 16, 4, 1).unwrap();
        let sums = |max_bounces: u32| -> (f64, f64) {
            let adjoint = Adjoint::new(&tracer, &lightmap, &points, settings(256, max_bounces));
            let of = |t: usize| adjoint.texel(t, &Silent).iter().map(|d| d.weight.x as f64).sum();
            let sums: Vec<f64> = (0..lightmap.texels.len()).map(of).collect();
            let n = sums.len() as f64;
            let mean = sums.iter().sum::<f64>() / n;
            let variance = sums.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / (n - 1.0);
            (mean, (variance / n).sqrt())
        };
        let expected = 1.0 / (1.0 - albedo as f64);
        let (mean, sigma) = sums(128);
        // Where all paths are as long as each other there is no spread but that of rounding.
        let tolerance = 4.5 * sigma + 1e-5 * expected;
        assert!((mean - expected).abs() < tolerance, "albedo {albedo}: {mean} ± {sigma}, expected {expected}");
        let (short, sigma) = sums(1);
        let tolerance = 4.5 * sigma + 1e-5 * expected;
        assert!((short - 1.0).abs() < tolerance, "albedo {albedo}: {short}");
        assert!((short - expected).abs() > tolerance, "the control: one vertex is not all");
    }
}

/// A room under spot lights: few conditions to train on, and others to test on.
struct Case {
    asset: Asset,
    lightmap: Lightmap,
    points: MeasurementPoints,
    scenario: Scenario,
}

impl Case {
    fn new() -> Self {
        let (asset, lightmap) = room(0.7, true, 32);
        let points = MeasurementPoints::place(&asset, 48, 4, 1).unwrap();
        let scenario = Scenario { clearance: Some(0.2), ..Scenario::default() };
        Self {
            asset,
            lightmap,
            points,
            scenario: Scenario { position: relight::light::scenario::Position::Inside, ..scenario },
        }
    }

    /// `training` spot lights, and held out those of `scenario`.
    fn dataset(&self, training: usize, kind: Kind) -> Dataset {
        let tracer = Tracer::new(&self.asset);
        let scenario = Scenario { kinds: KindWeights::only(kind), ..self.scenario.clone() };
        let draw = |scenario: &Scenario, count, seed| {
            Draw { scenario, training: count, held_out: 0 }.conditions(&tracer, seed).unwrap()
        };
        let conditions = [draw(&self.scenario, training, 1), draw(&scenario, 32, 2)].concat();
        let settings = settings(64, 32);
        Dataset::bake(&tracer, &self.lightmap, &self.points, conditions, training, &settings, &Silent).unwrap()
    }

    fn prior(&self, fit: &Fit, dataset: &Dataset) -> Prior {
        let tracer = Tracer::new(&self.asset);
        let adjoint = Adjoint::new(&tracer, &self.lightmap, &self.points, settings(256, 32));
        let mut sums = PriorSums::new(fit, dataset, &adjoint, &Silent).unwrap();
        let unbaked =
            Unbaked { tracer: &tracer, points: &self.points, scenario: &self.scenario, seed: 1, own: OF_SCENARIO };
        unbaked.for_each(&mut |measured| sums.add(measured)).unwrap();
        sums.finish().unwrap()
    }
}

/// With a third as many conditions as points the data leave most of M open, which the prior tells: the error on lights that
/// were not trained on falls, on those of the scenario and on others.
#[test]
fn a_prior_makes_up_for_conditions_that_are_missing() {
    let case = Case::new();
    for (kind, channels) in [(Kind::Spot, Channels::Mono), (Kind::Point, Channels::Mono), (Kind::Spot, Channels::Multi)]
    {
        let dataset = case.dataset(16, kind);
        let gram = Gram::of(&dataset, &Silent).unwrap();
        let settings = TrainSettings { method: Method::Linear, channels, elements: 12, lambda: Lambda::LeaveOneOut };
        let plain = Fit::train(&dataset, &gram, settings).unwrap();
        let error = |fit: &Fit| HeldOutErrors::of(fit, &dataset, &gram).summary();
        let without = error(&plain);
        let prior = case.prior(&plain, &dataset);
        let fit = plain.with_prior(&dataset, &prior).unwrap();
        let with = error(&fit);
        println!("{kind:?} {channels:?}: {:.4} -> {:.4}, oracle {:.4}", without.mean, with.mean, with.oracle_mean);
        assert!(fit.prior);
        // What the transfer adds to the oracle's error, in squares.
        let excess = |e: &relight::transfer::ErrorSummary| e.mean.powi(2) - e.oracle_mean.powi(2);
        assert!(excess(&with) < 0.5 * excess(&without), "{kind:?} {channels:?}: {with:?} against {without:?}");
    }
}

/// Light adds with a prior, too: what two lights together give is the sum of what each gives, for a global and a local basis, to
/// f32 rounding.
#[test]
fn two_lights_add_with_a_prior() {
    let case = Case::new();
    let dataset = case.dataset(16, Kind::Spot);
    let gram = Gram::of(&dataset, &Silent).unwrap();
    let (channels, lambda) = (Channels::Mono, Lambda::LeaveOneOut);
    let spots: Vec<_> = case.lightmap.spots(&case.asset.mesh).into_iter().map(|s| (s.centre, s.normal)).collect();
    for method in [Method::Linear, Method::Local] {
        let fit = Fit::train(&dataset, &gram, TrainSettings { method, channels, elements: 4, lambda }).unwrap();
        let prior = case.prior(&fit, &dataset);
        let fit = fit.with_prior(&dataset, &prior).unwrap();
        assert!(fit.prior);
        let transfer = if method == Method::Local {
            let terms = Terms::new(&fit, &dataset, &spots, 4, &Silent).unwrap();
            LocalFit::train(&terms, 4, Precision::Byte).transfer(&terms, channels)
        } else {
            fit.expand(&dataset, &Silent).unwrap().1
        };
        let transfer = transfer.rounded();
        let [a, b] = [17, 23].map(|condition| dataset.direct(condition));
        let both: Vec<Rgb> = a.iter().zip(&b).map(|(a, b)| *a + *b).collect();
        // Each coefficient is a sum of P products.
        let mut magnitudes = transfer.clone();
        magnitudes.matrices.iter_mut().flatten().for_each(|m| *m = m.abs());
        let bound = magnitudes.coefficients(&both);
        let misses = |both: &[Rgb]| {
            let [a, b, both] = [&a[..], &b, both].map(|x| transfer.coefficients(x));
            let tolerance = 2.0 * dataset.points() as f32 * f32::EPSILON;
            let differs = |j: &usize| !(a[*j] + b[*j] - both[*j]).abs().cmple(bound[*j] * tolerance).all();
            (0..both.len()).filter(differs).count()
        };
        assert_eq!(misses(&both), 0, "{method:?}");
        let brighter: Vec<Rgb> = both.iter().map(|x| *x * 1.01).collect();
        assert!(misses(&brighter) > 0, "{method:?}: a hundredth more light goes unnoticed");
    }
}

/// The same bits on any number of threads.
#[test]
fn a_prior_does_not_depend_on_the_number_of_threads() {
    faer::set_global_parallelism(faer::Par::Seq);
    let case = Case::new();
    let dataset = case.dataset(16, Kind::Spot);
    let matrices = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let gram = Gram::of(&dataset, &Silent).unwrap();
            let (channels, lambda) = (Channels::Mono, Lambda::LeaveOneOut);
            let settings = TrainSettings { method: Method::Linear, channels, elements: 12, lambda };
            let fit = Fit::train(&dataset, &gram, settings).unwrap();
            let prior = case.prior(&fit, &dataset);
            fit.with_prior(&dataset, &prior).unwrap().expand(&dataset, &Silent).unwrap().1.matrices
        })
    };
    assert_eq!(matrices(1), matrices(3));
}
