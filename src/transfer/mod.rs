//! From a dataset (D, I) to a basis and a transfer matrix: the two ways to train, the choice of λ, and their error.
//!
//! Everything happens in the small space of training vectors. The Gram matrix of all lightmaps, held-out ones included, is
//! computed once ([`Gram`]); bases, transfer matrices, oracles and errors for any method and size then follow from it
//! without touching a lightmap again, and only the chosen basis is expanded to texels ([`Fit::basis_values`]).

pub mod error;
pub mod fit;
pub mod gram;
pub mod ridge;

pub use error::{ErrorSummary, HeldOutErrors};
pub use fit::{Fit, Lambda, Method, PUBLISHED_LAMBDA, TrainSettings};
pub use gram::Gram;

#[derive(Debug, thiserror::Error)]
pub enum TransferError {
    #[error(
        "{kept} of {all} training conditions light both the measurement points and the lightmap; {elements} basis elements need at least {elements}; bake more conditions or ask for fewer elements (--basis)"
    )]
    TooFewConditions { kept: usize, all: usize, elements: usize },
    #[error("the {what} holds a value that is not finite; the dataset is damaged")]
    NotFinite { what: &'static str },
    #[error("the eigen-decomposition of a {size} x {size} matrix did not converge")]
    NoConvergence { size: usize },
}
