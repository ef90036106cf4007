//! Basis, transfer matrix and their errors on synthetic datasets whose answers are known.

use std::sync::Once;

use glam::Vec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use relight::dataset::{Dataset, Indirect};
use relight::light::LightingCondition;
use relight::math::Rgb;
use relight::model::{Basis, Channels, Transfer};
use relight::progress::Silent;
use relight::transfer::ridge::Ridge;
use relight::transfer::{
    Fit, Gram, HeldOutErrors, Lambda, LocalFit, Method, Precision, Probe, Terms, Tested, TrainSettings, TransferError,
    Trial, budget, enough,
};

/// I = G D + noise with a random transport G of the given rank: direct vectors are `rank` random patterns mixed at random.
fn synthetic(points: usize, texels: usize, training: usize, held_out: usize, rank: usize, noise: f64) -> Dataset {
    static SEQUENTIAL: Once = Once::new();
    SEQUENTIAL.call_once(|| faer::set_global_parallelism(faer::Par::Seq));
    let mut rng = Pcg64Mcg::seed_from_u64(11);
    let mut uniform = move || rng.random::<f64>();
    let n = training + held_out;
    let patterns: Vec<Vec<f64>> = (0..rank).map(|_| (0..points).map(|_| uniform()).collect()).collect();
    let transports: Vec<Vec<f64>> = (0..rank).map(|_| (0..texels).map(|_| uniform()).collect()).collect();
    let mut direct = vec![0f32; points * 3 * n];
    let mut indirect = vec![0f32; texels * 3 * n];
    for condition in 0..n {
        for channel in 0..3 {
            let mix: Vec<f64> = (0..rank).map(|_| uniform()).collect();
            let column = channel * n + condition;
            for p in 0..points {
                direct[p * 3 * n + column] = (0..rank).map(|r| mix[r] * patterns[r][p]).sum::<f64>() as f32;
            }
            for t in 0..texels {
                let value: f64 = (0..rank).map(|r| mix[r] * transports[r][t]).sum();
                indirect[t * 3 * n + column] = (value + noise * uniform()) as f32;
            }
        }
    }
    Dataset {
        conditions: vec![LightingCondition::default(); n],
        training,
        direct,
        indirect: Indirect::Memory(indirect),
        texel_areas: (0..texels).map(|_| 0.5 + uniform() as f32).collect(),
        noise: vec![0.0; n],
    }
}

fn settings(method: Method, channels: Channels, elements: usize, lambda: Lambda) -> TrainSettings {
    TrainSettings { method, channels, elements, lambda }
}

fn fit(dataset: &Dataset, settings: TrainSettings) -> (Fit, HeldOutErrors) {
    let gram = Gram::of(dataset, &Silent).unwrap();
    let fit = Fit::train(dataset, &gram, settings).unwrap();
    let errors = HeldOutErrors::of(&fit, dataset, &gram);
    (fit, errors)
}

/// I, which these datasets have in memory.
fn indirect(dataset: &Dataset) -> &[f32] {
    match &dataset.indirect {
        Indirect::Memory(values) => values,
        _ => unreachable!("made by `synthetic`"),
    }
}

/// x of one condition, one RGB a point.
fn direct_of(dataset: &Dataset, condition: usize) -> Vec<Rgb> {
    let columns: [Vec<f64>; 3] = std::array::from_fn(|c| dataset.direct_column(c, condition));
    (0..dataset.points()).map(|p| Rgb::new(columns[0][p] as f32, columns[1][p] as f32, columns[2][p] as f32)).collect()
}

/// Relative RMSE of the expanded model on `condition`, from its definition, texel by texel.
fn error_by_definition(
    dataset: &Dataset,
    values: &[f32],
    coefficients: &[Rgb],
    components: usize,
    condition: usize,
) -> f64 {
    let (texels, n) = (dataset.texels(), dataset.conditions.len());
    let (mut error, mut norm) = (0.0, 0.0);
    for t in 0..texels {
        for channel in 0..3 {
            let component = if components == 1 { 0 } else { channel };
            let value = |j: usize| values[(j * components + component) * texels + t] as f64;
            let estimate: f64 = coefficients.iter().enumerate().map(|(j, u)| u[channel] as f64 * value(j)).sum();
            let truth = indirect(dataset)[t * 3 * n + channel * n + condition] as f64;
            let area = dataset.texel_areas[t] as f64;
            error += area * (truth - estimate).powi(2);
            norm += area * truth * truth;
        }
    }
    (error / norm).sqrt()
}

