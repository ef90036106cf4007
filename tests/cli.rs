//! Whole commands in a temporary folder: what they write, what they say, and how they end.

mod common;
#[path = "common/work.rs"]
mod work;

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use common::{GltfBuilder, trial};
use libtest_mimic::{Arguments, Failed, Trial};
use relight::gpu::{Gpu, GpuError};
use serde_json::{Value, json};
use work::{POINT, TINY, Work};

fn main() {
    let no_gpu = matches!(Gpu::new(), Err(GpuError::NoAdapter { .. }));
    let gpu = || -> Result<(), Failed> {
        render_on("GPU", &[]);
        Ok(())
    };
    let trials = vec![
        trial("train_writes_a_model_and_its_figures", train_writes_a_model_and_its_figures),
        trial("conditions_are_added_until_more_gain_little", conditions_are_added_until_more_gain_little),
        trial("sizes_keep_a_budget", sizes_keep_a_budget),
        trial("an_error_out_of_reach_ends_with_status_1", an_error_out_of_reach_ends_with_status_1),
        trial("train_takes_scene_files_and_assets", train_takes_scene_files_and_assets),
        trial("a_model_tells_lights_that_it_was_not_trained_on", a_model_tells_lights_that_it_was_not_trained_on),
        trial("compare_writes_its_report", compare_writes_its_report),
        trial("render_on_the_cpu", || render_on("CPU", &["--cpu"])),
        trial("render_a_reference", || render_on("path traced", &["--reference", "--paths", "2"])),
        Trial::test("render_on_the_gpu", gpu).with_ignored_flag(no_gpu),
        trial("lights_and_cameras_read_alike_in_every_form", lights_and_cameras_read_alike_in_every_form),
        trial("bake_writes_both_layers", bake_writes_both_layers),
        trial("info_knows_models_scenes_and_assets", info_knows_models_scenes_and_assets),
        trial("a_closed_pipe_stops_no_work", a_closed_pipe_stops_no_work),
        trial("bad_settings_are_said_in_one_line", bad_settings_are_said_in_one_line),
        trial("bad_scene_files_are_said_in_one_line", bad_scene_files_are_said_in_one_line),
        trial("bad_assets_are_said_in_one_line", bad_assets_are_said_in_one_line),
        trial("bad_lights_and_cameras_are_said_in_one_line", bad_lights_and_cameras_are_said_in_one_line),
        trial("damaged_models_are_said_in_one_line", damaged_models_are_said_in_one_line),
        trial("results_that_cannot_be_written_are_said", results_that_cannot_be_written_are_said),
        #[cfg(unix)]
        trial("ctrl_c_stops_within_a_second_and_writes_nothing", ctrl_c_stops_within_a_second),
    ];
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}

