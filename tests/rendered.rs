//! Datasets that were rendered elsewhere: what is exported, what trains from them, and what is refused.
//!
//! The renderer is our own: lightmaps that it bakes, written as OpenEXR files, must train what it trains by itself.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage};
use glam::Vec3;
use half::f16;
use relight::dataset::{Bytes, Dataset, DatasetError, Export, Reading, Rendered};
use relight::light::{Light, LightingCondition};
use relight::measure::MeasurementPoints;
use relight::progress::Silent;
use relight::scene::{Asset, Lightmap, Tracer, UvPolicy, generate, lay_out};
use relight::transport::{BakeSettings, Integrator, bake, bake_direct};
use safetensors::SafeTensors;
use serde_json::Value;

const SIZE: u32 = 32;
const TRAINING: usize = 40;
const ALL: usize = 56;

/// Settings of both ways to train.
const SETTINGS: &str = "--size 32 --points 24 --paths 64 --basis 6 --max-bounces 6";

/// How a lightmap's values are written.
#[derive(Clone, Copy)]
enum Form {
    /// Floats in the channels `layer.R` and so on.
    Layer,
    /// Floats in R, G and B.
    Plain,
    /// Half floats in R, G and B, beside another layer.
    Half,
}

struct Work {
    folder: tempfile::TempDir,
    asset: Asset,
}

impl Work {
    /// The Cornell box's conditions exported into `rendered`, and nothing rendered.
    fn exported() -> Self {
        let mut asset = generate("cornell").unwrap();
        lay_out(&mut asset, SIZE, UvPolicy::Auto).unwrap();
        let work = Self { folder: tempfile::tempdir().unwrap(), asset };
        let counts = format!("--conditions {TRAINING} --held-out {}", ALL - TRAINING);
        work.succeeds(&format!("export-conditions SCENE {SETTINGS} {counts} -o rendered"));
        work
    }

    /// The same, every lightmap rendered.
    fn rendered() -> Self {
        let work = Self::exported();
        let (conditions, values) = (work.conditions(), work.baked());
        for (i, file) in work.files("indirect").iter().enumerate() {
            let of_condition: Vec<f32> = values.iter().skip(i).step_by(conditions.len()).copied().collect();
            let form = if i % 2 == 0 { Form::Layer } else { Form::Plain };
            work.write(file, "indirect", form, &of_condition);
        }
        work
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self, words: &str) -> Output {
        let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/cornell/scene.toml");
        let words = words.replace("SCENE", scene);
        let mut arguments: Vec<&str> = Vec::new();
        let mut words = words.split_whitespace();
        while let Some(word) = words.next() {
            // Of an option that is given twice, the last counts.
            let before = arguments.iter().position(|a| word.starts_with('-') && *a == word);
            match before {
                Some(at) => arguments[at + 1] = words.next().unwrap(),
                None => arguments.push(word),
            }
        }
        let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
        command.current_dir(self.folder.path()).args(arguments).output().unwrap()
    }

    fn succeeds(&self, words: &str) -> String {
        let output = self.run(words);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{words}: {stderr}");
        stderr
    }

    /// Trains from `rendered`. Returns the figures and what was said.
    fn train(&self, more: &str) -> (Value, String) {
        let said =
            self.succeeds(&format!("train SCENE {SETTINGS} --dataset rendered -o m.relight --json m.json {more}"));
        (serde_json::from_slice(&std::fs::read(self.path("m.json")).unwrap()).unwrap(), said)
    }

    /// Trains from `rendered`, which must be refused as wrong input in one line with `parts`.
    fn refuses(&self, more: &str, parts: &[&str]) {
        let output = self.run(&format!("train SCENE {SETTINGS} --dataset rendered -o refused.relight {more}"));
        let stderr = String::from_utf8(output.stderr).unwrap();
        let errors: Vec<&str> = stderr.lines().filter(|line| line.starts_with("error: ")).collect();
        assert_eq!((output.status.code(), errors.len()), (Some(2), 1), "{stderr}");
        assert!(parts.iter().all(|part| errors[0].contains(part)), "{parts:?} in {}", errors[0]);
        assert!(!self.path("refused.relight").exists());
    }

