//! Light from all around, as a grid of texels in latitude and longitude. What is much brighter than the mean is sampled in
//! proportion to luminance; the rest is found by the paths that leave the scene, with which samples are combined (after
//! Karlík et al., *MIS Compensation: Optimizing Sampling Techniques in Multiple Importance Sampling*, 2019, who take as much
//! off the density; here a sample is spared, too, where little is left of it).
//!
//! Radiance is constant within a texel, and so is the sampling density: rows and then columns are drawn by inversion of
//! their cumulative distributions, and the place within a texel uniformly by solid angle (Pharr, Jakob, Humphreys,
//! *Physically Based Rendering*, 14.2.4, there with densities per area of the image).

use std::f32::consts::{FRAC_1_PI, PI, TAU};

use glam::{Vec2, Vec3};

use crate::math::Rgb;
use crate::math::colour::luminance;

/// Columns of the finest grid that is kept; finer images are averaged down to it, by solid angle.
pub const MOST_COLUMNS: usize = 1024;

/// Directional lights that stand for a map where light is measured: 2 to the power of six median cuts.
const CUTS: u32 = 6;

/// Light from all directions. Column 0 begins at +z; the middle is −z, then come +x and +z again.
#[derive(Clone, PartialEq)]
pub struct EnvironmentMap {
    width: usize,
    height: usize,
    texels: Vec<Texel>,
    /// With what probability a sample is drawn at all.
    share: f32,
    /// `rows[r]`: probability of the rows before r; one more than rows.
    rows: Vec<f32>,
    /// `columns[r · (width + 1) + c]`: probability of the columns before c within row r.
    columns: Vec<f32>,
    /// cos θ of the rows' upper edges, and −1.
    edges: Vec<f32>,
    facets: Vec<DistantFacet>,
}

/// Its size alone: what it holds would fill pages.
impl std::fmt::Debug for EnvironmentMap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "EnvironmentMap({} x {})", self.width, self.height)
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Texel {
    radiance: Rgb,
    /// Samples of a direction within it, per steradian: over the sphere they add up to the probability of a sample.
    pdf: f32,
}

/// A directional light that stands for a part of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DistantFacet {
    /// Unit vector towards it, before the map is turned.
    pub towards: Vec3,
    /// Irradiance of a surface that faces it.
    pub irradiance: Rgb,
}

/// A direction drawn from a map.
#[derive(Clone, Copy, Debug)]
pub struct EnvironmentSample {
    /// Unit vector towards the light, before the map is turned.
    pub towards: Vec3,
    pub radiance: Rgb,
    /// Samples per steradian there.
    pub pdf: f32,
}

/// Texels up to so many times as bright as the mean are found by paths alone.
const BRIGHT: f64 = 4.0;

impl EnvironmentMap {
    /// From radiance in rows from +y downwards.
    pub fn new(width: usize, height: usize, radiance: Vec<Rgb>) -> Self {
        assert_eq!(radiance.len(), width * height, "one colour a texel");
        let edges: Vec<f32> = (0..=height).map(|r| (PI as f64 * r as f64 / height as f64).cos() as f32).collect();
        let solid_angle = |row: usize| (edges[row] - edges[row + 1]) * TAU / width as f32;
        let of_row = |row: usize| radiance[row * width..][..width].iter().map(|&c| luminance(c) as f64);
        let mean = luminance(mean(width, &edges, radiance.iter().copied())) as f64;
        // A path that leaves a surface along its normal has a density of 1/π; with so many samples beside it, no texel
        // counts for more than one of BRIGHT times the mean.
        let samples =
            |luminance: f64| if mean > 0.0 { (luminance / (BRIGHT * mean) - 1.0).max(0.0) / PI as f64 } else { 0.0 };
        let mut columns = Vec::with_capacity((width + 1) * height);
        let mut row_weights = Vec::with_capacity(height);
        for row in 0..height {
            let weights: Vec<f64> = of_row(row).map(samples).collect();
            row_weights.push(weights.iter().sum::<f64>() * solid_angle(row) as f64);
            columns.extend(cumulative(&weights));
        }
        let rows = cumulative(&row_weights);
        let share = row_weights.iter().sum::<f64>().min(1.0) as f32;
        // Densities are those of the rounded distributions, so that what is drawn is what is stated.
        let texels = (0..width * height)
            .map(|i| {
                let (row, column) = (i / width, i % width);
                let at = row * (width + 1) + column;
                let probability = (columns[at + 1] - columns[at]) * (rows[row + 1] - rows[row]);
                Texel { radiance: radiance[i], pdf: share * (probability / solid_angle(row)) }
            })
            .collect();
        let mut map = Self { width, height, texels, share, rows, columns, edges, facets: Vec::new() };
        map.facets = map.cut();
        map
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn height(&self) -> usize {
        self.height
    }

    /// Nit, in rows from +y downwards.
    pub fn radiances(&self) -> impl Iterator<Item = Rgb> + '_ {
        self.texels.iter().map(|t| t.radiance)
    }

