//! The model file: what is saved comes back, the same inputs give the same bytes, and no file makes the reader panic.

mod common;
#[path = "common/room.rs"]
mod room;

use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::process::Command;

use bytemuck::cast_slice;
use common::trial;
use half::f16;
use libtest_mimic::{Arguments, Failed, Trial};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use relight::light::{EmissionFacets, LightTable};
use relight::math::Rgb;
use relight::model::{Channels, Model, Values};
use relight::scene::Tracer;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};

fn main() {
    let python = std::env::var_os("RELIGHT_PYTHON");
    let no_python = python.is_none();
    let in_python = move || -> Result<(), Failed> {
        numpy_reconstructs_the_same_lightmap(Path::new(&python.unwrap_or_default()));
        Ok(())
    };
    let trials = vec![
        trial("saved_models_come_back_whole", saved_models_come_back_whole),
        trial("equal_seeds_give_equal_bytes_on_any_number_of_threads", equal_seeds_give_equal_bytes),
        trial("truncated_and_flipped_files_load_or_give_one_line", mangled_files),
        trial("each_broken_rule_has_its_message", each_broken_rule_has_its_message),
        trial("broken_local_models_have_their_messages", broken_local_models_have_their_messages),
        trial("models_that_cannot_be_read_are_named", models_that_cannot_be_read_are_named),
        Trial::test("numpy_reconstructs_the_same_lightmap", in_python).with_ignored_flag(no_python),
    ];
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}

fn loaded(bytes: &[u8]) -> Result<Model, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.relight");
    std::fs::write(&path, bytes).unwrap();
    Model::load(&path).map_err(|error| {
        let line = error.to_string();
        assert!(line.starts_with(&path.display().to_string()) && !line.contains('\n'), "{line:?}");
        line
    })
}

fn saved(model: &Model) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.relight");
    let size = model.save(&path).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!(bytes.len() as u64, size);
    bytes
}

/// A trained model of the Cornell box that takes a moment, with the size and settings of a toy.
fn trained(seed: u64, threads: usize) -> Vec<u8> {
    trained_with(seed, threads, &[])
}

fn trained_with(seed: u64, threads: usize, more: &[&str]) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cornell.relight");
    let arguments = "train --size 16 --conditions 24 --held-out 8 --paths 4 --points 16 --basis 4";
    let status = Command::new(env!("CARGO_BIN_EXE_relight"))
        .args(arguments.split(' '))
        .args(more)
        .args(["--seed", &seed.to_string(), "--threads", &threads.to_string(), "-o"])
        .arg(&path)
        .output()
        .unwrap();
    assert!(status.status.success(), "{}", String::from_utf8_lossy(&status.stderr));
    std::fs::read(path).unwrap()
}

/// What of a model differs from another one.
fn differences(a: &Model, b: &Model) -> Vec<&'static str> {
    [
        ("mesh", a.asset.hash() == b.asset.hash()),
        ("name", a.asset.name == b.asset.name),
        ("lights", a.asset.lights == b.asset.lights),
        ("cameras", a.asset.cameras == b.asset.cameras),
        ("textures", format!("{:?}", a.asset.textures) == format!("{:?}", b.asset.textures)),
        ("points", a.points == b.points),
        ("basis", a.basis == b.basis),
        ("transfer", a.transfer == b.transfer),
        ("record", a.record == b.record),
    ]
    .into_iter()
    .filter_map(|(what, same)| (!same).then_some(what))
    .collect()
}

fn saved_models_come_back_whole() {
    for channels in [Channels::Mono, Channels::Multi] {
        for mean in [false, true] {
            let mut model = room::model(channels, 5, mean);
            // Digits that a careless reader of decimal numbers loses.
            model.record.lambda = 0.1 + 0.2;
            model.record.held_out.mean = 0.750_258_307_919_782_1;
            model.record.held_out.worst = 1.376_134_301_127_674_5;
            model.record.scene = "[train]\nbasis = 5 # \"λ\"\n".into();
            let back = loaded(&saved(&model)).unwrap();
            assert_eq!(differences(&model, &back), [""; 0], "{channels:?}, mean {mean}");
            model.record.held_out.mean = f64::from_bits(model.record.held_out.mean.to_bits() + 1);
            let Values::Half(values) = &mut model.basis.values else { unreachable!("the room's") };
            values[7] = f16::from_f32(9.0);
            assert_eq!(differences(&model, &back), ["basis", "record"], "the control");
        }
        let mut model = room::local_model(channels, 5);
        let back = loaded(&saved(&model)).unwrap();
        assert_eq!(differences(&model, &back), [""; 0], "local, {channels:?}");
        model.basis.anchors.as_mut().unwrap().shares[3][3] ^= 1;
        assert_eq!(differences(&model, &back), ["basis"], "the control");
    }
    let bytes = trained(1, 2);
    assert_eq!(saved(&loaded(&bytes).unwrap()), bytes, "a model that is loaded and saved again is the same file");
}

