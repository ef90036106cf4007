//! What the texels without a value of their own take: the gutter between charts, and the texels that were left out.

use std::collections::HashMap;

use glam::Vec2;

use super::Lightmap;
use super::texels::{CELLS, WHOLE, set_bits};

/// A bilinear lookup on visible surface reads texels at most this far from the texel that the point lies in, and those
/// take their values with care for what lies inside a texel.
const NEAR: usize = 2;

impl Lightmap {
    /// For every texel of the whole map, `[y · size + x]`, the position in `texels` of the one that it takes its value from:
    /// itself where it is one of them, otherwise the nearest; for a texel that was left out the nearest of its own chart,
    /// so that a wall's two sides are filled up to its middle, each from its own side. `u32::MAX` where nothing is. Of
    /// several nearest ones, always the same.
    pub fn sources(&self) -> Vec<u32> {
        let size = self.size;
        let mut own = vec![u32::MAX; size * size];
        for (t, texel) in self.texels.iter().enumerate() {
            own[texel.index as usize] = t as u32;
        }
        let mut sources = nearest(size, size, &|x, y| own[y * size + x]);
        let at = |index: u32| (index as usize % size, index as usize / size);
        let mut left_out = self.left_out.clone();
        left_out.sort_unstable_by_key(|l| (l.chart, l.index));
        let mut boxes: HashMap<u32, Bounds> = left_out.iter().map(|l| (l.chart, Bounds::EMPTY)).collect();
        let of_texels = self.texels.iter().map(|t| t.index).zip(self.charts.iter().copied());
        for (index, chart) in of_texels.chain(left_out.iter().map(|l| (l.index, l.chart))) {
            if let Some(bounds) = boxes.get_mut(&chart) {
                bounds.add(at(index));
            }
        }
        for group in left_out.chunk_by(|a, b| a.chart == b.chart) {
            let chart = group[0].chart;
            let Bounds { lo, hi } = boxes[&chart];
            let width = hi.0 - lo.0;
            let of_chart = |x: usize, y: usize| {
                let t = own[(y + lo.1) * size + x + lo.0];
                if t != u32::MAX && self.charts[t as usize] == chart { t } else { u32::MAX }
            };
            let nearest = nearest(width, hi.1 - lo.1, &of_chart);
            for (x, y) in group.iter().map(|g| at(g.index)) {
                sources[y * size + x] = nearest[(y - lo.1) * width + x - lo.0];
            }
            // Beside a wall, these and the gutter that runs along them: by the nearer face of the wall.
            let mut beside: Vec<usize> = group.iter().flat_map(|g| self.around(at(g.index))).collect();
            beside.sort_unstable();
            beside.dedup();
            for index in beside.into_iter().filter(|&index| own[index] == u32::MAX) {
                let (x, y) = (index % size, index / size);
                let of_chart = |t: &u32| *t != u32::MAX && self.charts[*t as usize] == chart;
                let candidates = self.around((x, y)).map(|index| own[index]).filter(of_chart);
                let source = &mut sources[index];
                *source = self.nearest_surface((x, y), candidates.chain([*source])).unwrap_or(*source);
            }
        }
        sources
    }

    /// Indices of the page's texels at most [`NEAR`] texels from (x, y) along each axis.
    fn around(&self, (x, y): (usize, usize)) -> impl Iterator<Item = usize> + use<> {
        let size = self.size;
        let span = move |c: usize| c.saturating_sub(NEAR)..(c + NEAR + 1).min(size);
        span(y).flat_map(move |y| span(x).map(move |x| y * size + x))
    }

    /// Of `candidates` the one with the surface that counts nearest to the centre of texel (x, y): beside a wall it is not
    /// the nearest texel that matters but the nearer face of the wall.
    fn nearest_surface(&self, (x, y): (usize, usize), candidates: impl Iterator<Item = u32>) -> Option<u32> {
        let centre = Vec2::new(x as f32, y as f32) + 0.5;
        let distance = |t: u32| {
            let index = self.texels[t as usize].index as usize;
            let corner = Vec2::new((index % self.size) as f32, (index / self.size) as f32);
            let to_square = |lo: Vec2, side: f32| centre.distance_squared(centre.clamp(lo, lo + side));
            match self.part(t as usize) {
                WHOLE => to_square(corner, 1.0),
                part => set_bits(part)
                    .map(|cell| Vec2::new((cell % CELLS) as f32, (cell / CELLS) as f32) / CELLS as f32)
                    .map(|cell| to_square(corner + cell, 1.0 / CELLS as f32))
                    .fold(f32::INFINITY, f32::min),
            }
        };
        candidates.map(|t| (distance(t), t)).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, t)| t)
    }
}

/// A rectangle of texels, `hi` outside it.
struct Bounds {
    lo: (usize, usize),
    hi: (usize, usize),
}

impl Bounds {
    const EMPTY: Bounds = Bounds { lo: (usize::MAX, usize::MAX), hi: (0, 0) };

    fn add(&mut self, (x, y): (usize, usize)) {
        self.lo = (self.lo.0.min(x), self.lo.1.min(y));
        self.hi = (self.hi.0.max(x + 1), self.hi.1.max(y + 1));
    }
}

/// For every cell of a grid, `[y · width + x]`, the value of the nearest one that has any (that is not `u32::MAX`).
///
/// Exact Euclidean distances in two passes (Felzenszwalb and Huttenlocher, *Distance Transforms of Sampled Functions*,
/// 2012).
fn nearest(width: usize, height: usize, value: &dyn Fn(usize, usize) -> u32) -> Vec<u32> {
    // Along each column: the nearest row with a value.
    const NONE: usize = usize::MAX;
    let mut nearest_row = vec![NONE; width * height];
    for x in 0..width {
        let mut above = NONE;
        for y in 0..height {
            above = if value(x, y) != u32::MAX { y } else { above };
            nearest_row[y * width + x] = above;
        }
        let mut below = NONE;
        for y in (0..height).rev() {
            below = if value(x, y) != u32::MAX { y } else { below };
            let above = nearest_row[y * width + x];
            if above == NONE || below != NONE && below - y < y - above {
                nearest_row[y * width + x] = below;
            }
        }
    }
    // Along each row: the lower envelope of the parabolas (x − i)² + (distance along column i)².
    let mut nearest = vec![u32::MAX; width * height];
    let mut envelope: Vec<(usize, f64)> = Vec::with_capacity(width);
    for y in 0..height {
        let parabola = |x: usize| (nearest_row[y * width + x] as f64 - y as f64).powi(2) + (x * x) as f64;
        envelope.clear();
        for x in (0..width).filter(|&x| nearest_row[y * width + x] != NONE) {
            // Where this parabola falls below the last one of the envelope.
            let mut from = f64::NEG_INFINITY;
            while let Some(&(last, last_from)) = envelope.last() {
                from = (parabola(x) - parabola(last)) / (2 * (x - last)) as f64;
                if from > last_from {
                    break;
                }
                envelope.pop();
                from = f64::NEG_INFINITY;
            }
            envelope.push((x, from));
        }
        let mut piece = 0;
        for x in 0..width {
            while piece + 1 < envelope.len() && envelope[piece + 1].1 < x as f64 {
                piece += 1;
            }
            if let Some(&(column, _)) = envelope.get(piece) {
                nearest[y * width + x] = value(column, nearest_row[y * width + column]);
            }
        }
    }
    nearest
}
