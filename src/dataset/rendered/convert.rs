//! Turns rendered lightmaps, one condition a file, into shards, a range of texels of all conditions a file.

use std::ops::Range;
use std::path::Path;

use rayon::prelude::*;

use super::super::error::unreadable;
use super::super::folder::{Column, Store, slack};
use super::super::manifest::{Batch, Entry, Manifest, identity};
use super::super::{Bytes, Dataset, DatasetError, Identity, Indirect};
use super::direct::Direct;
use super::lightmap;
use super::manifest::{FILE, Rendered};
use crate::measure::MeasurementPoints;
use crate::progress::Progress;
use crate::scene::{Lightmap, Tracer};
use crate::transport::{BakedTexels, NoiseSums, TILE};

/// What the lightmaps are read for.
#[derive(Clone, Copy)]
pub struct Reading<'r, 'a> {
    pub tracer: &'r Tracer<'a>,
    pub lightmap: &'r Lightmap,
    pub points: &'r MeasurementPoints,
    /// Conditions to train on: the first of the manifest's.
    pub training: usize,
    /// Held-out conditions, likewise.
    pub held_out: usize,
    /// Ceiling of the process's resident memory.
    pub memory: Bytes,
}

impl Rendered {
    /// The dataset. Lightmaps are turned into shards in the folder `shards`, unless those are there and the files are as they
    /// were.
    ///
    /// # Errors
    /// When the folder is of another asset, a file is missing or of no use, the memory is too little, or `progress` cancels.
    pub fn dataset(&self, reading: &Reading, shards: &Path, progress: &dyn Progress) -> Result<Dataset, DatasetError> {
        let Reading { tracer, lightmap, points, training, held_out, .. } = *reading;
        self.check(tracer, lightmap)?;
        let selected = self.select(training, held_out)?;
        let conditions = self.lights(&selected)?;
        let source = self.direct_source(&selected)?;
        self.check_present(&selected)?;
        let by = self.manifest.renderer.as_ref().map_or(String::new(), |by| format!(" by {}", lightmap::one_line(by)));
        let folder = self.folder.display();
        progress.note(&format!("dataset: {} lightmaps{by} in {folder}, {}", selected.len(), source.line()));
        let direct = self.direct(source, &selected, &conditions, tracer, lightmap, points)?;
        let content = self.content(&selected, source, progress)?;
        let store = self.store(reading, &selected, content, shards)?;

        let n = selected.len();
        let (mut noise, mut batches) = (Vec::with_capacity(n), Vec::new());
        for batch in 0..store.manifest.batches.len() {
            let range = noise.len()..noise.len() + store.manifest.batches[batch].conditions.len();
            noise.extend(self.convert(&store, batch, &selected[range.clone()], lightmap, progress)?.relative_rmse());
            let of_batch: Vec<f32> = direct.chunks_exact(n).flat_map(|row| row[range.clone()].to_vec()).collect();
            store.write_direct(batch, &of_batch)?;
            batches.push(Column { folder: shards.into(), batch, columns: range.map(|c| Some(c as u32)).collect() });
        }
        Ok(Dataset {
            conditions,
            training,
            direct,
            indirect: Indirect::Folder(store.into_shards(batches)),
            texel_areas: lightmap.texels.iter().map(|t| t.area).collect(),
            noise,
        })
    }

    /// Refuses another asset than the one that was exported.
    fn check(&self, tracer: &Tracer, lightmap: &Lightmap) -> Result<(), DatasetError> {
        let manifest = &self.manifest;
        if manifest.size as usize != lightmap.size {
            let (was, is) = (manifest.size, lightmap.size);
            return Err(self.wrong(
                FILE,
                format!("is for a lightmap of {was} x {was} texels, this run's has {is} x {is}; give --size {was}"),
            ));
        }
        if manifest.asset_hash != tracer.asset().hash() {
            let why = "was exported from another asset, layout or materials than this run's; give the scene and settings of \
                       `relight export-conditions`, or export and render anew";
            return Err(self.wrong(FILE, why));
        }
        Ok(())
    }

