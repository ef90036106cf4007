//! Buffers, buffer views and accessors, every range checked.

use std::borrow::Cow;
use std::path::Path;

use base64::Engine;
use base64::alphabet;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::buffer::View;
use gltf::json::validation::Checked;
use gltf::json::{Accessor, Index, Root};

use crate::scene::load::read_file;

/// The bytes of every buffer. One that cannot be loaded is an error only where it is used.
pub(super) struct Buffers<'a> {
    root: &'a Root,
    buffers: Vec<Result<Cow<'a, [u8]>, String>>,
}

/// Elements of an accessor as floats, `components` each.
pub(super) struct Floats {
    pub components: usize,
    pub values: Vec<f32>,
}

impl<'a> Buffers<'a> {
    pub fn load(root: &'a Root, binary: Option<&'a [u8]>, directory: &Path) -> Self {
        let buffers = root.buffers.iter().enumerate().map(|(i, buffer)| {
            let bytes = match (&buffer.uri, binary) {
                (Some(uri), _) => resolve(uri, directory).map(Cow::Owned),
                (None, Some(binary)) if i == 0 => Ok(Cow::Borrowed(binary)),
                (None, _) => Err("it has no uri".to_owned()),
            };
            let bytes = bytes.map_err(|reason| format!("buffer {i} cannot be loaded: {reason}"))?;
            if (bytes.len() as u64) < buffer.byte_length.0 {
                let (has, needs) = (bytes.len(), buffer.byte_length.0);
                return Err(format!("buffer {i} has {has} bytes where {needs} are declared; export it again"));
            }
            Ok(bytes)
        });
        Self { root, buffers: buffers.collect() }
    }

    /// The bytes of a buffer view.
    pub fn view(&self, index: Index<View>) -> Result<&[u8], String> {
        let view = self.root.get(index).ok_or_else(|| format!("buffer view {index} does not exist"))?;
        let buffer = self.buffers.get(view.buffer.value());
        let buffer = buffer.ok_or_else(|| format!("buffer {} does not exist", view.buffer))?.as_ref()?;
        slice(buffer, view.byte_offset.map_or(0, |o| o.0), view.byte_length.0)
            .ok_or_else(|| format!("buffer view {index} runs past the end of buffer {}", view.buffer))
    }

    /// Elements of an accessor of one of the `allowed` types, as floats; normalised integers become [0, 1] or [−1, 1]
    /// (glTF 2.0, section 3.6.2.3), others keep their value (KHR_mesh_quantization).
    pub fn floats(&self, index: Index<Accessor>, allowed: &[Type]) -> Result<Floats, String> {
        let (accessor, components, component) = self.layout(index, allowed)?;
        let size = component_size(component);
        let mut values = vec![0.0; self.checked_count(index, accessor)? * components];
        self.for_each_element(index, accessor, components * size, &mut |element, bytes| {
            let decoded = bytes.chunks_exact(size).map(|b| decode_float(b, component, accessor.normalized));
            for (value, decoded) in values[element * components..].iter_mut().zip(decoded) {
                *value = decoded;
            }
        })?;
        Ok(Floats { components, values })
    }

    /// Elements of a scalar accessor of unsigned integers.
    pub fn indices(&self, index: Index<Accessor>) -> Result<Vec<u32>, String> {
        let (accessor, _, component) = self.layout(index, &[Type::Scalar])?;
        if !matches!(component, ComponentType::U8 | ComponentType::U16 | ComponentType::U32) {
            return Err(format!("accessor {index} holds indices that are not unsigned integers"));
        }
        let mut values = vec![0; self.checked_count(index, accessor)?];
        self.for_each_element(index, accessor, component_size(component), &mut |element, bytes| {
            values[element] = decode_unsigned(bytes);
        })?;
        Ok(values)
    }

    /// The accessor, its components per element and their type.
    fn layout(&self, index: Index<Accessor>, allowed: &[Type]) -> Result<(&'a Accessor, usize, ComponentType), String> {
        let accessor = self.root.get(index).ok_or_else(|| format!("accessor {index} does not exist"))?;
        let Checked::Valid(component) = accessor.component_type else {
            return Err(format!("accessor {index} has an unknown component type"));
        };
        let components = match accessor.type_ {
            Checked::Valid(t) if allowed.contains(&t) => t.multiplicity(),
            Checked::Valid(t) => return Err(format!("accessor {index} is {t:?} where {allowed:?} is expected")),
            Checked::Invalid => return Err(format!("accessor {index} has an unknown type")),
        };
        Ok((accessor, components, component.0))
    }

    /// The accessor's count, which never exceeds the bytes of all buffers: each element that geometry uses takes a byte
    /// of an index or of an attribute at least.
    fn checked_count(&self, index: Index<Accessor>, accessor: &Accessor) -> Result<usize, String> {
        let bytes: usize = self.buffers.iter().flatten().map(|b| b.len()).sum();
        usize::try_from(accessor.count.0)
            .ok()
            .filter(|&count| count <= bytes)
            .ok_or_else(|| format!("accessor {index} claims {} elements, more than its file holds", accessor.count.0))
    }

