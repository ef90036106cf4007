//! The dataset: what its bits depend on, and what happens when its bake is cut short, goes on, or is not what it was.

use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use glam::Vec3;
use relight::dataset::{Bytes, Dataset, Indirect, Job};
use relight::light::{Light, LightingCondition};
use relight::measure::MeasurementPoints;
use relight::progress::Silent;
use relight::scene::{Asset, Lightmap, Search, Tracer, UvPolicy, generate, lay_out};
use relight::transport::{BakeSettings, Baker, Integrator};

const SIZE: u32 = 16;

/// A Cornell box whose second material glows.
fn glowing_cornell() -> (Asset, Lightmap) {
    let mut asset = generate("cornell").unwrap();
    asset.materials[1].emissive = Vec3::new(0.5, 0.25, 0.0);
    lay_out(&mut asset, SIZE, UvPolicy::Auto).unwrap();
    let lightmap = Lightmap::new(&asset.mesh, SIZE as usize);
    (asset, lightmap)
}

/// Every kind of light, more than one in some conditions.
fn conditions() -> Vec<LightingCondition> {
    let point =
        |x: f32| Light::Point { position: Vec3::new(x, 4.0, 2.0), color: Vec3::ONE, intensity: 20.0, range: None };
    let spot = Light::Spot {
        position: Vec3::new(2.0, 5.0, 2.0),
        direction: Vec3::NEG_Y,
        color: Vec3::new(1.0, 0.5, 0.25),
        intensity: 9.0,
        range: Some(20.0),
        inner_cone_angle: 0.1,
        outer_cone_angle: 0.7,
    };
    let sun = Light::Directional { direction: Vec3::Z, color: Vec3::ONE, intensity: 2.0 };
    let glow = Light::Emissive { scale: 1.5 };
    [vec![point(1.0), point(4.0)], vec![spot], vec![point(2.0), glow.clone()], vec![sun], vec![glow], vec![point(3.0)]]
        .map(|lights| LightingCondition { lights })
        .into()
}

/// Bits of I, `[condition][texel][channel]`, baked in batches of conditions and in ranges of texels.
fn bits(tracer: &Tracer, lightmap: &Lightmap, seed: u64, batches: &[Range<usize>], cut: usize) -> Vec<Vec<u32>> {
    let settings = BakeSettings { paths: 8, max_bounces: 6, seed, integrator: Integrator::Path };
    let (conditions, texels) = (conditions(), lightmap.texels.len());
    let mut out = vec![Vec::new(); conditions.len()];
    for batch in batches {
        let baker = Baker::new(tracer, lightmap, &conditions[batch.clone()], &settings, &Silent).unwrap();
        for start in (0..texels).step_by(cut) {
            let baked = baker.texels(start..(start + cut).min(texels), &Silent).unwrap();
            for (i, value) in baked.indirect.iter().enumerate() {
                out[batch.start + i % batch.len()].push(value.to_bits());
            }
        }
    }
    out
}

#[test]
fn a_conditions_bits_depend_on_no_other_condition_no_cut_and_no_threads() {
    let (asset, lightmap) = glowing_cornell();
    for search in [Search::Brute, Search::Tree] {
        let tracer = Tracer::with_search(&asset, search);
        let run = |threads: usize, seed: u64, batches: &[Range<usize>], cut: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| bits(&tracer, &lightmap, seed, batches, cut))
        };
        let whole = std::slice::from_ref(&(0..6));
        let together = run(1, 7, whole, lightmap.texels.len());
        for (condition, values) in together.iter().enumerate() {
            assert!(values.iter().any(|&v| v != 0), "condition {condition} is lit");
        }
        assert!(together == run(2, 7, whole, 100), "other ranges");
        assert!(together == run(2, 7, &[0..1, 1..4, 4..5, 5..6], 33), "other batches");
        assert!(together[0] != run(2, 8, whole, 33)[0], "control: another seed");
    }
}

