//! A rendered picture.

#[cfg(feature = "train")]
mod animation;
#[cfg(feature = "train")]
mod write;

use crate::math::Rgb;
use crate::math::colour::{srgb8_from_linear, tone_map};
#[cfg(feature = "train")]
pub use animation::Animation;
#[cfg(feature = "train")]
pub use write::PictureError;

/// Scene-linear radiance, W·m⁻²·sr⁻¹, Rec. 709.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    pub width: u32,
    pub height: u32,
    /// `[y][x]`, row 0 on top.
    pub pixels: Vec<Rgb>,
}

impl Picture {
    pub fn pixel(&self, x: u32, y: u32) -> Rgb {
        self.pixels[(y * self.width + x) as usize]
    }

    /// 8-bit sRGB, `[y][x]`, after exposure and tone mapping.
    pub fn srgb8(&self, exposure: f32) -> Vec<[u8; 3]> {
        self.pixels.iter().map(|&radiance| srgb8_from_linear(tone_map(radiance * exposure))).collect()
    }
}
