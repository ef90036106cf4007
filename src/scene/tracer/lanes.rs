//! Lanes as the bits of a mask.

use crate::math::LANES;

/// Bit i is set where lane i is.
#[inline]
pub fn mask_of(lanes: &[bool; LANES]) -> u32 {
    // Eight bytes that are 0 or 1, times this, have their bits side by side in the top byte.
    const GATHER: u64 = 0x0102_0408_1020_4080;
    let bytes = lanes.map(|lane| lane as u8);
    bytes
        .as_chunks::<8>()
        .0
        .iter()
        .enumerate()
        .fold(0, |mask, (i, &eight)| mask | ((u64::from_le_bytes(eight).wrapping_mul(GATHER) >> 56) as u32) << (8 * i))
}

/// The set lanes of a mask, in order.
#[inline]
pub fn lanes(mut mask: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        (mask != 0).then(|| {
            let lane = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            lane
        })
    })
}
