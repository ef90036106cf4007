//! Rows of light, one a texel or patch, K columns wide, and their weighted sums: the dense inner loop of the final gather.
//!
//! Values are kept as bfloat16, the upper half of an f32: all of f32's range, so that a light near a surface does not overflow.
//! Two share a word, and are widened by a shift and a mask. They are rounded up or down at random, with the value as the mean:
//! rows that hold the same light are not all wrong the same way, and a texel sums dozens of them.

use std::ops::Range;

use crate::math::{LANES, Rgb};
use crate::memory::zeros;

/// Lines of a row and plane that are summed at a time: three channels of them stay in registers.
const LINES: usize = 2;

/// Columns of a line.
const COLUMNS: usize = 2 * LANES;

/// Columns of a block.
pub const BLOCK: usize = LINES * COLUMNS;

/// Terms by which the rows that are summed are fetched ahead of their use: they lie anywhere in the last level of the cache.
const AHEAD: usize = 6;

/// COLUMNS values of a row, a cache line: lane i holds column i in its lower half, and column LANES + i in its upper.
#[derive(Clone, Copy, Default, bytemuck::Zeroable)]
#[repr(align(64))]
pub struct Line([u32; LANES]);

/// A matrix of light. What is summed at a time lies together: `[block][row][plane][line of the block]`.
pub struct Rows {
    lines: Vec<Line>,
    count: usize,
    columns: usize,
    planes: usize,
}

/// All rows, a block of columns.
#[derive(Clone, Copy)]
pub struct Block<'r> {
    /// `[row][plane][line]`.
    lines: &'r [Line],
    /// 3 where a column has red, green and blue, 1 where one value serves for all of them.
    pub planes: usize,
    /// Columns.
    pub width: usize,
}

/// Some rows that follow each other, to be written.
pub struct Part<'r> {
    /// Per block, `[row][plane][line]`.
    blocks: Vec<&'r mut [Line]>,
    planes: usize,
    rows: usize,
    /// The number of the first row.
    pub first: usize,
}

/// Part of a weighted sum: a row, and the weight of each channel.
#[derive(Clone, Copy, Debug)]
pub struct Term {
    pub row: u32,
    pub weight: Rgb,
}

/// `columns` rounded up, so that rows are whole lines.
pub fn padded(columns: usize) -> usize {
    columns.next_multiple_of(COLUMNS)
}

/// Lines of so many columns.
pub fn lines(columns: usize) -> usize {
    columns / COLUMNS
}

impl Rows {
    /// `count` dark rows. `columns` is a whole number of lines: see [`padded`].
    pub fn new(count: usize, planes: usize, columns: usize) -> Self {
        assert!(columns.is_multiple_of(COLUMNS) && (planes == 1 || planes == 3));
        Self { lines: zeros(count * planes * lines(columns)), count, columns, planes }
    }

    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The columns of each block.
    pub fn blocks(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let columns = self.columns;
        (0..columns).step_by(BLOCK).map(move |first| first..(first + BLOCK).min(columns))
    }

    /// The block of these columns.
    pub fn block(&self, columns: &Range<usize>) -> Block<'_> {
        let line = |column: usize| self.count * self.planes * lines(column);
        Block { lines: &self.lines[line(columns.start)..line(columns.end)], planes: self.planes, width: columns.len() }
    }

    /// The lines of every block.
    pub fn blocks_mut(&mut self) -> Vec<&mut [Line]> {
        let size = (self.count * self.planes * LINES).max(1);
        self.lines.chunks_mut(size).collect()
    }

    /// All rows, `rows` at a time.
    pub fn parts_mut(&mut self, rows: usize) -> Vec<Part<'_>> {
        let (planes, widths) = (self.planes, self.blocks().map(|columns| columns.len()).collect::<Vec<_>>());
        let firsts = (0..self.count).step_by(rows);
        let part = |first| Part { blocks: Vec::new(), planes, rows: rows.min(self.count - first), first };
        let mut parts: Vec<Part> = firsts.map(part).collect();
        for (block, width) in self.blocks_mut().into_iter().zip(widths) {
            let of_part = block.chunks_mut(rows * planes * lines(width));
            parts.iter_mut().zip(of_part).for_each(|(part, block)| part.blocks.push(block));
        }
        parts
    }
}

