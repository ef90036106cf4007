//! Asset import: which reader a file goes to, and what can be wrong with an asset.

use std::fs;
use std::path::Path;

use super::{Asset, Reflectance, gltf, obj};

/// Why an asset cannot be imported or laid out. Each reads as one line: the file, the thing, what to do.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    #[error("{file}: cannot be read: {reason}")]
    Unreadable { file: String, reason: String },
    #[error("{file}: not an asset that can be imported; give a .gltf, .glb or .obj file")]
    UnknownKind { file: String },
    /// The file breaks the rules of its format.
    #[error("{file}: {problem}")]
    Invalid { file: String, problem: String },
    #[error("{file}: required extension {extensions} is not supported; export without it")]
    RequiredExtension { file: String, extensions: String },
    #[error("{file}: no triangle to light{reason}; export a file with triangle geometry in its scene")]
    NoTriangle { file: String, reason: String },
    /// A UV set that was asked for cannot serve as a lightmap.
    #[error("{asset}: {set} {reason}; lightmaps need a UV set without overlap: give `uv = \"auto\"` to unwrap anew")]
    LightmapUvs { asset: String, set: &'static str, reason: String },
    #[error("{asset}: cannot be unwrapped: {reason}; give a larger lightmap size or a UV set of your own")]
    Unwrap { asset: String, reason: String },
    #[error("{asset}: takes more than 4 GiB, which a .glb file cannot hold; give it smaller textures")]
    TooLarge { asset: String },
}

/// Imports a .gltf, .glb or .obj asset, everything flattened to world space.
///
/// What could be repaired or had to be left out is listed in [`Asset::warnings`].
///
/// # Errors
/// [`SceneError`] when the file cannot be read, breaks its format, requires an extension that is not supported, or holds
/// no triangle of positive area.
pub fn load(path: &Path) -> Result<Asset, SceneError> {
    let file = one_line(&path.display().to_string());
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let import = match extension.as_str() {
        "gltf" | "glb" => gltf::import,
        "obj" => obj::import,
        _ => return Err(SceneError::UnknownKind { file }),
    };
    let bytes = read_file(path).map_err(|reason| SceneError::Unreadable { file: file.clone(), reason })?;
    let name = one_line(&path.file_stem().unwrap_or_default().to_string_lossy());
    let directory = path.parent().unwrap_or(Path::new(""));
    let mut asset = import(&Source { file: &file, name: &name, directory, bytes: &bytes })?;
    for warning in &mut asset.warnings {
        *warning = one_line(warning);
    }
    Ok(asset)
}

/// A file to import, already in memory.
pub(super) struct Source<'a> {
    /// The path as errors print it.
    pub file: &'a str,
    /// The file's stem, which names the asset.
    pub name: &'a str,
    /// Where the files that it refers to are looked for.
    pub directory: &'a Path,
    pub bytes: &'a [u8],
}

impl Source<'_> {
    /// An error about this file's content.
    pub fn invalid(&self, problem: impl AsRef<str>) -> SceneError {
        SceneError::Invalid { file: self.file.to_owned(), problem: one_line(problem.as_ref()) }
    }
}

/// A regular file's bytes, or why there are none. A pipe or a device is refused: it might never end.
pub(super) fn read_file(path: &Path) -> Result<Vec<u8>, String> {
    let metadata = fs::metadata(path).map_err(|e| one_line(&e.to_string()))?;
    if !metadata.is_file() {
        return Err("it is not a regular file".to_owned());
    }
    fs::read(path).map_err(|e| one_line(&e.to_string()))
}

/// Text from a file as it may be printed: control characters become spaces, so a message stays one line.
pub(super) fn one_line(text: &str) -> String {
    text.chars().map(|c| if c.is_control() || matches!(c, '\u{2028}' | '\u{2029}') { ' ' } else { c }).collect()
}

impl Asset {
    /// Makes every material a Lambert surface of its base colour; metallic and roughness are no longer read.
    pub fn make_lambert(&mut self) {
        for material in &mut self.materials {
            material.reflectance = Reflectance::Lambert;
        }
    }
}