/// Half floats with a power of two for each condition: 2⁻¹¹ of the value, or 2⁻⁴⁰ of the largest.
#[test]
fn a_folder_holds_what_memory_holds_to_its_stated_rounding() {
    let (asset, lightmap) = glowing_cornell();
    let tracer = Tracer::new(&asset);
    let points = MeasurementPoints::place(&asset, 16, 2, 1).unwrap();
    let settings = BakeSettings { integrator: Integrator::Path, paths: 8, max_bounces: 6, seed: 1 };
    let in_memory = Dataset::bake(&tracer, &lightmap, &points, conditions(), 4, &settings, &Silent).unwrap();
    let Indirect::Memory(values) = &in_memory.indirect else { unreachable!() };
    let work = Work::new();
    let identity = [("settings".to_owned(), "of this test".to_owned())].into();
    let memory = Bytes(1 << 30);
    let job =
        Job { tracer: &tracer, lightmap: &lightmap, points: &points, settings: &settings, identity: &identity, memory };
    let folder = work.path("d");
    let some = conditions()[2..5].to_vec();
    Dataset::in_folder(&folder, &job, some, 2, &Silent).unwrap();
    // The rest is added, and all are in the order asked for.
    let dataset = Dataset::in_folder(&folder, &job, conditions(), 4, &Silent).unwrap();
    assert_eq!((&dataset.direct, &dataset.noise), (&in_memory.direct, &in_memory.noise));
    let mut read = Vec::new();
    dataset.for_each_rows(&Silent, |_, rows| read.extend_from_slice(rows)).unwrap();
    assert_eq!(read.len(), values.len());
    let n = dataset.conditions.len();
    let mut rounded = 0;
    for c in 0..n {
        let of = |values: &[f32]| values.iter().skip(c).step_by(n).copied().collect::<Vec<_>>();
        let (exact, read) = (of(values), of(&read));
        let peak = exact.iter().fold(0f32, |m, v| m.max(v.abs()));
        for (exact, read) in exact.iter().zip(&read) {
            let bound = (exact.abs() * 2f32.powi(-11)).max(peak * 2f32.powi(-40));
            assert!((exact - read).abs() <= bound, "condition {c}: {exact} {read}");
            rounded += (exact != read) as usize;
        }
    }
    // Control: it is f16 that was read.
    assert!(rounded > values.len() / 2, "{rounded} of {}", values.len());
    let held_out = dataset.indirect_of(4..6, &Silent).unwrap();
    let column = |values: &[f32], n: usize, c: usize| values.iter().skip(c).step_by(n).copied().collect::<Vec<_>>();
    assert_eq!(column(&held_out, 2, 1), column(&read, n, 5));

    // Conditions of two folders as one dataset: batches whose shards are read side by side, and parts of them.
    let apart = Dataset::in_folder(&work.path("e"), &job, conditions()[..3].to_vec(), 3, &Silent).unwrap();
    let picks = [(&dataset, vec![5, 3]), (&apart, vec![1])];
    let both = Dataset::gather(&picks, 2, &Silent).unwrap();
    let gathered = both.indirect_of(0..3, &Silent).unwrap();
    for (c, original) in [5, 3, 1].into_iter().enumerate() {
        assert_eq!(column(&gathered, 3, c), column(&read, n, original), "condition {original}");
        assert_eq!(both.direct(c), dataset.direct(original));
    }
    assert_ne!(column(&gathered, 3, 0), column(&gathered, 3, 1), "the control: conditions differ");
}

/// A temporary folder that commands run in.
struct Work(tempfile::TempDir);

/// A toy whose bake takes about a second.
const TOY: &str = "train --method linear --threads 2 --size 128 --integrator path --conditions 24 --held-out 240 --paths 16 --points 16 --basis 4";