    /// Refuses a folder that is not fully rendered.
    fn check_present(&self, selected: &[usize]) -> Result<(), DatasetError> {
        let conditions = &self.manifest.conditions;
        let absent = |&i: &usize| !self.folder.join(&conditions[i].indirect).is_file();
        let missing: Vec<usize> = selected.iter().copied().filter(absent).collect();
        let Some(&first) = missing.first() else { return Ok(()) };
        let more = match missing.len() - 1 {
            0 => String::new(),
            more => format!(" ({more} more are missing, too)"),
        };
        let why = format!("is missing: the indirect light of condition {first}{more}; render it, then run this again");
        Err(self.wrong(&conditions[first].indirect, why))
    }

    /// A hash of everything that the shards and what lies beside them are made from.
    fn content(&self, selected: &[usize], source: Direct, progress: &dyn Progress) -> Result<String, DatasetError> {
        let hash_of = |path: &Path| {
            if progress.cancelled() {
                return Err(DatasetError::Cancelled);
            }
            let path = self.folder.join(path);
            let file = std::fs::File::open(&path).map_err(unreadable(&path))?;
            let mut hasher = blake3::Hasher::new();
            hasher.update_reader(file).map_err(unreadable(&path))?;
            progress.advance(1);
            Ok(hasher.finalize())
        };
        progress.begin("check", selected.len() as u64, "files");
        let hashes = selected.par_iter().map(|&i| {
            let condition = &self.manifest.conditions[i];
            let direct =
                condition.direct.as_deref().filter(|_| source == Direct::Lightmaps).map(hash_of).transpose()?;
            let noise = condition.noise.map(f64::to_bits);
            Ok(format!("{i} {:?} {direct:?} {noise:?}", hash_of(&condition.indirect)?))
        });
        let hashes: Result<Vec<String>, DatasetError> = hashes.collect();
        progress.end();
        let mut all = blake3::Hasher::new();
        hashes?.iter().for_each(|hash| _ = all.update(hash.as_bytes()));
        if let Direct::Table(file) = source {
            all.update(hash_of(Path::new(file))?.as_bytes());
        }
        Ok(all.finalize().to_hex().to_string())
    }

    /// Opens the folder of shards, begun anew where it is of other files or its batches are too large for the memory.
    fn store(
        &self,
        reading: &Reading,
        selected: &[usize],
        content: String,
        shards: &Path,
    ) -> Result<Store, DatasetError> {
        let (lightmap, n) = (reading.lightmap, selected.len());
        let settings = Identity::from([("the rendered files (hash)".to_owned(), content)]);
        let identity = identity(settings, &self.manifest.asset_hash, lightmap);
        let wanted = Manifest::new(identity, lightmap.texels.len());
        let most = reading.most_conditions(n)?;
        let mut store = Store::renew(shards, wanted, lightmap, |found| {
            let sizes = found.batches.iter().map(|b| b.conditions.len());
            sizes.clone().sum::<usize>() == n && sizes.max() <= Some(most)
        })?;
        if store.manifest.batches.is_empty() {
            // Batches of like size take the least time together.
            let size = n.div_ceil(n.div_ceil(most));
            let entry = |&i: &usize| {
                let condition = &self.manifest.conditions[i];
                Entry { held_out: condition.held_out, lights: condition.lights.clone() }
            };
            let batches = selected.chunks(size).map(|of| Batch { conditions: of.iter().map(entry).collect() });
            store.manifest.batches = batches.collect();
            store.manifest.write(shards)?;
        }
        Ok(store)
    }