/// Two walls in a corner, the floor white and the wall red, with a point light above them and a camera.
fn corner_glb() -> Vec<u8> {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats(
        "VEC3",
        &[0., 0., 0., 0., 0., 2., 2., 0., 2., 2., 0., 0., 0., 0., 0., 2., 0., 0., 2., 2., 0., 0., 2., 0.],
    );
    gltf.attribute("POSITION", positions);
    gltf.indices(&[0, 1, 2, 0, 2, 3, 4, 5, 6, 4, 6, 7]);
    gltf.json["meshes"][0]["primitives"][0]["material"] = 0.into();
    gltf.json["materials"] =
        json!([{ "name": "red", "pbrMetallicRoughness": { "baseColorFactor": [0.8, 0.2, 0.2, 1.0] } }]);
    gltf.json["extensions"] = json!({ "KHR_lights_punctual": { "lights": [{ "type": "point", "intensity": 5.0 }] } });
    gltf.json["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 0.9, "znear": 0.1 } }]);
    gltf.json["nodes"] = json!([
        { "mesh": 0 },
        { "translation": [1.0, 1.5, 1.0], "extensions": { "KHR_lights_punctual": { "light": 0 } } },
        { "translation": [1.0, 1.0, 5.0], "camera": 0 },
    ]);
    gltf.json["scenes"] = json!([{ "nodes": [0, 1, 2] }]);
    gltf.glb()
}

fn keys(value: &Value) -> BTreeSet<&str> {
    value.as_object().unwrap().keys().map(String::as_str).collect()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"))
}

/// The keys that other programs rely on; there may be more.
fn has_keys(value: &Value, fixed: &[&str]) {
    let missing: Vec<_> = fixed.iter().filter(|key| !keys(value).contains(*key)).collect();
    assert!(missing.is_empty(), "{missing:?} missing in {value}");
}

fn check_train_figures(figures: &Value) {
    has_keys(
        figures,
        &[
            "method",
            "basis",
            "points",
            "conditions",
            "held_out",
            "error",
            "seconds",
            "texels",
            "paths_per_texel",
            "peak_bytes",
            "model_bytes",
        ],
    );
    has_keys(&figures["error"], &["mean", "median", "worst", "oracle_mean"]);
    has_keys(&figures["seconds"], &["bake", "train", "total"]);
    for (key, value) in [("basis", 4), ("points", 16), ("conditions", 24), ("paths_per_texel", 4)] {
        assert_eq!(figures[key], value, "{key}");
    }
    // Held-out conditions that light nothing have no relative error and do not count.
    assert!((1.0..=8.0).contains(&number(&figures["held_out"])), "{figures}");
    assert_eq!(figures["method"], "local");
    // Fractions: a toy is bad, but never a hundred times the light.
    let error = |key: &str| number(&figures["error"][key]);
    assert!(0.0 < error("oracle_mean") && error("oracle_mean") <= error("mean") && error("worst") < 10.0, "{figures}");
    assert!(error("median") <= error("worst") && error("mean") <= error("worst"));
    let seconds = |key: &str| number(&figures["seconds"][key]);
    assert!(seconds("bake") + seconds("train") <= seconds("total"));
}

fn train_writes_a_model_and_its_figures() {
    let work = Work::new();
    let stdout = work.succeeds(&format!("train {TINY} --json figures.json"), &[]);
    assert!(stdout.contains("8 held-out conditions") && stdout.contains("wrote out/cornell.relight"), "{stdout}");
    let files = work.files();
    let results: Vec<_> = files.iter().filter(|f| !f.starts_with("out/cornell.dataset/")).collect();
    assert_eq!(results, ["figures.json", "out", "out/cornell.dataset", "out/cornell.relight"]);
    let figures = work.json("figures.json");
    check_train_figures(&figures);
    assert_eq!(
        number(&figures["model_bytes"]),
        std::fs::metadata(work.path("out/cornell.relight")).unwrap().len() as f64
    );
    let percent = format!("mean {:.2} %", 100.0 * number(&figures["error"]["mean"]));
    assert!(stdout.contains(&percent), "{percent} in {stdout}");
    // The paper's baseline, multi-channel, and a seed as large as seeds get.
    work.succeeds(
        &format!(
            "train {TINY} --method belcour --channels multi --seed 18446744073709551615 -o b.relight --json b.json"
        ),
        &[],
    );
    assert_eq!(work.json("b.json")["method"], "belcour");
    work.succeeds("info b.relight", &[]);
}

/// Trained on spots, given suns (Belcour et al. 2022, figure 8) and whatever else there is. Measured 0.96 to 0.99; with 256
/// held-out lights and 30 of a kind the standard error is about 0.02.
fn a_model_tells_lights_that_it_was_not_trained_on() {
    let work = Work::new();
    let settings =
        "--size 16 --conditions 24 --held-out 256 --paths 1 --points 128 --basis 4 -o m.relight --json m.json";
    work.succeeds(&format!("train {settings}"), &[]);
    let figures = work.json("m.json");
    let separation = figures["separation"].as_array().unwrap();
    let auc = |kind: &str| number(&separation.iter().find(|s| s["kind"] == kind).unwrap()["auc"]);
    assert!(auc("directional") >= 0.95, "{figures}");
    for kind in ["point", "rect", "disk", "sphere", "sky"] {
        assert!(auc(kind) >= 0.9, "{kind}: {figures}");
    }
    assert!(separation.iter().all(|s| s["kind"] != "spot"));

    let spot = "{type=\"spot\", position=[2.8,4,1], direction=[0.2,-0.8,0.5], intensity=20, outer_cone_angle=0.7}";
    let sun = "{type=\"directional\", direction=[0.1,-0.2,0.9], intensity=3}";
    let reading = |light: &str| {
        let said = work.succeeds("render m.relight --cpu --size 8x8 -o a.png --json a.json", &["--light", light]);
        (said, work.json("a.json"))
    };
    let (said, figures) = reading(spot);
    assert!(number(&figures["novelty"]) < 0.5 && said.contains("lights: seen"), "{said}");
    let (said, figures) = reading(sun);
    assert!(number(&figures["novelty"]) > 0.5 && figures["like"] == "directional", "{said}");
}

/// Four elements are soon as good as they get.
fn conditions_are_added_until_more_gain_little() {
    let work = Work::new();
    let toy =
        "train --size 16 --held-out 16 --paths 16 --points 64 --method linear --channels multi --basis 4 --gamma 1";
    let said = work.succeeds(&format!("{toy} --conditions auto -o auto.relight --json auto.json"), &[]);
    let figures = work.json("auto.json");
    let choice = &figures["choices"][0];
    assert_eq!((&choice["setting"], figures["choices"].as_array().unwrap().len()), (&json!("bake.conditions"), 1));
    let count = figures["conditions"].as_u64().unwrap();
    assert_eq!(choice["value"], count.to_string());
    assert!((64..=1024).contains(&count) && count.is_power_of_two(), "{figures}");
    assert!(said.contains(&format!("chosen: bake.conditions = {count} (")), "{said}");
    assert!(work.succeeds("info auto.relight", &[]).contains(&format!("bake.conditions = {count}")));
    // As if that number had been given, from the folder that grew.
    let given = format!("{toy} --conditions {count} --dataset auto.dataset -o given.relight --json given.json");
    work.succeeds(&given, &[]);
    assert_eq!(work.json("given.json")["error"], figures["error"]);
    assert_eq!(work.json("given.json")["choices"], json!([]));
}

/// Bytes of the tensors that a run time loads for indirect light.
fn bytes_loaded(model: &Path) -> usize {
    let bytes = std::fs::read(model).unwrap();
    let tensors = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let counted = ["basis", "transfer", "anchors.", "points.", "sub_points."];
    let is_counted = |name: &str| counted.iter().any(|c| name == *c || c.ends_with('.') && name.starts_with(c));
    tensors.iter().filter(|(name, _)| is_counted(name)).map(|(_, tensor)| tensor.data().len()).sum()
}

fn sizes_keep_a_budget() {
    let work = Work::new();
    let toy = "train --size 16 --conditions 64 --held-out 16 --paths 16 --sub-points 2 --dataset d";
    let trained = |more: &str| {
        let said = work.succeeds(&format!("{toy} {more} -o m.relight --json m.json"), &[]);
        let figures = work.json("m.json");
        let settings = figures["choices"].as_array().unwrap().iter().map(|c| c["setting"].as_str().unwrap().to_owned());
        (settings.collect::<Vec<_>>(), bytes_loaded(&work.path("m.relight")), number(&figures["error"]["mean"]), said)
    };
    let all = ["train.basis", "train.anchors", "points.count"];
    let (settings, small, error_of_small, said) = trained("--max-bytes 40KiB");
    assert!(settings == all && small <= 40 << 10, "{settings:?} {small}");
    assert!(said.contains("max_bytes = 40KiB"), "{said}");
    let (_, large, error_of_large, _) = trained("--max-bytes 400KiB");
    assert!(large <= 400 << 10 && large > small, "{large}");
    assert!(error_of_large < error_of_small, "{error_of_large} {error_of_small}");
    // What it takes is what was told.
    let told = said.split("max_bytes = 40KiB: ").nth(1).unwrap().split(' ').next().unwrap();
    let told: relight::dataset::Bytes = told.parse().unwrap();
    assert!(told.0 >= small as u64 && told.0 < small as u64 + 200, "{told} {small}");
    // A large error is reached by a smaller model than a small one.
    let (_, rough, error, _) = trained("--max-error 0.6 --points 64");
    assert!(error <= 0.6 && rough <= large, "{error} {rough}");
    // Values that are given are kept.
    let (settings, bytes, _, _) = trained("--max-bytes 100KiB --method linear --points 96");
    assert!(settings == ["train.basis", "points.count"] && bytes <= 100 << 10, "{settings:?} {bytes}");
    assert_eq!(work.json("m.json")["points"], 96);
    // What no size keeps is refused before anything is baked.
    work.fails(2, "train --size 16 --max-bytes 1KiB -o no.relight", &[], "train.max_bytes = 1KiB is too little");
}

fn an_error_out_of_reach_ends_with_status_1() {
    let work = Work::new();
    let output = work.run(&format!("train {TINY} --max-error 0.0001 -o m.relight --json m.json"), &[]);
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("over --max-error 0.0001"), "{stderr}");
    assert!(work.path("m.relight").exists() && number(&work.json("m.json")["error"]["mean"]) > 0.0001);
}