impl Work {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn command(&self, words: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
        command.current_dir(self.0.path()).args(words.split_whitespace());
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// Runs the program, which must succeed. Returns stderr.
    fn succeeds(&self, words: &str) -> String {
        let Output { status, stderr, .. } = self.command(words).output().unwrap();
        let stderr = String::from_utf8(stderr).unwrap();
        assert!(status.success(), "{words}: {stderr}");
        stderr
    }

    /// Runs the program, which must end with `status` and one line of error that holds all of `expected`.
    fn fails(&self, status: i32, words: &str, expected: &[&str]) {
        let output = self.command(words).output().unwrap();
        check_failure(&output, status, expected);
    }

    fn bytes(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    /// Names, contents and times of writing of a folder's shards.
    fn shards(&self, folder: &str) -> BTreeMap<PathBuf, (Vec<u8>, std::time::SystemTime)> {
        let mut shards = BTreeMap::new();
        for batch in fs::read_dir(self.path(folder)).unwrap().map(|e| e.unwrap().path()).filter(|p| p.is_dir()) {
            for file in fs::read_dir(&batch).unwrap().map(|e| e.unwrap().path()) {
                let written = fs::metadata(&file).unwrap().modified().unwrap();
                let name = file.strip_prefix(self.path(folder)).unwrap().to_owned();
                shards.insert(name, (fs::read(&file).unwrap(), written));
            }
        }
        shards
    }
}

fn check_failure(output: &Output, status: i32, expected: &[&str]) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(status), "{stderr}");
    let errors: Vec<&str> = stderr.lines().filter(|line| line.starts_with("error: ")).collect();
    assert!(errors.len() == 1 && !stderr.contains("panicked"), "{stderr}");
    for expected in expected {
        assert!(errors[0].contains(expected), "{} should say: {expected}", errors[0]);
    }
}

/// The shard that most of these tests look at.
const SHARD: &str = "batch-000/tile-00000.safetensors";

/// Kills at moments spread over the whole run, from its first file to its last.
#[test]
#[cfg(unix)]
fn a_bake_killed_at_any_moment_ends_with_the_same_bits() {
    let work = Work::new();
    // Several batches, so that kills meet more than one file: the toy's tiles hold all of its texels.
    let toy = format!("{TOY} --memory 40MiB");
    let start = std::time::Instant::now();
    work.succeeds(&format!("{toy} -o whole.relight"));
    let whole = start.elapsed();
    let mut killed = 0;
    for k in 0..7u32 {
        // Later and later, with an odd part, since what is there already is not baked again.
        let mut child = work.command(&format!("{toy} -o killed.relight")).spawn().unwrap();
        std::thread::sleep(whole.mul_f64(0.05 + 0.618_034 * k as f64 % 0.4));
        killed += child.try_wait().unwrap().is_none() as u32;
        // SIGKILL.
        child.kill().unwrap();
        child.wait().unwrap();
    }
    assert!(killed >= 2, "{killed} runs were killed before their end");
    work.succeeds(&format!("{toy} -o killed.relight"));
    assert!(work.bytes("killed.relight") == work.bytes("whole.relight"), "the same bits");
    // How many conditions a batch has follows from the memory that is free when it begins: the shards may be cut otherwise.
    assert!(work.shards("whole.dataset").len() > 3 && work.shards("killed.dataset").len() > 3, "more than one batch");
    // Control: another seed.
    work.succeeds(&format!("{toy} --seed 2 -o other.relight"));
    assert!(work.bytes("other.relight") != work.bytes("whole.relight"));
}

#[test]
fn more_conditions_are_added_and_fewer_are_found() {
    let work = Work::new();
    let toy = |conditions: usize, held_out: usize| {
        format!("train --size 24 --paths 8 --points 16 --basis 4 --conditions {conditions} --held-out {held_out}")
    };
    work.succeeds(&format!("{} -o few.relight", toy(10, 4)));
    let before = work.shards("few.dataset");
    work.succeeds(&format!("{} --dataset few.dataset -o grown.relight", toy(16, 6)));
    let after = work.shards("few.dataset");
    assert!(before.iter().all(|(name, shard)| after[name] == *shard), "what was there is not baked again");
    assert_eq!(after.len(), 2 * before.len(), "one more batch");
    let n = |shards: &BTreeMap<PathBuf, _>| shards.len();
    assert!(n(&after) > n(&before));
    // As if all had been baked at once, and as before with as few as before.
    work.succeeds(&format!("{} -o many.relight", toy(16, 6)));
    work.succeeds(&format!("{} --dataset few.dataset -o again.relight", toy(10, 4)));
    assert!(work.bytes("grown.relight") == work.bytes("many.relight"));
    assert!(work.bytes("again.relight") == work.bytes("few.relight"));
    assert_eq!(work.shards("few.dataset"), after, "nothing is baked for fewer conditions");
    assert!(work.bytes("grown.relight") != work.bytes("few.relight"), "control");
}

