//! Where a model comes from and how good it is: carried in its file, printed by `info`.

use serde::{Deserialize, Serialize};

/// How a model was trained. Nothing in it depends on the clock or the machine, so that the same inputs give the same file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingRecord {
    /// Version of the program.
    pub version: String,
    /// The scene file's settings as used, in TOML, defaults included.
    pub scene: String,
    /// Hash of the mesh, materials, textures and lightmap layout that the model was trained on (BLAKE3, hexadecimal).
    pub asset_hash: String,
    /// Conditions trained on, and of these, how many were dropped because they light nothing.
    pub conditions: usize,
    pub dropped: usize,
    /// λ relative to trace(DDᵀ)/P.
    pub lambda: f64,
    /// Whether paths from the texels told the transfer beforehand, and λ is that of the fit to what they left.
    pub prior: bool,
    pub held_out: HeldOut,
    /// Per kind of light that the scenario does not have, the chance that one of them reads more novel than a held-out light.
    pub separation: Vec<Separation>,
    /// Settings that were chosen for the user.
    pub choices: Vec<Choice>,
    /// What more of would lower the error.
    pub shortages: Vec<Shortage>,
}

/// A setting that was chosen, by its name in scene files, and why so.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Choice {
    pub setting: String,
    pub value: String,
    pub why: String,
}

/// A count that is the limit of a model's error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shortage {
    /// By its name in scene files.
    pub setting: String,
    pub count: usize,
    /// What would do: twice as many would gain little more, or were not tried.
    pub enough: usize,
    /// Mean held-out error that is to be expected of it, a fraction.
    pub error: f64,
}

/// How well a model's [`super::Scope`] tells a kind of light from the scenario's held-out lights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Separation {
    pub kind: String,
    /// Area under the ROC curve, measured on lights of which nothing was fitted.
    pub auc: f64,
}

/// Relative RMSE on conditions that training never saw, as fractions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    pub conditions: usize,
    pub mean: f64,
    pub median: f64,
    pub worst: f64,
    /// Mean error of the held-out lightmaps projected on the basis: what no transfer matrix can better.
    pub oracle_mean: f64,
    /// Mean share of the error that is the renderer's own noise in the held-out lightmaps, where it is known.
    pub noise: Option<f64>,
    /// Mean share of the relit lightmaps' norm that is negative light, which is clamped when it is shown.
    pub negative: f64,
}
