//! Environment images: named by their file, read once, shared by all lights that name them.

#[cfg(feature = "train")]
mod read;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::EnvironmentMap;
#[cfg(feature = "train")]
pub use read::{EnvironmentError, EnvironmentImages};

/// The image of an environment light: written as its path alone, and read by [`EnvironmentImages`].
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(from = "PathBuf", into = "PathBuf")]
pub struct EnvironmentImage {
    path: PathBuf,
    map: Option<Arc<EnvironmentMap>>,
}

/// Two images are the same when their files are.
impl PartialEq for EnvironmentImage {
    fn eq(&self, other: &Self) -> bool {
        self.path == other.path
    }
}

impl From<PathBuf> for EnvironmentImage {
    fn from(path: PathBuf) -> Self {
        Self { path, map: None }
    }
}

impl From<EnvironmentImage> for PathBuf {
    fn from(image: EnvironmentImage) -> Self {
        image.path
    }
}

impl EnvironmentImage {
    /// A map that is in memory already, under a name of its own.
    pub fn from_map(name: &str, map: EnvironmentMap) -> Self {
        Self { path: name.into(), map: Some(Arc::new(map)) }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What the image holds.
    ///
    /// # Panics
    /// Where [`EnvironmentImages`] has not read it: lights are made ready when they come in.
    pub fn map(&self) -> &Arc<EnvironmentMap> {
        self.map.as_ref().expect("environment images are read when lights are")
    }
}
