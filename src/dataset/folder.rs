//! A dataset in a folder: baked shard by shard, so that nothing of size T × N is held in memory and a bake that is stopped, or
//! dies, goes on where it was. `docs/DATASET.md` describes the files.
//!
//! Conditions are found by their lights: those that the folder has are read, the others are baked and added.

use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;
use safetensors::Dtype;
use safetensors::tensor::TensorView;

use super::error::{unreadable, unwritable};
use super::manifest::{self, Batch, Entry, Identity, Manifest, key};
use super::shard::{self, Checked, Expected};
use super::{Bytes, Dataset, DatasetError, Indirect, ROWS};
use crate::files::write_whole;
use crate::light::{EmissionFacets, LightTable, LightingCondition};
use crate::measure::MeasurementPoints;
use crate::progress::Progress;
use crate::scene::{Lightmap, Tracer};
use crate::transport::{BakeSettings, BakedTexels, Baker, NoiseSums, TILE};

/// Takes a range of texels and their rows.
pub(super) type Visit<'v> = dyn FnMut(Range<usize>, &[f32]) -> Result<(), DatasetError> + 'v;

/// What is baked, and how.
#[derive(Clone, Copy)]
pub struct Job<'j, 'a> {
    pub tracer: &'j Tracer<'a>,
    pub lightmap: &'j Lightmap,
    pub points: &'j MeasurementPoints,
    pub settings: &'j BakeSettings,
    pub identity: &'j Identity,
    /// Ceiling of the process's resident memory.
    pub memory: Bytes,
}

/// I in the shards of one folder, or of several of the same texels.
#[derive(Clone, Debug)]
pub struct Shards {
    texels: usize,
    batches: Vec<Column>,
    /// Held as long as the shards are read.
    locks: Vec<Arc<File>>,
}

/// A batch's place in the dataset: per condition of the batch the dataset's condition, if it is one.
#[derive(Clone, Debug)]
pub(super) struct Column {
    pub folder: Arc<Path>,
    pub batch: usize,
    pub columns: Vec<Option<u32>>,
}

const LOCK: &str = "lock";
const TEXELS: &str = "texels.safetensors";
const DIRECT: &str = "direct.safetensors";

/// Resident memory beyond what is counted: the allocator's rounding, buffers of files, and per thread its stack and the blocks
/// that matrix products pack.
pub fn slack() -> u64 {
    (8 << 20) + ((rayon::current_num_threads() as u64) << 20)
}

/// Part of the slack that a batch is begun with and need not be there when it goes on.
const RUNS_DIFFER: u64 = 2 << 20;

fn batch_folder(folder: &Path, batch: usize) -> PathBuf {
    folder.join(format!("batch-{batch:03}"))
}

fn shard_file(folder: &Path, batch: usize, tile: usize) -> PathBuf {
    batch_folder(folder, batch).join(format!("tile-{tile:05}.safetensors"))
}

impl Job<'_, '_> {
    /// Bytes that one condition of a batch needs while it is baked, measured and written. `conditions` are all there are.
    fn bytes_per_condition(&self, conditions: &[LightingCondition]) -> u64 {
        let lights: usize = conditions.iter().map(|c| c.lights.len()).sum();
        let lights = lights.div_ceil(conditions.len().max(1));
        let texels = self.lightmap.texels.len();
        let tile = TILE.min(texels);
        let baked = self.settings.bytes_per_condition(texels, tile, lights, rayon::current_num_threads());
        // The shard's half floats beside them; D over points and sub-points.
        let halves = tile * 3 * 2;
        let direct = (self.points.sub_points.len() + 2 * self.points.points.len()) * 3 * 4;
        (baked + halves + direct) as u64
    }