/// Lights that shine together, and what changes from one frame to the next, against lightmaps put together texel by texel.
#[test]
fn errors_of_sums_and_of_changes_are_those_of_the_definition() {
    let dataset = synthetic(12, 150, 40, 10, 9, 0.3);
    let gram = Gram::of(&dataset, &Silent).unwrap();
    let (texels, n) = (dataset.texels(), dataset.conditions.len());
    let (from, to) = (42, 47);
    for method in [Method::Linear, Method::Belcour] {
        for channels in [Channels::Mono, Channels::Multi] {
            let fit = Fit::train(&dataset, &gram, settings(method, channels, 5, Lambda::Relative(1e-3))).unwrap();
            let (values, transfer) = fit.expand(&dataset, &Silent).unwrap();
            let components = if channels == Channels::Mono { 1 } else { 3 };
            let x = |weight: f32| -> Vec<Rgb> {
                direct_of(&dataset, to).iter().zip(direct_of(&dataset, from)).map(|(&b, a)| b + a * weight).collect()
            };
            let of_lights = |x: &[Rgb]| transfer.coefficients(x);
            let together = of_lights(&x(1.0));
            let frames = [to, from].map(|c| of_lights(&direct_of(&dataset, c)));
            let apart: Vec<Rgb> = frames[0].iter().zip(&frames[1]).map(|(&b, &a)| b - a).collect();
            let by_definition = |u: &[Rgb], weight: f64| {
                let (mut error, mut norm) = (0.0, 0.0);
                for (t, &area) in dataset.texel_areas.iter().enumerate() {
                    for channel in 0..3 {
                        let value = |j: usize| values[(j * components + channel % components) * texels + t] as f64;
                        let estimate: f64 = u.iter().enumerate().map(|(j, u)| u[channel] as f64 * value(j)).sum();
                        let of = |c: usize| indirect(&dataset)[(t * 3 + channel) * n + c] as f64;
                        let truth = of(to) + weight * of(from);
                        error += area as f64 * (truth - estimate).powi(2);
                        norm += area as f64 * truth * truth;
                    }
                }
                (error / norm).sqrt()
            };
            let tested = Tested::global(&fit, &dataset, &gram);
            let error = |probe: &Probe| {
                let (error, norm) = tested.squared_error(probe);
                (error / norm).sqrt()
            };
            let near = |a: f64, b: f64| (a - b).abs() < 1e-4 * b;
            let sum = Probe { parts: vec![(to, 1.0), (from, 1.0)], together: true };
            let (of_sum, of_change) = (error(&sum), error(&Probe::change(from, to)));
            assert!(near(of_sum, by_definition(&together, 1.0)), "{method:?} {channels:?}: {of_sum}");
            assert!(near(of_change, by_definition(&apart, -1.0)), "{method:?} {channels:?}: {of_change}");
            // Two lights are as one where the method is linear; the baseline's mean is scaled by a norm, and norms do not add.
            let one_by_one = error(&Probe { together: false, ..sum });
            let adds = (one_by_one - of_sum).abs() < 1e-9 * of_sum;
            assert_eq!(adds, method == Method::Linear, "{method:?}: {one_by_one} {of_sum}");
        }
    }
}

