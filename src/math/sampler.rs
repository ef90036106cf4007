//! The sample generator: randomness is a function of (seed, stream, sample, dimension) alone, so that results do not
//! depend on the number of threads or on how the work was cut.
//!
//! Owen-scrambled Sobol points (Burley, *Practical Hash-based Owen Scrambling*, 2020), four dimensions at a time.

/// Draws the dimensions of one sample in order.
#[derive(Clone, Debug)]
pub struct Sampler {
    seed: u32,
    sample: u32,
    dimension_set: u32,
}

/// Sobol points repeat beyond this many samples; later samples continue under another scramble.
const SAMPLES_PER_SCRAMBLE: u32 = 1 << 16;

impl Sampler {
    /// The generator of `sample` in `stream` (a texel, a pixel, a light) of the run that `seed` names.
    pub fn new(seed: u64, stream: u64, sample: u32) -> Self {
        let scramble = mix64(mix64(seed) ^ stream ^ ((sample / SAMPLES_PER_SCRAMBLE) as u64) << 48);
        Self { seed: (scramble ^ (scramble >> 32)) as u32, sample: sample % SAMPLES_PER_SCRAMBLE, dimension_set: 0 }
    }

    /// A generator for choices beside the path, such as samples of lights, at the place where this one stands. Its numbers
    /// have no part in this one's, nor in those of another `purpose`: the path stays the same whatever is drawn beside it.
    pub fn aside(&self, purpose: u32) -> Self {
        // Another seed has other, independent points.
        Self { seed: self.seed ^ (purpose + 1).wrapping_mul(0x6a09_e667), ..*self }
    }

    /// The next four dimensions, each in [0, 1).
    #[inline]
    pub fn next_4d(&mut self) -> [f32; 4] {
        // Beyond the tabulated dimensions the points go on under another scramble, that is, padded.
        let padding = self.dimension_set / sobol_burley::NUM_DIMENSION_SETS_4D;
        let set = self.dimension_set % sobol_burley::NUM_DIMENSION_SETS_4D;
        self.dimension_set += 1;
        sobol_burley::sample_4d(self.sample, set, self.seed ^ padding.wrapping_mul(0x9e37_79b9))
    }
}

/// A bijection of 64-bit words that spreads each bit over all (Stafford's variant 13 of the MurmurHash3 finaliser).
pub fn mix64(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `count` samples of one dimension in one stream.
    fn column(seed: u64, stream: u64, dimension: usize, count: u32) -> Vec<f32> {
        let value = |sample| {
            let mut sampler = Sampler::new(seed, stream, sample);
            (0..dimension / 4).for_each(|_| _ = sampler.next_4d());
            sampler.next_4d()[dimension % 4]
        };
        (0..count).map(value).collect()
    }

    /// Whether each of `values.len()` equal intervals holds exactly one of the values: a (0, m, 1)-net in base 2.
    fn is_net(values: &[f32]) -> bool {
        let mut cells = vec![0; values.len()];
        values.iter().for_each(|&v| cells[(v * values.len() as f32) as usize] += 1);
        cells.iter().all(|&n| n == 1)
    }

    /// Owen scrambling keeps what makes Sobol points good: each dimension of the first 2^m samples is a net.
    #[test]
    fn each_dimension_is_evenly_spread() {
        // Beyond 256 sets of four, dimensions are padded; they are nets, too.
        for dimension in (0..40).chain([1023, 1024, 1027, 2050]) {
            for count in [1, 16, 256, 1024] {
                let values = column(3, 17, dimension, count);
                assert!(values.iter().all(|v| (0.0..1.0).contains(v)));
                assert!(is_net(&values), "dimension {dimension}, {count} samples");
            }
        }
        // Control: one value moved to where another one is.
        let mut values = column(3, 17, 0, 256);
        values[9] = values[8];
        assert!(!is_net(&values));
    }

    #[test]
    fn a_sample_is_a_function_of_seed_stream_and_number() {
        let draw = |seed, stream, sample| Sampler::new(seed, stream, sample).next_4d();
        assert_eq!(draw(1, 2, 3), draw(1, 2, 3));
        for other in [draw(2, 2, 3), draw(1, 3, 3), draw(1, 2, 4), draw(1, 2, 3 + SAMPLES_PER_SCRAMBLE)] {
            assert_ne!(draw(1, 2, 3), other);
        }
    }

    #[test]
    fn what_is_drawn_aside_leaves_the_rest_as_it_is() {
        let (mut plain, mut beside) = (Sampler::new(1, 2, 3), Sampler::new(1, 2, 3));
        plain.next_4d();
        beside.next_4d();
        let (a, b) = (beside.aside(0).next_4d(), beside.aside(1).next_4d());
        assert_ne!(a, b);
        let next = plain.next_4d();
        assert_eq!(beside.next_4d(), next);
        assert!(next != a && next != b);
        assert_ne!(beside.aside(0).next_4d(), a);
    }

    /// Pearson's correlation of independent uniform samples has variance 1/n; the mean over m pairs of streams 1/(n m).
    #[test]
    fn streams_seeds_and_dimensions_are_independent() {
        let correlation = |a: &[f32], b: &[f32]| {
            let product = |(&a, &b): (&f32, &f32)| (a as f64 - 0.5) * (b as f64 - 0.5);
            a.iter().zip(b).map(product).sum::<f64>() * 12.0 / a.len() as f64
        };
        const N: u32 = 64;
        const PAIRS: u64 = 1000;
        let mean_of = |pair: &dyn Fn(u64) -> (Vec<f32>, Vec<f32>)| {
            (0..PAIRS).map(pair).map(|(a, b)| correlation(&a, &b)).sum::<f64>() / PAIRS as f64
        };
        // Stratified samples correlate no more than independent ones; four sigmas of these.
        let tolerance = 4.0 / (N as f64 * PAIRS as f64).sqrt();
        type Pair = dyn Fn(u64) -> (Vec<f32>, Vec<f32>);
        let pairs: [(&str, &Pair); 6] = [
            ("neighbouring streams", &|k| (column(1, k, 0, N), column(1, k + 1, 0, N))),
            ("neighbouring seeds", &|k| (column(k, 5, 1, N), column(k + 1, 5, 1, N))),
            ("dimensions of one set", &|k| (column(1, k, 0, N), column(1, k, 1, N))),
            ("dimensions of two sets", &|k| (column(1, k, 2, N), column(1, k, 6, N))),
            ("what is drawn aside", &|k| {
                let aside = |sample| Sampler::new(1, k, sample).aside(0).next_4d()[0];
                (column(1, k, 0, N), (0..N).map(aside).collect())
            }),
            ("two things drawn aside", &|k| {
                let aside = |purpose| (0..N).map(|s| Sampler::new(1, k, s).aside(purpose).next_4d()[0]).collect();
                (aside(0), aside(1))
            }),
        ];
        for (what, pair) in pairs {
            let mean = mean_of(pair);
            assert!(mean.abs() < tolerance, "{what}: {mean}");
        }
        let control = mean_of(&|k| (column(1, k, 0, N), column(1, k, 0, N)));
        assert!(control > 0.9, "a stream correlates with itself: {control}");
    }
}