    /// The most conditions that a batch may have, where `unforeseen` bytes may be needed beyond what is counted.
    fn most_conditions(&self, conditions: &[LightingCondition], unforeseen: u64) -> Result<usize, DatasetError> {
        let each = self.bytes_per_condition(conditions);
        // D of all conditions, and their lights, stay.
        let direct = self.points.points.len() * 3 * 4 * conditions.len() + conditions.len() * 1024;
        let fixed = self.settings.bytes_fixed(self.lightmap.texels.len());
        let taken = Bytes::resident().0 + unforeseen + (direct + fixed) as u64;
        let most = self.memory.0.saturating_sub(taken) / each;
        if most == 0 {
            return Err(DatasetError::Memory {
                ceiling: self.memory,
                what: "baking one condition at a time".into(),
                needed: Bytes(taken + each),
                advice: "; give more, or lower --conditions or --size".into(),
            });
        }
        Ok(most as usize)
    }
}

impl Dataset {
    /// Opens the dataset in `folder`, or begins one, and bakes those of `conditions` that it does not hold. The first
    /// `training` are to train on.
    ///
    /// # Errors
    /// When the folder is of other settings, cannot be read or written, or is in use; when `job.memory` is too little; when
    /// `progress` cancels. What was baked is kept in any case.
    pub fn in_folder(
        folder: &Path,
        job: &Job,
        conditions: Vec<LightingCondition>,
        training: usize,
        progress: &dyn Progress,
    ) -> Result<Self, DatasetError> {
        let texels = job.lightmap.texels.len();
        let wanted = Manifest::new(job.identity.clone(), texels);
        let mut store = Store::open(folder, wanted, job.lightmap)?;
        store.add(&conditions, training, job.most_conditions(&conditions, slack())?)?;
        // Resident memory differs a little from run to run: batches that one began, the next can go on with.
        let most = job.most_conditions(&conditions, slack() - RUNS_DIFFER)?;

        let places = store.manifest.places();
        let n = conditions.len();
        let mut batches: Vec<Column> = Vec::new();
        for (c, condition) in conditions.iter().enumerate() {
            let (batch, column) = places[&key(&condition.lights)];
            let at = batches.iter().position(|b| b.batch == batch).unwrap_or_else(|| {
                let columns = vec![None; store.manifest.batches[batch].conditions.len()];
                batches.push(Column { folder: folder.into(), batch, columns });
                batches.len() - 1
            });
            batches[at].columns[column] = Some(c as u32);
        }
        let mut noise = vec![0f32; n];
        let mut direct = vec![0f32; job.points.points.len() * 3 * n];
        for Column { batch, columns, .. } in &batches {
            let (of_batch, noise_of_batch) = store.bake(*batch, most, job, progress)?;
            let width = columns.len();
            for (column, c) in columns.iter().enumerate().filter_map(|(column, c)| Some((column, (*c)? as usize))) {
                noise[c] = noise_of_batch[column];
                for row in 0..direct.len() / n {
                    direct[row * n + c] = of_batch[row * width + column];
                }
            }
        }
        Ok(Self {
            conditions,
            training,
            direct,
            indirect: Indirect::Folder(store.into_shards(batches)),
            texel_areas: job.lightmap.texels.iter().map(|t| t.area).collect(),
            noise,
        })
    }
}

/// An open folder.
pub(super) struct Store {
    folder: PathBuf,
    pub manifest: Manifest,
    lock: Arc<File>,
}

impl Store {
    fn open(folder: &Path, wanted: Manifest, lightmap: &Lightmap) -> Result<Self, DatasetError> {
        let (lock, found) = Self::take(folder)?;
        let manifest = match found {
            Some(found) => match found.changes(&wanted) {
                Some(changes) => return Err(DatasetError::Stale { path: folder.to_owned(), changes }),
                None => found,
            },
            None => {
                write_texels(&folder.join(TEXELS), lightmap)?;
                wanted.write(folder)?;
                wanted
            }
        };
        Ok(Self { folder: folder.to_owned(), manifest, lock: Arc::new(lock) })
    }

