//! The asset and its geometry: import (glTF, OBJ), materials, ray tracing, lightmap charts and texels.

pub mod asset;
pub mod bsdf;
mod build;
mod buried;
mod denoise;
mod fill;
pub mod finish;
pub mod generate;
mod gltf;
mod image_file;
pub mod lightmap;
pub mod load;
pub mod material;
pub mod mesh;
mod mtl;
mod obj;
mod obj_normals;
pub mod proximity;
pub mod seams;
pub mod surface;
pub mod texels;
pub mod tracer;
mod uv_check;

pub use asset::{Asset, Camera, PunctualKind, PunctualLight};
pub use bsdf::BsdfSample;
pub use finish::Finish;
pub use generate::generate;
pub use lightmap::{LightmapChoice, LightmapSource, UvPolicy, lay_out};
pub use load::{SceneError, load};
pub use material::{Material, Reflectance, Texture, TextureRef, Wrap};
pub use mesh::{Aabb, Mesh};
pub use surface::{Bsdf, Hit, Surface};
pub use texels::{Fragment, Lightmap, Texel, TexelPoint, TexelSampler};
pub use tracer::{Search, ShadowRays, Tracer, lanes, mask_of};
pub use uv_check::charts;
