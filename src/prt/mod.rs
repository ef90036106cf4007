//! Classical precomputed radiance transfer, to compare with (Sloan, Kautz, Snyder, *Precomputed Radiance Transfer for
//! Real-Time Rendering in Dynamic, Low-Frequency Lighting Environments*, 2002; Sloan, Lehtinen, Kautz, course notes, 2005).
//!
//! Distant light is projected onto spherical harmonics, L(ω) ≈ Σⱼ lⱼ Yⱼ(ω); every receiver stores what each function
//! transfers to it, shadows and interreflections included; relighting is the inner product of the two.

pub mod bake;
pub mod light;
pub mod receivers;

pub use bake::{PrtError, PrtSettings, bake_texels, bake_vertices};
pub use light::light_coefficients;
pub use receivers::VertexWeights;

use crate::math::{Rgb, sh};

/// Where transfer is stored.
#[derive(Clone, Debug, PartialEq)]
pub enum Storage {
    /// At the mesh's vertices, as published; lightmap texels interpolate.
    Vertices(VertexWeights),
    /// At the lightmap's texels.
    Texels,
}

/// Transfer vectors of a whole asset.
#[derive(Clone, Debug, PartialEq)]
pub struct ShPrt {
    /// Order n of the spherical harmonics; lower orders are the first m² functions of each vector.
    pub order: usize,
    pub storage: Storage,
    /// `[receiver][function]`: irradiance that arrives unreflected, per unit of light in the function. It has no colour.
    pub direct: Vec<f32>,
    /// `[receiver][function]`: the same after at least one reflection.
    pub indirect: Vec<Rgb>,
}

impl ShPrt {
    /// Bytes of transfer to as many receivers.
    pub fn bytes_needed(receivers: usize, order: usize) -> u64 {
        (receivers * sh::count(order) * (size_of::<f32>() + size_of::<Rgb>())) as u64
    }

    /// Indirect irradiance of every lightmap texel under light of the given coefficients, whose number is that of an order
    /// of at most [`ShPrt::order`].
    pub fn indirect(&self, light: &[Rgb]) -> Vec<Rgb> {
        self.at_texels(self.per_receiver(&self.indirect, light, |transfer, light| transfer * light))
    }

    /// Direct irradiance of every lightmap texel, as [`ShPrt::indirect`].
    pub fn direct(&self, light: &[Rgb]) -> Vec<Rgb> {
        self.at_texels(self.per_receiver(&self.direct, light, |transfer, light| light * transfer))
    }

    fn per_receiver<T: Copy>(&self, transfer: &[T], light: &[Rgb], product: impl Fn(T, Rgb) -> Rgb) -> Vec<Rgb> {
        let vectors = transfer.chunks_exact(sh::count(self.order));
        vectors.map(|vector| vector.iter().zip(light).map(|(&t, &l)| product(t, l)).sum()).collect()
    }

    fn at_texels(&self, values: Vec<Rgb>) -> Vec<Rgb> {
        match &self.storage {
            Storage::Texels => values,
            Storage::Vertices(weights) => weights.interpolate(&values),
        }
    }
}