#[test]
fn what_does_not_belong_is_refused_with_the_reason() {
    let work = Work::new();
    let toy = "train --size 24 --paths 8 --points 16 --basis 4 --conditions 8 --held-out 4";
    work.succeeds(&format!("{toy} -o a.relight"));
    let before = work.shards("a.dataset");
    // `more` comes in the place of what it changes.
    let refused = |old: &str, more: &str, reasons: &[&str]| {
        let mut expected = vec!["a.dataset: is not the dataset of this run", "remove this one to bake anew"];
        expected.extend(reasons);
        work.fails(2, &format!("{} {more} -o a.relight", toy.replace(old, "")), &expected);
    };
    refused("--paths 8", "--paths 16", &["bake.paths was 8, now it is 16"]);
    refused("", "--seed 9 --max-bounces 3", &["bake.seed was 1, now it is 9", "bake.max_bounces was 32, now it is 3"]);
    refused("--size 24", "--size 32", &["lightmap.size was 24, now it is 32", "texels"]);
    // Another asset under the same settings.
    fs::write(
        work.path("s.toml"),
        "[asset]\ngenerator = \"statue\"\n[scenario]\nposition = \"near\"\naim = \"surface\"\n",
    )
    .unwrap();
    let asset = toy.replacen("train", "train s.toml", 1);
    work.fails(2, &format!("{asset} -o a.relight"), &["a.dataset", "the asset's geometry, layout or materials"]);
    // A model beside another model's dataset.
    work.succeeds(&format!("{toy} --seed 5 -o b.relight"));
    work.fails(2, "compare b.relight --dataset a.dataset -o report", &["a.dataset", "bake.seed was 1, now it is 5"]);
    // Folders that are something else, and a dataset in use.
    fs::create_dir(work.path("photos")).unwrap();
    fs::write(work.path("photos/cat.png"), "").unwrap();
    work.fails(2, &format!("{toy} --dataset photos -o c.relight"), &["photos: not a dataset: it holds cat.png"]);
    fs::write(work.path("file"), "").unwrap();
    work.fails(1, &format!("{toy} --dataset file/below -o c.relight"), &["file/below: cannot be written"]);
    let lock = fs::File::open(work.path("a.dataset/lock")).unwrap();
    lock.lock().unwrap();
    work.fails(1, &format!("{toy} -o a.relight"), &["a.dataset: another relight is at work in this folder"]);
    lock.unlock().unwrap();
    assert!(work.shards("a.dataset") == before, "nothing was changed");
    // Control: the same settings are taken, whatever the fit is.
    work.succeeds(&format!("{toy} --method belcour --channels multi -o a.relight"));
    assert!(work.shards("a.dataset") == before);
    // Other points measure the lights anew, and bake nothing.
    work.succeeds(&format!("{} -o b.relight --dataset a.dataset", toy.replace("--points 16", "--points 17")));
    work.succeeds(&format!("{} -o c.relight", toy.replace("--points 16", "--points 17")));
    let direct = PathBuf::from("batch-000/direct.safetensors");
    let after = work.shards("a.dataset");
    assert!(after.iter().all(|(name, shard)| (before[name] == *shard) == (*name != direct)));
    let fresh = work.shards("c.dataset");
    assert!(after.iter().all(|(name, (bytes, _))| fresh[name].0 == *bytes));
    assert!(work.bytes("b.relight") == work.bytes("c.relight"));
}

#[test]
fn damaged_shards_are_named_and_baked_anew() {
    let work = Work::new();
    let toy = "train --size 24 --paths 8 --points 16 --basis 4 --conditions 8 --held-out 4 -o a.relight";
    work.succeeds(toy);
    let (model, shard) = (work.bytes("a.relight"), work.bytes(&format!("a.dataset/{SHARD}")));
    let mut flipped = shard.clone();
    *flipped.last_mut().unwrap() ^= 1;
    let mut lengthened = shard.clone();
    lengthened.push(0);
    let damages = [("flipped", flipped), ("truncated", shard[..shard.len() / 2].to_vec()), ("lengthened", lengthened)];
    for (what, bytes) in damages.into_iter().chain([("emptied", Vec::new()), ("text", b"not a shard at all".into())]) {
        fs::write(work.path(&format!("a.dataset/{SHARD}")), bytes).unwrap();
        let stderr = work.succeeds(toy);
        assert!(stderr.contains(&format!("a.dataset/{SHARD}: damaged: ")), "{what}: {stderr}");
        assert!(work.bytes(&format!("a.dataset/{SHARD}")) == shard && work.bytes("a.relight") == model, "{what}");
    }
    // Control: a whole one is not spoken of.
    assert!(!work.succeeds(toy).contains("damaged"));
    fs::write(work.path("a.dataset/manifest.json"), "{").unwrap();
    work.fails(2, toy, &["a.dataset: not a dataset: its manifest.json does not parse"]);
}

