//! LANES floats side by side: one AVX-512 register, or two of [`F32x8`](super::simd::F32x8), whose operations these are.

use glam::Vec3;

pub use lanes::F32x16;

#[cfg(all(target_arch = "x86_64", target_feature = "avx512f"))]
mod lanes {
    use std::arch::x86_64::*;
    use std::ops::{Add, Div, Mul, Sub};

    use crate::math::LANES;

    #[derive(Clone, Copy)]
    pub struct F32x16(__m512);

    /// Lanes for which something holds.
    #[derive(Clone, Copy)]
    pub struct Mask(__mmask16);

    impl Mask {
        #[inline(always)]
        pub fn and(self, other: Self) -> Self {
            Self(self.0 & other.0)
        }

        #[inline(always)]
        pub fn bits(self) -> u32 {
            u32::from(self.0)
        }
    }

    // SAFETY, of every block below: this module is compiled only where the whole program is built for a processor with AVX-512,
    // which is all that the intrinsics ask for; loads and stores go through references to LANES floats.
    impl F32x16 {
        #[inline(always)]
        pub fn load(from: &[f32; LANES]) -> Self {
            Self(unsafe { _mm512_loadu_ps(from.as_ptr()) })
        }

        #[inline(always)]
        pub fn splat(value: f32) -> Self {
            Self(unsafe { _mm512_set1_ps(value) })
        }

        #[inline(always)]
        pub fn to_array(self) -> [f32; LANES] {
            let mut array = [0.0; LANES];
            unsafe { _mm512_storeu_ps(array.as_mut_ptr(), self.0) };
            array
        }

        #[inline(always)]
        pub fn mul_add(self, a: Self, b: Self) -> Self {
            Self(unsafe { _mm512_fmadd_ps(self.0, a.0, b.0) })
        }

        #[inline(always)]
        pub fn neg_mul_add(self, a: Self, b: Self) -> Self {
            Self(unsafe { _mm512_fnmadd_ps(self.0, a.0, b.0) })
        }

        #[inline(always)]
        pub fn min(self, other: Self) -> Self {
            Self(unsafe { _mm512_min_ps(self.0, other.0) })
        }

        #[inline(always)]
        pub fn max(self, other: Self) -> Self {
            Self(unsafe { _mm512_max_ps(self.0, other.0) })
        }

        #[inline(always)]
        pub fn abs(self) -> Self {
            Self(unsafe { _mm512_abs_ps(self.0) })
        }

        #[inline(always)]
        pub fn least(self) -> f32 {
            unsafe { _mm512_reduce_min_ps(self.0) }
        }

        #[inline(always)]
        pub fn at_most(self, other: Self) -> Mask {
            Mask(unsafe { _mm512_cmp_ps_mask::<_CMP_LE_OQ>(self.0, other.0) })
        }

        #[inline(always)]
        pub fn below(self, other: Self) -> Mask {
            Mask(unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, other.0) })
        }

        #[inline(always)]
        pub fn replace(self, other: Self, mask: Mask) -> Self {
            Self(unsafe { _mm512_mask_blend_ps(mask.0, self.0, other.0) })
        }

        #[inline(always)]
        pub fn negate_where_negative(self, signs: Self) -> Self {
            unsafe {
                let sign = _mm512_and_si512(_mm512_castps_si512(signs.0), _mm512_set1_epi32(i32::MIN));
                Self(_mm512_castsi512_ps(_mm512_xor_si512(_mm512_castps_si512(self.0), sign)))
            }
        }
    }

    impl Add for F32x16 {
        type Output = Self;
        #[inline(always)]
        fn add(self, other: Self) -> Self {
            Self(unsafe { _mm512_add_ps(self.0, other.0) })
        }
    }

    impl Sub for F32x16 {
        type Output = Self;
        #[inline(always)]
        fn sub(self, other: Self) -> Self {
            Self(unsafe { _mm512_sub_ps(self.0, other.0) })
        }
    }

    impl Mul for F32x16 {
        type Output = Self;
        #[inline(always)]
        fn mul(self, other: Self) -> Self {
            Self(unsafe { _mm512_mul_ps(self.0, other.0) })
        }
    }

    impl Div for F32x16 {
        type Output = Self;
        #[inline(always)]
        fn div(self, other: Self) -> Self {
            Self(unsafe { _mm512_div_ps(self.0, other.0) })
        }
    }
}

