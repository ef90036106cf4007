//! No input makes the import panic, hang or say more than one line.

mod common;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use common::{GltfBuilder, asset_trial, assets, trial};
use libtest_mimic::Arguments;
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use relight::scene::load;

/// Longer than any malformed file may take, and much longer than they do.
const TIME_LIMIT: Duration = Duration::from_secs(5);

fn main() {
    let trials = vec![
        asset_trial("validator_cases_load_or_give_one_line", "gltf_validator_cases", validator_cases),
        trial("made_glb_survives_truncation_and_flips", made_glb_survives_truncation_and_flips),
        asset_trial("cornell_glb_survives_truncation_and_flips", "CornellBox/CornellBox.glb", |p| {
            mangle(&p, "a.glb", 400)
        }),
        asset_trial("fox_survives_truncation_and_flips", "Fox/Fox.glb", |p| mangle(&p, "a.glb", 60)),
        asset_trial("cornell_obj_survives_truncation_and_flips", "embree_models/cornell_box.obj", |p| {
            mangle(&p, "a.obj", 400)
        }),
    ];
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}

#[derive(PartialEq)]
enum Outcome {
    Loaded,
    Error(String),
    Panicked,
}

/// Loads in a thread of its own, so that a hang fails instead of hanging the test.
fn outcome(path: &Path) -> Outcome {
    let (sender, receiver) = mpsc::channel();
    let file = path.to_owned();
    std::thread::spawn(move || {
        let outcome = match catch_unwind(AssertUnwindSafe(|| load(&file))) {
            Ok(Ok(_)) => Outcome::Loaded,
            Ok(Err(error)) => Outcome::Error(error.to_string()),
            Err(_) => Outcome::Panicked,
        };
        let _ = sender.send(outcome);
    });
    receiver.recv_timeout(TIME_LIMIT).unwrap_or_else(|_| panic!("{} did not finish in {TIME_LIMIT:?}", path.display()))
}

/// Each case as it is, and once more with a node for each of its meshes: few cases have a scene.
fn validator_cases(folder: PathBuf) {
    let (mut loaded, mut errors) = (0, 0);
    let mut slowest = Duration::ZERO;
    for file in files_below(&folder) {
        if !file.extension().is_some_and(|e| e == "gltf" || e == "glb") {
            continue;
        }
        let with_scene = with_scene(&file);
        let placed = with_scene.as_ref().map(|folder| folder.path().join("placed.gltf"));
        for file in [Some(file.clone()), placed].into_iter().flatten() {
            let start = Instant::now();
            match outcome(&file) {
                Outcome::Loaded => loaded += 1,
                Outcome::Error(message) => {
                    assert!(!message.contains('\n') && message.len() < 2000, "{message:?}");
                    errors += 1;
                }
                Outcome::Panicked => panic!("{} makes the import panic", file.display()),
            }
            slowest = slowest.max(start.elapsed());
        }
    }
    println!("validator cases: {loaded} load, {errors} give an error, 0 panic; slowest {slowest:?}");
    assert!(loaded + errors > 200);
}

/// A copy of the case in which every mesh is drawn, beside the files that it refers to; `None` where it has no mesh.
fn with_scene(file: &Path) -> Option<tempfile::TempDir> {
    let mut json: serde_json::Value = serde_json::from_slice(&std::fs::read(file).unwrap()).ok()?;
    let meshes = json.get("meshes")?.as_array()?.len();
    json["nodes"] = (0..meshes).map(|mesh| serde_json::json!({ "mesh": mesh })).collect();
    json["scenes"] = serde_json::json!([{ "nodes": (0..meshes).collect::<Vec<_>>() }]);
    json["scene"] = 0.into();
    let folder = tempfile::tempdir().unwrap();
    for sibling in files_below(file.parent().unwrap()) {
        std::fs::copy(&sibling, folder.path().join(sibling.file_name().unwrap())).unwrap();
    }
    std::fs::write(folder.path().join("placed.gltf"), serde_json::to_vec(&json).unwrap()).unwrap();
    Some(folder)
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() { open.push(path) } else { files.push(path) }
        }
    }
    files.sort();
    files
}

/// A file with every feature that small numbers steer: strides, sparse data, a texture, lights, several nodes.
fn made_glb_survives_truncation_and_flips() {
    let mut gltf = GltfBuilder::triangle();
    gltf.indices(&[0, 1, 2, 2, 1, 0]);
    let uvs = gltf.floats("VEC2", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    gltf.attribute("TEXCOORD_0", uvs);
    let image = gltf.accessor("SCALAR", 5121, 1, &common::png([1, 2, 3, 255]));
    gltf.json["images"] = serde_json::json!([{ "bufferView": image, "mimeType": "image/png" }]);
    gltf.json["textures"] = serde_json::json!([{ "source": 0 }]);
    gltf.json["materials"] = serde_json::json!([{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }]);
    gltf.json["meshes"][0]["primitives"][0]["material"] = 0.into();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("made.glb");
    std::fs::write(&path, gltf.glb()).unwrap();
    assert!(outcome(&path) == Outcome::Loaded);
    mangle(&path, "a.glb", 3000);
}

/// Truncates a file at every hundredth of it, and flips up to eight bytes or bits of it `flips` times.
fn mangle(path: &Path, name: &str, flips: usize) {
    let original = std::fs::read(path).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mangled = folder.path().join(name);
    let check = |bytes: &[u8], what: &dyn Fn() -> String| {
        std::fs::write(&mangled, bytes).unwrap();
        match outcome(&mangled) {
            Outcome::Error(message) => assert!(!message.contains('\n'), "{}: {message:?}", what()),
            Outcome::Loaded => {}
            Outcome::Panicked => panic!("{} makes the import panic", what()),
        }
    };
    for percent in 0..100 {
        let length = original.len() * percent / 100;
        check(&original[..length], &|| format!("{} cut to {length} bytes", path.display()));
    }
    let mut rng = Pcg64Mcg::seed_from_u64(7);
    for round in 0..flips {
        let mut bytes = original.clone();
        for _ in 0..rng.random_range(1..=8) {
            let at = rng.random_range(0..bytes.len());
            bytes[at] = if rng.random() { rng.next_u32() as u8 } else { bytes[at] ^ 1 << rng.random_range(0..8) };
        }
        check(&bytes, &|| format!("{} flipped in round {round}", path.display()));
    }
    // The folder of assets is only read.
    assert!(!mangled.starts_with(assets()));
}