    fn manifest(&self) -> Value {
        serde_json::from_slice(&std::fs::read(self.path("rendered/conditions.json")).unwrap()).unwrap()
    }

    fn edit(&self, change: impl FnOnce(&mut Value)) {
        let mut manifest = self.manifest();
        change(&mut manifest);
        std::fs::write(self.path("rendered/conditions.json"), manifest.to_string()).unwrap();
    }

    fn conditions(&self) -> Vec<LightingCondition> {
        let read = |c: &Value| LightingCondition { lights: serde_json::from_value(c["lights"].clone()).unwrap() };
        self.manifest()["conditions"].as_array().unwrap().iter().map(read).collect()
    }

    /// Files of the conditions' lightmaps.
    fn files(&self, folder: &str) -> Vec<PathBuf> {
        let manifest = self.manifest();
        let conditions = manifest["conditions"].as_array().unwrap().iter();
        let path = |c: &Value| format!("rendered/{}", c["indirect"].as_str().unwrap().replace("indirect", folder));
        conditions.map(|c| self.path(&path(c))).collect()
    }

    fn lightmap(&self) -> Lightmap {
        Lightmap::open(&Tracer::new(&self.asset), SIZE as usize)
    }

    /// I as `relight train` bakes it.
    fn baked(&self) -> Vec<f32> {
        let settings = BakeSettings { paths: 64, max_bounces: 6, seed: 1, integrator: Integrator::Auto };
        bake(&Tracer::new(&self.asset), &self.lightmap(), &self.conditions(), &settings, &Silent).unwrap().indirect
    }

    /// Writes one lightmap of values per texel; what no texel covers is not a number.
    fn write(&self, path: &Path, layer: &str, form: Form, values: &[f32]) {
        let (size, texels) = (SIZE as usize, self.lightmap().texels);
        let mut channels = Vec::new();
        for (c, channel) in ["R", "G", "B"].iter().enumerate() {
            let mut plane = vec![f32::NAN; size * size];
            texels.iter().enumerate().for_each(|(t, texel)| plane[texel.index as usize] = values[3 * t + c]);
            let (name, samples) = match form {
                Form::Layer => (format!("{layer}.{channel}"), FlatSamples::F32(plane)),
                Form::Plain => (channel.to_string(), FlatSamples::F32(plane)),
                Form::Half => (channel.to_string(), FlatSamples::F16(plane.into_iter().map(f16::from_f32).collect())),
            };
            channels.push(AnyChannel::new(name.as_str(), samples));
        }
        if matches!(form, Form::Half) {
            channels.push(AnyChannel::new("other.R", FlatSamples::F32(vec![7.0; size * size])));
        }
        let channels = AnyChannels::sort(channels.into_iter().collect());
        let layer = Layer::new((size, size), LayerAttributes::default(), Encoding::SMALL_LOSSLESS, channels);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        Image::from_layer(layer).write().to_file(path).unwrap();
    }
}

fn mean_error(figures: &Value) -> f64 {
    figures["error"]["mean"].as_f64().unwrap()
}

/// D of a dataset's only batch.
fn direct_of(shards: &Path) -> Vec<f32> {
    let bytes = std::fs::read(shards.join("batch-000/direct.safetensors")).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    bytemuck::pod_collect_to_vec(file.tensor("direct").unwrap().data())
}

fn relative_difference(a: &[f32], b: &[f32]) -> f64 {
    let squared = |of: &mut dyn Iterator<Item = f64>| of.map(|v| v * v).sum::<f64>();
    let difference = squared(&mut a.iter().zip(b).map(|(a, b)| (a - b) as f64));
    (difference / squared(&mut b.iter().map(|&b| b as f64))).sqrt()
}

