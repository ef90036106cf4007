//! Surface materials: glTF metallic-roughness and plain Lambert, with textures.

use glam::{Mat3, Vec2, Vec3, Vec4};

use crate::math::Rgb;

/// How a surface reflects.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reflectance {
    /// Base colour over π, no specular reflection.
    Lambert,
    /// The glTF 2.0 metallic-roughness model (specification, appendix B).
    MetallicRoughness,
}

/// A texture as a material uses it.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TextureRef {
    /// Index into the asset's textures.
    pub texture: u32,
    /// Which of the mesh's `uvs` it reads, 0 or 1.
    pub uv_set: u32,
    /// KHR_texture_transform: texture_uv = transform · (u, v, 1).
    pub transform: Mat3,
}

/// One material. Factors multiply textures, as in glTF.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Material {
    pub name: String,
    pub reflectance: Reflectance,
    /// Linear RGB and alpha.
    pub base_colour: Vec4,
    pub base_colour_texture: Option<TextureRef>,
    pub metallic: f32,
    pub roughness: f32,
    /// Roughness in green, metallic in blue.
    pub metallic_roughness_texture: Option<TextureRef>,
    /// Emitted radiance, strength included.
    pub emissive: Rgb,
    pub emissive_texture: Option<TextureRef>,
    /// Coverage is cut where alpha is below this (glTF alphaMode MASK).
    pub alpha_cutoff: Option<f32>,
    /// Whether the back is drawn. Light transport meets both sides of every surface.
    pub double_sided: bool,
}

impl Material {
    /// A one-sided Lambert surface of the given reflectance.
    pub fn lambert(name: &str, base_colour: Rgb) -> Self {
        Self {
            name: name.to_owned(),
            reflectance: Reflectance::Lambert,
            base_colour: base_colour.extend(1.0),
            base_colour_texture: None,
            metallic: 0.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            emissive: Vec3::ZERO,
            emissive_texture: None,
            alpha_cutoff: None,
            double_sided: false,
        }
    }
}

/// How a texture coordinate outside [0, 1] reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Wrap {
    Repeat,
    Mirror,
    Clamp,
}

/// An 8-bit RGBA image with its sampler state. Row 0 is v = 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    pub name: String,
    pub width: u32,
    pub height: u32,
    /// `[y][x]`, RGBA.
    pub texels: Vec<[u8; 4]>,
    /// Whether RGB is sRGB-encoded (base colour, emissive) or linear (metallic-roughness).
    pub srgb: bool,
    pub wrap: [Wrap; 2],
}

impl Texture {
    /// Bilinear lookup at `uv`, in linear RGBA.
    pub fn sample(&self, uv: Vec2) -> Vec4 {
        let x = uv.x * self.width as f32 - 0.5;
        let y = uv.y * self.height as f32 - 0.5;
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let texel = |dx: f32, dy: f32| self.texel(x0 + dx, y0 + dy);
        let top = texel(0.0, 0.0).lerp(texel(1.0, 0.0), fx);
        let bottom = texel(0.0, 1.0).lerp(texel(1.0, 1.0), fx);
        top.lerp(bottom, fy)
    }

    fn texel(&self, x: f32, y: f32) -> Vec4 {
        let x = wrap(x, self.width, self.wrap[0]);
        let y = wrap(y, self.height, self.wrap[1]);
        let [r, g, b, a] = self.texels[y * self.width as usize + x];
        let rgb = if self.srgb { [r, g, b].map(linear_from_srgb8) } else { [r, g, b].map(|c| c as f32 / 255.0) };
        Vec3::from_array(rgb).extend(a as f32 / 255.0)
    }
}

/// Index of texel coordinate `x` (an integer in f32) along an axis of `size` texels.
fn wrap(x: f32, size: u32, wrap: Wrap) -> usize {
    let size_i = size as i64;
    // A coordinate that is not finite reads texel 0: `as` saturates NaN to 0.
    let x = x as i64;
    let i = match wrap {
        Wrap::Repeat => x.rem_euclid(size_i),
        Wrap::Mirror => {
            let m = x.rem_euclid(2 * size_i);
            if m < size_i { m } else { 2 * size_i - 1 - m }
        }
        Wrap::Clamp => x.clamp(0, size_i - 1),
    };
    i as usize
}

fn linear_from_srgb8(code: u8) -> f32 {
    static TABLE: std::sync::LazyLock<[f32; 256]> =
        std::sync::LazyLock::new(|| std::array::from_fn(|i| crate::math::colour::linear_from_srgb(i as f32 / 255.0)));
    TABLE[code as usize]
}