    /// Opens a folder that can be made again from what is elsewhere: where it is not as `wanted`, or not `good`, it is begun
    /// anew.
    pub fn renew(
        folder: &Path,
        wanted: Manifest,
        lightmap: &Lightmap,
        good: impl Fn(&Manifest) -> bool,
    ) -> Result<Self, DatasetError> {
        let (lock, found) = Self::take(folder)?;
        let manifest = match found.filter(|found| found.changes(&wanted).is_none() && good(found)) {
            Some(found) => found,
            None => {
                let batches = (0..).map(|batch| batch_folder(folder, batch)).take_while(|folder| folder.exists());
                for batch in batches.collect::<Vec<_>>() {
                    std::fs::remove_dir_all(&batch).map_err(unwritable(&batch))?;
                }
                write_texels(&folder.join(TEXELS), lightmap)?;
                wanted.write(folder)?;
                wanted
            }
        };
        Ok(Self { folder: folder.to_owned(), manifest, lock: Arc::new(lock) })
    }

    /// Takes a folder that is a dataset or empty, and reads its manifest.
    fn take(folder: &Path) -> Result<(File, Option<Manifest>), DatasetError> {
        // What is there and is no dataset is left alone.
        let strange = |path: &Path| -> Option<String> {
            let name = path.file_name()?.to_str()?;
            let ours = [LOCK, TEXELS, manifest::FILE].contains(&name) || name.starts_with(".tmp");
            (!ours).then(|| format!("it holds {name} but no {}", manifest::FILE))
        };
        if folder.exists() && !folder.join(manifest::FILE).exists() {
            let entries = std::fs::read_dir(folder).map_err(unreadable(folder))?;
            if let Some(why) = entries.flatten().find_map(|e| strange(&e.path())) {
                return Err(DatasetError::NotADataset { path: folder.to_owned(), why });
            }
        }
        std::fs::create_dir_all(folder).map_err(unwritable(folder))?;
        let lock = lock(folder)?;
        remove_half_written(folder);
        Ok((lock, Manifest::read(folder)?))
    }

    /// The shards of `batches`.
    pub fn into_shards(self, batches: Vec<Column>) -> Shards {
        Shards { texels: self.manifest.texels, batches, locks: vec![self.lock] }
    }

    /// Adds batches of at most `most` conditions for those that no batch has yet.
    fn add(&mut self, conditions: &[LightingCondition], training: usize, most: usize) -> Result<(), DatasetError> {
        let mut places = self.manifest.places();
        let mut missing = Vec::new();
        for (c, condition) in conditions.iter().enumerate() {
            if let std::collections::hash_map::Entry::Vacant(place) = places.entry(key(&condition.lights)) {
                place.insert((0, 0));
                missing.push(Entry { held_out: c >= training, lights: condition.lights.clone() });
            }
        }
        if missing.is_empty() {
            return Ok(());
        }
        // Batches of like size take the least time together.
        let size = missing.len().div_ceil(missing.len().div_ceil(most));
        let batches = missing.chunks(size).map(|entries| Batch { conditions: entries.to_vec() });
        self.manifest.batches.extend(batches);
        self.manifest.write(&self.folder)
    }

    /// Bakes what a batch lacks. Returns D of its conditions and their relative noise.
    fn bake(
        &self,
        batch: usize,
        most: usize,
        job: &Job,
        progress: &dyn Progress,
    ) -> Result<(Vec<f32>, Vec<f32>), DatasetError> {
        let conditions = self.manifest.batches[batch].conditions();
        let (n, tiles) = (conditions.len(), self.manifest.tiles());
        let mut checked = self.check(batch, progress)?;
        let missing: Vec<usize> = (0..tiles).filter(|&tile| checked[tile].is_none()).collect();
        if !missing.is_empty() {
            if n > most {
                return Err(DatasetError::Memory {
                    ceiling: job.memory,
                    what: format!("{}, begun with {n} conditions at a time,", self.folder.display()),
                    needed: Bytes(job.memory.0 + (n - most) as u64 * job.bytes_per_condition(&conditions)),
                    advice: "; give as much, or begin anew in another folder (--dataset)".into(),
                });
            }
            let texels =
                |tiles: &[usize]| tiles.iter().map(|&t| self.manifest.tile_texels(t).len() as u64).sum::<u64>();
            if self.manifest.batches.len() > 1 || missing.len() < tiles {
                let left = texels(&missing);
                progress.note(&format!(
                    "dataset: batch {} of {} with {n} conditions, {left} of {} texels to bake",
                    batch + 1,
                    self.manifest.batches.len(),
                    self.manifest.texels
                ));
            }
            let baker = Baker::new(job.tracer, job.lightmap, &conditions, job.settings, progress)?;
            progress.begin("bake", texels(&missing), "texels");
            progress.made_of(job.settings.paths as u64, "paths");
            let part_of = self.manifest.part_of(batch);
            let baked: Result<(), DatasetError> = missing.iter().try_for_each(|&tile| {
                checked[tile] = Some(self.bake_tile(batch, tile, &part_of, &baker, progress)?);
                Ok(())
            });
            progress.end();
            baked?;
        }
        let mut noise = NoiseSums::new(n);
        checked.iter().flatten().for_each(|tile| noise.merge(&tile.noise));
        Ok((self.direct(batch, &conditions, job)?, noise.relative_rmse()))
    }