impl Part<'_> {
    /// Rounds and writes row `row` of these: `value` of plane and column.
    pub fn write(&mut self, row: usize, value: impl Fn(usize, usize) -> f32) {
        let mut first = 0;
        for block in &mut self.blocks {
            let lines = block.len() / self.planes / self.rows;
            let of_row = &mut block[row * self.planes * lines..][..self.planes * lines];
            for (plane, lines) in of_row.chunks_exact_mut(lines).enumerate() {
                for (l, line) in lines.iter_mut().enumerate() {
                    let values = std::array::from_fn(|i| value(plane, first + l * COLUMNS + i));
                    *line = Line::narrowed(&values, self.first + row);
                }
            }
            first += lines * COLUMNS;
        }
    }
}

impl Line {
    /// The values next to these, for row `row`.
    #[inline]
    pub fn narrowed(values: &[f32; COLUMNS], row: usize) -> Self {
        let mut line = Self::default();
        for i in 0..LANES {
            line.0[i] = narrowed(values[i], row) | narrowed(values[LANES + i], row) << 16;
        }
        line
    }

    #[inline]
    pub fn widened(&self) -> [f32; COLUMNS] {
        let mut values = [0.0; COLUMNS];
        for i in 0..LANES {
            values[i] = f32::from_bits(self.0[i] << 16);
            values[LANES + i] = f32::from_bits(self.0[i] & 0xffff_0000);
        }
        values
    }
}

/// Rounds values, as many as `lines` hold, for row `row`.
pub fn narrow(values: &[f32], row: usize, lines: &mut [Line]) {
    let values = values.as_chunks::<COLUMNS>().0;
    lines.iter_mut().zip(values).for_each(|(line, values)| *line = Line::narrowed(values, row));
}

impl<'r> Block<'r> {
    /// Of `[row][plane][line]`.
    pub fn new(lines: &'r [Line], planes: usize, width: usize) -> Self {
        Self { lines, planes, width }
    }

    /// One row, `[plane][line]`.
    pub fn row(&self, row: usize) -> &'r [Line] {
        let size = self.planes * lines(self.width);
        &self.lines[row * size..][..size]
    }

    /// Adds Σ weight · row over `terms` to `sums`, `[channel][column]`.
    #[inline]
    pub fn add(&self, terms: &[Term], sums: &mut [f32]) {
        assert_eq!(sums.len(), 3 * self.width);
        if terms.is_empty() {
            return;
        }
        match (lines(self.width), self.planes) {
            (1, 1) => self.add_lines::<1, 1>(terms, sums),
            (1, _) => self.add_lines::<1, 3>(terms, sums),
            (_, 1) => self.add_lines::<LINES, 1>(terms, sums),
            _ => self.add_lines::<LINES, 3>(terms, sums),
        }
    }

    #[inline(never)]
    fn add_lines<const L: usize, const PLANES: usize>(&self, terms: &[Term], sums: &mut [f32]) {
        // `[channel][line][half]`. Indices are written out: what a loop indexes is kept in memory, not in registers.
        let mut total = [Lanes([0.0; LANES]); 6 * LINES];
        let row = |term: &Term| &self.lines[term.row as usize * (PLANES * L)..][..PLANES * L];
        for (i, term) in terms.iter().enumerate() {
            if let Some(later) = terms.get(i + AHEAD) {
                row(later).iter().for_each(fetch);
            }
            let (row, [red, green, blue]) = (row(term), term.weight.to_array());
            macro_rules! line {
                ($line:literal) => {
                    if $line < L {
                        let [low, high] = Lanes::widened(&row[$line]);
                        let own = 2 * $line;
                        total[own].add(red, low);
                        total[own + 1].add(red, high);
                        // One plane serves all channels.
                        let [low_g, high_g] = if PLANES == 1 { [low, high] } else { Lanes::widened(&row[L + $line]) };
                        total[2 * LINES + own].add(green, low_g);
                        total[2 * LINES + own + 1].add(green, high_g);
                        let [low_b, high_b] =
                            if PLANES == 1 { [low, high] } else { Lanes::widened(&row[2 * L + $line]) };
                        total[4 * LINES + own].add(blue, low_b);
                        total[4 * LINES + own + 1].add(blue, high_b);
                    }
                };
            }
            line!(0);
            line!(1);
        }
        for (channel, sums) in sums.chunks_exact_mut(L * COLUMNS).enumerate() {
            for (out, lanes) in sums.chunks_exact_mut(LANES).zip(&total[channel * 2 * LINES..]) {
                out.iter_mut().zip(&lanes.0).for_each(|(out, sum)| *out += sum);
            }
        }
    }
}