    /// Draws a direction among what is bright, or none: every texel is drawn as often as [`Self::look`] says.
    pub fn sample(&self, u: Vec2) -> Option<EnvironmentSample> {
        if u.x >= self.share {
            return None;
        }
        let (row, y) = invert(&self.rows, (u.x / self.share).min(1.0 - f32::EPSILON / 2.0));
        let first = row * (self.width + 1);
        let (column, x) = invert(&self.columns[first..=first + self.width], u.y);
        let cos = self.edges[row] + (self.edges[row + 1] - self.edges[row]) * y;
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let (sin_phi, cos_phi) = (TAU * ((column as f32 + x) / self.width as f32)).sin_cos();
        // Column 0 begins at +z, which φ counts from −z: hence the signs.
        let towards = Vec3::new(-sin * sin_phi, cos, sin * cos_phi);
        let texel = &self.texels[row * self.width + column];
        Some(EnvironmentSample { towards, radiance: texel.radiance, pdf: texel.pdf })
    }

    /// The row of all directions at this cos θ from +y.
    #[inline]
    pub fn row(&self, cos: f32) -> usize {
        let guess = ((cos.clamp(-1.0, 1.0).acos() * FRAC_1_PI * self.height as f32) as usize).min(self.height - 1);
        // What was drawn from a row is found in it, whatever the rounding.
        if cos > self.edges[guess] && guess > 0 {
            guess - 1
        } else if cos < self.edges[guess + 1] && guess + 1 < self.height {
            guess + 1
        } else {
            guess
        }
    }

    /// Radiance, and samples per steradian, in `row` at `turn` ∈ [0, 1) of its columns.
    #[inline]
    pub fn look_up(&self, row: usize, turn: f32) -> (Rgb, f32) {
        let column = ((turn * self.width as f32) as usize).min(self.width - 1);
        let texel = &self.texels[row * self.width + column];
        (texel.radiance, texel.pdf)
    }

    /// Radiance, and samples per steradian, in the direction `towards`, before the map is turned.
    pub fn look(&self, towards: Vec3) -> (Rgb, f32) {
        self.look_up(self.row(towards.y), turn(towards))
    }

    /// Irradiance of a surface with `normal`, before the map is turned: the sum over all texels.
    pub fn irradiance(&self, normal: Vec3) -> Rgb {
        let n = normal.as_dvec3();
        let mut sum = glam::DVec3::ZERO;
        for row in 0..self.height {
            for column in 0..self.width {
                let (direction, solid_angle) = self.centre(row, column);
                let cos = direction.dot(n).max(0.0);
                sum += self.texels[row * self.width + column].radiance.as_dvec3() * (cos * solid_angle);
            }
        }
        sum.as_vec3()
    }

    /// Mean radiance over the sphere.
    pub fn mean(&self) -> Rgb {
        mean(self.width, &self.edges, self.radiances())
    }

    /// The directional lights that stand for the map where light is measured.
    pub fn facets(&self) -> &[DistantFacet] {
        &self.facets
    }

