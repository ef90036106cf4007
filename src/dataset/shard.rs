//! One shard: the lightmaps of a batch of conditions over a tile of texels, as a safetensors file.
//!
//! I is kept as half floats, each condition of a shard times a power of two that brings its largest value to [2¹⁴, 2¹⁵): the
//! relative rounding error is at most 2⁻¹¹ (0.05 %) for what is above 2⁻²⁹ of the largest, and 2⁻⁴⁰ of the largest below.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde::{Deserialize, Serialize};

use crate::transport::{BakedTexels, NoiseSums};

/// Where in a file safetensors' header starts, after its length.
const LENGTH_BYTES: u64 = 8;

/// Largest header that is read; ours are some hundred bytes.
const MOST_HEADER_BYTES: u64 = 1 << 20;

/// The metadata key, as in the model file.
const METADATA_KEY: &str = "relight";

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Metadata {
    /// BLAKE3 of the dataset's identity and the batch's conditions: what this shard is a part of.
    part_of: String,
    tile: usize,
    /// BLAKE3 of everything after the header.
    blake3: String,
}

/// A shard that is there and whole.
#[derive(Clone, Debug)]
pub(super) struct Checked {
    pub noise: NoiseSums,
}

/// What a shard must hold.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expected<'e> {
    pub part_of: &'e str,
    pub tile: usize,
    pub texels: usize,
    pub conditions: usize,
}

/// The file's bytes.
pub(super) fn encode(baked: BakedTexels, expected: &Expected) -> Vec<u8> {
    let n = expected.conditions;
    let exponents = exponents(&baked.indirect, n);
    let scale: Vec<f32> = exponents.iter().map(|&e| power_of_two(e)).collect();
    let inverse: Vec<f32> = exponents.iter().map(|&e| power_of_two(-e)).collect();
    let mut values = vec![f16::ZERO; baked.indirect.len()];
    values.par_chunks_mut(n).zip(baked.indirect.par_chunks(n)).for_each(|(out, row)| {
        out.iter_mut().zip(row).zip(&inverse).for_each(|((out, value), inverse)| *out = f16::from_f32(value * inverse));
    });
    let BakedTexels { indirect, noise, .. } = baked;
    // The largest part goes before its bytes are laid out.
    drop(indirect);
    let noise = [noise.squared_noise, noise.squared_signal].concat();
    let view = |dtype, shape: &[usize], bytes| TensorView::new(dtype, shape.to_vec(), bytes).expect("our own shapes");
    let tensors = || {
        [
            ("indirect", view(Dtype::F16, &[expected.texels, 3, n], bytemuck::cast_slice(&values))),
            ("noise", view(Dtype::F64, &[2, n], bytemuck::cast_slice(&noise))),
            ("scale", view(Dtype::F32, &[n], bytemuck::cast_slice(&scale))),
        ]
    };
    // safetensors lays tensors out by falling alignment, then by name.
    let mut hasher = blake3::Hasher::new();
    hasher.update(bytemuck::cast_slice(&noise)).update(bytemuck::cast_slice(&scale));
    hasher.update(bytemuck::cast_slice(&values));
    let metadata = Metadata {
        part_of: expected.part_of.to_owned(),
        tile: expected.tile,
        blake3: hasher.finalize().to_hex().to_string(),
    };
    let json = serde_json::to_string(&metadata).expect("plain fields");
    safetensors::serialize(tensors(), Some(HashMap::from([(METADATA_KEY.to_owned(), json)])))
        .expect("tensors of our own making serialise")
}

/// Per condition, the exponent of the power of two that its values are divided by.
fn exponents(indirect: &[f32], n: usize) -> Vec<i32> {
    let peaks = |mut peaks: Vec<f32>, row: &[f32]| {
        peaks.iter_mut().zip(row).for_each(|(peak, value)| *peak = peak.max(value.abs()));
        peaks
    };
    let rows = indirect.par_chunks(n);
    let peaks = rows.fold(|| vec![0f32; n], peaks).reduce(|| vec![0f32; n], |a, b| peaks(a, &b));
    let exponent = |&peak: &f32| {
        // Of infinity, the largest that there is: it stays infinite, and is told when it is read.
        if peak > 0.0 { (((peak.to_bits() >> 23) as i32 - 127).min(127) - 14).clamp(-126, 126) } else { 0 }
    };
    peaks.iter().map(exponent).collect()
}

/// 2^`exponent` for exponents from −126 to 127.
fn power_of_two(exponent: i32) -> f32 {
    f32::from_bits(((exponent + 127) as u32) << 23)
}

/// A tensor's entry in the header.
#[derive(Deserialize)]
struct Entry {
    dtype: String,
    shape: Vec<usize>,
    data_offsets: [u64; 2],
}

struct Header {
    metadata: Metadata,
    tensors: BTreeMap<String, Entry>,
    /// Where the tensors start in the file.
    data: u64,
}

impl Header {
    fn read(file: &mut impl Read) -> Result<Self, String> {
        let mut length = [0; LENGTH_BYTES as usize];
        file.read_exact(&mut length).map_err(|_| "it is shorter than a header")?;
        let length = u64::from_le_bytes(length);
        if length > MOST_HEADER_BYTES {
            return Err("its header is not one of a shard".into());
        }
        let mut json = vec![0; length as usize];
        file.read_exact(&mut json).map_err(|_| "it is shorter than its header")?;
        let not_json = |e: serde_json::Error| format!("its header does not parse ({e})");
        let mut entries: BTreeMap<String, serde_json::Value> = serde_json::from_slice(&json).map_err(not_json)?;
        let metadata = entries.remove("__metadata__").and_then(|m| m.get(METADATA_KEY)?.as_str().map(str::to_owned));
        let metadata = metadata.ok_or("it has no relight metadata")?;
        let metadata = serde_json::from_str(&metadata).map_err(not_json)?;
        let tensors = entries.into_iter().map(|(name, entry)| Ok((name, serde_json::from_value(entry)?)));
        let tensors = tensors.collect::<Result<_, serde_json::Error>>().map_err(not_json)?;
        Ok(Self { metadata, tensors, data: LENGTH_BYTES + length })
    }