fn equal_seeds_give_equal_bytes() {
    assert!(trained_with(5, 1, &["--method", "local"]) == trained_with(5, 2, &["--method", "local"]), "local");
    let first = trained(5, 1);
    assert!(first == trained(5, 1), "the same command twice");
    assert!(first == trained(5, 2), "one thread and two");
    assert!(first != trained(6, 1), "another seed");
}

/// Loads `bytes`; what loads is also relit, since a number that passes the checks must not make later code panic.
fn survives(bytes: &[u8], what: &str) -> bool {
    let outcome = catch_unwind(AssertUnwindSafe(|| {
        let model = loaded(bytes)?;
        let tracer = Tracer::new(&model.asset);
        let u = model
            .transfer
            .coefficients(&model.points.direct(&tracer, &LightTable::new(&room::lights(), &EmissionFacets::default())));
        model.basis.reconstruct(&u).sample(glam::Vec2::splat(0.5));
        Ok::<_, String>(())
    }));
    outcome.unwrap_or_else(|_| panic!("{what} makes the reader panic")).is_ok()
}

fn mangled_files() {
    let original = trained(1, 2);
    assert!(survives(&original, "the file as it is"));
    for part in 0..50 {
        let length = original.len() * part / 50;
        assert!(!survives(&original[..length], &format!("cut to {length} bytes")), "{length} bytes load");
    }
    // The header, where names, shapes and metadata are, gets half of the flips.
    let header = 8 + u64::from_le_bytes(original[..8].try_into().unwrap()) as usize;
    let mut rng = Pcg64Mcg::seed_from_u64(7);
    let mut refused = 0;
    for round in 0..400 {
        let mut bytes = original.clone();
        let end = if round % 2 == 0 { header } else { bytes.len() };
        for _ in 0..rng.random_range(1..=4) {
            let at = rng.random_range(0..end);
            bytes[at] = if rng.random() { rng.next_u32() as u8 } else { bytes[at] ^ 1 << rng.random_range(0..8) };
        }
        refused += !survives(&bytes, &format!("flips of round {round}")) as u32;
    }
    assert!(refused > 100, "only {refused} of 400 are refused");
}

/// A model file taken apart.
struct Parts {
    tensors: Vec<(String, Dtype, Vec<usize>, Vec<u8>)>,
    metadata: serde_json::Value,
}

impl Parts {
    fn of(bytes: &[u8]) -> Self {
        let file = SafeTensors::deserialize(bytes).unwrap();
        let tensors = file.iter().map(|(name, t)| (name.to_owned(), t.dtype(), t.shape().to_vec(), t.data().to_vec()));
        let (_, header) = SafeTensors::read_metadata(bytes).unwrap();
        let metadata = serde_json::from_str(&header.metadata().as_ref().unwrap()["relight"]).unwrap();
        Self { tensors: tensors.collect(), metadata }
    }

    fn bytes(&self) -> Vec<u8> {
        let views = self.tensors.iter().map(|(n, d, s, b)| (n.as_str(), TensorView::new(*d, s.clone(), b).unwrap()));
        let metadata = HashMap::from([("relight".to_owned(), self.metadata.to_string())]);
        safetensors::serialize(views, Some(metadata)).unwrap()
    }

    fn tensor(&mut self, name: &str) -> &mut (String, Dtype, Vec<usize>, Vec<u8>) {
        self.tensors.iter_mut().find(|t| t.0 == name).unwrap_or_else(|| panic!("{name}"))
    }

    /// Overwrites the first element.
    fn put(&mut self, name: &str, value: &[u8]) {
        self.tensor(name).3[..value.len()].copy_from_slice(value);
    }

    fn remove(&mut self, name: &str) {
        self.tensors.retain(|t| t.0 != name);
    }
}

