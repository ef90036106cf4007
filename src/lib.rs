//! Data-driven direct-to-indirect light transfer (Belcour, Deliot, Barbier, Soler, *A Data-Driven Paradigm for
//! Precomputed Radiance Transfer*, 2022): train it for one asset, compare it with classical SH PRT, relight in real time.
//!
//! Data flows one way, down this list; each room imports only from rooms above it (a test keeps that true).
//!
//! | room | holds |
//! |---|---|
//! | [`math`] | frames, sampling warps beside their pdfs, the sample generator, spherical harmonics, colour |
//! | [`files`] | reading words, writing files whole or not at all |
//! | [`progress`] | how long work tells how far it is, and learns that it should stop |
//! | [`memory`] | large arrays, and what threads work with, lent from job to job |
//! | [`scene`] | asset import, materials, ray tracing, lightmap charts and texels |
//! | [`light`] | light kinds, the lighting condition, scenarios |
//! | [`measure`] | measurement points, their sub-points, the direct vector x |
//! | [`model`] | the trained model, its file, relighting on the CPU |
//! | [`gpu`] | the wgpu run time |
//! | [`export`] | a model as files that engines load |
//! | [`transport`] | the path tracer: light of N conditions along shared paths |
//! | [`dataset`] | the matrices D and I, and the held-out set |
//! | [`transfer`] | basis and transfer matrix from a dataset, choice of λ |
//! | [`scene_file`] | the settings of a training run |
//! | [`prt`] | classical SH PRT, to compare with |
//! | [`report`] | errors, plots, the HTML page |
//! | [`viewer`] | the window |
//! | [`cli`] | one file per command |
//!
//! `docs/METHOD.md` has the notation and the numbered equations that comments cite.

// In the order of the table.
pub mod math;
pub mod files;
pub mod progress;
pub mod memory;
pub mod scene;
pub mod light;
pub mod measure;
pub mod model;
#[cfg(feature = "gpu")]
pub mod gpu;
#[cfg(all(feature = "train", feature = "gpu"))]
pub mod export;
#[cfg(feature = "train")]
pub mod transport;
#[cfg(feature = "train")]
pub mod dataset;
#[cfg(feature = "train")]
pub mod transfer;
#[cfg(feature = "train")]
pub mod scene_file;
#[cfg(feature = "train")]
pub mod prt;
#[cfg(feature = "train")]
pub mod report;
#[cfg(feature = "viewer")]
pub mod viewer;
#[cfg(feature = "cli")]
pub mod cli;