/// Data of rank r are recovered by r elements, r ≤ P and no ridge, to the rounding of the f32 data (1e-7) times the
/// conditioning of D (under 1e3 here).
#[test]
fn low_rank_transport_is_recovered_exactly() {
    let dataset = synthetic(24, 200, 40, 20, 6, 0.0);
    for channels in [Channels::Mono, Channels::Multi] {
        // Interleaved, the three channels of a condition are mixed independently: three times the rank.
        let elements = if channels == Channels::Mono { 6 } else { 18 };
        let (fit, errors) = fit(&dataset, settings(Method::Linear, channels, elements, Lambda::Relative(0.0)));
        assert!(errors.summary().worst < 1e-4, "{channels:?}: {:?}, {}", errors.summary(), fit.condition_number);
        let (_, control) = self::fit(&dataset, settings(Method::Linear, channels, elements - 1, Lambda::Relative(0.0)));
        assert!(control.summary().mean > 1e-3, "the control: one element fewer cannot do it, {:?}", control.summary());
    }
}

/// The errors that come from inner products are those of the definition, for every method and both kinds of channels, up to
/// the f32 of the expanded basis and matrices.
#[test]
fn errors_from_inner_products_are_those_of_the_definition() {
    let dataset = synthetic(12, 150, 40, 10, 9, 0.3);
    for method in [Method::Linear, Method::Belcour] {
        for channels in [Channels::Mono, Channels::Multi] {
            let (fit, errors) = fit(&dataset, settings(method, channels, 5, Lambda::Relative(1e-3)));
            let (values, transfer) = fit.expand(&dataset, &Silent).unwrap();
            let components = if channels == Channels::Mono { 1 } else { 3 };
            for (h, &expected) in dataset.held_out().zip(&errors.transfer) {
                let u = transfer.coefficients(&direct_of(&dataset, h));
                let error = error_by_definition(&dataset, &values, &u, components, h);
                assert!(
                    (error - expected).abs() < 1e-4 * expected,
                    "{method:?} {channels:?}: {error} against {expected}"
                );
            }
        }
    }
}

/// No transfer can be better than the projection of the truth on the basis.
#[test]
fn oracle_is_a_lower_bound() {
    let dataset = synthetic(12, 150, 40, 20, 9, 0.3);
    for method in [Method::Linear, Method::Belcour] {
        let (_, errors) = fit(&dataset, settings(method, Channels::Mono, 5, Lambda::LeaveOneOut));
        for (transfer, oracle) in errors.transfer.iter().zip(&errors.oracle) {
            assert!(*oracle <= transfer + 1e-9);
        }
    }
}

/// Light adds: with `linear` the coefficients of two lights together are the sum of their coefficients, to f32 rounding. The
/// baseline's ‖x‖ does not add (the control).
#[test]
fn coefficients_of_two_lights_add_with_linear_and_not_with_belcour() {
    let dataset = synthetic(12, 150, 40, 10, 9, 0.3);
    let deviation = |method| {
        let (fit, _) = fit(&dataset, settings(method, Channels::Mono, 5, Lambda::Relative(1e-3)));
        let (_, transfer) = fit.expand(&dataset, &Silent).unwrap();
        let (a, b) = (direct_of(&dataset, 41), direct_of(&dataset, 45));
        let both: Vec<Rgb> = a.iter().zip(&b).map(|(a, b)| *a + *b).collect();
        let (a, b, both) = (transfer.coefficients(&a), transfer.coefficients(&b), transfer.coefficients(&both));
        let difference = |j: usize| (a[j] + b[j] - both[j]).length() / (a[j].length() + b[j].length());
        (0..both.len()).map(difference).fold(0.0, f32::max)
    };
    assert!(deviation(Method::Linear) < 1e-4, "{}", deviation(Method::Linear));
    assert!(deviation(Method::Belcour) > 1e-3, "{}", deviation(Method::Belcour));
}

/// Mono keeps the colour of light exact: a light tinted by c gives coefficients tinted by c.
#[test]
fn mono_transfer_keeps_the_colour_of_light() {
    let dataset = synthetic(12, 150, 40, 10, 9, 0.3);
    let (fit, _) = fit(&dataset, settings(Method::Linear, Channels::Mono, 5, Lambda::LeaveOneOut));
    let (_, transfer) = fit.expand(&dataset, &Silent).unwrap();
    let x = direct_of(&dataset, 42);
    let tint = Rgb::new(0.25, 2.0, 0.0);
    let tinted: Vec<Rgb> = x.iter().map(|&x| x * tint).collect();
    for (u, v) in transfer.coefficients(&x).iter().zip(transfer.coefficients(&tinted)) {
        assert_eq!(*u * tint, v);
    }
}

