//! Tabulated sample points: what a ray costs before it is traced.
//!
//! A few Owen-scrambled Sobol sets are tabulated once; each texel takes one of them and moves it by a random digital shift
//! (exclusive or of the bits), which keeps its net structure and makes every point uniform (Friedel and Keller, *Fast
//! Generation of Randomized Low-Discrepancy Point Sets*, 2002).

use crate::math::LANES;
use crate::math::sampler::{Sampler, mix64};

/// Sets that texels choose from, so that neighbours do not share one.
const SETS: usize = 16;

/// Names the tables' random numbers.
const TABLE_STREAM: u64 = 0x7461_626c_6573;

/// Names the numbers that follow a point.
const FOLLOWING_STREAM: u64 = 0x666f_6c6c_6f77;

/// Dimensions of a point: the direction of the ray, the point that it leaves from, and four for what it meets first.
pub const DIMENSIONS: usize = 8;

/// SETS times `count` points of the unit hypercube, as 32-bit fractions.
pub struct SampleTable {
    /// `[set][point / LANES][dimension][point % LANES]`.
    points: Vec<Points>,
    count: usize,
}

type Points = [[u32; LANES]; DIMENSIONS];

/// The points of one texel.
#[derive(Clone, Copy)]
pub struct Samples<'t> {
    points: &'t [Points],
    shift: [u32; DIMENSIONS],
    key: u64,
}

impl SampleTable {
    pub fn new(seed: u64, count: u32) -> Self {
        let blocks = (count as usize).div_ceil(LANES);
        let mut points = vec![[[0; LANES]; DIMENSIONS]; SETS * blocks];
        for (set, i) in (0..SETS).flat_map(|set| (0..count as usize).map(move |i| (set, i))) {
            let mut sampler = Sampler::new(seed, TABLE_STREAM + set as u64, i as u32);
            let coordinates = [sampler.next_4d(), sampler.next_4d()].concat();
            for (d, u) in coordinates.into_iter().enumerate() {
                points[set * blocks + i / LANES][d][i % LANES] = (u as f64 * 4_294_967_296.0) as u32;
            }
        }
        Self { points, count: count as usize }
    }

    /// Bytes of a table of `count` points a set.
    pub fn bytes(count: usize) -> usize {
        SETS * count.next_multiple_of(LANES) * DIMENSIONS * size_of::<u32>()
    }

    /// Points a set.
    pub fn count(&self) -> usize {
        self.count
    }

    /// The points of the stream (a texel, a patch) `stream` of the run that `seed` names.
    pub fn of(&self, seed: u64, stream: u64) -> Samples<'_> {
        let key = mix64(mix64(seed) ^ stream);
        let set = (key % SETS as u64) as usize;
        let blocks = self.count.div_ceil(LANES);
        let mut shift = [0; DIMENSIONS];
        for (d, two) in shift.as_chunks_mut::<2>().0.iter_mut().enumerate() {
            let random = mix64(key ^ (d as u64 + 1));
            *two = [random as u32, (random >> 32) as u32];
        }
        Samples { points: &self.points[set * blocks..(set + 1) * blocks], shift, key }
    }
}

impl Samples<'_> {
    /// Points `block` · LANES and the following, `[dimension][lane]`, each coordinate in [0, 1).
    #[inline(always)]
    pub fn points(&self, block: usize) -> [[f32; LANES]; DIMENSIONS] {
        let (points, shift) = (&self.points[block], &self.shift);
        let of = |d: usize| shifted(&points[d], shift[d]);
        [of(0), of(1), of(2), of(3), of(4), of(5), of(6), of(7)]
    }

    /// A generator for all that follows point `i` after its bounce `bounce`.
    pub fn sampler(&self, i: usize, bounce: u32) -> Sampler {
        Sampler::new(self.key, FOLLOWING_STREAM + bounce as u64, i as u32)
    }

    /// Four more numbers for point `i` after its bounce `bounce`, each in [0, 1), independent of it and of each other.
    #[inline]
    pub fn following(&self, i: usize, bounce: u32) -> [f32; 4] {
        let a = mix64(self.key ^ (i as u64) << 32 ^ (bounce as u64) << 8 ^ 0xff);
        let b = mix64(a);
        [a as u32, (a >> 32) as u32, b as u32, (b >> 32) as u32].map(unit)
    }
}

/// One at a time: over two loops the compiler would scatter.
#[inline(always)]
fn shifted(points: &[u32; LANES], shift: u32) -> [f32; LANES] {
    let mut units = [0.0; LANES];
    for i in 0..LANES {
        units[i] = unit(points[i] ^ shift);
    }
    units
}

/// The upper 24 bits as a fraction.
#[inline(always)]
fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Any 2^m equal intervals of each coordinate hold one of 2^m points; shifted or not.
    #[test]
    fn shifted_points_stay_nets() {
        let table = SampleTable::new(1, 64);
        for stream in 0..40 {
            let samples = table.of(7, stream);
            for d in 0..DIMENSIONS {
                let mut cells = [0; 64];
                (0..4).flat_map(|block| samples.points(block)[d]).for_each(|u| cells[(u * 64.0) as usize] += 1);
                assert_eq!(cells, [1; 64], "stream {stream}, dimension {d}");
            }
        }
        assert_ne!(table.of(7, 1).points(0), table.of(7, 2).points(0));
        assert_ne!(table.of(7, 1).points(0), table.of(8, 1).points(0));
    }

    /// Each point is uniform over streams: mean 1/2 with variance 1/(12 n).
    #[test]
    fn points_are_uniform_over_streams() {
        let table = SampleTable::new(1, 4);
        let n = 20_000;
        let mut means = [0f64; DIMENSIONS + 4];
        for stream in 0..n {
            let samples = table.of(3, stream);
            let values = samples.points(0).into_iter().map(|u| u[2]).chain(samples.following(2, 1));
            means.iter_mut().zip(values).for_each(|(mean, v)| *mean += v as f64 / n as f64);
        }
        let sigma = (1.0 / (12.0 * n as f64)).sqrt();
        assert!(means.iter().all(|m| (m - 0.5).abs() < 4.5 * sigma), "{means:?}");
        assert!((means[0] + 0.01 - 0.5).abs() > 4.5 * sigma, "a shift by 0.01 would be told");
    }
}