fn each_broken_rule_has_its_message() {
    let original = saved(&room::model(Channels::Mono, 4, false));
    assert!(loaded(&Parts::of(&original).bytes()).is_ok(), "taken apart and put together it loads");
    let nan = f32::NAN.to_le_bytes();
    type Change = fn(&mut Parts, [u8; 4]);
    let cases: [(&str, Change); 14] = [
        ("tensor points.neighbours has index 4294967295", |p, _| p.put("points.neighbours", &[255; 4])),
        ("tensor mesh.triangles has index 4294967295", |p, _| p.put("mesh.triangles", &[255; 4])),
        ("tensor mesh.triangle_materials has index", |p, _| p.put("mesh.triangle_materials", &[255; 4])),
        ("tensor transfer is not finite", |p, nan| p.put("transfer", &nan)),
        ("tensor basis is not finite", |p, _| p.put("basis", &f16::NAN.to_le_bytes())),
        ("tensor mesh.positions is not finite", |p, nan| p.put("mesh.positions", &nan)),
        ("tensor sub_points.albedo is not finite", |p, nan| p.put("sub_points.albedo", &nan)),
        ("tensor basis is [4, 1, 8, 128], expected square layers", |p, _| {
            let shape = &mut p.tensor("basis").2;
            let side = shape[2];
            *shape = vec![4, 1, 8, side * side / 8];
        }),
        ("tensor basis is F16", |p, _| p.metadata["channels"] = "multi".into()),
        ("tensor transfer is F16 [3, 4, 61], expected F16 [1, 4, 183]", |p, _| {
            p.metadata["channels"] = "multi".into();
            let (_, _, shape, data) = p.tensor("basis");
            shape[1] = 3;
            *data = data.repeat(3);
        }),
        ("tensor mesh.normals is missing", |p, _| p.remove("mesh.normals")),
        ("tensor mesh.triangles is F32", |p, _| p.tensor("mesh.triangles").1 = Dtype::F32),
        ("format 999, this build reads", |p, _| p.metadata["format"] = 999.into()),
        ("not a relight model", |p, _| p.metadata = serde_json::json!({ "name": "another program's" })),
    ];
    for (expected, change) in cases {
        let mut parts = Parts::of(&original);
        change(&mut parts, nan);
        let error = loaded(&parts.bytes()).map(|_| ()).expect_err(expected);
        assert!(error.contains(expected), "{error}\nexpected: {expected}");
        assert!(error.contains("relight train"), "says what to do: {error}");
    }
}

fn broken_local_models_have_their_messages() {
    let original = saved(&room::local_model(Channels::Mono, 4));
    type Change = fn(&mut Parts);
    let cases: [(&str, Change); 6] = [
        ("tensor transfer is [3, 36, 61], expected 4 rows for each of 256 anchors", |p| {
            p.put("anchors.indices", &[255])
        }),
        ("tensor anchors.shares is missing", |p| p.remove("anchors.shares")),
        ("tensor transfer is F16 [3, 36, 61], expected F16 [3, 4, 61]", |p| p.remove("anchors.indices")),
        ("tensor anchors.indices is U8 [1, 1024, 4], expected U8 [32, 32, 4]", |p| {
            p.tensor("anchors.indices").2 = vec![1, 1024, 4];
        }),
        ("gamma = 40 must be from 0.1 to 10", |p| p.metadata["gamma"] = 40.0.into()),
        ("a local basis has no mean", |p| p.metadata["mean_scaled_by_norm"] = true.into()),
    ];
    for (expected, change) in cases {
        let mut parts = Parts::of(&original);
        change(&mut parts);
        let error = loaded(&parts.bytes()).map(|_| ()).expect_err(expected);
        assert!(error.contains(expected), "{error}\nexpected: {expected}");
    }
    let mut rng = Pcg64Mcg::seed_from_u64(8);
    for round in 0..100 {
        let mut bytes = original.clone();
        let at = rng.random_range(0..bytes.len());
        bytes[at] ^= 1 << rng.random_range(0..8);
        survives(&bytes, &format!("local, flip of round {round}"));
    }
}

fn models_that_cannot_be_read_are_named() {
    let folder = tempfile::tempdir().unwrap();
    for (path, expected) in
        [(folder.path().join("gone.relight"), "cannot be read"), (folder.path().into(), "cannot be read")]
    {
        let error = Model::load(&path).map(|_| ()).unwrap_err().to_string();
        assert!(error.starts_with(&path.display().to_string()) && error.contains(expected), "{error}");
    }
    for bytes in [&b""[..], b"x", &[0; 64], &[255; 64], b"not a model at all, but long enough to be one"] {
        let error = loaded(bytes).map(|_| ()).unwrap_err();
        assert!(error.contains("not a relight model"), "{error}");
    }
}

