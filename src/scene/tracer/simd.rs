//! Eight floats side by side: one AVX register, or an array of eight that the compiler makes what it can of.
//!
//! Written by hand because comparisons must become bit masks, for which the compiler finds no short way, and because the
//! loops of a traversal are too small for it to vectorise reliably.

/// Floats in an [`F32x8`]: the children of a node, the triangles of a block.
pub const WIDTH: usize = 8;

pub use lanes::F32x8;
#[cfg(not(all(target_arch = "x86_64", target_feature = "avx512f")))]
pub use lanes::Mask;

#[cfg(all(target_arch = "x86_64", target_feature = "avx2", target_feature = "fma"))]
mod lanes {
    use std::arch::x86_64::*;
    use std::ops::{Add, Div, Mul, Sub};

    use super::WIDTH;

    #[derive(Clone, Copy)]
    pub struct F32x8(__m256);

    // SAFETY, of every block below: this module is compiled only where the whole program is built for a processor with AVX
    // and FMA, which is all that the intrinsics ask for; loads and stores go through references to eight floats.
    impl F32x8 {
        #[inline(always)]
        pub fn load(from: &[f32; WIDTH]) -> Self {
            Self(unsafe { _mm256_loadu_ps(from.as_ptr()) })
        }

        #[inline(always)]
        pub fn splat(value: f32) -> Self {
            Self(unsafe { _mm256_set1_ps(value) })
        }

        /// Lane i of the result is lane `lanes[i]` of this, all below WIDTH.
        #[inline(always)]
        pub fn pick(self, lanes: &[u8; WIDTH]) -> Self {
            unsafe {
                let lanes = _mm256_cvtepu8_epi32(_mm_loadl_epi64(lanes.as_ptr().cast()));
                Self(_mm256_permutevar8x32_ps(self.0, lanes))
            }
        }

        #[inline(always)]
        pub fn to_array(self) -> [f32; WIDTH] {
            let mut array = [0.0; WIDTH];
            unsafe { _mm256_storeu_ps(array.as_mut_ptr(), self.0) };
            array
        }

        /// `self` · `a` + `b`, rounded once.
        #[inline(always)]
        pub fn mul_add(self, a: Self, b: Self) -> Self {
            Self(unsafe { _mm256_fmadd_ps(self.0, a.0, b.0) })
        }

        /// `b` − `self` · `a`, rounded once.
        #[inline(always)]
        pub fn neg_mul_add(self, a: Self, b: Self) -> Self {
            Self(unsafe { _mm256_fnmadd_ps(self.0, a.0, b.0) })
        }

        /// `self` · `a` − `b`, rounded once.
        #[inline(always)]
        pub fn mul_sub(self, a: Self, b: Self) -> Self {
            Self(unsafe { _mm256_fmsub_ps(self.0, a.0, b.0) })
        }

        #[inline(always)]
        pub fn min(self, other: Self) -> Self {
            Self(unsafe { _mm256_min_ps(self.0, other.0) })
        }

        #[inline(always)]
        pub fn max(self, other: Self) -> Self {
            Self(unsafe { _mm256_max_ps(self.0, other.0) })
        }

        /// `a` · `b` − `c` · `d`, of the right sign, and zero only where it is (Kahan; Jeannerod, Louvet, Muller, *Further
        /// Analysis of Kahan's Algorithm for the Accurate Computation of 2 × 2 Determinants*, 2013).
        #[inline(always)]
        pub fn determinant(a: Self, b: Self, c: Self, d: Self) -> Self {
            let product = c * d;
            let error = c.mul_sub(d, product);
            a.mul_sub(b, product) - error
        }