    /// Calls `visit(element, bytes)` for every element that is stored, sparse substitutions last.
    fn for_each_element(
        &self,
        index: Index<Accessor>,
        accessor: &Accessor,
        size: usize,
        visit: &mut dyn FnMut(usize, &[u8]),
    ) -> Result<(), String> {
        let count = self.checked_count(index, accessor)?;
        if let Some(view) = accessor.buffer_view {
            let stride = self.root.get(view).and_then(|v| v.byte_stride).map_or(size, |s| s.0);
            let offset = accessor.byte_offset.map_or(0, |o| o.0);
            let elements = strided(self.view(view)?, offset, stride, size, count);
            let elements = elements.ok_or_else(|| format!("accessor {index} runs past the end of its buffer view"))?;
            for element in 0..count {
                visit(element, &elements[element * stride..][..size]);
            }
        }
        let Some(sparse) = &accessor.sparse else { return Ok(()) };
        let Checked::Valid(component) = sparse.indices.component_type else {
            return Err(format!("accessor {index} has sparse indices of an unknown type"));
        };
        let n = usize::try_from(sparse.count.0).ok().filter(|&n| n <= count);
        let n = n.ok_or_else(|| format!("accessor {index} has more sparse elements than elements"))?;
        let index_size = component_size(component.0);
        let indices = self.view(sparse.indices.buffer_view)?;
        let indices = strided(indices, sparse.indices.byte_offset.0, index_size, index_size, n);
        let values = strided(self.view(sparse.values.buffer_view)?, sparse.values.byte_offset.0, size, size, n);
        let (Some(indices), Some(values)) = (indices, values) else {
            return Err(format!("accessor {index} has sparse data that runs past the end of its buffer view"));
        };
        for i in 0..n {
            let element = decode_unsigned(&indices[i * index_size..][..index_size]) as usize;
            if element >= count {
                return Err(format!("accessor {index} substitutes element {element} of {count}"));
            }
            visit(element, &values[i * size..][..size]);
        }
        Ok(())
    }
}

/// The bytes that a URI stands for: a base64 `data:` URI or a file relative to `directory`.
pub(super) fn resolve(uri: &str, directory: &Path) -> Result<Vec<u8>, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let Some((_, payload)) = data.split_once(";base64,") else {
            return Err("its data URI is not base64".to_owned());
        };
        const LENIENT: GeneralPurposeConfig =
            GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent);
        let engine = GeneralPurpose::new(&alphabet::STANDARD, LENIENT);
        return engine.decode(payload.trim()).map_err(|e| format!("its data URI is not valid base64: {e}"));
    }
    if let Some((scheme, _)) = uri.split_once("://") {
        return Err(format!("{scheme}: addresses are not fetched; put the file beside the asset"));
    }
    let path = percent_decoded(uri);
    read_file(&directory.join(&path)).map_err(|reason| format!("{path}: {reason}"))
}

/// Replaces %XX escapes; a malformed one stays as it is, and so does a text that would not be UTF-8.
fn percent_decoded(uri: &str) -> String {
    let bytes = uri.as_bytes();
    let mut decoded = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        let hex = bytes.get(at + 1..at + 3).and_then(|h| std::str::from_utf8(h).ok());
        match hex.and_then(|h| u8::from_str_radix(h, 16).ok()) {
            Some(byte) if bytes[at] == b'%' => {
                decoded.push(byte);
                at += 3;
            }
            _ => {
                decoded.push(bytes[at]);
                at += 1;
            }
        }
    }
    String::from_utf8(decoded).unwrap_or_else(|_| uri.to_owned())
}

fn slice(bytes: &[u8], offset: u64, length: u64) -> Option<&[u8]> {
    let start = usize::try_from(offset).ok()?;
    let end = start.checked_add(usize::try_from(length).ok()?)?;
    bytes.get(start..end)
}

/// The bytes from the first of `count` elements, if all of them lie inside and do not overlap.
fn strided(bytes: &[u8], offset: u64, stride: usize, size: usize, count: usize) -> Option<&[u8]> {
    let bytes = bytes.get(usize::try_from(offset).ok()?..)?;
    let Some(last) = count.checked_sub(1) else { return Some(bytes) };
    let end = last.checked_mul(stride)?.checked_add(size)?;
    (stride >= size && end <= bytes.len()).then_some(bytes)
}

fn component_size(component: ComponentType) -> usize {
    match component {
        ComponentType::I8 | ComponentType::U8 => 1,
        ComponentType::I16 | ComponentType::U16 => 2,
        ComponentType::U32 | ComponentType::F32 => 4,
    }
}

/// A little-endian unsigned integer of 1, 2 or 4 bytes.
fn decode_unsigned(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |value, &byte| value << 8 | byte as u32)
}

fn decode_float(bytes: &[u8], component: ComponentType, normalized: bool) -> f32 {
    let bits = decode_unsigned(bytes);
    let (value, largest) = match component {
        ComponentType::I8 => (bits as u8 as i8 as f32, i8::MAX as f32),
        ComponentType::U8 => (bits as f32, u8::MAX as f32),
        ComponentType::I16 => (bits as u16 as i16 as f32, i16::MAX as f32),
        ComponentType::U16 => (bits as f32, u16::MAX as f32),
        ComponentType::U32 => (bits as f32, u32::MAX as f32),
        ComponentType::F32 => return f32::from_bits(bits),
    };
    if normalized { (value / largest).max(-1.0) } else { value }
}