    /// Where the tensor is in the file, in bytes.
    fn place(&self, name: &str, dtype: &str, shape: &[usize], size: u64) -> Result<std::ops::Range<u64>, String> {
        let entry = self.tensors.get(name).ok_or_else(|| format!("tensor {name} is missing"))?;
        let bytes = shape.iter().product::<usize>() as u64 * size;
        let [start, end] = entry.data_offsets;
        if entry.dtype != dtype || entry.shape != shape || end.checked_sub(start) != Some(bytes) || end > u64::MAX / 2 {
            return Err(format!("tensor {name} is {} {:?}, expected {dtype} {shape:?}", entry.dtype, entry.shape));
        }
        Ok(self.data + start..self.data + end)
    }

    fn noise(&self, n: usize) -> Result<std::ops::Range<u64>, String> {
        self.place("noise", "F64", &[2, n], 8)
    }

    fn scale(&self, n: usize) -> Result<std::ops::Range<u64>, String> {
        self.place("scale", "F32", &[n], 4)
    }

    fn indirect(&self, texels: usize, n: usize) -> Result<std::ops::Range<u64>, String> {
        self.place("indirect", "F16", &[texels, 3, n], 2)
    }
}

fn read_at<T: bytemuck::Pod>(file: &mut File, place: &std::ops::Range<u64>, out: &mut [T]) -> std::io::Result<()> {
    debug_assert_eq!(place.end - place.start, size_of_val(out) as u64);
    file.seek(SeekFrom::Start(place.start))?;
    file.read_exact(bytemuck::cast_slice_mut(out))
}

/// Reads all of the file and checks it against its checksum and what is expected of it. `None` where there is no file.
///
/// # Errors
/// Why it is damaged.
pub(super) fn check(path: &Path, expected: &Expected) -> Result<Option<Checked>, String> {
    let told = |e: std::io::Error| e.to_string();
    let mut file = match File::open(path) {
        Ok(file) => BufReader::with_capacity(1 << 16, file),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(told(error)),
    };
    let header = Header::read(&mut file)?;
    let n = expected.conditions;
    let noise_place = header.noise(n)?;
    header.scale(n)?;
    header.indirect(expected.texels, n)?;
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(&mut file).map_err(told)?;
    if hasher.finalize().to_hex().as_str() != header.metadata.blake3 {
        return Err("its checksum is wrong".into());
    }
    if header.metadata.part_of != expected.part_of || header.metadata.tile != expected.tile {
        return Err("it belongs elsewhere".into());
    }
    let mut sums = vec![0f64; 2 * n];
    read_at(file.get_mut(), &noise_place, &mut sums).map_err(told)?;
    let squared_signal = sums.split_off(n);
    Ok(Some(Checked { noise: NoiseSums { squared_noise: sums, squared_signal } }))
}

/// A shard whose rows are read.
pub(super) struct Rows {
    file: File,
    place: std::ops::Range<u64>,
    scale: Vec<f32>,
    /// Half floats as they are in the file.
    read: Vec<f16>,
}

impl Rows {
    /// Opens a shard that [`check`] found whole.
    pub fn open(path: &Path, texels: usize, conditions: usize) -> Result<Self, String> {
        let told = |e: std::io::Error| e.to_string();
        let mut file = File::open(path).map_err(told)?;
        let header = Header::read(&mut file)?;
        let mut scale = vec![0f32; conditions];
        read_at(&mut file, &header.scale(conditions)?, &mut scale).map_err(told)?;
        Ok(Self { place: header.indirect(texels, conditions)?, file, scale, read: Vec::new() })
    }

    /// Reads `count` texels from `first` on and puts the batch's conditions into their columns of `rows`,
    /// `[texel][channel][condition]` of `row` values a texel; `columns[c]` is where condition c goes, if anywhere.
    pub fn read(&mut self, first: usize, columns: &[Option<u32>], rows: &mut [f32], row: usize) -> Result<(), String> {
        let n = columns.len();
        let count = rows.len() / row;
        self.read.resize(count * 3 * n, f16::ZERO);
        let start = self.place.start + (first * 3 * n * size_of::<f16>()) as u64;
        let place = start..start + size_of_val(&self.read[..]) as u64;
        read_at(&mut self.file, &place, &mut self.read).map_err(|e| e.to_string())?;
        let all = row / 3;
        let scale = &self.scale;
        rows.par_chunks_mut(row).zip(self.read.par_chunks(3 * n)).for_each_init(
            || vec![0f32; 3 * n],
            |values, (out, halves)| {
                halves.convert_to_f32_slice(values);
                for (channel, values) in values.chunks(n).enumerate() {
                    let out = &mut out[channel * all..(channel + 1) * all];
                    for ((value, scale), column) in values.iter().zip(scale).zip(columns) {
                        if let Some(column) = column {
                            out[*column as usize] = value * scale;
                        }
                    }
                }
            },
        );
        Ok(())
    }
}