        /// Bit i is set where lane i is at most the other's.
        #[inline(always)]
        pub fn at_most(self, other: Self) -> u32 {
            unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(self.0, other.0)) as u32 }
        }

        /// Bit i is set where lane i is below the other's.
        #[inline(always)]
        pub fn below(self, other: Self) -> u32 {
            unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0)) as u32 }
        }

        /// Changes the sign of the lanes where that of `signs` is set.
        #[inline(always)]
        pub fn negate_where_negative(self, signs: Self) -> Self {
            unsafe { Self(_mm256_xor_ps(self.0, _mm256_and_ps(signs.0, _mm256_set1_ps(-0.0)))) }
        }
    }

    /// Lanes for which something holds.
    #[derive(Clone, Copy)]
    #[cfg_attr(target_feature = "avx512f", allow(dead_code, reason = "F32x16 needs them where it is a pair"))]
    pub struct Mask(__m256);

    #[cfg_attr(target_feature = "avx512f", allow(dead_code, reason = "F32x16 needs them where it is a pair"))]
    impl Mask {
        #[inline(always)]
        pub fn and(self, other: Self) -> Self {
            Self(unsafe { _mm256_and_ps(self.0, other.0) })
        }

        #[inline(always)]
        pub fn bits(self) -> u32 {
            unsafe { _mm256_movemask_ps(self.0) as u32 }
        }
    }

    #[cfg_attr(target_feature = "avx512f", allow(dead_code, reason = "F32x16 needs them where it is a pair"))]
    impl F32x8 {
        #[inline(always)]
        pub fn abs(self) -> Self {
            Self(unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0) })
        }

        /// The smallest lane; none is NaN.
        #[inline(always)]
        pub fn least(self) -> f32 {
            unsafe {
                let four = _mm_min_ps(_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0));
                let two = _mm_min_ps(four, _mm_movehl_ps(four, four));
                _mm_cvtss_f32(_mm_min_ss(two, _mm_movehdup_ps(two)))
            }
        }

        /// The lanes that are at most the other's.
        #[inline(always)]
        pub fn lanes_at_most(self, other: Self) -> Mask {
            Mask(unsafe { _mm256_cmp_ps::<_CMP_LE_OQ>(self.0, other.0) })
        }

        /// The lanes that are below the other's.
        #[inline(always)]
        pub fn lanes_below(self, other: Self) -> Mask {
            Mask(unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0) })
        }

        /// This, but `other` in the lanes of `mask`.
        #[inline(always)]
        pub fn replace(self, other: Self, mask: Mask) -> Self {
            Self(unsafe { _mm256_blendv_ps(self.0, other.0, mask.0) })
        }
    }

    impl Add for F32x8 {
        type Output = Self;
        #[inline(always)]
        fn add(self, other: Self) -> Self {
            Self(unsafe { _mm256_add_ps(self.0, other.0) })
        }
    }

    impl Sub for F32x8 {
        type Output = Self;
        #[inline(always)]
        fn sub(self, other: Self) -> Self {
            Self(unsafe { _mm256_sub_ps(self.0, other.0) })
        }
    }

    impl Mul for F32x8 {
        type Output = Self;
        #[inline(always)]
        fn mul(self, other: Self) -> Self {
            Self(unsafe { _mm256_mul_ps(self.0, other.0) })
        }
    }

    impl Div for F32x8 {
        type Output = Self;
        #[inline(always)]
        fn div(self, other: Self) -> Self {
            Self(unsafe { _mm256_div_ps(self.0, other.0) })
        }
    }
}

/// The same without AVX and FMA; what is rounded once there is rounded twice here.
#[cfg(not(all(target_arch = "x86_64", target_feature = "avx2", target_feature = "fma")))]
mod lanes {
    use std::array::from_fn;
    use std::ops::{Add, Div, Mul, Sub};

    use super::WIDTH;

    #[derive(Clone, Copy)]
    pub struct F32x8([f32; WIDTH]);

    #[derive(Clone, Copy)]
    pub struct Mask([bool; WIDTH]);

    impl Mask {
        #[inline(always)]
        pub fn and(self, other: Self) -> Self {
            Self(from_fn(|i| self.0[i] & other.0[i]))
        }

        #[inline(always)]
        pub fn bits(self) -> u32 {
            (0..WIDTH).fold(0, |bits, i| bits | u32::from(self.0[i]) << i)
        }
    }

    impl F32x8 {
        #[inline(always)]
        pub fn load(from: &[f32; WIDTH]) -> Self {
            Self(*from)
        }

        #[inline(always)]
        pub fn splat(value: f32) -> Self {
            Self([value; WIDTH])
        }

