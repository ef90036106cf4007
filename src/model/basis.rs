//! What a texel stores, and what it makes of the coefficients.

use half::f16;
use rayon::prelude::*;

use crate::math::Rgb;
#[cfg(feature = "train")]
use crate::scene::Finish;

/// n values a texel over the lightmap, finished: lookups inside a chart read only its own values, and charts join without a
/// seam.
///
/// A global basis has one set of n coefficients for all texels. A local one has n at each anchor, and a texel takes those
/// interpolated between its anchors.
#[derive(Clone, Debug, PartialEq)]
pub struct Basis {
    /// Side of the square lightmap, texels.
    pub size: usize,
    /// n: basis elements, or channels of a local basis.
    pub elements: usize,
    /// 1 for mono, 3 for multi.
    pub components: usize,
    /// `[element][component][y][x]`.
    pub values: Values,
    /// Of a local basis.
    pub anchors: Option<Anchors>,
    /// What values and coefficients make is raised to this: the transfer's γ. 1: they make the light itself.
    pub gamma: f32,
}

/// Values of a basis, about 1 at most (but for a mean's, which are as they are).
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    Half(Vec<f16>),
    /// In 127ths.
    Byte(Vec<i8>),
}

/// Which anchors each texel interpolates between.
#[derive(Clone, Debug, PartialEq)]
pub struct Anchors {
    /// K, at most 256.
    pub count: usize,
    /// Four of them for each texel.
    pub indices: Vec<[u8; 4]>,
    /// The shares of the first three, in 255ths; the fourth has the rest. Then what all values of the texel are multiplied by, as
    /// [`scale_of`] reads it: eight bits with a scale for each texel are as good as half floats.
    pub shares: Vec<[u8; 4]>,
}

/// 2^((code − 255)/16): from 1 down to 2⁻¹⁶.
pub fn scale_of(code: u8) -> f32 {
    ((code as f32 - 255.0) / 16.0).exp2()
}

impl Values {
    pub fn len(&self) -> usize {
        match self {
            Values::Half(values) => values.len(),
            Values::Byte(codes) => codes.len(),
        }
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    #[inline]
    pub fn get(&self, at: usize) -> f32 {
        match self {
            Values::Half(values) => values[at].to_f32(),
            Values::Byte(codes) => codes[at] as f32 / 127.0,
        }
    }

    pub fn bytes(&self) -> usize {
        match self {
            Values::Half(values) => 2 * values.len(),
            Values::Byte(codes) => codes.len(),
        }
    }
}

impl Anchors {
    /// The anchors of a texel and their shares.
    #[inline]
    pub fn of(&self, texel: usize) -> [(usize, f32); 4] {
        let ([a, b, c, d], [x, y, z, _]) = (self.indices[texel], self.shares[texel]);
        let rest = 255 - (x as i32 + y as i32 + z as i32);
        [(a, x as i32), (b, y as i32), (c, z as i32), (d, rest)].map(|(k, share)| (k as usize, share as f32 / 255.0))
    }

    /// What all values of a texel are multiplied by.
    #[inline]
    pub fn scale(&self, texel: usize) -> f32 {
        scale_of(self.shares[texel][3])
    }
}

impl Basis {
    /// Lays path traced values per texel of the lightmap, `[element][component][texel]`, out over the whole page.
    #[cfg(feature = "train")]
    pub fn from_texels(finish: &Finish, elements: usize, values: &[f32]) -> Self {
        let pages = finish.path_traced_pages(values);
        let components = pages.len() / (elements * finish.size * finish.size).max(1);
        let values = Values::Half(pages.into_iter().map(f16::from_f32).collect());
        Self { size: finish.size, elements, components, values, anchors: None, gamma: 1.0 }
    }

    /// Bytes a texel: values, anchors and their weights.
    pub fn bytes_per_texel(&self) -> usize {
        let anchors = if self.anchors.is_some() { 8 } else { 0 };
        self.values.bytes() / (self.size * self.size) + anchors
    }