/// u = M x and Σ uⱼ Uⱼ, written once more with numpy alone (docs/METHOD.md, eq. 7 and 8).
const RECONSTRUCT: &str = r#"
import sys
import numpy
from safetensors.numpy import load_file

tensors = load_file(sys.argv[1])
x = numpy.fromfile(sys.argv[2], "<f4").reshape(-1, 3)
basis = tensors["basis"].astype("f8")
transfer = tensors["transfer"].astype("f8") * tensors["transfer.scale"]
elements, components, size, _ = basis.shape
assert tensors["points.position"].shape == x.shape
if "anchors.indices" in tensors:
    indices, shares = tensors["anchors.indices"], tensors["anchors.shares"].astype("f8")
    scale = 2 ** ((shares[:, :, 3] - 255) / 16)
    shares[:, :, 3] = 255 - shares[:, :, :3].sum(axis=2)
    if components == 1:
        u = numpy.stack([transfer[c] @ x[:, c] for c in range(3)], axis=1)
    else:
        u = numpy.repeat((transfer[0] @ x.reshape(-1))[:, None], 3, axis=1)
    u = u.reshape(-1, elements, 3)
    mixed = numpy.einsum("yxk,yxkjc->yxjc", shares / 255, u[indices])
    b = numpy.broadcast_to(basis / 127, (elements, components, size, size))
    b = numpy.repeat(b, 3 // components, axis=1)
    result = numpy.einsum("yxjc,jcyx->yxc", mixed, b) * scale[:, :, None]
elif components == 1:
    u = numpy.stack([transfer[c] @ x[:, c] for c in range(3)], axis=1)
    result = numpy.einsum("jc,jyx->yxc", u, basis[:, 0])
else:
    u = transfer[0] @ x.reshape(-1)
    result = numpy.einsum("j,jcyx->yxc", u, basis)
result.astype("<f4").tofile(sys.argv[3])
"#;

fn numpy_reconstructs_the_same_lightmap(python: &Path) {
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let global = [Channels::Mono, Channels::Multi].map(|channels| room::model(channels, 6, false));
    let local = [Channels::Mono, Channels::Multi].map(|channels| room::local_model(channels, 4));
    for model in global.into_iter().chain(local) {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        model.save(&at("a.relight")).unwrap();
        let direct: Vec<Rgb> = (0..61).map(|_| Rgb::new(rng.random(), rng.random(), rng.random())).collect();
        std::fs::write(at("x"), cast_slice::<Rgb, u8>(&direct)).unwrap();
        let run = Command::new(python)
            .args(["-c", RECONSTRUCT])
            .args([at("a.relight"), at("x"), at("result")])
            .output()
            .unwrap_or_else(|e| panic!("RELIGHT_PYTHON = {}: {e}", python.display()));
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        let bytes = std::fs::read(at("result")).unwrap();
        let theirs: Vec<f32> = bytes.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
        let (u, size) = (model.transfer.coefficients(&direct), model.basis.size);
        assert_eq!(theirs.len(), size * size * 3);

        // Ours sums P (or 3P) and then n products in f32: a rounding of the sum of magnitudes each.
        let mut magnitudes = model.clone();
        magnitudes.transfer.matrices.iter_mut().flatten().for_each(|m| *m = m.abs());
        match &mut magnitudes.basis.values {
            Values::Half(values) => values.iter_mut().for_each(|v| *v = f16::from_f32(v.to_f32().abs())),
            Values::Byte(codes) => codes.iter_mut().for_each(|c| *c = c.abs()),
        }
        let bound = magnitudes.transfer.coefficients(&direct);
        // A local basis has four anchors' shares and a power of two besides.
        let roundings = (3 * direct.len() + u.len() + 16) as f32 * f32::EPSILON;
        let misses = |scale: f32| {
            let [ours, bound] = [model.basis.reconstruct(&u), magnitudes.basis.reconstruct(&bound)].map(|i| i.values);
            let ours = ours.into_iter().map(|v| v * scale).zip(bound);
            let theirs = theirs.chunks_exact(3).map(Rgb::from_slice);
            ours.zip(theirs).filter(|((a, bound), b)| !(*a - *b).abs().cmple(*bound * roundings).all()).count()
        };
        assert_eq!(misses(1.0), 0, "{:?}, {} channels", model.transfer.channels, model.basis.elements);
        assert!(misses(1.01) > size * size / 2, "a lightmap one percent brighter goes unnoticed");
    }
}
