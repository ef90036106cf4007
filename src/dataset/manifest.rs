//! The manifest of a dataset's folder: what it was baked from, and which conditions are in which batch.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::DatasetError;
use super::error::unwritable;
use crate::files::write_whole;
use crate::light::{Light, LightingCondition};
use crate::measure::MeasurementPoints;
use crate::scene::Lightmap;

/// Raised whenever a folder of the old shape would be misread.
const FORMAT: u32 = 2;

/// Raised whenever a bake from the same settings gives other bits than before, so that no dataset mixes the two.
const BAKE: u32 = 2;

pub(super) const FILE: &str = "manifest.json";

/// Everything that I depends on but the conditions themselves, by name: settings as they are called in a scene file, and hashes.
/// The points are no part of it: D is measured when a dataset is opened.
pub type Identity = BTreeMap<String, String>;

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Manifest {
    format: u32,
    /// The program's version that began the folder.
    program: String,
    pub identity: Identity,
    /// T, covered texels of the lightmap.
    pub texels: usize,
    /// Texels of a shard; the last has the rest.
    pub tile: usize,
    pub batches: Vec<Batch>,
}

/// Conditions that are baked together. Its files are in the folder `batch-` and its number.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Batch {
    pub conditions: Vec<Entry>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Entry {
    pub held_out: bool,
    pub lights: Vec<Light>,
}

impl Manifest {
    pub fn new(identity: Identity, texels: usize) -> Self {
        let program = env!("CARGO_PKG_VERSION").to_owned();
        Self { format: FORMAT, program, identity, texels, tile: crate::transport::TILE, batches: Vec::new() }
    }

    /// The manifest in `folder`, or `None` where there is none.
    pub fn read(folder: &Path) -> Result<Option<Self>, DatasetError> {
        #[derive(Deserialize)]
        struct FormatOnly {
            format: u32,
        }
        let path = folder.join(FILE);
        let text = match std::fs::read(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(source) => return Err(DatasetError::Read { path, source }),
        };
        let damaged = |e: serde_json::Error| DatasetError::NotADataset {
            path: folder.to_owned(),
            why: format!("its {FILE} does not parse ({e})"),
        };
        let FormatOnly { format } = serde_json::from_slice(&text).map_err(damaged)?;
        if format != FORMAT {
            let changes = format!("it has format {format}, this build writes {FORMAT}");
            return Err(DatasetError::Stale { path: folder.to_owned(), changes });
        }
        Ok(Some(serde_json::from_slice(&text).map_err(damaged)?))
    }

    pub fn write(&self, folder: &Path) -> Result<(), DatasetError> {
        let path = folder.join(FILE);
        let json = serde_json::to_vec_pretty(self).expect("maps have text for keys");
        write_whole(&path, &json).map_err(unwritable(&path))
    }

    /// What is not as in `wanted`, as one line; `None` where all is.
    pub fn changes(&self, wanted: &Self) -> Option<String> {
        let mut lines = Vec::new();
        let names = self.identity.keys().chain(wanted.identity.keys());
        for name in names.collect::<std::collections::BTreeSet<_>>() {
            let (old, new) = (self.identity.get(name), wanted.identity.get(name));
            if old != new {
                let shown = |v: Option<&String>| v.map_or("absent".to_owned(), |v| short(v).to_owned());
                lines.push(format!("{name} was {}, now it is {}", shown(old), shown(new)));
            }
        }
        for (name, old, new) in [
            ("the number of texels", self.texels, wanted.texels),
            ("the number of texels in a shard", self.tile, wanted.tile),
        ] {
            if old != new {
                lines.push(format!("{name} was {old}, now it is {new}"));
            }
        }
        (!lines.is_empty()).then(|| lines.join("; "))
    }

    /// The number of shards of a batch.
    pub fn tiles(&self) -> usize {
        self.texels.div_ceil(self.tile)
    }

    /// First texel and number of texels of a shard.
    pub fn tile_texels(&self, tile: usize) -> std::ops::Range<usize> {
        tile * self.tile..((tile + 1) * self.tile).min(self.texels)
    }

    /// Names the dataset and the batch: what a shard is a part of.
    pub fn part_of(&self, batch: usize) -> String {
        let whole = (&self.identity, self.texels, self.tile, &self.batches[batch].conditions);
        blake3::hash(&serde_json::to_vec(&whole).expect("maps have text for keys")).to_hex().to_string()
    }

    /// Where each condition is: batch and column by the condition's lights.
    pub fn places(&self) -> HashMap<String, (usize, usize)> {
        let batches = self.batches.iter().enumerate();
        let all =
            batches.flat_map(|(b, batch)| batch.conditions.iter().enumerate().map(move |(c, e)| (b, c, &e.lights)));
        all.map(|(batch, column, lights)| (key(lights), (batch, column))).collect()
    }
}

impl Batch {
    pub fn conditions(&self) -> Vec<LightingCondition> {
        self.conditions.iter().map(|e| LightingCondition { lights: e.lights.clone() }).collect()
    }
}

/// Names a condition by its lights, to the last bit.
pub(super) fn key(lights: &[Light]) -> String {
    serde_json::to_string(lights).expect("lights hold no maps")
}

/// A dataset's identity: `settings` and the hashes of what they lead to.
pub fn identity(settings: Identity, asset: &str, lightmap: &Lightmap) -> Identity {
    let mut texels = blake3::Hasher::new();
    for texel in &lightmap.texels {
        texels.update(&texel.index.to_le_bytes()).update(&texel.area.to_le_bytes());
    }
    let mut all = settings;
    all.insert("the asset's geometry, layout or materials (hash)".into(), asset.to_owned());
    all.insert("the lightmap's texels (hash)".into(), texels.finalize().to_hex().to_string());
    all.insert("the program's way to bake".into(), BAKE.to_string());
    all
}

/// Names a set of points.
pub(super) fn points_hash(points: &MeasurementPoints) -> String {
    let mut hasher = blake3::Hasher::new();
    for point in points.points.iter().chain(&points.sub_points) {
        for v in [point.position, point.normal, point.geometric_normal, point.albedo] {
            hasher.update(bytemuck::bytes_of(&v));
        }
    }
    hasher.update(bytemuck::cast_slice(&points.neighbours)).finalize().to_hex().to_string()
}

/// A hash's first digits; other values as they are.
fn short(value: &str) -> &str {
    let is_hash = value.len() == 64 && value.bytes().all(|b| b.is_ascii_hexdigit());
    if is_hash { &value[..12] } else { value }
}