    /// Elements in a layer of a texture with four channels: four scalar ones, or one of RGB.
    pub fn elements_per_layer(&self) -> usize {
        if self.components == 1 { 4 } else { 1 }
    }

    /// Layers that hold all elements.
    pub fn layers(&self) -> usize {
        self.elements.div_ceil(self.elements_per_layer()).max(1)
    }

    /// Coefficients that it takes: n, or n for each anchor, `[anchor][element]`.
    pub fn coefficients(&self) -> usize {
        self.elements * self.anchors.as_ref().map_or(1, |a| a.count)
    }

    /// Indirect irradiance of all texels (METHOD eq. 8 and 10), or its root. GPU twin: `shaders/reconstruct.wgsl`.
    pub fn reconstruct(&self, coefficients: &[Rgb]) -> LightmapImage {
        assert_eq!(coefficients.len(), self.coefficients(), "coefficients of another basis");
        let values = (0..self.size * self.size).into_par_iter().map(|texel| self.at(texel, coefficients)).collect();
        LightmapImage { size: self.size, values, gamma: self.gamma }
    }

    pub(super) fn at(&self, texel: usize, coefficients: &[Rgb]) -> Rgb {
        let (anchors, scale) = match &self.anchors {
            Some(anchors) => (anchors.of(texel), anchors.scale(texel)),
            None => ([(0, 1.0), (0, 0.0), (0, 0.0), (0, 0.0)], 1.0),
        };
        let plane = self.size * self.size;
        (0..self.elements)
            .map(|element| {
                let value = |component: usize| self.values.get((element * self.components + component) * plane + texel);
                let u: Rgb = (anchors.iter().filter(|(_, share)| *share != 0.0))
                    .map(|&(anchor, share)| coefficients[anchor * self.elements + element] * share)
                    .sum();
                if self.components == 1 { u * value(0) } else { u * Rgb::new(value(0), value(1), value(2)) }
            })
            .sum::<Rgb>()
            * scale
    }
}

/// One colour per texel of a lightmap's page, to be looked up by lightmap coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct LightmapImage {
    /// Side, texels.
    pub size: usize,
    /// `[y][x]`, of either sign: light, or its γth root.
    pub values: Vec<Rgb>,
    /// γ.
    pub gamma: f32,
}

impl LightmapImage {
    /// From path traced values per texel of the lightmap.
    #[cfg(feature = "train")]
    pub fn new(finish: &Finish, values: &[Rgb]) -> Self {
        let page = |channel: usize| finish.path_traced_pages(&values.iter().map(|v| v[channel]).collect::<Vec<f32>>());
        let [r, g, b] = [page(0), page(1), page(2)];
        let values = (0..r.len()).map(|i| Rgb::new(r[i], g[i], b[i])).collect();
        Self { size: finish.size, values, gamma: 1.0 }
    }

    /// Light at lightmap coordinates in [0, 1]², bilinear between texel centres, with γ = 1 of either sign. GPU twin:
    /// `shaders/lookup_bilinear.wgsl`.
    pub fn sample(&self, uv: glam::Vec2) -> Rgb {
        let p = uv * self.size as f32 - 0.5;
        let (base, f) = (p.floor(), p - p.floor());
        let clamp = |x: f32| (x as i64).clamp(0, self.size as i64 - 1) as usize;
        let texel = |dx: f32, dy: f32| self.values[clamp(base.y + dy) * self.size + clamp(base.x + dx)];
        let top = texel(0.0, 0.0).lerp(texel(1.0, 0.0), f.x);
        let value = top.lerp(texel(0.0, 1.0).lerp(texel(1.0, 1.0), f.x), f.y);
        if self.gamma == 1.0 { value } else { value.max(Rgb::ZERO).powf(self.gamma) }
    }
}