#[test]
fn lightmaps_from_files_train_what_our_own_bake_trains() {
    let work = Work::rendered();
    let (figures, said) = work.train("");
    assert!(said.contains("56 lightmaps in rendered, direct light measured from the lights"), "{said}");
    assert_eq!((figures["conditions"].as_u64(), figures["held_out"].as_u64()), (Some(40), Some(16)));
    // Nobody told how noisy they are.
    assert!(figures["error"]["noise"].is_null() && figures["paths_per_texel"] == 0);
    let counts = format!("--conditions {TRAINING} --held-out {}", ALL - TRAINING);
    work.succeeds(&format!("train SCENE {SETTINGS} {counts} -o own.relight --json own.json"));
    let own: Value = serde_json::from_slice(&std::fs::read(work.path("own.json")).unwrap()).unwrap();
    // The same lightmaps but for directions, which were made unit once more: their rounding, 1e-7, moves the fit little.
    assert!((mean_error(&figures) / mean_error(&own) - 1.0).abs() < 1e-4, "{figures} {own}");
    assert!(
        relative_difference(&direct_of(&work.path("rendered/shards")), &direct_of(&work.path("own.dataset"))) < 1e-5
    );

    // A second run reads the shards as they are; one from a part of the conditions, or from other files, makes them anew.
    let shard = work.path("rendered/shards/batch-000/tile-00000.safetensors");
    let before = std::fs::metadata(&shard).unwrap().modified().unwrap();
    assert_eq!(work.train("").0["error"], figures["error"]);
    assert_eq!(std::fs::metadata(&shard).unwrap().modified().unwrap(), before);
    let (fewer, _) = work.train("--conditions 30");
    assert_eq!((fewer["conditions"].as_u64(), fewer["held_out"].as_u64()), (Some(30), Some(16)));

    // Control: with lightmaps of other conditions the error is another, by a thousand times what is allowed above.
    let files = work.files("indirect");
    let first = work.path("first.exr");
    std::fs::rename(&files[0], &first).unwrap();
    (1..TRAINING).for_each(|i| std::fs::rename(&files[i], &files[i - 1]).unwrap());
    std::fs::rename(&first, &files[TRAINING - 1]).unwrap();
    let (permuted, _) = work.train("");
    assert!(mean_error(&permuted) > 1.1 * mean_error(&figures), "{permuted} {figures}");
}

#[test]
fn what_a_renderer_tells_is_taken_over() {
    let work = Work::rendered();
    work.edit(|manifest| {
        manifest["renderer"] = "Lumen 3".into();
        manifest["samples"] = 512.into();
        manifest["conditions"].as_array_mut().unwrap().iter_mut().for_each(|c| c["noise"] = 0.125.into());
    });
    let (figures, said) = work.train("");
    assert!(said.contains("56 lightmaps by Lumen 3"), "{said}");
    assert_eq!(figures["paths_per_texel"], 512);
    assert!((figures["error"]["noise"].as_f64().unwrap() - 0.125).abs() < 1e-6, "{figures}");
}

#[test]
fn half_floats_train_the_same() {
    let work = Work::rendered();
    let (whole, _) = work.train("");
    let (n, values) = (work.conditions().len(), work.baked());
    for (i, file) in work.files("indirect").iter().enumerate() {
        let of_condition: Vec<f32> = values.iter().skip(i).step_by(n).copied().collect();
        work.write(file, "indirect", Form::Half, &of_condition);
    }
    let (halves, _) = work.train("");
    // Half floats round by 2⁻¹¹ at most.
    assert!((mean_error(&halves) / mean_error(&whole) - 1.0).abs() < 1e-3);
}

/// A value that tells where it belongs, exact as a half float times a power of two.
fn mark(texel: usize, channel: usize, condition: usize) -> f32 {
    ((texel * 3 + channel) * 7 % 97 + 100 * condition + 1) as f32
}

