//! Denoising by the geometry alone: each texel becomes a mean over its neighbours on the same chart that face the same way
//! and lie in the same plane. One linear operator, so that it is applied to basis elements instead of N lightmaps.
//!
//! The weights are those of an edge-avoiding filter (Dammertz, Sewtz, Hanika, Lensch, *Edge-Avoiding À-Trous Wavelet
//! Transform for Fast Global Illumination Filtering*, 2010, its first level) without the one for colour, which would not be
//! linear.

use rayon::prelude::*;

use super::{Lightmap, Mesh, Spot};

/// The means, as a sparse matrix over a lightmap's texels.
pub(super) struct Denoise {
    /// Texel t has `entries[starts[t]..starts[t + 1]]`.
    starts: Vec<usize>,
    /// Texel and weight; the weights of a texel add up to 1.
    entries: Vec<(u32, f32)>,
}

/// Texels on each side that a mean takes in. Measured on three scenes at 128²: with 64 and 256 paths a texel it lowers the
/// error of each; two on each side make all three lightmaps worse with 256.
const RADIUS: i64 = 1;

/// Power of the cosine between two texels' normals: at 10° a neighbour counts a half, at 25° hardly.
const NORMAL_POWER: i32 = 45;

/// Distance from a texel's plane, relative to the distance between the texels, at which a neighbour counts 1/e.
const OFF_PLANE: f32 = 0.25;

impl Denoise {
    /// Means over squares of (2 [`RADIUS`] + 1)² texels under a tent.
    pub fn new(mesh: &Mesh, lightmap: &Lightmap) -> Self {
        let size = lightmap.size as i64;
        let mut own = vec![u32::MAX; lightmap.size * lightmap.size];
        lightmap.texels.iter().enumerate().for_each(|(t, texel)| own[texel.index as usize] = t as u32);
        let spots = lightmap.spots(mesh);
        let window = |d: i64| (1.0 - d.abs() as f32 / (RADIUS + 1) as f32).max(0.0);
        let charts = &lightmap.charts;
        let apart = |a: usize, b: usize| !charts.is_empty() && charts[a] != charts[b];
        let rows: Vec<Vec<(u32, f32)>> = (0..lightmap.texels.len())
            .into_par_iter()
            .map(|t| {
                let index = lightmap.texels[t].index as i64;
                let (x, y) = (index % size, index / size);
                let mut row = Vec::new();
                for dy in -RADIUS..=RADIUS {
                    for dx in -RADIUS..=RADIUS {
                        let inside = (0..size).contains(&(x + dx)) && (0..size).contains(&(y + dy));
                        let Some(other) = inside.then(|| own[((y + dy) * size + x + dx) as usize]) else { continue };
                        if other == u32::MAX || apart(other as usize, t) {
                            continue;
                        }
                        let weight = window(dx) * window(dy) * spots[t].likeness(&spots[other as usize]);
                        row.push((other, weight));
                    }
                }
                let sum: f32 = row.iter().map(|e| e.1).sum();
                row.iter_mut().for_each(|e| e.1 /= sum);
                row
            })
            .collect();
        let mut starts = vec![0];
        starts.extend(rows.iter().scan(0, |end, row| {
            *end += row.len();
            Some(*end)
        }));
        Self { starts, entries: rows.concat() }
    }

    /// The means of values per texel.
    pub fn apply(&self, values: &[f32]) -> Vec<f32> {
        let rows = self.starts.windows(2).map(|w| &self.entries[w[0]..w[1]]);
        rows.map(|row| row.iter().map(|&(t, w)| values[t as usize] * w).sum()).collect()
    }
}

impl Spot {
    /// How much of a neighbour's value holds here, from 0 to 1.
    fn likeness(&self, other: &Spot) -> f32 {
        let to = other.centre - self.centre;
        let distance = to.length();
        if distance == 0.0 {
            return 1.0;
        }
        let off = self.normal.dot(to).abs().max(other.normal.dot(to).abs()) / (OFF_PLANE * distance);
        let area = (other.area / self.area).min(1.0);
        self.normal.dot(other.normal).max(0.0).powi(NORMAL_POWER) * (-off * off).exp() * area
    }
}