/// The leave-one-out residual without refitting equals refitting without each condition in turn.
#[test]
fn leave_one_out_equals_refitting_without_each_condition() {
    let (rows, n, elements, lambda) = (7, 12, 3, 0.05);
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let direct = faer::Mat::from_fn(rows, n, |_, _| rng.random::<f64>());
    let coefficients = faer::Mat::from_fn(elements, n, |_, _| rng.random::<f64>());
    let all = Ridge::new(direct.as_ref()).unwrap();
    let without = |matrix: &faer::Mat<f64>, k: usize| {
        faer::Mat::from_fn(matrix.nrows(), n - 1, |r, c| matrix[(r, if c < k { c } else { c + 1 })])
    };
    let fast = all.leave_one_out(coefficients.as_ref(), lambda);
    assert_eq!(fast.len(), n);
    for (k, fast) in fast.into_iter().enumerate() {
        let m = Ridge::new(without(&direct, k).as_ref()).unwrap().solve(without(&coefficients, k).as_ref(), lambda);
        let expected = (m * direct.col(k) - coefficients.col(k)).squared_norm_l2();
        assert!((fast - expected).abs() < 1e-9 * expected, "{fast} against {expected}");
    }
}

/// The two forms of the ridge solution, C Dᵀ (DDᵀ + λ)⁻¹ and C (DᵀD + λ)⁻¹ Dᵀ, are equal: for tall and for wide D the result
/// satisfies the normal equation M (DDᵀ + λ) = C Dᵀ.
#[test]
fn ridge_satisfies_its_normal_equation_on_a_grid_of_shapes() {
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    for (rows, n) in [(1, 1), (1, 9), (9, 1), (5, 30), (30, 5), (16, 16)] {
        for rank_one in [false, true] {
            let direct = if rank_one {
                faer::Mat::from_fn(rows, n, |r, c| (r + 1) as f64 * (c + 1) as f64)
            } else {
                faer::Mat::from_fn(rows, n, |_, _| rng.random::<f64>())
            };
            let c = faer::Mat::from_fn(2, n, |_, _| rng.random::<f64>());
            let lambda = 0.1;
            let m = Ridge::new(direct.as_ref()).unwrap().solve(c.as_ref(), lambda);
            let mut normal = &direct * direct.transpose();
            (0..rows).for_each(|i| normal[(i, i)] += lambda);
            let residual = (&m * &normal - &c * direct.transpose()).norm_l2();
            let scale = (&c * direct.transpose()).norm_l2();
            assert!(residual < 1e-9 * scale, "{rows} x {n}, rank one {rank_one}: {residual} of {scale}");
        }
    }
}

/// Conditions that light nothing are dropped, not divided by; data of lower rank than n, a single condition, repeated
/// conditions and more conditions than points give finite results.
#[test]
fn degenerate_datasets_stay_finite() {
    let mut dark = synthetic(12, 80, 20, 10, 4, 0.1);
    let n = dark.conditions.len();
    for row in dark.direct.chunks_mut(3 * n) {
        (0..3).for_each(|c| row[c * n + 5] = 0.0);
    }
    let mut repeated = synthetic(12, 80, 20, 10, 4, 0.1);
    let Indirect::Memory(lightmaps) = &mut repeated.indirect else { unreachable!() };
    for matrix in [&mut repeated.direct, lightmaps] {
        for row in matrix.chunks_mut(n) {
            row.copy_within(0..1, 1);
            row.copy_within(0..1, 2);
        }
    }
    let single = synthetic(12, 80, 1, 10, 1, 0.0);
    for (dataset, elements, dropped) in [(&dark, 8, 1), (&repeated, 12, 0), (&single, 1, 0)] {
        for method in [Method::Linear, Method::Belcour] {
            for lambda in [Lambda::LeaveOneOut, Lambda::Relative(0.0)] {
                let (fit, errors) = fit(dataset, settings(method, Channels::Mono, elements, lambda));
                assert_eq!(fit.dropped, dropped);
                let (values, transfer) = fit.expand(dataset, &Silent).unwrap();
                assert!(values.iter().chain(transfer.matrices.iter().flatten()).all(|v| v.is_finite()));
                assert!(errors.transfer.iter().all(|e| e.is_finite()));
            }
        }
    }
}