    fn expected<'e>(&self, batch: usize, tile: usize, part_of: &'e str) -> Expected<'e> {
        let texels = self.manifest.tile_texels(tile).len();
        Expected { part_of, tile, texels, conditions: self.manifest.batches[batch].conditions.len() }
    }

    fn bake_tile(
        &self,
        batch: usize,
        tile: usize,
        part_of: &str,
        baker: &Baker,
        progress: &dyn Progress,
    ) -> Result<Checked, DatasetError> {
        self.write_tile(batch, tile, part_of, baker.texels(self.manifest.tile_texels(tile), progress)?)
    }

    /// Writes a shard.
    pub fn write_tile(
        &self,
        batch: usize,
        tile: usize,
        part_of: &str,
        baked: BakedTexels,
    ) -> Result<Checked, DatasetError> {
        let checked = Checked { noise: baked.noise.clone() };
        let bytes = shard::encode(baked, &self.expected(batch, tile, part_of));
        let path = shard_file(&self.folder, batch, tile);
        write_whole(&path, &bytes).map_err(unwritable(&path))?;
        Ok(checked)
    }

    /// Reads and checks every shard that a batch has. Those that are damaged are told, and count as not there.
    pub fn check(&self, batch: usize, progress: &dyn Progress) -> Result<Vec<Option<Checked>>, DatasetError> {
        let folder = batch_folder(&self.folder, batch);
        if !folder.exists() {
            return Ok(vec![None; self.manifest.tiles()]);
        }
        remove_half_written(&folder);
        let part_of = self.manifest.part_of(batch);
        let check = |tile: usize| {
            if progress.cancelled() {
                return Err(DatasetError::Cancelled);
            }
            let path = shard_file(&self.folder, batch, tile);
            Ok(shard::check(&path, &self.expected(batch, tile, &part_of)).unwrap_or_else(|why| {
                progress.note(&format!("warning: {}: damaged: {why}; it is baked anew", path.display()));
                None
            }))
        };
        (0..self.manifest.tiles()).into_par_iter().map(check).collect()
    }

    /// D of a batch, `[point][channel][condition]`: measured, which takes no time, and written for others to read.
    fn direct(&self, batch: usize, conditions: &[LightingCondition], job: &Job) -> Result<Vec<f32>, DatasetError> {
        let direct = job.points.direct_matrix(
            job.tracer,
            &LightTable::from_conditions(conditions, &EmissionFacets::of(job.tracer.asset())),
        );
        self.write_direct(batch, &direct)?;
        Ok(direct)
    }

    /// Writes D of a batch, unless it is there: it may be that of other points.
    pub fn write_direct(&self, batch: usize, direct: &[f32]) -> Result<(), DatasetError> {
        let path = batch_folder(&self.folder, batch).join(DIRECT);
        let n = self.manifest.batches[batch].conditions.len();
        let bytes = encode(&[("direct", Dtype::F32, vec![direct.len() / (3 * n), 3, n], bytemuck::cast_slice(direct))]);
        if std::fs::read(&path).is_ok_and(|there| there == bytes) {
            return Ok(());
        }
        write_whole(&path, &bytes).map_err(unwritable(&path))
    }
}

