//! Data-driven direct-to-indirect light transfer (Belcour, Deliot, Barbier, Soler, *A Data-Driven Paradigm for
//! Precomputed Radiance Transfer*, 2022): train it for one asset, compare it with classical SH PRT, relight in real time.
//!
//! Data flows one way, down this list; each room imports only from rooms above it (a test keeps that true).
//!
//! | room | holds |
//! |---|---|
//! | [`math`] | frames, sampling warps beside their pdfs, the sample generator, spherical harmonics, colour |
//! | [`scene`] | asset import, materials, ray tracing, lightmap charts and texels |
//! | [`light`] | light kinds, the lighting condition, scenarios |
//! | [`measure`] | measurement points, their sub-points, the direct vector x |
//! | [`transport`] | the path tracer: light of N conditions along shared paths |
//! | [`dataset`] | the matrices D and I, and the held-out set |
//! | [`transfer`] | basis and transfer matrix from a dataset, choice of λ |
//! | [`model`] | the trained model, its file, relighting on the CPU |
//! | [`prt`] | classical SH PRT, to compare with |
//! | [`gpu`] | the wgpu run time |
//! | [`report`] | errors, plots, the HTML page |
//! | [`cli`] | one file per command |
//!
//! `docs/METHOD.md` has the notation and the numbered equations that comments cite.

pub mod cli;
pub mod dataset;
pub mod files;
pub mod gpu;
pub mod light;
pub mod math;
pub mod measure;
pub mod model;
pub mod progress;
pub mod prt;
pub mod report;
pub mod scene;
pub mod scene_file;
pub mod transfer;
pub mod transport;
