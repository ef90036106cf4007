//! From a dataset (D, I) to a basis and a transfer matrix: the ways to train, the choice of λ, and their error.
//!
//! Everything global happens in the small space of training vectors. The Gram matrix of all lightmaps, held-out ones included, is
//! computed once ([`Gram`]); bases, transfer matrices, oracles and errors for any method and size then follow from it
//! without touching a lightmap again, and only the chosen basis is expanded to texels ([`Fit::expand`]). A local basis ([`LocalFit`]) starts from there.

pub mod anchors;
pub mod budget;
pub mod enough;
pub mod error;
pub mod fit;
pub mod gamma;
pub mod gram;
pub mod local;
pub mod prior;
pub mod ridge;
pub mod scope;
mod small;
pub mod trial;

use crate::dataset::ROWS;
use crate::model::Channels;

pub use budget::{Budget, Candidate, Size};
pub use error::{ErrorSummary, HeldOutErrors, Probe, Tested};
pub use fit::{Fit, Lambda, Method, PUBLISHED_LAMBDA, Spectrum, TrainSettings};
pub use gram::Gram;
pub use local::{LocalFit, Precision, Terms};
pub use prior::{Prior, PriorSums};
pub use scope::fit_scope;
pub use trial::Trial;

/// What a training run is made of, as far as its memory goes.
#[derive(Clone, Copy, Debug)]
pub struct Extent {
    pub method: Method,
    pub channels: Channels,
    /// Elements, or channels a texel.
    pub elements: usize,
    /// Anchors of a local basis.
    pub anchors: usize,
    /// Conditions to train on, and all.
    pub training: usize,
    pub conditions: usize,
    pub points: usize,
    /// Sub-points that a prior is made with; 0 without one.
    pub sub_points: usize,
    pub texels: usize,
    /// Side of the lightmap.
    pub lightmap_size: usize,
    /// Whether the fit is in gamma space, which has a Gram matrix of its own.
    pub raised: bool,
}

/// Bytes that training takes at most: the Gram matrix, and beside it what makes it, the fit (the weighted and the centred
/// matrix, the eigenvectors, their copy in falling order and the solver's own), or the basis over texels and the model file.
pub fn bytes_needed(extent: &Extent) -> u64 {
    let Extent { method, channels, .. } = *extent;
    let components = channels.components() as u64;
    let [elements, training, points, texels] =
        [extent.elements, extent.training, extent.points, extent.texels].map(|n| n as u64);
    let page = (extent.lightmap_size * extent.lightmap_size) as u64;
    let (width, vectors) = (3 * extent.conditions as u64, training * 3 / components);
    let gram = 8 * width * width;
    let making = gram / 2 + ROWS as u64 * width * (8 + 4 + 2);
    let fit = 7 * 8 * vectors * vectors + 4 * 8 * 3 * points * training;
    let terms = if method == Method::Local { vectors.min(fit::LOCAL_TERMS as u64) } else { elements };
    // The lightmaps and the expanded rows of a tile, and what combines them.
    let tile = 8 * ROWS as u64 * components * (vectors + terms) + 2 * 8 * vectors * terms;
    let values = texels * elements * components * 4;
    let halves = page * elements * components * 2;
    let basis = match method {
        // The nearest covered texel of each is found for the gutter; the model's bytes are laid out twice before they are
        // written.
        Method::Belcour | Method::Linear => (values + halves + 16 * page + tile).max(3 * halves),
        Method::Local => {
            let coefficients = extent.anchors as u64 * elements;
            // The normal matrix, its copy with a ridge, their factor and products of the frames, old and new.
            let normal = 6 * 8 * coefficients * (coefficients + terms);
            let matrices = 2 * 3 * 8 * coefficients * points;
            let finished = page * (components * elements * (8 + 4 + 2) + 2 * 4 * local::PLANES as u64 + 24);
            texels * components * terms * 4 + values + matrices + tile.max(normal).max(finished)
        }
    };
    // The fit stays while prior and scope are found.
    let prior = match (extent.sub_points, method) {
        (0, _) | (_, Method::Belcour) => 0,
        (sub_points, _) => tile + prior::bytes_needed(terms, sub_points as u64, points),
    };
    let vectors_of_scope = scope::vector_bytes(points);
    let prior = 2 * 8 * vectors * terms + (prior + vectors_of_scope).max(scope::bytes_needed(points));
    // So do it and the model's basis while more points and fewer conditions are tried: D at four times the points as floats and in ridges, and a fit
    // on half of the conditions.
    let (tried, rank) = (4 * points, (4 * points).min(training));
    let direct = 4 * 3 * tried * 2 * extent.conditions as u64 + 3 * 8 * (2 * tried * training + 4 * rank * rank);
    let trial = match method {
        Method::Belcour => 0,
        _ => halves + 2 * 8 * terms * (2 * vectors + 3 * extent.conditions as u64) + direct.max(fit / 4),
    };
    let kept = if extent.raised { 2 * gram } else { gram };
    kept + making.max(fit).max(basis).max(prior).max(trial).max(gamma::bytes_needed(extent))
}

#[derive(Debug, thiserror::Error)]
pub enum TransferError {
    #[error(
        "{kept} of {all} training conditions light both the measurement points and the lightmap; {elements} basis elements need at least {elements}; bake more conditions or ask for fewer elements (--basis)"
    )]
    TooFewConditions { kept: usize, all: usize, elements: usize },
    #[error("the {what} holds a value that is not finite; the dataset is damaged")]
    NotFinite { what: &'static str },
    #[error(transparent)]
    Dataset(#[from] crate::dataset::DatasetError),
    #[error("the eigen-decomposition of a {size} x {size} matrix did not converge")]
    NoConvergence { size: usize },
}