#[test]
fn a_memory_ceiling_makes_more_batches_and_changes_no_value() {
    let mut asset = generate("cornell").unwrap();
    let size = 256;
    lay_out(&mut asset, size as u32, UvPolicy::Auto).unwrap();
    let tracer = Tracer::new(&asset);
    let lightmap = Lightmap::open(&tracer, size);
    let points = MeasurementPoints::place(&asset, 16, 2, 1).unwrap();
    let light = |i: usize| Light::Point {
        position: Vec3::new(2.8, 4.0, 1.0 + 0.3 * i as f32),
        color: Vec3::ONE,
        intensity: 9.0,
        range: None,
    };
    let conditions: Vec<_> = (0..9).map(|i| LightingCondition { lights: vec![light(i)] }).collect();
    let folder = tempfile::tempdir().unwrap();
    let (asset, lightmap, points) = (&asset, &lightmap, &points);
    let scene = Value::Null;
    let export =
        Export { asset, lightmap, points, conditions: &conditions, training: 7, max_bounces: 4, seed: 1, scene };
    export.write(folder.path()).unwrap();
    for i in 0..9 {
        let name = if i < 7 { format!("train-{i:04}") } else { format!("test-{:04}", i - 7) };
        let mut pixels = vec![(0f32, 0f32, 0f32); size * size];
        for (t, texel) in lightmap.texels.iter().enumerate() {
            pixels[texel.index as usize] = (mark(t, 0, i), mark(t, 1, i), mark(t, 2, i));
        }
        let path = folder.path().join("indirect").join(name).with_extension("exr");
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        exr::prelude::write_rgb_file(path, size, size, |x, y| pixels[y * size + x]).unwrap();
    }
    let rendered = Rendered::open(folder.path()).unwrap().unwrap();
    let read = |memory: Bytes| {
        let reading = Reading { tracer: &tracer, lightmap, points, training: 7, held_out: 2, memory };
        rendered.dataset(&reading, &rendered.shards(), &Silent)
    };
    let batches = || std::fs::read_dir(rendered.shards()).unwrap().flatten().filter(|e| e.path().is_dir()).count();
    let check = |dataset: &Dataset| {
        let mut texel = 0;
        let visit = |_: std::ops::Range<usize>, rows: &[f32]| {
            for row in rows.chunks_exact(27) {
                (0..27).for_each(|i| assert_eq!(row[i], mark(texel, i / 9, i % 9), "texel {texel}"));
                texel += 1;
            }
        };
        dataset.for_each_rows(&Silent, visit).unwrap();
        assert_eq!(texel, lightmap.texels.len());
    };
    let Err(DatasetError::Memory { needed, .. }) = read(Bytes(1 << 20)) else { panic!("too little") };
    // Three lightmaps at a time and a half: the resident memory may have grown a little.
    let each = (lightmap.texels.len() * 12 + 4096 * 24) as u64;
    let few = read(Bytes(needed.0 + 5 * each / 2)).unwrap();
    assert!(batches() >= 3, "{} batches", batches());
    check(&few);
    let direct = few.direct.clone();
    // Who reads the shards holds them.
    assert!(matches!(read(Bytes(1 << 30)), Err(DatasetError::InUse { .. })));
    drop(few);
    // Small batches serve a higher ceiling as well.
    let again = read(Bytes(1 << 30)).unwrap();
    assert!(batches() >= 3 && again.direct == direct);
    check(&again);
    drop(again);
    std::fs::remove_dir_all(rendered.shards()).unwrap();
    let whole = read(Bytes(1 << 30)).unwrap();
    assert_eq!(batches(), 1);
    check(&whole);
    assert_eq!(whole.direct, direct);
}