#[cfg(not(all(target_arch = "x86_64", target_feature = "avx512f")))]
mod lanes {
    use std::ops::{Add, Div, Mul, Sub};

    use super::super::simd::{self, F32x8, WIDTH};
    use crate::math::LANES;

    #[derive(Clone, Copy)]
    pub struct F32x16(F32x8, F32x8);

    #[derive(Clone, Copy)]
    pub struct Mask(simd::Mask, simd::Mask);

    impl Mask {
        #[inline(always)]
        pub fn and(self, other: Self) -> Self {
            Self(self.0.and(other.0), self.1.and(other.1))
        }

        #[inline(always)]
        pub fn bits(self) -> u32 {
            self.0.bits() | self.1.bits() << WIDTH
        }
    }

    impl F32x16 {
        #[inline(always)]
        pub fn load(from: &[f32; LANES]) -> Self {
            let (halves, _) = from.as_chunks::<WIDTH>();
            Self(F32x8::load(&halves[0]), F32x8::load(&halves[1]))
        }

        #[inline(always)]
        pub fn splat(value: f32) -> Self {
            Self(F32x8::splat(value), F32x8::splat(value))
        }

        #[inline(always)]
        pub fn to_array(self) -> [f32; LANES] {
            let mut array = [0.0; LANES];
            let (halves, _) = array.as_chunks_mut::<WIDTH>();
            (halves[0], halves[1]) = (self.0.to_array(), self.1.to_array());
            array
        }

        #[inline(always)]
        pub fn mul_add(self, a: Self, b: Self) -> Self {
            Self(self.0.mul_add(a.0, b.0), self.1.mul_add(a.1, b.1))
        }

        #[inline(always)]
        pub fn neg_mul_add(self, a: Self, b: Self) -> Self {
            Self(self.0.neg_mul_add(a.0, b.0), self.1.neg_mul_add(a.1, b.1))
        }

        #[inline(always)]
        pub fn min(self, other: Self) -> Self {
            Self(self.0.min(other.0), self.1.min(other.1))
        }

        #[inline(always)]
        pub fn max(self, other: Self) -> Self {
            Self(self.0.max(other.0), self.1.max(other.1))
        }

        #[inline(always)]
        pub fn abs(self) -> Self {
            Self(self.0.abs(), self.1.abs())
        }

        #[inline(always)]
        pub fn least(self) -> f32 {
            self.0.min(self.1).least()
        }

        #[inline(always)]
        pub fn at_most(self, other: Self) -> Mask {
            Mask(self.0.lanes_at_most(other.0), self.1.lanes_at_most(other.1))
        }

        #[inline(always)]
        pub fn below(self, other: Self) -> Mask {
            Mask(self.0.lanes_below(other.0), self.1.lanes_below(other.1))
        }

        #[inline(always)]
        pub fn replace(self, other: Self, mask: Mask) -> Self {
            Self(self.0.replace(other.0, mask.0), self.1.replace(other.1, mask.1))
        }

        #[inline(always)]
        pub fn negate_where_negative(self, signs: Self) -> Self {
            Self(self.0.negate_where_negative(signs.0), self.1.negate_where_negative(signs.1))
        }
    }

    impl Add for F32x16 {
        type Output = Self;
        #[inline(always)]
        fn add(self, other: Self) -> Self {
            Self(self.0 + other.0, self.1 + other.1)
        }
    }

    impl Sub for F32x16 {
        type Output = Self;
        #[inline(always)]
        fn sub(self, other: Self) -> Self {
            Self(self.0 - other.0, self.1 - other.1)
        }
    }

    impl Mul for F32x16 {
        type Output = Self;
        #[inline(always)]
        fn mul(self, other: Self) -> Self {
            Self(self.0 * other.0, self.1 * other.1)
        }
    }

    impl Div for F32x16 {
        type Output = Self;
        #[inline(always)]
        fn div(self, other: Self) -> Self {
            Self(self.0 / other.0, self.1 / other.1)
        }
    }
}

/// A vector in every lane. Written out, here and where it is used: of maps over arrays of registers the compiler makes calls.
#[inline(always)]
pub fn splat(v: Vec3) -> [F32x16; 3] {
    [F32x16::splat(v.x), F32x16::splat(v.y), F32x16::splat(v.z)]
}

/// Lane by lane.
#[inline(always)]
pub fn dot(a: &[F32x16; 3], b: &[F32x16; 3]) -> F32x16 {
    a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]))
}