#[test]
fn fewer_conditions_than_elements_is_an_error() {
    let dataset = synthetic(12, 80, 4, 10, 4, 0.1);
    let gram = Gram::of(&dataset, &Silent).unwrap();
    let result = Fit::train(&dataset, &gram, settings(Method::Linear, Channels::Mono, 8, Lambda::LeaveOneOut));
    assert!(matches!(result, Err(TransferError::TooFewConditions { kept: 4, all: 4, elements: 8 })));
}

#[test]
fn values_that_are_not_finite_are_an_error() {
    let mut dataset = synthetic(12, 80, 10, 10, 4, 0.1);
    let Indirect::Memory(lightmaps) = &mut dataset.indirect else { unreachable!() };
    lightmaps[100] = f32::NAN;
    assert!(matches!(Gram::of(&dataset, &Silent), Err(TransferError::NotFinite { .. })));
}

/// A local fit with all that is made of it; its page holds the texels as they are.
struct Local {
    fit: LocalFit,
    errors: HeldOutErrors,
    basis: Basis,
    transfer: Transfer,
}

fn local(dataset: &Dataset, channels: Channels, size: usize, anchors: usize, precision: Precision) -> Local {
    let gram = Gram::of(dataset, &Silent).unwrap();
    let settings = settings(Method::Local, channels, size, Lambda::Relative(1e-9));
    let global = Fit::train(dataset, &gram, settings).unwrap();
    let side = dataset.texels().isqrt();
    // A square sheet.
    let at = |t: usize| (Vec3::new((t % side) as f32, (t / side) as f32, 0.0), Vec3::Z);
    let places: Vec<_> = (0..dataset.texels()).map(at).collect();
    let terms = Terms::new(&global, dataset, &places, anchors, &Silent).unwrap();
    let fit = LocalFit::train(&terms, size, precision);
    let errors = HeldOutErrors::of_local(&fit, &terms, channels, dataset, &gram, &Silent).unwrap();
    let sources: Vec<u32> = (0..dataset.texels() as u32).collect();
    let basis = fit.page(&terms, &sources, &|planes| planes.to_vec());
    let transfer = fit.transfer(&terms, channels);
    Local { fit, errors, basis, transfer }
}

/// Data of rank r need r channels, whatever the anchors are: their frames are all the same. Half floats round by 2⁻¹².
#[test]
fn a_local_basis_recovers_low_rank_transport() {
    let dataset = synthetic(24, 400, 40, 20, 6, 0.0);
    let errors = |size| local(&dataset, Channels::Mono, size, 8, Precision::Half).errors.summary();
    assert!(errors(6).worst < 1e-3 && errors(6).oracle_mean < 1e-3, "{:?}", errors(6));
    assert!(errors(5).mean > 1e-2, "the control: one channel fewer cannot do it, {:?}", errors(5));
    // Nearly as well with 8 bits: 127ths of the texel's largest channel.
    let bytes = local(&dataset, Channels::Mono, 6, 8, Precision::Byte).errors.summary();
    assert!(bytes.worst < 1e-2, "{bytes:?}");
}

