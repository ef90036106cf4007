//! Colour spaces and the picture transforms that the CPU and the GPU share.

use glam::Vec3;

use super::Rgb;

/// Relative luminance of linear Rec. 709.
pub fn luminance(c: Rgb) -> f32 {
    c.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

/// Linear value of an sRGB-encoded one in [0, 1] (IEC 61966-2-1).
pub fn linear_from_srgb(encoded: f32) -> f32 {
    if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// sRGB-encoded value of a linear one in [0, 1] (IEC 61966-2-1).
pub fn srgb_from_linear(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// Maps scene-linear colour to display-linear [0, 1] with the Khronos PBR Neutral tone mapper (2024): colours under 0.8
/// stay as they are but for the Fresnel offset; only highlights are compressed and desaturated.
pub fn tone_map(colour: Rgb) -> Rgb {
    const START_COMPRESSION: f32 = 0.8 - 0.04;
    const DESATURATION: f32 = 0.15;
    let colour = colour.max(Vec3::ZERO);
    let low = colour.min_element();
    let offset = if low < 0.08 { low - 6.25 * low * low } else { 0.04 };
    let colour = colour - offset;
    let peak = colour.max_element();
    if peak < START_COMPRESSION {
        return colour;
    }
    let d = 1.0 - START_COMPRESSION;
    let new_peak = 1.0 - d * d / (peak + d - START_COMPRESSION);
    let g = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
    (colour * (new_peak / peak)).lerp(Vec3::splat(new_peak), g)
}

/// 8-bit sRGB of display-linear colour; values outside [0, 1] are clamped.
pub fn srgb8_from_linear(colour: Rgb) -> [u8; 3] {
    colour.to_array().map(|c| (srgb_from_linear(c.clamp(0.0, 1.0)) * 255.0 + 0.5) as u8)
}

/// sRGB colour of `value` in [0, 1] on a perceptually even, colour-blind safe scale from dark violet to yellow
/// (a polynomial fit to viridis; Smith and van der Walt 2015).
pub fn false_colour(value: f32) -> [u8; 3] {
    const C: [Vec3; 7] = [
        Vec3::new(0.277_727_3, 0.005_407_344_5, 0.334_099_8),
        Vec3::new(0.105_093_04, 1.404_613_5, 1.384_590_2),
        Vec3::new(-0.330_861_83, 0.214_847_56, 0.095_095_165),
        Vec3::new(-4.634_230_5, -5.799_101, -19.332_441),
        Vec3::new(6.228_27, 14.179_933, 56.690_55),
        Vec3::new(4.776_385, -13.745_145, -65.353_033),
        Vec3::new(-5.435_456, 4.645_852_6, 26.312_435),
    ];
    let t = if value.is_finite() { value.clamp(0.0, 1.0) } else { 1.0 };
    let c = C.iter().rev().fold(Vec3::ZERO, |sum, &k| sum * t + k);
    c.to_array().map(|c| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_transfer_round_trips_all_8_bit_codes() {
        for code in 0..=255u8 {
            let linear = linear_from_srgb(code as f32 / 255.0);
            assert_eq!(srgb8_from_linear(Vec3::splat(linear)), [code; 3]);
        }
    }

    #[test]
    fn tone_map_is_monotonic_and_stays_below_one() {
        let mut last = -1.0;
        for i in 0..2000 {
            let y = tone_map(Vec3::splat(i as f32 * 0.01)).x;
            assert!(y >= last && y <= 1.0, "tone_map({}) = {y} after {last}", i as f32 * 0.01);
            last = y;
        }
    }
}
