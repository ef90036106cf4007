//! KTX 2.0 (Khronos, *KTX File Format Specification*, version 2.0.4): one level of a square texture, or an array of them, of four
//! channels, not compressed.

/// What a texel's channels are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Texels {
    Float16,
    Snorm8,
    Unorm8,
    Uint8,
}

pub struct Ktx2 {
    pub texels: Texels,
    /// Texels along a side.
    pub size: usize,
    /// Of an array.
    pub layers: Option<usize>,
}

const IDENTIFIER: [u8; 12] = *b"\xABKTX 20\xBB\r\n\x1A\n";
/// Identifier, header, index, and the one level's place.
const HEADER: usize = 12 + 9 * 4 + 4 * 4 + 2 * 8 + 3 * 8;

impl Texels {
    /// VK_FORMAT_R16G16B16A16_SFLOAT, R8G8B8A8_SNORM, _UNORM, _UINT.
    fn vk_format(self) -> u32 {
        match self {
            Texels::Float16 => 97,
            Texels::Snorm8 => 38,
            Texels::Unorm8 => 37,
            Texels::Uint8 => 41,
        }
    }

    /// Bytes of a channel.
    fn size(self) -> u32 {
        if self == Texels::Float16 { 2 } else { 1 }
    }

    /// Qualifiers of a channel (float, signed), and what stands for the ends of its range (Khronos Data Format
    /// Specification 1.3, section 5).
    fn sample(self) -> (u8, u32, u32) {
        const FLOAT: u8 = 0x80;
        const SIGNED: u8 = 0x40;
        match self {
            Texels::Float16 => (FLOAT | SIGNED, (-1f32).to_bits(), 1f32.to_bits()),
            Texels::Snorm8 => (SIGNED, -127i32 as u32, 127),
            Texels::Unorm8 => (0, 0, 255),
            Texels::Uint8 => (0, 0, 1),
        }
    }

    /// The data format descriptor: linear RGBA with BT.709 primaries.
    fn descriptor(self) -> Vec<u8> {
        const RGBSDA: u8 = 1;
        const BT709: u8 = 1;
        const LINEAR: u8 = 1;
        const VERSION: u16 = 2;
        let block_size = 24 + 4 * 16u16;
        let mut bytes = (4 + block_size as u32).to_le_bytes().to_vec();
        bytes.extend([0; 4]);
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend(block_size.to_le_bytes());
        bytes.extend([RGBSDA, BT709, LINEAR, 0]);
        // A block of one texel; its bytes in the first plane.
        bytes.extend([0; 4]);
        bytes.extend([4 * self.size() as u8, 0, 0, 0, 0, 0, 0, 0]);
        let (qualifiers, lower, upper) = self.sample();
        let bits = 8 * self.size();
        for (i, channel) in [0u8, 1, 2, 15].into_iter().enumerate() {
            bytes.extend((i as u16 * bits as u16).to_le_bytes());
            bytes.extend([bits as u8 - 1, channel | qualifiers, 0, 0, 0, 0]);
            bytes.extend(lower.to_le_bytes());
            bytes.extend(upper.to_le_bytes());
        }
        bytes
    }
}

impl Ktx2 {
    /// The file of `texels`, layer by layer and row by row.
    pub fn bytes(&self, texels: &[u8]) -> Vec<u8> {
        let texel = 4 * self.texels.size() as usize;
        assert_eq!(texels.len(), self.size * self.size * self.layers.unwrap_or(1) * texel, "texels of another size");
        let descriptor = self.texels.descriptor();
        let pairs = pairs(&[
            // Row 0 is at v = 0, where glTF's images have their top.
            ("KTXorientation", "rd"),
            ("KTXwriter", concat!("relight ", env!("CARGO_PKG_VERSION"))),
        ]);
        let pairs_start = HEADER + descriptor.len();
        let start = (pairs_start + pairs.len()).next_multiple_of(texel);

        let mut bytes = IDENTIFIER.to_vec();
        let (side, layers) = (self.size as u32, self.layers.unwrap_or(0) as u32);
        // Width, height, no depth; layers, one face, one level; not compressed.
        for word in [self.texels.vk_format(), self.texels.size(), side, side, 0, layers, 1, 1, 0] {
            bytes.extend(word.to_le_bytes());
        }
        for word in [HEADER, descriptor.len(), pairs_start, pairs.len()] {
            bytes.extend((word as u32).to_le_bytes());
        }
        // No supercompression data; then the level: where it is, its bytes, and its bytes when not compressed.
        for long in [0, 0, start, texels.len(), texels.len()] {
            bytes.extend((long as u64).to_le_bytes());
        }
        bytes.extend(descriptor);
        bytes.extend(pairs);
        bytes.resize(start, 0);
        bytes.extend(texels);
        bytes
    }
}

/// Keys and values, in the order of the keys, each padded to four bytes.
fn pairs(pairs: &[(&str, &str)]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for (key, value) in pairs {
        let length = key.len() + value.len() + 2;
        bytes.extend((length as u32).to_le_bytes());
        bytes.extend([key.as_bytes(), b"\0", value.as_bytes(), b"\0"].concat());
        bytes.resize(bytes.len().next_multiple_of(4), 0);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use ::ktx2::{Format, Reader, dfd};

    /// An independent reader finds the format, the layers and the texels, and the descriptor that it would have written.
    #[test]
    fn files_validate_and_hold_their_texels() {
        for (texels, format) in [
            (Texels::Float16, Format::R16G16B16A16_SFLOAT),
            (Texels::Snorm8, Format::R8G8B8A8_SNORM),
            (Texels::Unorm8, Format::R8G8B8A8_UNORM),
            (Texels::Uint8, Format::R8G8B8A8_UINT),
        ] {
            for layers in [None, Some(1), Some(3)] {
                let size = 5;
                let count = size * size * 4 * texels.size() as usize * layers.unwrap_or(1);
                let data: Vec<u8> = (0..count).map(|i| (i * 7 % 251) as u8).collect();
                let file = Ktx2 { texels, size, layers }.bytes(&data);
                let reader = Reader::new(&file[..]).unwrap();
                let header = reader.header();
                assert_eq!(header.format, Some(format));
                assert_eq!(header.type_size, texels.size());
                assert_eq!((header.pixel_width, header.pixel_height, header.pixel_depth), (5, 5, 0));
                assert_eq!(
                    (header.layer_count, header.face_count, header.level_count),
                    (layers.unwrap_or(0) as u32, 1, 1)
                );
                let levels: Vec<_> = reader.levels().collect();
                assert_eq!(levels.len(), 1);
                assert_eq!(levels[0].data, data);
                let (expected, _) = dfd::Basic::from_format(format).unwrap();
                let descriptor = texels.descriptor();
                assert_eq!(descriptor[12..], expected.to_vec()[..], "{format:?}");
                // The control: a file that is cut is refused.
                assert!(Reader::new(&file[..file.len() - 1]).is_err());
            }
        }
    }
}
