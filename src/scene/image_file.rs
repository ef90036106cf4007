//! Texture images from files and buffers.

use std::io::Cursor;

use image::{ImageReader, Limits};

use super::Texture;
use super::material::Wrap;

/// Pixels along an axis; twice the largest texture side that graphics APIs guarantee today.
const MAX_SIDE: u32 = 32_768;

/// Bytes that a decoder may allocate: a 16,384 × 16,384 RGBA image.
const MAX_BYTES: u64 = 1 << 30;

/// Decodes a PNG, JPEG, WebP, HDR, TGA or BMP image to 8-bit RGBA, or says why it cannot.
pub(super) fn decode(bytes: &[u8], name: &str, srgb: bool, wrap: [Wrap; 2]) -> Result<Texture, String> {
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| e.to_string())?;
    let Some(format) = reader.format() else {
        return Err(format!("{}; PNG, JPEG and WebP are read", unknown_format(bytes)));
    };
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_BYTES);
    reader.limits(limits);
    let image = reader.decode().map_err(|e| e.to_string())?.into_rgba8();
    let (width, height) = image.dimensions();
    if width == 0 || height == 0 {
        return Err("it has no pixels".to_owned());
    }
    let texels = image.pixels().map(|p| p.0).collect();
    Ok(Texture { name: name.to_owned(), width, height, texels, srgb, wrap })
}

fn unknown_format(bytes: &[u8]) -> &'static str {
    const KTX2: &[u8] = b"\xABKTX 20\xBB\r\n\x1A\n";
    match bytes {
        [] => "it is empty",
        b if b.starts_with(KTX2) => "KTX2 is not supported",
        b if b.starts_with(b"DDS ") => "DDS is not supported",
        _ => "its format is not known",
    }
}
