//! Tabulated sample points: what a ray costs before it is traced.
//!
//! A few Owen-scrambled Sobol sets are tabulated once; each texel takes one of them and moves it by a random digital shift
//! (exclusive or of the bits), which keeps its net structure and makes every point uniform (Friedel and Keller, *Fast
//! Generation of Randomized Low-Discrepancy Point Sets*, 2002).

use crate::math::sampler::{Sampler, mix64};

/// Sets that texels choose from, so that neighbours do not share one.
const SETS: usize = 16;

/// Names the tables' random numbers.
const TABLE_STREAM: u64 = 0x7461_626c_6573;

/// Names the numbers that follow a point.
const FOLLOWING_STREAM: u64 = 0x666f_6c6c_6f77;

/// SETS times `count` points of the unit hypercube, as 32-bit fractions.
pub struct SampleTable {
    points: Vec<[u32; 4]>,
    count: usize,
}

/// The points of one texel.
pub struct Samples<'t> {
    points: &'t [[u32; 4]],
    shift: [u32; 4],
    key: u64,
}

impl SampleTable {
    pub fn new(seed: u64, count: u32) -> Self {
        let fraction = |u: f32| (u as f64 * 4_294_967_296.0) as u32;
        let of_set =
            |set: u64| (0..count).map(move |i| Sampler::new(seed, TABLE_STREAM + set, i).next_4d().map(fraction));
        Self { points: (0..SETS as u64).flat_map(of_set).collect(), count: count as usize }
    }

    /// Bytes of a table of `count` points a set.
    pub fn bytes(count: usize) -> usize {
        SETS * count * size_of::<[u32; 4]>()
    }

    /// Points a set.
    pub fn count(&self) -> usize {
        self.count
    }

    /// The points of the stream (a texel, a patch) `stream` of the run that `seed` names.
    pub fn of(&self, seed: u64, stream: u64) -> Samples<'_> {
        let key = mix64(mix64(seed) ^ stream);
        let (a, b) = (mix64(key ^ 1), mix64(key ^ 2));
        let set = (key % SETS as u64) as usize;
        Samples {
            points: &self.points[set * self.count..(set + 1) * self.count],
            shift: [a as u32, (a >> 32) as u32, b as u32, (b >> 32) as u32],
            key,
        }
    }
}

impl Samples<'_> {
    /// Point `i`, each coordinate in [0, 1).
    #[inline]
    pub fn point(&self, i: usize) -> [f32; 4] {
        let p = &self.points[i];
        std::array::from_fn(|d| unit(p[d] ^ self.shift[d]))
    }

    /// A generator for all that follows point `i` after its bounce `bounce`.
    pub fn sampler(&self, i: usize, bounce: u32) -> Sampler {
        Sampler::new(self.key, FOLLOWING_STREAM + bounce as u64, i as u32)
    }

    /// Four more numbers for point `i` after its bounce `bounce`, each in [0, 1), independent of it and of each other.
    #[inline]
    pub fn following(&self, i: usize, bounce: u32) -> [f32; 4] {
        let a = mix64(self.key ^ (i as u64) << 32 ^ (bounce as u64) << 8 ^ 3);
        let b = mix64(a);
        [a as u32, (a >> 32) as u32, b as u32, (b >> 32) as u32].map(unit)
    }
}

/// The upper 24 bits as a fraction.
#[inline]
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
            for d in 0..4 {
                let mut cells = [0; 64];
                (0..64).for_each(|i| cells[(samples.point(i)[d] * 64.0) as usize] += 1);
                assert_eq!(cells, [1; 64], "stream {stream}, dimension {d}");
            }
        }
        assert_ne!(table.of(7, 1).point(0), table.of(7, 2).point(0));
        assert_ne!(table.of(7, 1).point(0), table.of(8, 1).point(0));
    }

    /// Each point is uniform over streams: mean 1/2 with variance 1/(12 n).
    #[test]
    fn points_are_uniform_over_streams() {
        let table = SampleTable::new(1, 4);
        let n = 20_000;
        let mut means = [0f64; 8];
        for stream in 0..n {
            let samples = table.of(3, stream);
            let values = samples.point(2).into_iter().chain(samples.following(2, 1));
            means.iter_mut().zip(values).for_each(|(mean, v)| *mean += v as f64 / n as f64);
        }
        let sigma = (1.0 / (12.0 * n as f64)).sqrt();
        assert!(means.iter().all(|m| (m - 0.5).abs() < 4.5 * sigma), "{means:?}");
        assert!((means[0] + 0.01 - 0.5).abs() > 4.5 * sigma, "a shift by 0.01 would be told");
    }
}