#[test]
fn direct_light_comes_from_a_table_or_from_lightmaps_too() {
    let work = Work::rendered();
    let (measured, _) = work.train("");
    let shards = work.path("rendered/shards");
    let direct = direct_of(&shards);
    // [point][channel][condition] here, [point][condition][channel] in the table.
    let at = |p: usize, c: usize, channel: usize| direct[(3 * p + channel) * ALL + c];
    let points = direct.len() / (3 * ALL);
    let rows = (0..points).flat_map(|p| (0..ALL).map(move |c| (p, c)));
    let line = |(p, c): (usize, usize)| format!("{p},{c},{},{},{}\n", at(p, c, 0), at(p, c, 1), at(p, c, 2));
    let table: String = std::iter::once("point,condition,r,g,b\n".to_owned()).chain(rows.map(line)).collect();
    std::fs::write(work.path("rendered/direct.csv"), &table).unwrap();
    let (from_table, said) = work.train("");
    assert!(said.contains("direct light from direct.csv"), "{said}");
    assert_eq!(from_table["error"], measured["error"]);
    work.refuses("--seed 2", &["direct.csv", "other measurement points"]);
    work.refuses("--points 23", &["direct.csv", "other measurement points"]);
    std::fs::write(work.path("rendered/direct.npy"), "").unwrap();
    work.refuses("", &["direct.npy", "direct.csv", "keep one"]);
    std::fs::remove_file(work.path("rendered/direct.npy")).unwrap();
    let short = table.lines().take(9).collect::<Vec<_>>().join("\n");
    std::fs::write(work.path("rendered/direct.csv"), short).unwrap();
    work.refuses("", &["direct.csv", "no line for point 0 under condition 8"]);
    std::fs::remove_file(work.path("rendered/direct.csv")).unwrap();

    // Lights that this program does not know: then the direct light must be given.
    work.edit(|manifest| manifest["conditions"][3]["lights"] = serde_json::json!([]));
    work.refuses("", &["condition 3 lists no lights", "direct.csv"]);
    let mut conditions = work.conditions();
    conditions[3].lights.push(Light::Emissive { scale: 0.0 });
    let values = bake_direct(&Tracer::new(&work.asset), &work.lightmap(), &conditions, 1, &Silent).unwrap();
    for (i, file) in work.files("direct").iter().enumerate() {
        let of_condition: Vec<f32> = values.iter().skip(i).step_by(ALL).copied().collect();
        work.write(file, "direct", Form::Layer, &of_condition);
    }
    work.edit(|manifest| {
        for condition in manifest["conditions"].as_array_mut().unwrap().iter_mut().skip(1) {
            condition["direct"] = condition["indirect"].as_str().unwrap().replace("indirect", "direct").into();
        }
    });
    work.refuses("", &["condition 0 has no `direct` lightmap"]);
    work.edit(|manifest| manifest["conditions"][0]["direct"] = "direct/train-0000.exr".into());
    let (_, said) = work.train("");
    assert!(said.contains("looked up in direct lightmaps"), "{said}");
    let looked_up = direct_of(&shards);
    // A texel is 0.2 m, a spot's edge crosses it: some points see another share of it than the texel's mean.
    let of = |values: &[f32], c: usize| values.iter().skip(c).step_by(ALL).copied().collect::<Vec<_>>();
    let mut differences: Vec<f64> =
        (0..ALL).filter(|&c| c != 3).map(|c| relative_difference(&of(&looked_up, c), &of(&direct, c))).collect();
    differences.sort_by(f64::total_cmp);
    assert!(differences[ALL / 2] < 0.25, "{differences:?}");
    // Control: another condition's direct light is another.
    assert!(relative_difference(&of(&looked_up, 1), &of(&direct, 0)) > 0.5);
}