    /// Direction of a texel's middle (by solid angle), and its solid angle.
    fn centre(&self, row: usize, column: usize) -> (glam::DVec3, f64) {
        let (top, bottom) = (self.edges[row] as f64, self.edges[row + 1] as f64);
        let cos = 0.5 * (top + bottom);
        let sin = (1.0 - cos * cos).sqrt();
        let step = std::f64::consts::TAU / self.width as f64;
        let (sin_phi, cos_phi) = (step * (column as f64 + 0.5)).sin_cos();
        (glam::DVec3::new(-sin * sin_phi, cos, sin * cos_phi), (top - bottom) * step)
    }

    /// Cuts the map into 2^CUTS rectangles of about the same power, each across its longer side (Debevec, *A Median Cut
    /// Algorithm for Light Probe Sampling*, 2005). A rectangle's light is its vector irradiance, with which a surface that
    /// sees all of it receives exactly its light.
    fn cut(&self) -> Vec<DistantFacet> {
        // Sums over the texels above and to the left.
        let stride = self.width + 1;
        let mut sums = vec![0f64; stride * (self.height + 1)];
        for row in 0..self.height {
            let solid_angle = (self.edges[row] - self.edges[row + 1]) as f64;
            let mut across = 0.0;
            for column in 0..self.width {
                across += luminance(self.texels[row * self.width + column].radiance) as f64 * solid_angle;
                sums[(row + 1) * stride + column + 1] = sums[row * stride + column + 1] + across;
            }
        }
        let power = |[top, bottom, left, right]: [usize; 4]| {
            sums[bottom * stride + right] + sums[top * stride + left]
                - sums[top * stride + right]
                - sums[bottom * stride + left]
        };
        let mut parts = vec![[0, self.height, 0, self.width]];
        for _ in 0..CUTS {
            parts = parts.into_iter().flat_map(|part| self.halves(part, &power)).collect();
        }
        parts.into_iter().filter_map(|part| self.facet(part)).collect()
    }

    fn halves(&self, part: [usize; 4], power: &dyn Fn([usize; 4]) -> f64) -> Vec<[usize; 4]> {
        let [top, bottom, left, right] = part;
        let middle = PI * (top + bottom) as f32 / (2 * self.height) as f32;
        let across = TAU * (right - left) as f32 / self.width as f32 * middle.sin();
        let down = PI * (bottom - top) as f32 / self.height as f32;
        let by_columns = (across > down || bottom - top == 1) && right - left > 1;
        if !by_columns && bottom - top == 1 {
            return vec![part];
        }
        let (first, last) = if by_columns { (left, right) } else { (top, bottom) };
        let split = |at: usize| match by_columns {
            true => ([top, bottom, left, at], [top, bottom, at, right]),
            false => ([top, at, left, right], [at, bottom, left, right]),
        };
        let half = 0.5 * power(part);
        let nearest = |&a: &usize, &b: &usize| {
            let off = |at: usize| (power(split(at).0) - half).abs();
            off(a).total_cmp(&off(b))
        };
        let at = (first + 1..last).min_by(nearest).unwrap_or(first + 1);
        let (one, other) = split(at);
        vec![one, other]
    }

    fn facet(&self, [top, bottom, left, right]: [usize; 4]) -> Option<DistantFacet> {
        let mut vectors = [glam::DVec3::ZERO; 3];
        for row in top..bottom {
            for column in left..right {
                let (direction, solid_angle) = self.centre(row, column);
                let radiance = self.texels[row * self.width + column].radiance;
                for channel in 0..3 {
                    vectors[channel] += direction * (radiance[channel] as f64 * solid_angle);
                }
            }
        }
        let [r, g, b] = vectors;
        let towards = (0.2126 * r + 0.7152 * g + 0.0722 * b).try_normalize()?;
        let irradiance = Vec3::from_array(vectors.map(|v| v.dot(towards).max(0.0) as f32));
        Some(DistantFacet { towards: towards.as_vec3(), irradiance })
    }
}