fn train_takes_scene_files_and_assets() {
    let work = Work::new();
    std::fs::create_dir(work.path("assets")).unwrap();
    work.put("assets/corner.glb", corner_glb());
    // The asset's path is relative to the scene file, not to where the command runs.
    work.put(
        "assets/scene.toml",
        "[asset]\npath = \"corner.glb\"\nmaterials = \"lambert\"\n[bake]\nconditions = 1000\n",
    );
    work.succeeds(&format!("train assets/scene.toml {TINY} -o scene.relight --json scene.json"), &[]);
    check_train_figures(&work.json("scene.json"));
    work.succeeds(&format!("train assets/corner.glb {TINY} -o nested/deep/glb.relight --json glb.json"), &[]);
    check_train_figures(&work.json("glb.json"));
    assert!(work.files().contains("nested/deep/glb.relight"));
    let settings = |file: &str, json: &str| {
        work.succeeds(&format!("info {file} --json {json}"), &[]);
        work.json(json)["scene settings"]["asset"]["materials"].clone()
    };
    assert_eq!(settings("scene.relight", "a.json"), "lambert");
    assert_eq!(settings("nested/deep/glb.relight", "b.json"), "file");
}

fn compare_writes_its_report() {
    let work = Work::with_model();
    let stdout = work.succeeds("compare model.relight -o report --reference-paths 1 --seeds 2 --json rows.json", &[]);
    assert!(stdout.contains("mean relative RMSE on held-out lights, as trained"), "{stdout}");
    let files = work.files();
    let data = "errors views temporal figure-03-eigenvalues figure-04-points figure-04-averaging figure-05-channels \
                figure-06-gamma figure-08-scenarios figure-12-classical figure-13-sizes figure-14-errors sweep-conditions \
                sweep-points sweep-lambda sweep-together";
    for name in data.split_whitespace() {
        let csv =
            std::fs::read_to_string(work.path(&format!("report/{name}.csv"))).unwrap_or_else(|e| panic!("{name}: {e}"));
        let mut lines = csv.lines();
        let columns = lines.next().unwrap().split(',').count();
        assert!(columns > 2 && lines.clone().count() > 1, "{name}: {csv}");
        assert!(lines.all(|line| line.split(',').count() == columns && !line.contains("NaN")), "{name}: {csv}");
    }
    for name in ["report.html", "comparison.json", "images", "plots/figure-14-own.svg", "plots/temporal-path.svg"] {
        assert!(files.contains(&format!("report/{name}")), "{name}: {files:?}");
    }
    let page = std::fs::read_to_string(work.path("report/report.html")).unwrap();
    for figure in [3, 4, 5, 6, 8, 12, 13, 14] {
        assert!(page.contains(&format!("Figure {figure}:")), "figure {figure}");
    }
    let comparison = work.json("report/comparison.json");
    assert_eq!(comparison, work.json("rows.json"));
    let rows = comparison["rows"].as_array().unwrap();
    let mut methods = BTreeSet::new();
    for row in rows {
        has_keys(row, &["bytes_per_texel", "multiply_adds_per_texel", "model_bytes", "spread", "means", "temporal"]);
        let trained = !row["method"].as_str().unwrap().starts_with("sh_prt");
        // Two sets: the spread is their difference over √2.
        let means: Vec<f64> = row["means"].as_array().unwrap().iter().map(number).collect();
        assert_eq!((means.len(), row["spread"].is_f64()), if trained { (2, true) } else { (1, false) }, "{row}");
        if trained {
            assert!((number(&row["mean"]) - (means[0] + means[1]) / 2.0).abs() < 1e-12, "{row}");
            assert!((number(&row["spread"]) - (means[0] - means[1]).abs() / 2f64.sqrt()).abs() < 1e-12, "{row}");
            assert!(means[0] != means[1], "the control: sets differ, {row}");
        }
        // Lights are moved under the model's own scenario.
        assert_eq!(row["temporal"].is_f64(), row["scenario"] == "as trained", "{row}");
        has_keys(row, &["method", "coefficients", "points", "scenario", "mean", "median", "oracle_mean"]);
        methods.insert(row["method"].as_str().unwrap());
        let data_driven = !row["method"].as_str().unwrap().starts_with("sh_prt");
        assert_eq!(data_driven, row["oracle_mean"].is_f64(), "{row}");
        assert_eq!(data_driven, row["points"] == 16, "{row}");
        assert!(number(&row["mean"]) > 0.0 && number(&row["mean"]) < 100.0, "{row}");
    }
    assert_eq!(methods, ["belcour", "linear", "local", "sh_prt_texel", "sh_prt_vertex"].into());
    // Four methods and the reference's halves under three lights.
    let views = comparison["views"].as_array().unwrap();
    assert_eq!(views.len(), 15);
    for view in views {
        has_keys(view, &["light", "method", "flip_ldr", "flip_hdr"]);
        assert!(
            ["flip_ldr", "flip_hdr"].iter().all(|k| (0.0..=1.0).contains(&number(&view[k])) && number(&view[k]) > 0.0)
        );
    }
    let csv = std::fs::read_to_string(work.path("report/errors.csv")).unwrap();
    assert_eq!(csv.lines().count(), rows.len() + 1);
    // What the model was trained to is what comes out again.
    work.succeeds("info model.relight --json info.json", &[]);
    let own = rows.iter().find(|r| r["method"] == "local" && r["coefficients"] == 4 && r["scenario"] == "as trained");
    assert_eq!(own.unwrap()["means"][0], work.json("info.json")["held-out error"]["mean"]);
    let images: Vec<_> = files.iter().filter(|f| f.starts_with("report/images/")).collect();
    assert!(images.len() >= 20, "{images:?}");
    // In short: one set, no sweeps, nothing of the other seed.
    work.succeeds("compare model.relight -o short --reference-paths 1 --quick --json short.json", &[]);
    let short = work.json("short.json");
    let row =
        short["rows"].as_array().unwrap().iter().find(|r| r["method"] == "linear" && r["coefficients"] == 4).unwrap();
    assert!(row["spread"].is_null() && row["means"].as_array().unwrap().len() == 1, "{row}");
    assert!(!work.files().contains("short/sweep-points.csv") && work.files().contains("short/figure-13-sizes.csv"));
    for name in images {
        let image = image::open(work.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(image.width() > 1 && image.height() > 1, "{name}");
    }
}

/// Linear radiance, row by row.
fn read_exr(path: &Path) -> ((usize, usize), Vec<[f32; 3]>) {
    let image = exr::prelude::read_first_rgba_layer_from_file(
        path,
        |size, _| (size.width(), vec![[0.0; 3]; size.area()]),
        |(width, pixels), at, (r, g, b, _): (f32, f32, f32, f32)| pixels[at.y() * *width + at.x()] = [r, g, b],
    )
    .unwrap();
    let size = image.layer_data.size;
    ((size.width(), size.height()), image.layer_data.channel_data.pixels.1)
}

fn render_on(renderer: &str, options: &[&str]) {
    let work = Work::with_model();
    let light = [options, &["--light", POINT]].concat();
    let stdout = work.succeeds("render model.relight --size 20x12 -o a.png --json a.json", &light);
    assert!(stdout.contains("wrote a.png") && stdout.contains(renderer), "{stdout}");
    assert_eq!((&work.json("a.json")["width"], &work.json("a.json")["height"]), (&json!(20), &json!(12)));
    let png = image::open(work.path("a.png")).unwrap().into_rgb8();
    assert_eq!((png.width(), png.height()), (20, 12));
    assert!(png.iter().any(|&code| code > 100), "the picture is black");
    let part = |part: &str| {
        work.succeeds(&format!("render model.relight --size 20x12 --show {part} -o {part}.exr"), &light);
        let (size, pixels) = read_exr(&work.path(&format!("{part}.exr")));
        assert_eq!(size, (20, 12));
        assert!(pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0));
        assert!(pixels.iter().flatten().any(|v| *v > 0.0), "{part} is black");
        pixels
    };
    let (full, direct, indirect) = (part("full"), part("direct"), part("indirect"));
    // f32 sums of two parts, each rounded once more where pixels are averaged.
    for ((full, direct), indirect) in full.iter().flatten().zip(direct.iter().flatten()).zip(indirect.iter().flatten())
    {
        assert!((full - direct - indirect).abs() <= 1e-5 * full.abs() + 1e-7, "{full} {direct} {indirect}");
    }
}

