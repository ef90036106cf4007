//! The end of a run that did not succeed: one line and an exit status.

use std::process::ExitCode;

use super::Reporter;
use crate::dataset::DatasetError;
use crate::export::ExportError;
use crate::gpu::GpuError;
use crate::light::ScenarioError;
use crate::measure::PointsError;
use crate::model::{ModelFileError, PictureError, ViewError};
use crate::report::assemble::ReportError;
use crate::scene::SceneError;
use crate::scene_file::SceneFileError;
use crate::transfer::TransferError;
use crate::transport::BakeError;
use crate::transport::reference::ReferenceError;

/// Why a command failed.
#[derive(Debug)]
pub enum Failure {
    /// The input or the arguments are wrong (exit status 2).
    Input(String),
    /// The work itself failed (exit status 1).
    Work(String),
    /// The user stopped it (exit status 1).
    Stopped,
}

impl Failure {
    /// Prints the one line and gives the exit status.
    pub fn report(&self, reporter: &Reporter) -> ExitCode {
        match self {
            Failure::Input(line) => {
                reporter.print(&format!("error: {line}"));
                ExitCode::from(2)
            }
            Failure::Work(line) => {
                reporter.print(&format!("error: {line}"));
                ExitCode::from(1)
            }
            Failure::Stopped => {
                reporter.say_stopped();
                ExitCode::from(1)
            }
        }
    }
}

macro_rules! input_error {
    ($($error:ty),*) => {
        $(impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                Failure::Input(error.to_string())
            }
        })*
    };
}
input_error!(SceneError, SceneFileError, ScenarioError, PointsError, ViewError);

impl From<BakeError> for Failure {
    fn from(error: BakeError) -> Self {
        match error {
            BakeError::Cancelled => Failure::Stopped,
            BakeError::NotDiffuse { .. } => Failure::Input(error.to_string()),
        }
    }
}

impl From<DatasetError> for Failure {
    fn from(error: DatasetError) -> Self {
        match error {
            DatasetError::Cancelled => Failure::Stopped,
            DatasetError::Bake(error) => error.into(),
            DatasetError::Read { .. } | DatasetError::Write { .. } | DatasetError::InUse { .. } => {
                Failure::Work(error.to_string())
            }
            _ => Failure::Input(error.to_string()),
        }
    }
}

impl From<TransferError> for Failure {
    fn from(error: TransferError) -> Self {
        match error {
            TransferError::Dataset(error) => error.into(),
            _ => Failure::Input(error.to_string()),
        }
    }
}

impl From<ModelFileError> for Failure {
    fn from(error: ModelFileError) -> Self {
        match error {
            ModelFileError::Write { .. } => Failure::Work(error.to_string()),
            _ => Failure::Input(error.to_string()),
        }
    }
}

impl From<GpuError> for Failure {
    fn from(error: GpuError) -> Self {
        match error {
            GpuError::Failed(_) | GpuError::NoDevice { .. } => Failure::Work(error.to_string()),
            _ => Failure::Input(error.to_string()),
        }
    }
}

#[cfg(feature = "viewer")]
impl From<crate::viewer::ViewerError> for Failure {
    fn from(error: crate::viewer::ViewerError) -> Self {
        use crate::viewer::ViewerError;
        match error {
            ViewerError::Gpu(error) => error.into(),
            ViewerError::NoDisplay(_) => Failure::Input(error.to_string()),
            ViewerError::Failed(_) => Failure::Work(error.to_string()),
        }
    }
}

impl From<PictureError> for Failure {
    fn from(error: PictureError) -> Self {
        Failure::Work(error.to_string())
    }
}

impl From<ExportError> for Failure {
    fn from(error: ExportError) -> Self {
        match error {
            ExportError::Asset(error) => error.into(),
            _ => Failure::Work(error.to_string()),
        }
    }
}

impl From<ReferenceError> for Failure {
    fn from(error: ReferenceError) -> Self {
        match error {
            ReferenceError::View(error) => error.into(),
            ReferenceError::Stopped(error) => error.into(),
        }
    }
}

impl From<ReportError> for Failure {
    fn from(error: ReportError) -> Self {
        match error {
            ReportError::Transfer(error) => error.into(),
            ReportError::Dataset(error) => error.into(),
            ReportError::View(error) => error.into(),
            ReportError::Bake(error) => error.into(),
            ReportError::Scenario(error) => error.into(),
        }
    }
}
