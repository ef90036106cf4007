//! Transfer in gamma space (METHOD section 5): its errors are those of the light, and it is taken where it wins and nowhere else.

use std::process::Command;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use relight::dataset::{Dataset, Indirect};
use relight::light::LightingCondition;
use relight::math::Rgb;
use relight::model::Channels;
use relight::progress::Silent;
use relight::transfer::gamma::{Contest, GAMMA, Judged, errors_of_global};
use relight::transfer::{Fit, Gram, HeldOutErrors, Lambda, Method, TrainSettings};

const POINTS: usize = 10;
const TEXELS: usize = 120;
const RANK: usize = 6;

/// D of rank [`RANK`] in the `gamma`th roots, and I whose roots are G times those of D: linear light for γ = 1.
fn synthetic(training: usize, held_out: usize, gamma: f32, noise: f32) -> Dataset {
    faer::set_global_parallelism(faer::Par::Seq);
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let mut uniform = move || rng.random::<f32>();
    let n = training + held_out;
    let patterns: Vec<[f32; POINTS]> = (0..RANK).map(|_| [(); POINTS].map(|_| uniform())).collect();
    let transport: Vec<[f32; RANK]> = (0..TEXELS).map(|_| [(); RANK].map(|_| uniform())).collect();
    let (mut direct, mut indirect) = (vec![0f32; POINTS * 3 * n], vec![0f32; TEXELS * 3 * n]);
    for column in 0..3 * n {
        let mix = [(); RANK].map(|_| uniform().powi(3));
        for p in 0..POINTS {
            let root: f32 = (0..RANK).map(|r| mix[r] * patterns[r][p]).sum();
            direct[p * 3 * n + column] = root.powf(gamma);
        }
        for (t, of_texel) in transport.iter().enumerate() {
            let root: f32 = (0..RANK).map(|r| mix[r] * of_texel[r]).sum();
            indirect[t * 3 * n + column] = (root + noise * uniform()).powf(gamma);
        }
    }
    Dataset {
        conditions: vec![LightingCondition::default(); n],
        training,
        direct,
        indirect: Indirect::Memory(indirect),
        texel_areas: (0..TEXELS).map(|_| 0.5 + uniform()).collect(),
        noise: vec![0.0; n],
    }
}

fn settings(method: Method, channels: Channels, elements: usize) -> TrainSettings {
    TrainSettings { method, channels, elements, lambda: Lambda::Relative(1e-6) }
}

fn held_out(dataset: &Dataset) -> Vec<usize> {
    dataset.held_out().collect()
}

/// Against lightmaps put together texel by texel, for global bases of every kind; the errors of the roots are others.
#[test]
fn errors_are_those_of_the_light() {
    let dataset = synthetic(40, 8, 1.0, 0.3);
    let roots = dataset.roots(GAMMA);
    let gram = Gram::of(&roots, &Silent).unwrap();
    let conditions = held_out(&dataset);
    let Indirect::Memory(truth) = &dataset.indirect else { unreachable!("made in memory") };
    for method in [Method::Linear, Method::Belcour] {
        for channels in [Channels::Mono, Channels::Multi] {
            let fit = Fit::train(&roots, &gram, settings(method, channels, 5)).unwrap();
            let judged = Judged { gamma: GAMMA, conditions: &conditions };
            let errors = errors_of_global(&fit, &roots, &gram, judged, &Silent).unwrap();
            let (values, mut transfer) = fit.expand(&roots, &Silent).unwrap();
            transfer.gamma = GAMMA;
            let (components, n) = (channels.components(), dataset.conditions.len());
            for (&h, &expected) in conditions.iter().zip(&errors.transfer) {
                let column = |c: usize| dataset.direct_column(c, h);
                let columns = [column(0), column(1), column(2)];
                let x: Vec<Rgb> =
                    (0..POINTS).map(|p| Rgb::from_array([0, 1, 2].map(|c| columns[c][p] as f32))).collect();
                let u = transfer.coefficients(&x);
                let (mut error, mut norm) = (0.0, 0.0);
                for t in 0..TEXELS {
                    for channel in 0..3 {
                        let value = |j: usize| values[(j * components + channel % components) * TEXELS + t];
                        let root: f32 = u.iter().enumerate().map(|(j, u)| u[channel] * value(j)).sum();
                        let light = truth[(t * 3 + channel) * n + h];
                        let difference = root.max(0.0).powf(GAMMA) - light;
                        error += (dataset.texel_areas[t] * difference * difference) as f64;
                        norm += (dataset.texel_areas[t] * light * light) as f64;
                    }
                }
                let error = (error / norm).sqrt();
                // The expanded basis and matrices are f32.
                assert!((error - expected).abs() < 1e-4 * expected, "{method:?} {channels:?}: {error}, {expected}");
            }
            let of_roots = HeldOutErrors::of(&fit, &roots, &gram).summary().mean;
            let mean = errors.transfer.iter().sum::<f64>() / errors.transfer.len() as f64;
            assert!((of_roots - mean).abs() > 0.05 * mean, "the control: {of_roots} and {mean} are alike");
            assert!(errors.oracle.iter().zip(&errors.transfer).all(|(oracle, error)| *oracle < 1.5 * error));
        }
    }
}

