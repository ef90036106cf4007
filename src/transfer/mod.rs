//! From a dataset (D, I) to a basis and a transfer matrix: the two ways to train, the choice of λ, and their error.
//!
//! Everything happens in the small space of training vectors. The Gram matrix of all lightmaps, held-out ones included, is
//! computed once ([`Gram`]); bases, transfer matrices, oracles and errors for any method and size then follow from it
//! without touching a lightmap again, and only the chosen basis is expanded to texels ([`Fit::basis_values`]).

pub mod error;
pub mod fit;
pub mod gram;
pub mod ridge;
pub mod scope;

use crate::dataset::ROWS;
use crate::model::Channels;

pub use error::{ErrorSummary, HeldOutErrors};
pub use fit::{Fit, Lambda, Method, PUBLISHED_LAMBDA, TrainSettings};
pub use gram::Gram;
pub use scope::fit_scope;

/// Bytes that training takes at most: the Gram matrix, and beside it what makes it, the fit (the weighted and the centred
/// matrix, the eigenvectors, their copy in falling order and the solver's own), or the basis over texels and the model file.
pub fn bytes_needed(
    channels: Channels,
    elements: usize,
    training: usize,
    conditions: usize,
    points: usize,
    texels: usize,
    lightmap_size: usize,
) -> u64 {
    let components = if channels == Channels::Mono { 1 } else { 3 };
    let [elements, training, points, texels] = [elements, training, points, texels].map(|n| n as u64);
    let page = (lightmap_size * lightmap_size) as u64;
    let (width, vectors) = (3 * conditions as u64, training * 3 / components);
    let gram = 8 * width * width;
    let making = gram / 2 + ROWS as u64 * width * (8 + 4 + 2);
    let fit = 7 * 8 * vectors * vectors + 4 * 8 * 3 * points * training;
    let values = texels * elements * components * 4;
    let halves = page * elements * components * 2;
    // The nearest covered texel of each is found for the gutter; the model's bytes are laid out twice before they are written.
    let basis = (values + halves + 16 * page).max(3 * halves);
    gram + making.max(fit).max(basis)
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
