//! Rows of light, one a texel or patch, K columns wide, and their weighted sums: the dense inner loop of the final gather.
//!
//! Values are kept as bfloat16, the upper half of an f32: all of f32's range, so that a light near a surface does not overflow,
//! and widened by one shift. They are rounded up or down at random, with the value as the mean: rows that hold the same light
//! are not all wrong the same way, and a texel sums dozens of them.

use crate::math::{LANES, Rgb};

/// Vectors of columns that are summed at a time: three channels of them stay in registers.
const BLOCK: usize = 4;

/// Terms by which the rows that are summed are fetched ahead of their use: they lie anywhere in the last level of the cache.
const AHEAD: usize = 6;

/// A matrix of light. What is summed at a time lies together: a row is `[block][plane][column of the block]`, see [`place`].
pub struct Rows {
    values: Vec<u16>,
    columns: usize,
    /// 3 where a column has red, green and blue, 1 where one value serves for all of them.
    planes: usize,
}

/// Part of a weighted sum: a row, and the weight of each channel.
#[derive(Clone, Copy, Debug)]
pub struct Term {
    pub row: u32,
    pub weight: Rgb,
}

/// `columns` rounded up, so that rows are whole vectors.
pub fn padded(columns: usize) -> usize {
    columns.next_multiple_of(LANES)
}

/// Where a row of `planes` planes and `columns` columns keeps a value.
#[inline]
pub fn place(planes: usize, columns: usize, plane: usize, column: usize) -> usize {
    let first = column - column % (BLOCK * LANES);
    let width = (columns - first).min(BLOCK * LANES);
    planes * first + plane * width + (column - first)
}

impl Rows {
    /// `count` dark rows. `columns` is a whole number of vectors: see [`padded`].
    pub fn new(count: usize, planes: usize, columns: usize) -> Self {
        assert!(columns.is_multiple_of(LANES) && (planes == 1 || planes == 3));
        Self { values: vec![0; count * planes * columns], columns, planes }
    }

    /// As many columns and planes, for `count` other rows.
    pub fn like(&self, count: usize) -> Self {
        Self::new(count, self.planes, self.columns)
    }

    pub fn count(&self) -> usize {
        self.values.len() / self.stride()
    }

    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Values a row.
    pub fn stride(&self) -> usize {
        self.planes * self.columns
    }

    pub fn values_mut(&mut self) -> &mut [u16] {
        &mut self.values
    }

    /// One row in f32, its values where they were.
    pub fn widen(&self, row: usize, out: &mut [f32]) {
        let stride = self.stride();
        out.iter_mut().zip(&self.values[row * stride..(row + 1) * stride]).for_each(|(out, &v)| *out = widened(v));
    }

    /// Adds Σ weight · row over `terms` to `sums`, a row of three planes.
    pub fn add(&self, terms: &[Term], sums: &mut [f32]) {
        assert_eq!(sums.len(), 3 * self.columns);
        if terms.is_empty() {
            return;
        }
        for first in (0..self.columns).step_by(BLOCK * LANES) {
            match (self.columns - first) / LANES {
                1 => self.add_block::<1>(first, terms, sums),
                2 => self.add_block::<2>(first, terms, sums),
                3 => self.add_block::<3>(first, terms, sums),
                _ => self.add_block::<BLOCK>(first, terms, sums),
            }
        }
    }

    fn add_block<const VECTORS: usize>(&self, first: usize, terms: &[Term], sums: &mut [f32]) {
        let sums = &mut sums[3 * first..][..3 * VECTORS * LANES];
        if self.planes == 3 {
            self.add_planes::<VECTORS, 3>(first, terms, sums);
        } else {
            self.add_planes::<VECTORS, 1>(first, terms, sums);
        }
    }

    fn add_planes<const VECTORS: usize, const PLANES: usize>(&self, first: usize, terms: &[Term], sums: &mut [f32]) {
        let mut block = [[Lanes([0.0; LANES]); VECTORS]; 3];
        let values = |term: &Term| {
            let start = term.row as usize * self.stride() + first * PLANES;
            &self.values[start..][..PLANES * VECTORS * LANES]
        };
        for (i, term) in terms.iter().enumerate() {
            if let Some(later) = terms.get(i + AHEAD) {
                fetch(values(later));
            }
            for (plane, row) in values(term).chunks_exact(VECTORS * LANES).enumerate() {
                for (i, lanes) in row.chunks_exact(LANES).enumerate() {
                    let light = Lanes::widened(lanes);
                    // One plane serves all channels.
                    for channel in if PLANES == 1 { 0..3 } else { plane..plane + 1 } {
                        block[channel][i].add(term.weight[channel], light);
                    }
                }
            }
        }
        for (out, lanes) in sums.chunks_exact_mut(LANES).zip(block.as_flattened()) {
            out.iter_mut().zip(&lanes.0).for_each(|(out, sum)| *out += sum);
        }
    }
}