/// The same light and camera in every way that the help names give the same picture, bit for bit.
fn lights_and_cameras_read_alike_in_every_form() {
    let work = Work::new();
    work.put("corner.glb", corner_glb());
    work.succeeds(&format!("train corner.glb {TINY} -o m.relight"), &[]);
    let picture = |light: &str, camera: &[&str]| {
        let more = [&["--light", light], camera].concat();
        work.succeeds("render m.relight --cpu --size 12x8 -o a.exr", &more);
        std::fs::read(work.path("a.exr")).unwrap()
    };
    work.put("l.toml", "[[lights]]\ntype = \"point\"\nposition = [1.0, 1.5, 1.0]\nintensity = 5.0\n");
    work.put("l.json", r#"{"lights": [{"type": "point", "position": [1.0, 1.5, 1.0], "intensity": 5.0}]}"#);
    let expected = picture("asset", &[]);
    for light in [
        "{type=\"point\", position=[1,1.5,1], intensity=5}",
        "{\"type\":\"point\",\"position\":[1,1.5,1],\"intensity\":5,\"color\":[1,1,1]}",
        "l.toml",
        "l.json",
    ] {
        assert!(picture(light, &[]) == expected, "--light {light}");
    }
    assert!(picture("{type=\"point\", position=[1,1.5,1], intensity=6}", &[]) != expected, "a brighter light");
    work.succeeds("info m.relight --json m.json", &[]);
    let camera = "{\"eye\":[0.5,1.5,5],\"target\":[1,1,0],\"vertical_fov\":30}";
    let other = picture("asset", &["--camera", camera]);
    assert!(other == picture("asset", &["--camera", "{eye=[0.5,1.5,5], target=[1,1,0], vertical_fov=30}"]));
    assert!(other != expected && picture("asset", &["--camera", "0"]) == expected, "the first camera is the default");
}

fn bake_writes_both_layers() {
    use exr::prelude::{ReadChannels, ReadLayers, read};
    let work = Work::new();
    work.put("corner.glb", corner_glb());
    work.succeeds("bake corner.glb --size 16 --paths 16 -o a.exr --json a.json", &["--light", "asset"]);
    let image = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer().all_attributes();
    let image = image.from_file(work.path("a.exr")).unwrap();
    assert_eq!((image.layer_data.size.width(), image.layer_data.size.height()), (16, 16));
    let channels = &image.layer_data.channel_data.list;
    let names: BTreeSet<String> = channels.iter().map(|c| c.name.to_string()).collect();
    let expected = ["direct.R", "direct.G", "direct.B", "indirect.R", "indirect.G", "indirect.B"];
    assert_eq!(names, expected.map(String::from).into());
    let sum = |name: &str| {
        let channel = channels.iter().find(|c| c.name.to_string() == name).unwrap();
        channel.sample_data.values_as_f32().inspect(|v| assert!(v.is_finite() && *v >= 0.0)).sum::<f32>()
    };
    // White light stays white until red walls reflect it: albedo 0.8 against 0.2 once, and more so later.
    assert_eq!(sum("direct.R"), sum("direct.B"));
    assert!(sum("direct.R") > 0.0 && sum("indirect.R") >= 3.9 * sum("indirect.B"));
    let figures = work.json("a.json");
    has_keys(&figures, &["seconds", "rays", "texels"]);
    assert!(number(&figures["rays"]) >= 16.0 * number(&figures["texels"]));
}

fn info_knows_models_scenes_and_assets() {
    let work = Work::with_model();
    work.put("corner.glb", corner_glb()).put("scene.toml", "[asset]\ngenerator = \"statue\"\n[lightmap]\nsize = 64\n");
    let info = |file: &str| work.succeeds(&format!("info {file}"), &[]);
    let model = info("model.relight");
    assert!(
        model.contains("elements: 4") && model.contains("triangles: 42") && model.contains("points: 16"),
        "{model}"
    );
    let scene = info("scene.toml");
    assert!(scene.contains("name: statue") && scene.contains("size: 64 x 64"), "{scene}");
    let asset = info("corner.glb");
    assert!(
        asset.contains("triangles: 4") && asset.contains("materials: red") && asset.contains("cameras: 1"),
        "{asset}"
    );
}

/// What is printed into a pipe that nobody reads is lost, and nothing else is.
fn a_closed_pipe_stops_no_work() {
    let work = Work::with_model();
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_relight"))
        .current_dir(work.0.path())
        .args(["info", "model.relight", "--json", "facts.json"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    assert!(child.wait().unwrap().success());
    assert!(!work.json("facts.json").is_null());
}

fn bad_settings_are_said_in_one_line() {
    let work = Work::new();
    let refused = |words: &str, expected: &str| work.fails(2, &format!("train -o a.relight {words}"), &[], expected);
    refused("--conditions 0", "bake.conditions = 0 must be from 1 to");
    for (option, setting) in [
        ("--size", "lightmap.size"),
        ("--conditions", "bake.conditions"),
        ("--held-out", "bake.held_out"),
        ("--paths", "bake.paths"),
        ("--points", "points.count"),
        ("--sub-points", "points.sub_points"),
        ("--basis", "train.basis"),
        ("--max-bounces", "bake.max_bounces"),
    ] {
        refused(&format!("{option} 1000000000"), &format!("{setting} = 1000000000 must be from"));
    }
    refused("--conditions 65536 --memory 1GiB", "--memory 1GiB is too little: training on 65536 conditions");
    refused("--size 64 --memory 9MiB", "--memory 9MiB is too little");
    refused("--max-error 5", "train.max_error = 5 must be above 0 and below 1: it is a fraction, 0.05 is 5 %");
    refused("--max-error 0", "train.max_error = 0 must be above 0");
    refused("--max-error 0.1 --method belcour", "`belcour` is kept as published");
    refused("--gamma 9", "train.gamma = 9 must be from 0.2 to 5");
    refused("--gamma 2.2 --max-bytes 1MiB", "choose sizes in linear light");
    refused("--lambda NaN", "train.lambda = NaN must be finite");
    refused("--lambda=-1", "train.lambda = -1 must be finite and not negative");
    // Without a prior, whose sums would be refused first.
    let many = "--points 60000 --sub-points 200 --size 16 --method belcour --conditions 8 --held-out 1 --basis 4";
    refused(many, "points of 200 sub-points");
    refused("--basis 80", "train.basis = 80 channels a texel; `local` has 1 to 16");
    let basis = "--method linear --size 16 --conditions 24 --held-out 8 --paths 4 --points 16 --basis 80";
    refused(basis, "80 basis elements need at least 80");
    assert!(work.files().is_empty());
}

fn bad_scene_files_are_said_in_one_line() {
    let work = Work::new();
    for (text, expected) in [
        ("[bake]\nconditions = \n", "s.toml: line 2: "),
        ("[bake]\nconditions = 10\n\n[bake]\n", "s.toml: line 4: "),
        ("[asset]\ngenerator = \"cornell\"\n[bake]\nconditoins = 3\n", "s.toml: line 4: unknown field `conditoins`"),
        ("[asset]\ngenerator = \"cornell\"\n[bake]\nconditions = 0\n", "s.toml: bake.conditions = 0"),
        ("[asset]\ngenerator = \"cornell\"\n[bake]\nconditions = -3\n", "s.toml: line 4: "),
        ("[asset]\ngenerator = \"cornel\"\n", "s.toml: generator \"cornel\" is not known; there are cornell, interior"),
        ("[lightmap]\nsize = 16\n", "s.toml: [asset] needs either `path` or `generator`"),
        ("[asset]\npath = \"gone.glb\"\n", "gone.glb: cannot be read"),
        (
            "[asset]\ngenerator = \"cornell\"\n[camera]\neye = [1, 2, 3]\ntarget = [1, 2, 3]\n",
            "s.toml: camera: eye and target",
        ),
        ("[asset]\ngenerator = \"cornell\"\n[scenario]\nkinds = { spot = 0 }\n", "scenario: `kinds`"),
        ("[asset]\ngenerator = \"cornell\"\n[scenario]\nclearance = 9.0\n", "no room for a light"),
        ("[asset]\ngenerator = \"cornell\"\n[scenario]\nclearance = nan\n", "scenario: `clearance`"),
    ] {
        work.put("s.toml", text);
        work.fails(2, "train s.toml -o a.relight --size 16", &[], expected);
    }
    work.fails(2, "train gone.toml", &[], "gone.toml: cannot be read");
    work.put("s.toml", b"\xff\xfe");
    work.fails(2, "train s.toml", &[], "s.toml: ");
    work.put("s.toml", "[asset]\ngenerator = \"cornel\"\n");
    work.fails(2, "info s.toml", &[], "s.toml: generator");
}

fn bad_assets_are_said_in_one_line() {
    let work = Work::new();
    work.fails(2, "train gone.glb", &[], "gone.glb: cannot be read");
    work.fails(2, "info gone.relight", &[], "gone.relight: cannot be read");
    work.put("a.fbx", "").put("empty.glb", "").put("empty.obj", "# nothing\n").put("folder.obj.txt", "");
    work.fails(2, "train a.fbx", &[], "a.fbx: not an asset that can be imported");
    work.fails(2, "bake a.fbx -o a.exr", &["--light", POINT], "a.fbx: not an asset");
    work.fails(2, "train empty.glb", &[], "empty.glb: ");
    work.fails(2, "train empty.obj", &[], "empty.obj: no triangle to light");
    work.put("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\nf 1 1 1\n");
    work.fails(2, "train flat.obj", &[], "flat.obj: no triangle to light");
    work.put("nan.obj", "v 0 0 0\nv nan 0 0\nv 0 inf 0\nf 1 2 3\n");
    work.fails(2, "train nan.obj", &[], "nan.obj: ");
    work.put("missing.obj", "v 0 0 0\nf 1 2 3\n");
    work.fails(2, "train missing.obj", &[], "missing.obj: a face refers to vertex 2 of 1");
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStrExt;
        let path = work.0.path().join(std::ffi::OsStr::from_bytes(b"\xff.glb"));
        std::fs::write(&path, corner_glb()).unwrap();
        let mut command = assert_cmd::Command::new(env!("CARGO_BIN_EXE_relight"));
        let output = command.current_dir(work.0.path()).arg("train").arg(&path).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        assert!(stderr.starts_with("error: ") && stderr.contains("is not UTF-8; rename the file"), "{stderr}");
        std::fs::remove_file(path).unwrap();
    }
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &[]);
    gltf.attribute("POSITION", positions);
    work.put("none.glb", gltf.glb());
    work.fails(2, "train none.glb", &[], "none.glb: ");
}

fn bad_lights_and_cameras_are_said_in_one_line() {
    let work = Work::with_model();
    let refused = |more: &[&str], expected: &str| work.fails(2, "render model.relight --cpu -o a.png", more, expected);
    let light = |light: &str, expected: &str| refused(&["--light", light], expected);
    refused(&[], "no light is given");
    light("asset", "--light asset: cornell defines no light");
    light("gone.toml", "--light gone.toml: cannot be read");
    light("{type=\"point\", position=[nan,0,0], intensity=1}", "position [NaN, 0, 0] is not finite");
    light("{type=\"point\", position=[0,0,0], intensity=nan}", "intensity NaN must be finite");
    light("{type=\"point\", position=[0,0,0], intensity=-1}", "intensity -1 must be finite and not negative");
    light("{type=\"point\", position=[0,0,0], intensity=1, range=0}", "range 0 must be finite and positive");
    light("{type=\"spot\", position=[0,0,0], direction=[0,0,0], intensity=1}", "direction [0, 0, 0] has no length");
    light("{type=\"spot\", position=[0,0,0], direction=[0,-1,0], intensity=1, outer_cone_angle=3}", "cone angles");
    light("{type=\"laser\", position=[0,0,0]}", "unknown variant `laser`");
    light("{type=\"point\", position=[0,0,0], intensity=1, colour=[1,1,1]}", "unknown field `colour`");
    light("{\"type\":\"point\",\"position\":[0,0,0]}", "missing field `intensity`");
    light("{type=\"point\"", "--light {type=\"point\": ");
    light(
        "{type=\"rect\", position=[0,1,0], direction=[0,-1,0], size=[1,0], radiance=1}",
        "size 0 must be finite and positive",
    );
    light("{type=\"sky\", sun_elevation=2}", "sun_elevation 2 must be in 0 to");
    light("{type=\"environment\", image=\"gone.hdr\"}", "gone.hdr: cannot be read as an environment");
    work.put("noise.exr", "not an image");
    light("{type=\"environment\", image=\"noise.exr\"}", "noise.exr: cannot be read as an environment");
    work.put("l.toml", "# lamps\n[[lights]]\ntype = \"point\"\nposition = [0, 0\n");
    light("l.toml", "l.toml: line 4: ");
    work.put("l.json", "{\"lights\": [\n{\"type\": \"point\"}]}");
    light("l.json", "l.json: ");
    work.put("l.toml", "lights = []\n");
    light("l.toml", "no light is given");

    let camera = |camera: &str, expected: &str| refused(&["--light", POINT, "--camera", camera], expected);
    camera("{eye=[1,1,1], target=[1,1,1]}", "--camera: eye and target must differ");
    camera("{eye=[0,0,0], target=[0,0,inf]}", "--camera: eye, target and up must be finite");
    camera("{eye=[0,0,0], target=[0,0,1], vertical_fov=180}", "--camera: vertical_fov 180");
    camera("{eye=[0,0,0]}", "missing field `target`");
    camera("7", "cameras, numbered from 0");
    camera("first", "neither a camera in braces nor a number");
    for size in ["0x0", "1x0", "100000x1"] {
        refused(&["--light", POINT, "--size", size], "a picture of ");
    }
    refused(&["--light", POINT, "--exposure", "nan"], "--exposure must be finite and positive");
    work.fails(2, "render model.relight --cpu -o a.jpg", &["--light", POINT], "a.jpg: pictures are .png or .exr");
    work.fails(2, "bake out.toml -o a.png", &["--light", POINT], "a.png: lightmaps are written as .exr");
}

fn damaged_models_are_said_in_one_line() {
    let work = Work::with_model();
    let bytes = std::fs::read(work.path("model.relight")).unwrap();
    work.put("cut.relight", &bytes[..bytes.len() / 2]).put("empty.relight", "");
    for name in ["cut", "empty"] {
        for command in ["info NAME", "compare NAME -o report", "render NAME --cpu -o a.png"] {
            let words = command.replace("NAME", &format!("{name}.relight"));
            work.fails(2, &words, &[], &format!("{name}.relight: not a relight model"));
        }
    }
}

fn results_that_cannot_be_written_are_said() {
    let work = Work::with_model();
    work.put("file", "").put("corner.glb", corner_glb());
    work.fails(1, &format!("train {TINY} -o file/a.relight"), &[], "file/a.relight: cannot be written");
    work.fails(1, "render model.relight --cpu --size 4x4 -o file/a.png", &["--light", POINT], "file/a.png: ");
    work.fails(1, "render model.relight --cpu --size 4x4 -o file/a.exr", &["--light", POINT], "file/a.exr: ");
    let bake = "bake corner.glb --size 16 --paths 1 -o file/a.exr";
    work.fails(1, bake, &["--light", POINT], "file/a.exr: cannot be written");
    // A folder in the place of the file: nothing temporary stays beside it.
    std::fs::create_dir(work.path("taken.relight")).unwrap();
    work.fails(1, &format!("train {TINY} -o taken.relight"), &[], "taken.relight: cannot be written");
}

/// Few texels with very many paths, so that whoever asks only between texels is found out.
#[cfg(unix)]
fn ctrl_c_stops_within_a_second() {
    let work = Work::new();
    let arguments = "train --size 16 --conditions 64 --paths 1048576 --points 16 --basis 4 -o a.relight --json a.json";
    let child = std::process::Command::new(env!("CARGO_BIN_EXE_relight"))
        .current_dir(work.0.path())
        .args(arguments.split(' '))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The bake of 2^20 paths a texel takes minutes; after two seconds it is under way.
    std::thread::sleep(Duration::from_secs(2));
    let interrupt = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(interrupt.success());
    let start = Instant::now();
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(start.elapsed() < Duration::from_secs(1), "took {:?} to stop", start.elapsed());
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("stopped; what was baked is kept in a.dataset"), "{stderr}");
    assert!(!work.files().contains("a.relight") && output.stdout.is_empty());
}
