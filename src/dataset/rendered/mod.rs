//! Datasets that another renderer rendered: a folder with the lights to render, written by [`Export`], and the lightmaps that
//! came back. `docs/DATASET.md` describes the files.
//!
//! Lightmaps come one condition a file and are wanted all conditions a texel: they are turned once into shards like those of
//! our own bakes, batch by batch, so that no more than a batch is ever in memory.

mod convert;
mod direct;
mod export;
mod lightmap;
mod manifest;
mod table;

pub use convert::Reading;
pub use export::Export;
pub use manifest::Rendered;
