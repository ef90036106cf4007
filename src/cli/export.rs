//! `relight export`: a model as files that engines load.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::{Failure, Reporter};
use crate::export;
use crate::model::Model;

/// Export a model for an engine: GLB, KTX2, matrices, shaders, and a page on how to use them
#[derive(Args)]
pub struct Export {
    /// A model made by `relight train`
    pub model: PathBuf,
    /// The folder for the files
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,
}

impl Export {
    pub fn run(&self, json: Option<&Path>, _: &Reporter) -> Result<(), Failure> {
        let model = Model::load(&self.model)?;
        super::check_output(&self.output.join("README.md"))?;
        let files = export::write(&model, &self.output)?;
        for (name, bytes) in &files {
            say!("{:<28}{:>9.1} kB", name, *bytes as f64 * 1e-3);
        }
        say!("wrote {}: README.md there says how to shade with it", self.output.display());
        let files: Vec<_> = files.iter().map(|(name, bytes)| json!({ "name": name, "bytes": bytes })).collect();
        super::write_json(json, &json!({ "files": files }))
    }
}
