//! What a method costs at run time, in the units of the hardware: bytes that a texel reads, multiply-adds that it takes, and
//! bytes that are shipped.

use serde::Serialize;

use crate::model::Channels;
use crate::prt::{ShPrt, Storage};

/// Storage and run time of one method at one size. Indirect light alone; what is measured and multiplied once per change of
/// light is not counted with the texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Cost {
    /// What a texel of the basis takes, and reads to be reconstructed (a vertex, for transfer per vertex).
    pub bytes_per_texel: usize,
    /// Of a texel's three colours.
    pub multiply_adds_per_texel: usize,
    /// Basis over the whole page and transfer matrices.
    pub model_bytes: usize,
}

/// Half floats store bases, matrices and transfer vectors.
const HALF: usize = 2;

/// Anchors that a texel of a local basis blends.
const BLENDED: usize = 4;

impl Cost {
    /// A global basis of n `elements`, of a lightmap with `size` texels a side.
    pub fn global(channels: Channels, elements: usize, points: usize, size: usize) -> Self {
        let bytes_per_texel = HALF * elements * channels.components();
        Self {
            bytes_per_texel,
            multiply_adds_per_texel: 3 * elements,
            model_bytes: size * size * bytes_per_texel + matrices(channels, elements, points),
        }
    }

    /// A local basis of `anchors`, whose texel takes `bytes_per_texel`: coefficients of four anchors are blended, then multiplied
    /// with the texel's channels.
    pub fn local(
        channels: Channels,
        elements: usize,
        bytes_per_texel: usize,
        anchors: usize,
        points: usize,
        size: usize,
    ) -> Self {
        // One set of coefficients a colour for mono; one for all, and three bases, for multi.
        let blends = BLENDED * elements * (3 / channels.components());
        Self {
            bytes_per_texel,
            multiply_adds_per_texel: blends + 3 * elements,
            model_bytes: size * size * bytes_per_texel + matrices(channels, anchors * elements, points),
        }
    }

    /// SH PRT of `order`: three colours of transfer for each harmonic, at texels or at vertices. Without the direct part.
    pub fn classical(prt: &ShPrt, order: usize, size: usize) -> Self {
        let functions = order * order;
        let bytes_per_texel = HALF * 3 * functions;
        let receivers = match prt.storage {
            Storage::Texels => size * size,
            Storage::Vertices(_) => prt.indirect.len() / (prt.order * prt.order).max(1),
        };
        Self { bytes_per_texel, multiply_adds_per_texel: 3 * functions, model_bytes: receivers * bytes_per_texel }
    }
}

/// M: a matrix a colour for mono; one that takes three colours in for multi.
fn matrices(channels: Channels, elements: usize, points: usize) -> usize {
    let (groups, rows) = match channels {
        Channels::Mono => (3, points),
        Channels::Multi => (1, 3 * points),
    };
    HALF * groups * elements * rows
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Section 6.5 of the paper: "a 16 monochannel basis at 1024×1024 resolution with 32 bits per channel is 64MB", half of that
    /// with half floats. Three matrices of 16 × 256 half floats come on top.
    #[test]
    fn storage_is_that_of_the_paper() {
        let cost = Cost::global(Channels::Mono, 16, 256, 1024);
        assert_eq!(cost.model_bytes, (32 << 20) + 3 * 16 * 256 * 2);
        assert_eq!((cost.bytes_per_texel, cost.multiply_adds_per_texel), (32, 48));
    }

    /// Four channels of 8 bits, four anchors and their shares: 12 bytes; 4 · 4 blends a colour, 4 products a colour.
    #[test]
    fn a_local_texel_reads_few_bytes() {
        let cost = Cost::local(Channels::Mono, 4, 12, 64, 128, 128);
        assert_eq!((cost.bytes_per_texel, cost.multiply_adds_per_texel), (12, 48 + 12));
        assert_eq!(cost.model_bytes, 128 * 128 * 12 + 3 * 64 * 4 * 128 * 2);
    }
}
