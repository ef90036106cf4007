//! What can go wrong with a dataset's folder.

use std::path::{Path, PathBuf};

use crate::transport::BakeError;

#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    #[error("stopped")]
    Cancelled,
    #[error(transparent)]
    Bake(BakeError),
    #[error("{}: cannot be read: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error(
        "{}: cannot be written: {source}; what was baked is kept: make room or choose another folder (--dataset), and the same command goes on from there",
        path.display()
    )]
    Write { path: PathBuf, source: std::io::Error },
    #[error("{}: not a dataset: {why}; choose another folder with --dataset", path.display())]
    NotADataset { path: PathBuf, why: String },
    #[error("{}: another relight is at work in this folder; wait for it, or choose another folder with --dataset", path.display())]
    InUse { path: PathBuf },
    #[error(
        "{}: is not the dataset of this run: {changes}; take the old settings back, choose another folder with --dataset, or remove this one to bake anew",
        path.display()
    )]
    Stale { path: PathBuf, changes: String },
    #[error("{}: damaged: {why}; remove this file, and the same command bakes what was in it anew", path.display())]
    Damaged { path: PathBuf, why: String },
    /// A rendered dataset that cannot be used.
    #[error("{}: {why}", path.display())]
    Rendered { path: PathBuf, why: String },
    #[error("--memory {ceiling} is too little: {what} needs {needed}{advice}")]
    Memory { ceiling: super::Bytes, what: String, needed: super::Bytes, advice: String },
}

impl From<BakeError> for DatasetError {
    fn from(error: BakeError) -> Self {
        match error {
            BakeError::Cancelled => DatasetError::Cancelled,
            other => DatasetError::Bake(other),
        }
    }
}

/// Names the file that could not be written.
pub(super) fn unwritable(path: &Path) -> impl Fn(std::io::Error) -> DatasetError {
    |source| DatasetError::Write { path: path.to_owned(), source }
}

/// Names the file that could not be read.
pub(super) fn unreadable(path: &Path) -> impl Fn(std::io::Error) -> DatasetError {
    |source| DatasetError::Read { path: path.to_owned(), source }
}
