//! What several tests share: where real assets are, tests that need one, and files made by a test.

#![allow(dead_code)]

use std::path::PathBuf;

use libtest_mimic::{Failed, Trial};

pub mod room;

/// The folder of real assets: `RELIGHT_ASSETS`, or `shared/assets` beside the repository.
pub fn assets() -> PathBuf {
    match std::env::var_os("RELIGHT_ASSETS") {
        Some(folder) => folder.into(),
        None => PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/assets"),
    }
}

/// A test that always runs.
pub fn trial(name: &str, body: fn()) -> Trial {
    Trial::test(name, move || {
        body();
        Ok(())
    })
}

/// A test of one real asset; reported as ignored where the file is absent.
pub fn asset_trial(name: &str, file: &'static str, body: fn(PathBuf)) -> Trial {
    let path = assets().join(file);
    let absent = !path.exists();
    let run = move || -> Result<(), Failed> {
        body(path);
        Ok(())
    };
    Trial::test(name, run).with_ignored_flag(absent)
}
