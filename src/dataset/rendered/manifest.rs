//! `conditions.json`: the conditions to render, where their lightmaps go, and what they were rendered for.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::super::DatasetError;
use crate::files::write_whole;
use crate::light::{EnvironmentImages, Light, LightingCondition};

pub const FILE: &str = "conditions.json";

const FORMAT: &str = "relight-conditions";

/// Raised whenever a folder of the old shape would be misread.
const VERSION: u32 = 1;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    pub format: String,
    pub version: u32,
    /// What wrote it.
    pub program: String,
    /// [`crate::scene::Asset::hash`] of what is in the .glb.
    pub asset_hash: String,
    /// Of the points in points.safetensors.
    pub points_hash: String,
    /// Side of the lightmap, texels.
    pub size: u32,
    pub max_bounces: u32,
    /// The scene file's settings, for the reader.
    pub scene: serde_json::Value,
    /// Who rendered, and with how many samples a texel: filled in by who did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub renderer: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub samples: Option<u32>,
    pub conditions: Vec<Condition>,
}

/// Paths are relative to the folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Condition {
    pub held_out: bool,
    #[serde(default)]
    pub lights: Vec<Light>,
    pub indirect: PathBuf,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direct: Option<PathBuf>,
    /// Relative RMSE of the lightmap, where its renderer knows it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<f64>,
}

impl Manifest {
    pub fn new(program: String) -> Self {
        let (format, version) = (FORMAT.to_owned(), VERSION);
        Self {
            format,
            version,
            program,
            asset_hash: String::new(),
            points_hash: String::new(),
            size: 0,
            max_bounces: 0,
            scene: serde_json::Value::Null,
            renderer: None,
            samples: None,
            conditions: Vec::new(),
        }
    }

    /// The manifest in `folder`; `None` where there is none.
    ///
    /// # Errors
    /// When it cannot be read, does not parse, or is of another version.
    pub fn read(folder: &Path) -> Result<Option<Self>, DatasetError> {
        #[derive(Deserialize)]
        struct Head {
            format: String,
            version: u32,
        }
        let path = folder.join(FILE);
        let text = match std::fs::read(&path) {
            Ok(text) => text,
            Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => return Ok(None),
            Err(source) => return Err(DatasetError::Read { path, source }),
        };
        let wrong = |why: String| DatasetError::Rendered { path: path.clone(), why };
        let head: Head = serde_json::from_slice(&text).map_err(|e| wrong(format!("does not parse: {e}")))?;
        if head.format != FORMAT {
            return Err(wrong(format!("its format is \"{}\", expected \"{FORMAT}\"", head.format)));
        }
        if head.version != VERSION {
            let (found, here) = (head.version, VERSION);
            return Err(wrong(format!("version {found}, this build reads {here}; export the conditions anew")));
        }
        serde_json::from_slice(&text).map(Some).map_err(|e| wrong(format!("does not parse: {e}")))
    }

    pub fn write(&self, folder: &Path) -> std::io::Result<()> {
        let json = serde_json::to_vec_pretty(self).expect("maps have text for keys");
        write_whole(&folder.join(FILE), &json)
    }
}

/// A folder with lightmaps that another renderer rendered, or is to render.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    pub(super) folder: PathBuf,
    pub(super) manifest: Manifest,
}

impl Rendered {
    /// Opens `folder`; `None` where it holds no `conditions.json`.
    ///
    /// # Errors
    /// When that cannot be read or is of no use.
    pub fn open(folder: &Path) -> Result<Option<Self>, DatasetError> {
        let manifest = Manifest::read(folder)?;
        Ok(manifest.map(|manifest| Self { folder: folder.to_owned(), manifest }))
    }

    /// Numbers of conditions to train on and held out.
    pub fn counts(&self) -> (usize, usize) {
        let held_out = self.manifest.conditions.iter().filter(|c| c.held_out).count();
        (self.manifest.conditions.len() - held_out, held_out)
    }

    /// Samples a texel, where its renderer tells.
    pub fn samples(&self) -> Option<u32> {
        self.manifest.samples
    }

    /// Where the shards go that the lightmaps are turned into.
    pub fn shards(&self) -> PathBuf {
        self.folder.join("shards")
    }

    pub(super) fn wrong(&self, path: impl AsRef<Path>, why: impl Into<String>) -> DatasetError {
        DatasetError::Rendered { path: self.folder.join(path), why: why.into() }
    }

    /// Places in the manifest of the first `training` conditions to train on, then of the first `held_out` held out.
    pub(super) fn select(&self, training: usize, held_out: usize) -> Result<Vec<usize>, DatasetError> {
        let there = self.counts();
        for (what, asked, there) in [("to train on", training, there.0), ("held out", held_out, there.1)] {
            if asked > there || there == 0 {
                let why = format!("lists {there} conditions {what}, and {} are asked for", asked.max(1));
                return Err(self.wrong(FILE, why));
            }
        }
        let of = |wanted: bool, count: usize| {
            let all = self.manifest.conditions.iter().enumerate();
            all.filter(move |(_, c)| c.held_out == wanted).map(|(i, _)| i).take(count)
        };
        Ok(of(false, training).chain(of(true, held_out)).collect())
    }

    /// The lights of these conditions, checked, their images read.
    pub(super) fn lights(&self, selected: &[usize]) -> Result<Vec<LightingCondition>, DatasetError> {
        let mut images = EnvironmentImages::default();
        let mut lights_of = |&i: &usize| {
            let mut ready = Vec::new();
            for light in &self.manifest.conditions[i].lights {
                let mut light = light.clone();
                let wrong = |why| self.wrong(FILE, format!("condition {i}: {why}"));
                images.ready(&mut light, &self.folder).map_err(|e| wrong(e.to_string()))?;
                ready.push(light.validated().map_err(wrong)?);
            }
            Ok(LightingCondition { lights: ready })
        };
        selected.iter().map(&mut lights_of).collect()
    }
}