/// Shards larger than files may be: the disk is as good as full.
#[test]
#[cfg(unix)]
fn a_full_disk_is_one_error_and_what_was_baked_is_kept() {
    let work = Work::new();
    let with = |conditions: usize| {
        format!("train --size 64 --paths 4 --points 16 --basis 4 --held-out 8 --conditions {conditions} -o a.relight")
    };
    let toy = with(8);
    work.succeeds(&toy);
    let before = work.shards("a.dataset");
    let more = with(64);
    // In units of 512 bytes: 512 KiB a file. A shard of 56 conditions on 2,800 texels takes about 900 KB.
    let limited = format!("trap '' XFSZ; ulimit -f 1024; exec {} {more}", env!("CARGO_BIN_EXE_relight"));
    let output = Command::new("sh").args(["-c", &limited]).current_dir(work.0.path()).output().unwrap();
    check_failure(
        &output,
        1,
        &["a.dataset/batch-001/tile-00000.safetensors: cannot be written", "what was baked is kept"],
    );
    let after = work.shards("a.dataset");
    assert!(before.iter().all(|(name, shard)| after.get(name) == Some(shard)), "what was baked is kept");
    assert!(after.keys().all(|name| !name.display().to_string().contains(".tmp")));
    // With room, it goes on, and ends as it would have.
    work.succeeds(&more);
    work.succeeds(&more.replace("a.relight", "b.relight"));
    assert!(work.bytes("a.relight") == work.bytes("b.relight"));
}

/// The ceiling is half of what I alone would take in memory.
#[test]
#[cfg(target_os = "linux")]
fn the_ceiling_of_memory_is_kept_and_changes_nothing() {
    let work = Work::new();
    let job = "train --method linear --size 256 --conditions 128 --held-out 32 --paths 1 --points 32 --sub-points 8 --basis 8 --threads 2";
    let peak = |words: &str| {
        work.succeeds(&format!("{words} --json figures.json"));
        let figures: serde_json::Value = serde_json::from_slice(&work.bytes("figures.json")).unwrap();
        (figures["peak_bytes"].as_u64().unwrap(), figures["texels"].as_u64().unwrap())
    };
    let (low, texels) = peak(&format!("{job} --memory 40MiB -o low.relight"));
    let whole = texels * 160 * 3 * 4;
    assert!(low <= 40 << 20, "peak {low}");
    assert!(whole > 72 << 20, "control: I in memory takes {whole} bytes");
    let (_, _) = peak(&format!("{job} --memory 1GiB -o high.relight"));
    assert!(work.shards("low.dataset").len() > work.shards("high.dataset").len(), "more batches under the ceiling");
    assert!(work.bytes("low.relight") == work.bytes("high.relight"));
    work.fails(
        2,
        &format!("{job} --memory 12MiB -o no.relight"),
        &["--memory 12MiB is too little", "needs", "give more"],
    );
    assert!(!work.path("no.dataset").exists());
}

/// Long enough for anyone to ask to stop: the neighbours, too, of what does not ask.
#[test]
#[cfg(unix)]
fn a_stopped_bake_says_where_it_goes_on() {
    let work = Work::new();
    // Small batches, so that the first shard is there soon.
    let long = TOY.replace("--paths 16", "--paths 128");
    let mut child = work.command(&format!("{long} --memory 40MiB -o a.relight")).spawn().unwrap();
    while !work.path(&format!("a.dataset/{SHARD}")).exists() {
        assert!(child.try_wait().unwrap().is_none(), "it ended before its first shard");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let start = std::time::Instant::now();
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(start.elapsed() < Duration::from_secs(2), "took {:?}", start.elapsed());
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("stopped; what was baked is kept in a.dataset: the same command goes on"), "{stderr}");
    assert!(work.path(&format!("a.dataset/{SHARD}")).exists() && !work.path("a.relight").exists());
}
