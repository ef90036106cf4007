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

/// Bit i is set where `values[i]` is above zero.
#[inline(always)]
pub fn above_zero(values: &[f32; LANES]) -> u32 {
    #[cfg(all(target_arch = "x86_64", target_feature = "avx512f"))]
    {
        use std::arch::x86_64::{_CMP_GT_OQ, _mm512_cmp_ps_mask, _mm512_loadu_ps, _mm512_setzero_ps};
        // SAFETY: the whole program is built for a processor with AVX-512; LANES floats are loaded.
        unsafe {
            let values = _mm512_loadu_ps(values.as_ptr());
            u32::from(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(values, _mm512_setzero_ps()))
        }
    }
    #[cfg(not(all(target_arch = "x86_64", target_feature = "avx512f")))]
    mask_of(&values.map(|value| value > 0.0))
}

/// Moves the lanes of `mask` side by side, in order. What lies behind them tells nothing.
#[inline(always)]
pub fn packed(values: &[f32; LANES], mask: u32) -> [f32; LANES] {
    let mut packed = [0.0; LANES];
    #[cfg(all(target_arch = "x86_64", target_feature = "avx512f"))]
    {
        use std::arch::x86_64::{_mm512_loadu_ps, _mm512_maskz_compress_ps, _mm512_storeu_ps};
        // SAFETY: as above; LANES floats are loaded and stored.
        unsafe {
            let values = _mm512_loadu_ps(values.as_ptr());
            _mm512_storeu_ps(packed.as_mut_ptr(), _mm512_maskz_compress_ps(mask as u16, values));
        }
    }
    #[cfg(not(all(target_arch = "x86_64", target_feature = "avx512f")))]
    for (packed, lane) in packed.iter_mut().zip(lanes(mask)) {
        *packed = values[lane];
    }
    packed
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lanes_above_zero_are_told_and_packed() {
        let values: [f32; LANES] = std::array::from_fn(|i| (i as f32 * 7.0) % 5.0 - 2.0);
        let mask = above_zero(&values);
        assert_eq!(mask, mask_of(&values.map(|value| value > 0.0)));
        let expected: Vec<f32> = values.into_iter().filter(|&value| value > 0.0).collect();
        assert!(!expected.is_empty() && expected.len() < LANES);
        assert_eq!(packed(&values, mask)[..expected.len()], expected);
        assert_eq!(above_zero(&[f32::NAN; LANES]), 0);
        assert_eq!(packed(&values, 0xffff), values);
    }
}