/// A rank of its own in each quarter of the sheet: many for a global basis, few for a local one.
#[test]
fn a_local_basis_needs_few_channels_for_light_that_differs_from_place_to_place() {
    let mut dataset = synthetic(32, 1600, 60, 20, 16, 0.0);
    let n = dataset.conditions.len();
    let Indirect::Memory(lightmaps) = &mut dataset.indirect else { unreachable!() };
    // Four points each light a quarter.
    for (t, row) in lightmaps.chunks_mut(3 * n).enumerate() {
        let quarter = (t % 40 / 20) + 2 * (t / 40 / 20);
        for channel in 0..3 {
            for condition in 0..n {
                let at = |p: usize| dataset.direct[p * 3 * n + channel * n + condition];
                let mix = [1.0, t as f32 % 7.0, t as f32 % 5.0, t as f32 % 3.0];
                row[channel * n + condition] = (0..4).map(|i| mix[i] * at(4 * quarter + i)).sum();
            }
        }
    }
    let (_, global) = fit(&dataset, settings(Method::Linear, Channels::Mono, 4, Lambda::Relative(1e-9)));
    let few = local(&dataset, Channels::Mono, 4, 64, Precision::Byte);
    let (global, local) = (global.summary().mean, few.errors.summary().mean);
    assert!(local < 0.3 * global, "{local} and {global}");
}

/// What comes from inner products is what the stored basis and the matrices show, texel by texel; and no transfer is better
/// than the oracle.
#[test]
fn errors_of_a_local_basis_are_those_of_the_definition() {
    let dataset = synthetic(12, 144, 40, 10, 9, 0.3);
    for (channels, precision) in
        [(Channels::Mono, Precision::Byte), (Channels::Mono, Precision::Half), (Channels::Multi, Precision::Byte)]
    {
        let model = local(&dataset, channels, 3, 5, precision);
        for (h, (&expected, &oracle)) in dataset.held_out().zip(model.errors.transfer.iter().zip(&model.errors.oracle))
        {
            let image = model.basis.reconstruct(&model.transfer.coefficients(&direct_of(&dataset, h)));
            let error = error_of_image(&dataset, &image.values, h);
            assert!((error - expected).abs() < 1e-4 * expected, "{channels:?}: {error} against {expected}");
            assert!(oracle <= expected + 1e-9);
            let mut brighter = image.values.clone();
            brighter.iter_mut().for_each(|v| *v *= 1.01);
            assert!((error_of_image(&dataset, &brighter, h) - expected).abs() > 1e-4 * expected, "the control");
        }
    }
}

/// Relative RMSE of a lightmap, from its definition.
fn error_of_image(dataset: &Dataset, image: &[Rgb], condition: usize) -> f64 {
    let n = dataset.conditions.len();
    let (mut error, mut norm) = (0.0, 0.0);
    for (t, estimate) in image.iter().enumerate() {
        for channel in 0..3 {
            let truth = indirect(dataset)[t * 3 * n + channel * n + condition] as f64;
            error += dataset.texel_areas[t] as f64 * (truth - estimate[channel] as f64).powi(2);
            norm += dataset.texel_areas[t] as f64 * truth * truth;
        }
    }
    (error / norm).sqrt()
}

/// Both steps of the alternation minimise the same sum, up to their ridge of 10⁻⁶.
#[test]
fn the_loss_of_the_alternation_falls() {
    let dataset = synthetic(12, 400, 40, 10, 9, 0.3);
    let losses = local(&dataset, Channels::Mono, 3, 16, Precision::Half).fit.losses;
    assert!(losses.windows(2).all(|w| w[1] <= w[0] + 1e-5), "{losses:?}");
    assert!(losses[losses.len() - 1] < 0.9 * losses[0], "{losses:?}");
}

/// Light adds: the lightmap of two lights together is the sum of theirs, to f32 rounding.
#[test]
fn lightmaps_of_two_lights_add_with_a_local_basis() {
    let dataset = synthetic(12, 144, 40, 10, 9, 0.3);
    let model = local(&dataset, Channels::Mono, 4, 8, Precision::Byte);
    let image = |x: &[Rgb]| model.basis.reconstruct(&model.transfer.coefficients(x)).values;
    let (a, b) = (direct_of(&dataset, 41), direct_of(&dataset, 45));
    let both: Vec<Rgb> = a.iter().zip(&b).map(|(a, b)| *a + *b).collect();
    let brightest = image(&both).iter().fold(0f32, |m, v| m.max(v.max_element()));
    for ((a, b), both) in image(&a).iter().zip(&image(&b)).zip(&image(&both)) {
        assert!((*a + *b - *both).abs().max_element() < 1e-4 * brightest, "{a} + {b} and {both}");
    }
}