/// Mean over the sphere of texels in rows of `width`, whose upper edges, and −1, are at these cos θ.
fn mean(width: usize, edges: &[f32], mut texels: impl Iterator<Item = Rgb>) -> Rgb {
    let of_row =
        |edges: &[f32]| texels.by_ref().take(width).sum::<Rgb>() * ((edges[0] - edges[1]) / (2 * width) as f32);
    edges.windows(2).map(of_row).sum()
}

/// Where in a map's columns a direction lies, in [0, 1].
#[inline]
pub fn turn(towards: Vec3) -> f32 {
    let turn = 0.5 + towards.x.atan2(-towards.z) / TAU;
    turn.clamp(0.0, 1.0)
}

/// A direction of a map that is turned about +y by the angle of this sine and cosine.
#[inline]
pub fn turned(v: Vec3, [sin, cos]: [f32; 2]) -> Vec3 {
    Vec3::new(v.x * cos + v.z * sin, v.y, v.z * cos - v.x * sin)
}

/// Shares of the sum before each element, and 1; uniform where all are zero.
fn cumulative(weights: &[f64]) -> Vec<f32> {
    let total: f64 = weights.iter().sum();
    let (share, floor) = if total > 0.0 { (1.0 / total, 0.0) } else { (0.0, 1.0 / weights.len() as f64) };
    let mut sum = 0.0;
    let mut shares: Vec<f32> = vec![0.0];
    shares.extend(weights.iter().map(|w| {
        sum += w * share + floor;
        sum.min(1.0) as f32
    }));
    *shares.last_mut().expect("at least the first") = 1.0;
    shares
}

/// The interval of `cumulative` that holds u, and where in it, in [0, 1].
fn invert(cumulative: &[f32], u: f32) -> (usize, f32) {
    // The last share is 1 and u is under it, so that an interval of some width is found.
    let i = cumulative.partition_point(|&c| c <= u) - 1;
    let (low, high) = (cumulative[i], cumulative[i + 1]);
    (i, ((u - low) / (high - low)).clamp(0.0, 1.0))
}

/// Averages an image down to at most [`MOST_COLUMNS`] columns, by solid angle.
pub fn downsampled(width: usize, height: usize, pixels: Vec<Rgb>) -> EnvironmentMap {
    if width <= MOST_COLUMNS {
        return EnvironmentMap::new(width, height, pixels);
    }
    let (columns, rows) = (MOST_COLUMNS, MOST_COLUMNS / 2);
    let across = overlaps(width, columns);
    let mut texels = vec![glam::DVec3::ZERO; columns * rows];
    let mut weights = vec![0f64; rows];
    for (to, from, [top, bottom]) in overlaps(height, rows) {
        let band = (std::f64::consts::PI * top).cos() - (std::f64::consts::PI * bottom).cos();
        weights[to] += band;
        for &(column, source, [left, right]) in &across {
            let weight = band * (right - left) * columns as f64;
            texels[to * columns + column] += pixels[from * width + source].as_dvec3() * weight;
        }
    }
    let mean = |(i, sum): (usize, &glam::DVec3)| (*sum / weights[i / columns]).as_vec3();
    EnvironmentMap::new(columns, rows, texels.iter().enumerate().map(mean).collect())
}

/// The parts of the unit interval that belong to one cell of `to` and one of `from`: (to, from, ends).
fn overlaps(from: usize, to: usize) -> Vec<(usize, usize, [f64; 2])> {
    let mut parts = Vec::with_capacity(from + to);
    let (mut a, mut b, mut start) = (0, 0, 0.0);
    while a < from && b < to {
        // In units of 1 / (from · to), exact.
        let (end_a, end_b) = ((a + 1) * to, (b + 1) * from);
        let end = end_a.min(end_b) as f64 / (from * to) as f64;
        parts.push((b, a, [start, end]));
        start = end;
        (a, b) = (a + (end_a <= end_b) as usize, b + (end_b <= end_a) as usize);
    }
    parts
}