/// Takes the folder for this process until the file is dropped.
fn lock(folder: &Path) -> Result<File, DatasetError> {
    let path = folder.join(LOCK);
    let file = File::options().create(true).truncate(false).write(true).open(&path).map_err(unwritable(&path))?;
    match file.try_lock() {
        Err(std::fs::TryLockError::WouldBlock) => Err(DatasetError::InUse { path: folder.to_owned() }),
        // Some file systems have no locks.
        Ok(()) | Err(std::fs::TryLockError::Error(_)) => Ok(file),
    }
}

/// Removes files that a killed run was still writing.
fn remove_half_written(folder: &Path) {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    for entry in entries.filter(|e| e.file_name().to_string_lossy().starts_with(".tmp")) {
        // What stays is only litter.
        let _ = std::fs::remove_file(entry.path());
    }
}

fn write_texels(path: &Path, lightmap: &Lightmap) -> Result<(), DatasetError> {
    let index: Vec<u32> = lightmap.texels.iter().map(|t| t.index).collect();
    let area: Vec<f32> = lightmap.texels.iter().map(|t| t.area).collect();
    let count = vec![index.len()];
    write_tensors(
        path,
        &[
            ("index", Dtype::U32, count.clone(), bytemuck::cast_slice(&index)),
            ("area", Dtype::F32, count, bytemuck::cast_slice(&area)),
        ],
    )
}

fn encode(tensors: &[(&str, Dtype, Vec<usize>, &[u8])]) -> Vec<u8> {
    let views = tensors.iter().map(|(name, dtype, shape, bytes)| {
        (*name, TensorView::new(*dtype, shape.clone(), bytes).expect("our own shapes"))
    });
    safetensors::serialize(views, None).expect("tensors of our own making serialise")
}

pub(super) fn write_tensors(path: &Path, tensors: &[(&str, Dtype, Vec<usize>, &[u8])]) -> Result<(), DatasetError> {
    write_whole(path, &encode(tensors)).map_err(unwritable(path))
}

impl Shards {
    /// Shards of some conditions of several datasets: `columns` gives, for each condition of a part, the condition that it becomes.
    pub(super) fn gather(parts: &[(&Self, Vec<Option<u32>>)]) -> Self {
        let column = |b: &Column, becomes: &[Option<u32>]| Column {
            columns: b.columns.iter().map(|&c| c.and_then(|c| becomes[c as usize])).collect(),
            ..b.clone()
        };
        let batches = parts.iter().flat_map(|(part, becomes)| part.batches.iter().map(|b| column(b, becomes)));
        Self {
            texels: parts.first().map_or(0, |(part, _)| part.texels),
            // A batch of which nothing is taken is not read.
            batches: batches.filter(|b| b.columns.iter().any(Option::is_some)).collect(),
            locks: parts.iter().flat_map(|(part, _)| part.locks.iter().cloned()).collect(),
        }
    }

    /// Hands all rows to `visit`, [`ROWS`] texels at a time; `row` values a texel.
    pub(super) fn for_each_rows(&self, row: usize, visit: &mut Visit) -> Result<(), DatasetError> {
        let mut rows = vec![0f32; ROWS * row];
        for (tile, start) in (0..self.texels).step_by(TILE).enumerate() {
            let texels = TILE.min(self.texels - start);
            let path = |b: &Column| shard_file(&b.folder, b.batch, tile);
            let damaged = |b: &Column| {
                let path = path(b);
                move |why| DatasetError::Damaged { path, why }
            };
            let mut shards = (self.batches.iter())
                .map(|b| shard::Rows::open(&path(b), texels, b.columns.len()).map_err(damaged(b)))
                .collect::<Result<Vec<_>, _>>()?;
            for first in (0..texels).step_by(ROWS) {
                let count = ROWS.min(texels - first);
                let rows = &mut rows[..count * row];
                for (shard, batch) in shards.iter_mut().zip(&self.batches) {
                    shard.read(first, &batch.columns, rows, row).map_err(damaged(batch))?;
                }
                visit(start + first..start + first + count, rows)?;
            }
        }
        Ok(())
    }
}