/// The same bits on any number of threads.
#[test]
fn a_local_basis_does_not_depend_on_the_number_of_threads() {
    let dataset = synthetic(12, 400, 40, 10, 9, 0.3);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let model = pool.install(|| local(&dataset, Channels::Mono, 4, 16, Precision::Byte));
        (model.basis, model.transfer, model.errors)
    };
    assert!(on(1) == on(3));
}

/// Conditions that light nothing, a single one, repeated ones, fewer texels than anchors: finite, and no panic.
#[test]
fn degenerate_datasets_have_a_local_basis() {
    let mut dark = synthetic(12, 81, 20, 10, 4, 0.1);
    let n = dark.conditions.len();
    for row in dark.direct.chunks_mut(3 * n) {
        (0..3).for_each(|c| row[c * n + 5] = 0.0);
    }
    let single = synthetic(12, 81, 1, 10, 1, 0.0);
    let one_texel = synthetic(12, 1, 20, 10, 4, 0.1);
    for (dataset, size) in [(&dark, 8), (&single, 1), (&one_texel, 4)] {
        for precision in [Precision::Byte, Precision::Half] {
            let model = local(dataset, Channels::Mono, size, 64, precision);
            assert!(model.transfer.matrices.iter().flatten().all(|v| v.is_finite()));
            assert!((0..model.basis.values.len()).all(|at| model.basis.values.get(at).is_finite()));
            assert!(model.errors.transfer.iter().all(|e| e.is_finite()));
        }
    }
}

/// A trial of a fit on its own points has the fit's held-out errors, and those of a fit with fewer elements as well.
#[test]
fn a_trial_has_the_errors_of_the_fit() {
    let dataset = synthetic(12, 150, 40, 10, 9, 0.3);
    let gram = Gram::of(&dataset, &Silent).unwrap();
    for channels in [Channels::Mono, Channels::Multi] {
        let of = |elements| settings(Method::Linear, channels, elements, Lambda::Relative(1e-3));
        let fit = Fit::train(&dataset, &gram, of(8)).unwrap();
        let trial = Trial::of(&fit, &gram, dataset.held_out());
        let errors = trial.errors(&dataset).unwrap();
        assert_eq!(errors.len(), 8);
        for elements in [3, 8] {
            let expected = self::fit(&dataset, of(elements)).1.transfer;
            let close = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-9;
            assert!(errors[elements - 1].iter().zip(&expected).all(close), "{channels:?} {elements}");
            assert!(!errors[elements - 2].iter().zip(&expected).all(close), "the control");
        }
        // The same light at other points.
        let fewer = at_first_points(&dataset, 5);
        let refitted = Fit::train(&fewer, &gram, of(8)).unwrap();
        let expected = HeldOutErrors::of(&refitted, &fewer, &gram).transfer;
        let errors = &trial.errors(&fewer).unwrap()[7];
        // The fit's bound on leverage is that of its own points.
        assert!(errors.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 0.02 * b), "{errors:?} {expected:?}");
    }
}

/// The same light, measured at the first points only.
fn at_first_points(dataset: &Dataset, points: usize) -> Dataset {
    let row = 3 * dataset.conditions.len();
    Dataset { direct: dataset.direct[..points * row].to_vec(), ..dataset.clone() }
}