/// Asks for values that will be read soon.
#[inline(always)]
fn fetch(values: &[u16]) {
    #[cfg(target_arch = "x86_64")]
    for line in values.chunks(64 / size_of::<u16>()) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a hint; it reads nothing, wherever it points.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(line.as_ptr().cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = values;
}

/// LANES values that one instruction handles.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Lanes([f32; LANES]);

impl Lanes {
    #[inline(always)]
    fn widened(values: &[u16]) -> Self {
        Self(std::array::from_fn(|i| widened(values[i])))
    }

    #[inline(always)]
    fn add(&mut self, weight: f32, light: Lanes) {
        for i in 0..LANES {
            self.0[i] = fused(weight, light.0[i], self.0[i]);
        }
    }
}

/// a·b + c, in one instruction where there is one. Without it the library's fused form would be slow.
#[inline(always)]
fn fused(a: f32, b: f32, c: f32) -> f32 {
    if cfg!(target_feature = "fma") { a.mul_add(b, c) } else { a * b + c }
}

#[inline(always)]
fn widened(value: u16) -> f32 {
    f32::from_bits((value as u32) << 16)
}

/// A bfloat16 next to a finite `value` that is not negative: the one above or the one below, so that its mean over many `row`s is
/// the value. It depends on the two alone.
#[inline(always)]
pub fn narrowed(value: f32, row: usize) -> u16 {
    let bits = value.to_bits();
    let random = (bits ^ (row as u32).wrapping_mul(0x85eb_ca6b)).wrapping_mul(0x9e37_79b1) >> 16;
    // Values beyond the largest bfloat16 stay finite.
    (bits.saturating_add(random) >> 16).min(0x7f7f) as u16
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    /// Neighbours are at most 1 part in 128 apart. The mean over n rows is the value, with a standard error of at most half that
    /// step over √n.
    #[test]
    fn narrowing_is_right_in_the_mean() {
        const N: usize = 10_000;
        for value in [1.0f32, 1.003_9, 1.007, 3.7e-20, 65_504.0, 1.0e8, 2.51, 0.0] {
            let back = |row| widened(narrowed(value, row)) as f64;
            assert!((0..N).all(|row| (back(row) - value as f64).abs() <= value as f64 / 128.0));
            let mean = (0..N).map(back).sum::<f64>() / N as f64;
            let sigma = value as f64 / 256.0 / (N as f64).sqrt();
            assert!((mean - value as f64).abs() <= 4.5 * sigma, "{value} became {mean}");
        }
        assert!(widened(narrowed(f32::MAX, 3)).is_finite());
    }

    /// Small whole numbers are exact in bfloat16, and so are their sums in f32.
    #[test]
    fn sums_of_rows_are_those_of_a_plain_loop() {
        // Whole blocks, and every width of the last.
        for (planes, columns) in [1, 3].into_iter().flat_map(|p| [10, 90, 110, 128, 170].map(|c| (p, padded(c)))) {
            let mut rows = Rows::new(5, planes, columns);
            let stride = rows.stride();
            let value = |row: usize, i: usize| ((row * 31 + i * 7) % 100) as f32;
            for row in 0..5 {
                for i in 0..stride {
                    rows.values_mut()[row * stride + i] = narrowed(value(row, i), row);
                }
            }
            let terms = [(4, Vec3::new(1.0, 2.0, 3.0)), (0, Vec3::splat(2.0)), (4, Vec3::X)];
            let terms = terms.map(|(row, weight)| Term { row, weight });
            let mut sums = vec![1.0; 3 * columns];
            rows.add(&terms, &mut sums);
            for channel in 0..3 {
                for k in 0..columns {
                    let plane = if planes == 3 { channel } else { 0 };
                    let light = |t: &Term| t.weight[channel] * value(t.row as usize, place(planes, columns, plane, k));
                    let expected = 1.0 + terms.iter().map(light).sum::<f32>();
                    assert_eq!(sums[place(3, columns, channel, k)], expected);
                }
            }
        }
    }
}