        #[inline(always)]
        pub fn pick(self, lanes: &[u8; WIDTH]) -> Self {
            Self(lanes.map(|lane| self.0[usize::from(lane) % WIDTH]))
        }

        #[inline(always)]
        pub fn to_array(self) -> [f32; WIDTH] {
            self.0
        }

        #[inline(always)]
        pub fn mul_add(self, a: Self, b: Self) -> Self {
            self * a + b
        }

        #[inline(always)]
        pub fn neg_mul_add(self, a: Self, b: Self) -> Self {
            b - self * a
        }

        #[inline(always)]
        pub fn mul_sub(self, a: Self, b: Self) -> Self {
            self * a - b
        }

        #[inline(always)]
        pub fn min(self, other: Self) -> Self {
            Self(from_fn(|i| if self.0[i] < other.0[i] { self.0[i] } else { other.0[i] }))
        }

        #[inline(always)]
        pub fn max(self, other: Self) -> Self {
            Self(from_fn(|i| if self.0[i] > other.0[i] { self.0[i] } else { other.0[i] }))
        }

        #[inline(always)]
        pub fn determinant(a: Self, b: Self, c: Self, d: Self) -> Self {
            // Exact products; their difference is rounded to the right sign.
            let exact = |i: usize| f64::from(a.0[i]) * f64::from(b.0[i]) - f64::from(c.0[i]) * f64::from(d.0[i]);
            Self(from_fn(|i| exact(i) as f32))
        }

        #[inline(always)]
        pub fn abs(self) -> Self {
            Self(self.0.map(f32::abs))
        }

        #[inline(always)]
        pub fn least(self) -> f32 {
            self.0.into_iter().reduce(f32::min).unwrap_or(f32::INFINITY)
        }

        #[inline(always)]
        pub fn lanes_at_most(self, other: Self) -> Mask {
            Mask(from_fn(|i| self.0[i] <= other.0[i]))
        }

        #[inline(always)]
        pub fn lanes_below(self, other: Self) -> Mask {
            Mask(from_fn(|i| self.0[i] < other.0[i]))
        }

        #[inline(always)]
        pub fn replace(self, other: Self, mask: Mask) -> Self {
            Self(from_fn(|i| if mask.0[i] { other.0[i] } else { self.0[i] }))
        }

        #[inline(always)]
        pub fn at_most(self, other: Self) -> u32 {
            self.lanes_at_most(other).bits()
        }

        #[inline(always)]
        pub fn below(self, other: Self) -> u32 {
            self.lanes_below(other).bits()
        }

        #[inline(always)]
        pub fn negate_where_negative(self, signs: Self) -> Self {
            Self(from_fn(|i| if signs.0[i].is_sign_negative() { -self.0[i] } else { self.0[i] }))
        }
    }

    impl Add for F32x8 {
        type Output = Self;
        #[inline(always)]
        fn add(self, other: Self) -> Self {
            Self(from_fn(|i| self.0[i] + other.0[i]))
        }
    }

    impl Sub for F32x8 {
        type Output = Self;
        #[inline(always)]
        fn sub(self, other: Self) -> Self {
            Self(from_fn(|i| self.0[i] - other.0[i]))
        }
    }

    impl Mul for F32x8 {
        type Output = Self;
        #[inline(always)]
        fn mul(self, other: Self) -> Self {
            Self(from_fn(|i| self.0[i] * other.0[i]))
        }
    }

    impl Div for F32x8 {
        type Output = Self;
        #[inline(always)]
        fn div(self, other: Self) -> Self {
            Self(from_fn(|i| self.0[i] / other.0[i]))
        }
    }
}

/// Asks for `BYTES` at an address ahead of their use: trees do not fit the caches, and their nodes lie where nothing foresees
/// them.
#[inline(always)]
pub fn prefetch<const BYTES: usize>(address: *const u8) {
    #[cfg(all(target_arch = "x86_64", target_feature = "sse"))]
    for line in 0..BYTES.div_ceil(64) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch reads nothing, wherever it points.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(address.wrapping_add(64 * line).cast()) };
    }
    #[cfg(not(all(target_arch = "x86_64", target_feature = "sse")))]
    let _ = address;
}