#[test]
fn what_cannot_be_used_is_said_in_one_line() {
    let work = Work::exported();
    let first = "indirect/train-0000.exr";
    work.refuses("", &[first, "missing", "condition 0 (55 more"]);
    let work = Work::rendered();
    let file = work.path("rendered/indirect/train-0004.exr");
    let whole = std::fs::read(&file).unwrap();
    let values: Vec<f32> = work.baked().iter().skip(4).step_by(ALL).copied().collect();
    for (wrong, part) in [(f32::NAN, "NaN"), (f32::INFINITY, "inf"), (-0.5, "-0.5")] {
        let mut values = values.clone();
        values[7] = wrong;
        work.write(&file, "indirect", Form::Plain, &values);
        let index = work.lightmap().texels[2].index;
        let place = format!("G of column {}, row {}", index % SIZE, index / SIZE);
        work.refuses("", &["train-0004.exr", "condition 4", &place, part]);
    }
    for (bytes, part) in [(&whole[..whole.len() / 2], "cannot be read"), (b"text", "cannot be read")] {
        std::fs::write(&file, bytes).unwrap();
        work.refuses("", &["train-0004.exr", "condition 4", part]);
    }
    exr::prelude::write_rgb_file(&file, 16, 32, |_, _| (1f32, 1f32, 1f32)).unwrap();
    work.refuses("", &["train-0004.exr", "condition 4", "16 x 32", "32 x 32"]);
    work.write(&file, "diffuse", Form::Layer, &values);
    work.refuses("", &["train-0004.exr", "indirect.R", "diffuse.R"]);
    std::fs::remove_file(&file).unwrap();
    work.refuses("", &["train-0004.exr", "missing", "condition 4;"]);
    std::fs::write(&file, &whole).unwrap();
    work.train("");

    work.refuses("--size 16", &["conditions.json", "32 x 32", "16 x 16"]);
    work.refuses("--uv texcoord1", &["conditions.json", "another asset"]);
    work.refuses("--conditions 41", &["conditions.json", "40 conditions to train on", "41"]);
    work.refuses("--held-out 17", &["conditions.json", "16 conditions held out", "17"]);
    let good = work.manifest();
    let change = |change: &dyn Fn(&mut Value), parts: &[&str]| {
        work.edit(change);
        work.refuses("", parts);
        work.edit(|manifest| *manifest = good.clone());
    };
    change(&|m| m["version"] = 9.into(), &["conditions.json", "version 9, this build reads 1"]);
    change(&|m| m["format"] = "other".into(), &["conditions.json", "\"other\"", "relight-conditions"]);
    change(&|m| m["asset_hash"] = "0".into(), &["conditions.json", "another asset"]);
    change(&|m| m["conditions"][2]["lights"][0]["type"] = "laser".into(), &["conditions.json", "laser"]);
    change(&|m| m["conditions"][2]["lights"][0]["intensity"] = (-1).into(), &["condition 2", "intensity -1"]);
    change(&|m| m["conditions"][2]["lights"] = serde_json::json!([]), &["condition 2 lists no lights"]);
    change(
        &|m| m["conditions"].as_array_mut().unwrap().iter_mut().for_each(|c| c["held_out"] = false.into()),
        &["0 conditions held out"],
    );
    std::fs::write(work.path("rendered/conditions.json"), "{").unwrap();
    work.refuses("", &["conditions.json", "does not parse"]);
}

#[test]
fn an_export_is_extended_and_never_mixed_with_another() {
    let work = Work::rendered();
    work.edit(|manifest| manifest["conditions"][1]["noise"] = 0.5.into());
    let export = |more: &str| work.run(&format!("export-conditions SCENE {SETTINGS} -o rendered {more}"));
    assert!(export("--conditions 44 --held-out 20").status.success());
    let manifest = work.manifest();
    assert_eq!(manifest["conditions"].as_array().unwrap().len(), 64);
    assert_eq!(manifest["conditions"][1]["noise"], 0.5);
    // What was rendered is there, what was added is not.
    work.refuses("", &["train-0040.exr", "condition 40 (7 more"]);
    for (more, part) in [
        ("--size 16", "another asset"),
        ("--points 20", "other measurement points"),
        ("--seed 2", "other measurement points"),
    ] {
        let output = export(more);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{more}: {stderr}");
        assert!(stderr.contains(part), "{more}: {stderr}");
    }
    assert_eq!(work.manifest(), manifest);
}
