//! Whole commands in a temporary folder.

#![allow(dead_code)]

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Output;
use std::time::Duration;

use assert_cmd::Command;
use serde_json::Value;
use tempfile::TempDir;

/// Settings of a toy: a run takes a fraction of a second.
pub const TINY: &str = "--size 16 --conditions 24 --held-out 8 --paths 4 --points 16 --basis 4";

pub const POINT: &str = "{type=\"point\", position=[2.8,4,2], intensity=20}";

/// A temporary folder that commands run in.
pub struct Work(pub TempDir);

impl Work {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn path(&self, name: &str) -> std::path::PathBuf {
        self.0.path().join(name)
    }

    pub fn put(&self, name: &str, bytes: impl AsRef<[u8]>) -> &Self {
        std::fs::write(self.path(name), bytes).unwrap();
        self
    }

    /// Runs `relight` here. `words` are split at blanks, `more` are taken as they are.
    pub fn run(&self, words: &str, more: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
        command.current_dir(self.0.path()).timeout(Duration::from_secs(600));
        command.args(words.split_whitespace()).args(more).output().unwrap()
    }

    /// The same, which must succeed. Returns stdout.
    pub fn succeeds(&self, words: &str, more: &[&str]) -> String {
        let output = self.run(words, more);
        assert!(output.status.success(), "{words} {more:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    /// The same, which must end with `status`, one line of error that holds `expected`, and no file more than before.
    pub fn fails(&self, status: i32, words: &str, more: &[&str], expected: &str) {
        let before = self.files();
        let output = self.run(words, more);
        let stderr = String::from_utf8(output.stderr).unwrap();
        let call = format!("relight {words} {more:?}");
        assert_eq!(output.status.code(), Some(status), "{call}: {stderr}");
        // What was chosen and repaired on the way may stand before the error.
        let known = ["lightmap: ", "warning: ", "bake ", "direct ", "gram ", "basis "];
        let lines: Vec<&str> = stderr.lines().filter(|line| !known.iter().any(|k| line.starts_with(k))).collect();
        assert!(lines.len() == 1 && lines[0].starts_with("error: "), "{call}: {stderr}");
        assert!(lines[0].contains(expected), "{call}\n  says {}\n  expected {expected}", lines[0]);
        assert!(output.stdout.is_empty(), "{call} prints results");
        assert_eq!(self.files(), before, "{call} leaves files behind");
    }

    /// Relative names of all files and folders here.
    pub fn files(&self) -> BTreeSet<String> {
        fn below(folder: &Path, root: &Path, names: &mut BTreeSet<String>) {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                names.insert(path.strip_prefix(root).unwrap().display().to_string());
                if path.is_dir() {
                    below(&path, root, names);
                }
            }
        }
        let mut names = BTreeSet::new();
        below(self.0.path(), self.0.path(), &mut names);
        names
    }

    pub fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&std::fs::read(self.path(name)).unwrap()).unwrap()
    }

    /// A tiny model of the Cornell box as `model.relight`.
    pub fn with_model() -> Self {
        let work = Self::new();
        work.succeeds(&format!("train {TINY} -o model.relight"), &[]);
        work
    }
}