/// Asks for a line that will be read soon.
#[inline(always)]
fn fetch(line: &Line) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a hint; it reads nothing, wherever it points.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(line).cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = line;
}

/// LANES values that one instruction handles.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Lanes([f32; LANES]);

impl Lanes {
    /// The columns of a line's lower halves, and those of its upper.
    #[inline(always)]
    fn widened(line: &Line) -> [Self; 2] {
        let low = std::array::from_fn(|i| f32::from_bits(line.0[i] << 16));
        let high = std::array::from_fn(|i| f32::from_bits(line.0[i] & 0xffff_0000));
        [Self(low), Self(high)]
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

/// A bfloat16 next to a finite `value` that is not negative: the one above or the one below, so that its mean over many `row`s is
/// the value. It depends on the two alone.
#[inline(always)]
fn narrowed(value: f32, row: usize) -> u32 {
    let bits = value.to_bits();
    let random = (bits ^ (row as u32).wrapping_mul(0x85eb_ca6b)).wrapping_mul(0x9e37_79b1) >> 16;
    // Values beyond the largest bfloat16 stay finite.
    (bits.saturating_add(random) >> 16).min(0x7f7f)
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
            let back = |row| f32::from_bits(narrowed(value, row) << 16) as f64;
            assert!((0..N).all(|row| (back(row) - value as f64).abs() <= value as f64 / 128.0));
            let mean = (0..N).map(back).sum::<f64>() / N as f64;
            let sigma = value as f64 / 256.0 / (N as f64).sqrt();
            assert!((mean - value as f64).abs() <= 4.5 * sigma, "{value} became {mean}");
        }
        assert!(f32::from_bits(narrowed(f32::MAX, 3) << 16).is_finite());
    }

    /// Small whole numbers are exact in bfloat16, and so are their sums in f32.
    #[test]
    fn sums_of_rows_are_those_of_a_plain_loop() {
        // Whole blocks, and every width of the last.
        for (planes, columns) in [1, 3].into_iter().flat_map(|p| [10, 90, 110, 128, 170].map(|c| (p, padded(c)))) {
            let mut rows = Rows::new(5, planes, columns);
            let value = |row: usize, plane: usize, k: usize| ((row * 31 + plane * 17 + k * 7) % 100) as f32;
            // Rows that follow each other are written in two parts.
            for mut part in rows.parts_mut(3) {
                for row in part.first..(part.first + 3).min(5) {
                    part.write(row - part.first, |plane, k| value(row, plane, k));
                }
            }
            let terms = [(4, Vec3::new(1.0, 2.0, 3.0)), (0, Vec3::splat(2.0)), (4, Vec3::X)];
            let terms = terms.map(|(row, weight)| Term { row, weight });
            let mut columns_seen = 0;
            for block in rows.blocks() {
                let mut sums = vec![1.0; 3 * block.len()];
                rows.block(&block).add(&terms, &mut sums);
                for (channel, k) in (0..3).flat_map(|channel| block.clone().map(move |k| (channel, k))) {
                    let plane = if planes == 3 { channel } else { 0 };
                    let light = |t: &Term| t.weight[channel] * value(t.row as usize, plane, k);
                    let expected = 1.0 + terms.iter().map(light).sum::<f32>();
                    assert_eq!(sums[channel * block.len() + k - block.start], expected);
                }
                columns_seen += block.len();
            }
            assert_eq!(columns_seen, columns);
        }
    }
}
