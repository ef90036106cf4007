//! `relight bench` on a toy: its rows, what they say of themselves, and how it ends without a GPU.

use std::time::Duration;

use assert_cmd::Command;
use libtest_mimic::{Arguments, Failed, Trial};
use relight::gpu::Gpu;
use serde_json::Value;

fn main() {
    let absent = Gpu::new().is_err();
    let times = || -> Result<(), Failed> {
        every_pass_of_every_size_has_a_row();
        Ok(())
    };
    let without = || -> Result<(), Failed> {
        without_an_adapter_there_is_one_line();
        Ok(())
    };
    let trials = vec![
        Trial::test("every_pass_of_every_size_has_a_row", times).with_ignored_flag(absent),
        Trial::test("without_an_adapter_there_is_one_line", without),
    ];
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}

fn relight(folder: &std::path::Path, words: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
    command.current_dir(folder).timeout(Duration::from_secs(300)).args(words.split_whitespace());
    command
}

/// A model of a toy Cornell box in a folder of its own.
fn trained() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let settings = "--size 16 --conditions 24 --held-out 8 --paths 4 --points 16 --basis 4 --method linear";
    relight(folder.path(), &format!("train {settings} -o model.relight")).assert().success();
    folder
}

fn every_pass_of_every_size_has_a_row() {
    let folder = trained();
    let stdout = relight(folder.path(), "bench model.relight --size 64x48 --json bench.json").assert().success();
    let stdout = String::from_utf8(stdout.get_output().stdout.clone()).unwrap();
    let json: Value = serde_json::from_slice(&std::fs::read(folder.path().join("bench.json")).unwrap()).unwrap();
    let rows = json["rows"].as_array().unwrap();
    let count = |pass: &str, method: &str, n: u64| {
        rows.iter().filter(|r| r["pass"] == pass && r["method"] == method && r["coefficients"] == n).count()
    };
    assert_eq!(count("no_gi", "none", 4), 1, "{stdout}");
    for (method, n) in [("linear", 4), ("linear", 16), ("linear", 64), ("local", 4)] {
        // The model's own basis and a made-up one of the same shape for four elements.
        let bases = if (method, n) == ("linear", 4) { 2 } else { 1 };
        for pass in ["fragment", "fragment_texture", "reconstruct"] {
            assert_eq!(count(pass, method, n), bases, "{pass} {method} {n}: {stdout}");
        }
        assert!(count("transfer", method, n) >= 1, "{method} {n}: {stdout}");
    }
    // Itself, four counts of lights, three of points.
    assert_eq!(rows.iter().filter(|r| r["pass"] == "measure").count(), 8, "{stdout}");
    for row in rows {
        let number = |key: &str| row[key].as_f64().unwrap_or_else(|| panic!("{key} in {row}"));
        assert!(number("tenth") <= number("microseconds") && number("microseconds") <= number("ninetieth"), "{row}");
        assert!(number("frames") >= 1.0 && number("bytes") > 0.0, "{row}");
    }
    assert!(json["bytes"].as_u64().unwrap() > 0 && !json["adapter"].as_str().unwrap().is_empty());
    // The default scenes' direct light is that of training within 2 %.
    let direct = &json["direct_light"];
    assert_eq!(direct["conditions"], 8);
    let worst = direct["worst"].as_f64().unwrap();
    assert!((0.0..0.02).contains(&worst), "{worst}");
}

fn without_an_adapter_there_is_one_line() {
    let folder = trained();
    let mut command = relight(folder.path(), "bench model.relight --json bench.json");
    let output = command.env("WGPU_ADAPTER_NAME", "none of this name").assert().code(2);
    let stderr = String::from_utf8(output.get_output().stderr.clone()).unwrap();
    let errors: Vec<&str> = stderr.lines().filter(|line| line.starts_with("error: no usable GPU adapter")).collect();
    assert_eq!(errors.len(), 1, "{stderr}");
    assert!(!folder.path().join("bench.json").exists() && output.get_output().stdout.is_empty());
    // Only what renders without a GPU is advised to.
    assert!(!errors[0].contains("--cpu"), "{stderr}");
    let mut command = relight(folder.path(), "render model.relight --light {type=\"sky\",sun_elevation=1} -o a.png");
    let output = command.env("WGPU_ADAPTER_NAME", "none of this name").assert().code(2);
    let stderr = String::from_utf8(output.get_output().stderr.clone()).unwrap();
    assert!(stderr.lines().last().unwrap().ends_with("or render with --cpu"), "{stderr}");
}
