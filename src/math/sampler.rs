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
