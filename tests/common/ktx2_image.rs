//! High dynamic range KTX2 images, as reference lightmaps are stored.

use std::io::Read;
use std::path::Path;

use glam::Vec3;
use half::f16;
use ktx2::{Format, SupercompressionScheme};

/// A square image of linear RGB, row 0 at v = 0.
pub struct HdrImage {
    pub width: usize,
    pub pixels: Vec<Vec3>,
}

/// Reads the base level of a square image of 32 bits a texel, Zstandard-compressed or plain.
pub fn read_ktx2(path: &Path) -> HdrImage {
    let reader = ktx2::Reader::new(std::fs::read(path).unwrap()).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let header = reader.header();
    let level = reader.levels().next().unwrap();
    let mut bytes = Vec::new();
    match header.supercompression_scheme {
        None => bytes.extend_from_slice(level.data),
        Some(SupercompressionScheme::Zstandard) => {
            ruzstd::decoding::StreamingDecoder::new(level.data).unwrap().read_to_end(&mut bytes).unwrap();
        }
        other => panic!("{}: supercompression {other:?}", path.display()),
    }
    let decode: fn(u32) -> Vec3 = match header.format {
        Some(Format::E5B9G9R9_UFLOAT_PACK32) => shared_exponent,
        Some(Format::B10G11R11_UFLOAT_PACK32) => small_floats,
        other => panic!("{}: format {other:?}", path.display()),
    };
    let pixels: Vec<Vec3> = bytes.as_chunks::<4>().0.iter().map(|&texel| decode(u32::from_le_bytes(texel))).collect();
    let width = header.pixel_width as usize;
    assert!(header.pixel_height == header.pixel_width && pixels.len() == width * width, "{}", path.display());
    HdrImage { width, pixels }
}

/// Three 9-bit mantissas without leading one under a common exponent of bias 15.
fn shared_exponent(texel: u32) -> Vec3 {
    let mantissa = |shift: u32| (texel >> shift & 0x1ff) as f32;
    let exponent = (texel >> 27) as i32 - 15 - 9;
    Vec3::new(mantissa(0), mantissa(9), mantissa(18)) * 2f32.powi(exponent)
}

/// Two 11-bit and one 10-bit float: halves without sign and with fewer mantissa bits.
fn small_floats(texel: u32) -> Vec3 {
    let half = |bits: u32, dropped: u32| f16::from_bits((bits << dropped) as u16).to_f32();
    Vec3::new(half(texel & 0x7ff, 4), half(texel >> 11 & 0x7ff, 4), half(texel >> 22, 5))
}