/// Light whose roots are linear is recovered in gamma space, light that is linear in linear space, each to the f32 of the data
/// times the conditioning (under 1e3); a trial on training conditions tells which it is.
#[test]
fn the_space_in_which_transport_is_linear_is_taken() {
    for (gamma, expected) in [(GAMMA, true), (1.0, false)] {
        let dataset = synthetic(60, 12, gamma, 0.0);
        let space = dataset.roots(gamma);
        let gram = Gram::of(&space, &Silent).unwrap();
        let fit = Fit::train(&space, &gram, settings(Method::Linear, Channels::Mono, RANK)).unwrap();
        let conditions = held_out(&dataset);
        let errors = errors_of_global(&fit, &space, &gram, Judged { gamma, conditions: &conditions }, &Silent).unwrap();
        assert!(errors.summary().worst < 2e-3, "gamma {gamma}: {:?}", errors.summary());
        let contest = Contest::of(&dataset, Channels::Mono, &Silent).unwrap().unwrap();
        assert_eq!(contest.gamma_wins, expected, "{contest:?}");
    }
    // Too few conditions tell nothing, and the held-out ones have no part in it.
    assert_eq!(Contest::of(&synthetic(2, 60, GAMMA, 0.0), Channels::Mono, &Silent).unwrap(), None);
}

/// Diffuse light is linear, which the trial says; what is asked for is done, stays in the model and relights.
#[test]
fn a_model_is_trained_in_the_space_that_is_asked_for_or_found() {
    let folder = tempfile::tempdir().unwrap();
    let run = |words: &str, more: &[&str]| -> String {
        let words = words.split_whitespace();
        let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
        let output = command.current_dir(folder.path()).args(words).args(more).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let error = |name: &str| -> f64 {
        let figures: serde_json::Value =
            serde_json::from_slice(&std::fs::read(folder.path().join(name)).unwrap()).unwrap();
        figures["error"]["mean"].as_f64().unwrap()
    };
    let tiny = "train --size 16 --conditions 48 --held-out 16 --paths 16 --points 64 --sub-points 1 --dataset d";
    for method in ["linear", "local", "belcour"] {
        let found = run(&format!("{tiny} --method {method} --basis 4 -o a.relight --json a.json"), &[]);
        assert_eq!(found.contains("chosen: train.gamma = 1 (on trial"), method != "belcour", "{found}");
        run(&format!("{tiny} --method {method} --basis 4 --gamma 2.2 -o b.relight --json b.json"), &[]);
        assert!(run("info a.relight", &[]).contains("gamma: 1"));
        assert!(run("info b.relight", &[]).contains("gamma: 2.2"));
        assert!(error("a.json") != error("b.json"));
        let light = ["--light", "{type=\"spot\", position=[2,4,-1], direction=[0,-1,1], intensity=50}"];
        let picture = |model: &str| {
            run(&format!("render {model} --cpu --show indirect --size 32x32 --exposure 1 -o p.exr"), &light);
            let image = exr::prelude::read_first_rgba_layer_from_file(
                folder.path().join("p.exr"),
                |size, _| (Vec::<f32>::new(), size.area()),
                |(all, _), _, (r, g, b, _): (f32, f32, f32, f32)| all.extend([r, g, b]),
            );
            image.unwrap().layer_data.channel_data.pixels.0
        };
        let (linear, raised) = (picture("a.relight"), picture("b.relight"));
        let sum = |values: &[f32]| values.iter().sum::<f32>();
        let difference: f32 = linear.iter().zip(&raised).map(|(a, b)| (a - b).abs()).sum();
        // The same light by two models that err by a third or so each; with γ forgotten at either end it would be another magnitude.
        assert!(difference < 0.9 * sum(&linear), "{method}: {difference} of {}", sum(&linear));
        assert!(difference > 0.0 && sum(&raised) > 0.0, "{method}");
    }
}
