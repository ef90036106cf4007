//! The trained model: what relights the asset. The file, and relighting on the CPU.

pub mod basis;
pub mod file;
pub mod negative;
pub mod picture;
pub mod record;
pub mod render;
pub mod scope;
pub mod view;

pub use basis::{Anchors, Basis, LightmapImage, Values};
pub use file::ModelFileError;
pub use negative::negative_shares;
pub use picture::Picture;
#[cfg(feature = "train")]
pub use picture::{Animation, PictureError};
pub use record::{Choice, HeldOut, Separation, Shortage, TrainingRecord};
pub use scope::{Reading, Scope};
pub use view::{Shown, View, ViewError};

use half::f16;

use crate::math::Rgb;
use crate::measure::MeasurementPoints;
use crate::scene::Asset;

/// Whether colour channels share the vectors or have vectors of their own (paper 5.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Channels {
    /// Each channel is a vector of its own: one scalar basis, a transfer matrix for each channel.
    Mono,
    /// Channels are interleaved in one vector: a coloured basis, one transfer matrix.
    Multi,
}

impl Channels {
    /// Values of an element at a texel.
    pub fn components(self) -> usize {
        match self {
            Channels::Mono => 1,
            Channels::Multi => 3,
        }
    }
}

/// From the direct vector x to the coefficients u (METHOD eq. 7).
#[derive(Clone, Debug, PartialEq)]
pub struct Transfer {
    pub channels: Channels,
    /// Coefficients: n, the mean included where there is one; of a local basis n for each anchor, `[anchor][channel]`.
    pub elements: usize,
    /// P.
    pub points: usize,
    /// Mono: three matrices (R, G, B) of `[element][point]`. Multi: one of `[element][3·point + channel]`. In files and on
    /// GPUs they are half floats of a common [`Self::scale`].
    pub matrices: Vec<Vec<f32>>,
    /// Whether element 0 is the mean, whose coefficient is the norm of x (of the channel's x for mono) and whose matrix
    /// row is zero (the paper's baseline).
    pub mean_scaled_by_norm: bool,
    /// γ: x is raised to 1/γ first, and what the basis makes of u is raised to γ (paper 5.3). 1: linear in the light.
    pub gamma: f32,
}

/// A trained model, complete for relighting: nothing else needs to be read.
#[derive(Clone, Debug)]
pub struct Model {
    pub asset: Asset,
    pub points: MeasurementPoints,
    pub basis: Basis,
    pub transfer: Transfer,
    /// What tells how far light is from what was trained on; none where nothing was there to tell it from.
    pub scope: Option<Scope>,
    pub record: TrainingRecord,
}

impl Transfer {
    /// u = M x: one coefficient per element and channel from the direct vector (one RGB per point).
    /// GPU twin: `shaders/transfer.wgsl`.
    pub fn coefficients(&self, direct: &[Rgb]) -> Vec<Rgb> {
        assert_eq!(direct.len(), self.points, "direct vector of another point set");
        if self.gamma == 1.0 {
            return self.of_vector(direct);
        }
        let roots: Vec<Rgb> = direct.iter().map(|x| x.max(Rgb::ZERO).powf(1.0 / self.gamma)).collect();
        self.of_vector(&roots)
    }

    /// The power of two that half floats of the matrices are multiplied with: not under their largest magnitude.
    pub fn scale(&self) -> f32 {
        let largest = self.matrices.iter().flatten().fold(f32::MIN_POSITIVE, |most, m| most.max(m.abs()));
        largest.log2().ceil().min(127.0).exp2()
    }

    /// The matrices as half floats, over [`Self::scale`].
    pub fn halves(&self) -> Vec<Vec<f16>> {
        let scale = self.scale();
        self.matrices.iter().map(|m| m.iter().map(|v| f16::from_f32(v / scale)).collect()).collect()
    }

    /// With matrices as they come back from half floats.
    pub fn rounded(mut self) -> Self {
        let scale = self.scale();
        self.matrices.iter_mut().flatten().for_each(|v| *v = f16::from_f32(*v / scale).to_f32() * scale);
        self
    }

    fn of_vector(&self, direct: &[Rgb]) -> Vec<Rgb> {
        let mut u = vec![Rgb::ZERO; self.elements];
        match self.channels {
            Channels::Mono => {
                for (channel, matrix) in self.matrices.iter().enumerate() {
                    for (row, u) in matrix.chunks_exact(self.points).zip(&mut u) {
                        u[channel] = row.iter().zip(direct).map(|(m, x)| m * x[channel]).sum();
                    }
                }
                if self.mean_scaled_by_norm {
                    u[0] = direct.iter().map(|&x| x * x).sum::<Rgb>().map(f32::sqrt);
                }
            }
            Channels::Multi => {
                for (row, u) in self.matrices[0].chunks_exact(3 * self.points).zip(&mut u) {
                    let sum: f32 = row.chunks_exact(3).zip(direct).map(|(m, x)| Rgb::from_slice(m).dot(*x)).sum();
                    *u = Rgb::splat(sum);
                }
                if self.mean_scaled_by_norm {
                    u[0] = Rgb::splat(direct.iter().map(|x| x.length_squared()).sum::<f32>().sqrt());
                }
            }
        }
        u
    }
}
