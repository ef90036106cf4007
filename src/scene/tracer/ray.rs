//! A ray as the triangle and the box tests want it.

use glam::Vec3;

use super::simd::F32x8;

/// A ray sheared so that it runs along z from the origin (Woop, Benthin, Wald, *Watertight Ray/Triangle Intersection*, 2013).
pub struct ShearedRay {
    /// The axis of the direction's largest part last.
    pub axes: [usize; 3],
    /// By `axes`.
    pub origin: [F32x8; 3],
    /// What to take off x and y per unit of z.
    pub shear: [F32x8; 2],
    /// Units of the ray's direction per unit of z.
    pub scale: F32x8,
}

/// The axis after each.
static NEXT: [usize; 4] = [1, 2, 0, 0];

impl ShearedRay {
    #[inline(always)]
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        // In memory, where a computed axis costs a load and no branch.
        let from = [origin.x, origin.y, origin.z, 0.0];
        let along = [direction.x, direction.y, direction.z, 0.0];
        let [x, y, z, _] = along.map(f32::abs);
        let k = if (z > x) & (z > y) { 2 } else { usize::from(y >= x) };
        let [i, j] = [NEXT[k], NEXT[NEXT[k]]];
        let scale = 1.0 / along[k];
        Self {
            axes: [i, j, k],
            origin: [F32x8::splat(from[i]), F32x8::splat(from[j]), F32x8::splat(from[k])],
            shear: [F32x8::splat(along[i] * scale), F32x8::splat(along[j] * scale)],
            scale: F32x8::splat(scale),
        }
    }
}

/// A unit in the last place of 1.
const ULP: f32 = f32::EPSILON;

/// Of a box's far distance, before the near one is held against it: the roundings of the box and the triangle tests together are below six halves of an
/// [`ULP`] a side.
pub const SLACK: f32 = 1.0 + 6.0 * ULP;

/// 1 / `d`, or what stands for it where `d` is next to nothing beside a direction's `largest` part: finite, so that 0 · ∞ never
/// makes a NaN.
#[inline(always)]
pub fn inverse_of(d: f32, largest: f32) -> f32 {
    let least = largest * 1e-18 + 1e-30;
    1.0 / (if d.abs() > least { d.abs() } else { least }).copysign(d)
}

/// What a ray needs to meet boxes: t where it crosses a plane of an axis is `position * inverse + offset`, rounded outwards, so
/// that no box is missed whose triangles the ray hits (Ize, *Robust BVH Ray Traversal*, 2013).
pub struct Slabs {
    pub inverse: [F32x8; 3],
    pub near: [F32x8; 3],
    pub far: [F32x8; 3],
    /// Per axis: 1 where the ray runs downwards and so enters by the upper plane.
    pub backwards: [usize; 3],
}

impl Slabs {
    /// `size`: the largest coordinate of a box, metres.
    #[inline(always)]
    pub fn new(origin: Vec3, direction: Vec3, size: f32) -> Self {
        let along = direction.abs();
        let largest = along.x.max(along.y).max(along.z);
        let inverse = direction.to_array().map(|d| inverse_of(d, largest));
        let product = [origin.x * inverse[0], origin.y * inverse[1], origin.z * inverse[2]];
        // The product's rounding, and that of its sum with the margin, are half a unit each. A ray in the plane of a box's face
        // is in the box.
        let margin = [0, 1, 2].map(|i| 1.5 * ULP * (product[i].abs() + size * inverse[i].abs()));
        Self {
            inverse: [F32x8::splat(inverse[0]), F32x8::splat(inverse[1]), F32x8::splat(inverse[2])],
            near: [0, 1, 2].map(|i| F32x8::splat(-margin[i] - product[i])),
            far: [0, 1, 2].map(|i| F32x8::splat(margin[i] - product[i])),
            backwards: inverse.map(|d| (d.to_bits() >> 31) as usize),
        }
    }
}
