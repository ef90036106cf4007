//! The asset and its geometry: import (glTF, OBJ), materials, ray tracing, lightmap charts and texels.

pub mod asset;
pub mod bsdf;
pub mod material;
pub mod mesh;
pub mod surface;
pub mod tracer;

pub use asset::{Asset, Camera, PunctualKind, PunctualLight};
pub use bsdf::BsdfSample;
pub use material::{Material, Reflectance, Texture, TextureRef, Wrap};
pub use mesh::{Aabb, Mesh};
pub use surface::{Bsdf, Hit, Surface};
pub use tracer::Tracer;