/// Light of 12 patterns needs 12 points, and is then known up to the noise; 3 points of light that has but 2 patterns are enough.
#[test]
fn too_few_points_are_told_with_how_many_would_do() {
    let asked = |rank: usize, few: usize| {
        let dataset = synthetic(48, 150, 80, 30, rank, 0.02);
        let gram = Gram::of(&dataset, &Silent).unwrap();
        let now = at_first_points(&dataset, few);
        let fit = Fit::train(&now, &gram, settings(Method::Linear, Channels::Mono, 12, Lambda::LeaveOneOut)).unwrap();
        let summary = HeldOutErrors::of(&fit, &now, &gram).summary();
        let measure = |points: usize| Ok::<_, TransferError>(at_first_points(&dataset, points));
        let means = (summary.mean, summary.oracle_mean);
        let more = enough::points(&fit, &now, &gram, means, &[2 * few, 4 * few, 8 * few], measure).unwrap();
        let then = more.map(|more| {
            let then = at_first_points(&dataset, more.enough);
            let fit = Fit::train(&then, &gram, fit.settings).unwrap();
            HeldOutErrors::of(&fit, &then, &gram).summary().mean
        });
        (more, then, summary.mean)
    };
    let (more, then, now) = asked(12, 4);
    let (more, then) = (more.unwrap(), then.unwrap());
    assert!(more.enough >= 12 && then < 0.5 * now, "{more:?} {then} {now}");
    assert!((more.error - then).abs() < 0.05 * then, "what is foretold comes true: {more:?} {then}");
    assert_eq!(asked(2, 4).0, None, "the control");
}

/// Light of rank 20: half of 28 conditions do not span it, all do; of 400 more only average the noise.
#[test]
fn too_few_conditions_are_told() {
    let curve = |training: usize| {
        let dataset = synthetic(60, 150, training, 40, 20, 0.02);
        let gram = Gram::of(&dataset, &Silent).unwrap();
        // No floor to λ, under which the mean of all light would hide the rest.
        let of = settings(Method::Local, Channels::Mono, 4, Lambda::Relative(1e-9));
        let fit = Fit::train(&dataset, &gram, of).unwrap();
        let error = HeldOutErrors::of(&fit, &dataset, &gram).summary().mean;
        let held_out = enough::curve(&fit, None, &dataset, &gram, error).unwrap().unwrap();
        (held_out, enough::curve_of_training(&dataset, &gram, of, |_| Ok::<_, TransferError>(None)).unwrap().unwrap())
    };
    let ((few, few_training), (many, many_training)) = (curve(28), curve(400));
    assert!(few.shortage(1 << 16).is_some_and(|more| more.enough > 28 && more.error < 0.9 * few.error), "{few:?}");
    assert!(few_training.gain() > enough::LEAST_GAIN, "{few_training:?}");
    assert!(
        many.shortage(1 << 16).is_none() && many_training.gain() < enough::LEAST_GAIN,
        "{many:?} {many_training:?}"
    );
}

/// Errors by cross-validation are those of held-out conditions, within what 40 of them differ from others.
#[test]
fn cross_validation_tells_the_held_out_error() {
    let dataset = synthetic(24, 150, 120, 40, 12, 0.2);
    let gram = Gram::of(&dataset, &Silent).unwrap();
    let of = |elements| settings(Method::Linear, Channels::Mono, elements, Lambda::LeaveOneOut);
    let measured = [at_first_points(&dataset, 6), dataset.clone()];
    let estimates = budget::cross_validate(&measured, &gram, of(10)).unwrap();
    for (dataset, estimates) in measured.iter().zip(&estimates) {
        for elements in [2, 10] {
            let fit = Fit::train(dataset, &gram, of(elements)).unwrap();
            let errors = HeldOutErrors::of(&fit, dataset, &gram).transfer;
            let (mean, count) = (errors.iter().sum::<f64>() / errors.len() as f64, errors.len() as f64);
            let variance = errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / (count - 1.0);
            let estimate = estimates[elements - 1];
            // Four standard errors of both, and what a fit on a quarter fewer conditions loses.
            let bound = 4.0 * (variance * (1.0 / 40.0 + 1.0 / 120.0)).sqrt() + 0.1 * mean;
            assert!((estimate - mean).abs() < bound, "{elements}: {estimate} {mean}");
        }
    }
    assert!(estimates[0][9] > 1.5 * estimates[1][9], "the control: six points tell less, {estimates:?}");
}