    /// Writes the shards that a batch lacks. Returns the noise of its lightmaps.
    fn convert(
        &self,
        store: &Store,
        batch: usize,
        selected: &[usize],
        lightmap: &Lightmap,
        progress: &dyn Progress,
    ) -> Result<NoiseSums, DatasetError> {
        let mut checked = store.check(batch, progress)?;
        if checked.iter().any(Option::is_none) {
            progress.begin("read", selected.len() as u64, "lightmaps");
            let read = |&i: &usize| {
                if progress.cancelled() {
                    return Err(DatasetError::Cancelled);
                }
                let file = &self.manifest.conditions[i].indirect;
                let values = lightmap::read(&self.folder.join(file), "indirect", lightmap.size, &lightmap.texels)
                    .map_err(|why| self.wrong(file, format!("condition {i}: {why}")))?;
                progress.advance(1);
                Ok(values)
            };
            let lightmaps: Result<Vec<Vec<f32>>, DatasetError> = selected.par_iter().map(read).collect();
            progress.end();
            let lightmaps = lightmaps?;
            let noise: Vec<f64> =
                selected.iter().map(|&i| self.manifest.conditions[i].noise.unwrap_or(f64::NAN)).collect();
            let part_of = store.manifest.part_of(batch);
            for (tile, checked) in checked.iter_mut().enumerate().filter(|(_, checked)| checked.is_none()) {
                let rows = rows(&lightmaps, &noise, lightmap, store.manifest.tile_texels(tile));
                *checked = Some(store.write_tile(batch, tile, &part_of, rows)?);
            }
        }
        let mut noise = NoiseSums::new(selected.len());
        checked.iter().flatten().for_each(|tile| noise.merge(&tile.noise));
        Ok(noise)
    }
}

/// A range of texels of all `lightmaps`, as if they had been baked. `noise`: relative RMSE of each, NaN where it is not known.
fn rows(lightmaps: &[Vec<f32>], noise: &[f64], lightmap: &Lightmap, texels: Range<usize>) -> BakedTexels {
    let n = lightmaps.len();
    let mut indirect = vec![0f32; texels.len() * 3 * n];
    indirect.par_chunks_mut(n).enumerate().for_each(|(i, row)| {
        let at = 3 * texels.start + i;
        row.iter_mut().zip(lightmaps).for_each(|(out, values)| *out = values[at]);
    });
    let mut sums = NoiseSums::new(n);
    for (i, row) in indirect.chunks_exact(n).enumerate() {
        let area = lightmap.texels[texels.start + i / 3].area as f64;
        sums.squared_signal.iter_mut().zip(row).for_each(|(sum, &v)| *sum += area * (v as f64) * (v as f64));
    }
    for c in 0..n {
        sums.squared_noise[c] = sums.squared_signal[c] * noise[c] * noise[c];
    }
    BakedTexels { indirect, noise: sums, rays: 0 }
}

impl Reading<'_, '_> {
    /// The most lightmaps that are held at a time; D of all `conditions` stays beside them.
    fn most_conditions(&self, conditions: usize) -> Result<usize, DatasetError> {
        let texels = self.lightmap.texels.len();
        let size = self.lightmap.size;
        // The lightmap, and its rows of a shard as floats and as half floats, twice while they are laid out.
        let each = (texels * 3 * 4 + TILE.min(texels) * 3 * (4 + 2 + 2)) as u64;
        // Files being decoded: up to eight channels and their bytes, on each thread.
        let decoding = rayon::current_num_threads() * size * size * (8 * 4 + 8 * 4);
        let direct = self.points.points.len() * 3 * 4 * conditions + conditions * 1024;
        let taken = Bytes::resident().0 + slack() + (decoding + direct) as u64;
        match self.memory.0.saturating_sub(taken) / each {
            0 => Err(DatasetError::Memory {
                ceiling: self.memory,
                what: "reading one lightmap at a time".into(),
                needed: Bytes(taken + each),
                advice: "; give more, or export at a lower --size".into(),
            }),
            most => Ok(most as usize),
        }
    }
}
