//! The asset and its geometry: import (glTF, OBJ), materials, ray tracing, lightmap charts and texels.

#[cfg(feature = "train")]
mod apart;
pub mod asset;
pub mod bsdf;
#[cfg(feature = "train")]
mod build;
#[cfg(feature = "train")]
mod buried;
#[cfg(feature = "train")]
mod cut;
#[cfg(feature = "train")]
mod denoise;
#[cfg(feature = "train")]
mod fill;
#[cfg(feature = "train")]
pub mod finish;
#[cfg(feature = "train")]
pub mod generate;
#[cfg(feature = "train")]
mod glb;
#[cfg(feature = "train")]
mod gltf;
#[cfg(feature = "train")]
mod image_file;
#[cfg(feature = "train")]
pub mod lightmap;
#[cfg(feature = "train")]
pub mod load;
pub mod material;
pub mod mesh;
#[cfg(feature = "train")]
mod mtl;
#[cfg(feature = "train")]
mod obj;
#[cfg(feature = "train")]
mod obj_normals;
#[cfg(feature = "train")]
pub mod proximity;
#[cfg(feature = "train")]
pub mod seams;
#[cfg(feature = "train")]
mod spot;
pub mod surface;
#[cfg(feature = "train")]
pub mod texels;
pub mod tracer;
#[cfg(feature = "train")]
mod uv_check;
#[cfg(feature = "train")]
mod walls;

pub use asset::{Asset, Camera, PunctualKind, PunctualLight};
pub use bsdf::BsdfSample;
#[cfg(feature = "train")]
pub use finish::Finish;
#[cfg(feature = "train")]
pub use generate::generate;
#[cfg(feature = "train")]
pub use lightmap::{LightmapChoice, LightmapSource, UvPolicy, lay_out};
#[cfg(feature = "train")]
pub use load::{SceneError, load};
pub use material::{Material, Reflectance, Texture, TextureRef, Wrap};
pub use mesh::{Aabb, Mesh};
#[cfg(feature = "train")]
pub use spot::Spot;
pub use surface::{Bsdf, Hit, Surface, TexelPoint};
#[cfg(feature = "train")]
pub use texels::{Fragment, Lightmap, Texel, TexelSampler};
pub use tracer::{Search, ShadowRays, Tracer, above_zero, lanes, mask_of, packed};
#[cfg(feature = "train")]
pub use uv_check::charts;
