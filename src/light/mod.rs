//! Light kinds in glTF's units, the lighting condition, and the scenarios that conditions are drawn from.
//!
//! Light is evaluated in two ways. A [`LightTable`] holds a fixed set of points and directions that stands for all lights,
//! area lights and environments included: the same wherever direct light is measured or shaded, on the CPU and the GPU. A
//! [`LightSet`] is for path tracing: area lights and environments are sampled anew at each surface point.

pub mod area;
pub mod condition;
#[cfg(feature = "train")]
pub mod draw;
#[cfg(feature = "train")]
pub mod edit;
pub mod emitters;
pub mod environment;
pub mod facets;
pub mod gather;
pub mod image;
#[cfg(feature = "train")]
pub mod motion;
#[cfg(feature = "train")]
pub mod path;
#[cfg(feature = "train")]
pub mod sampled;
#[cfg(feature = "train")]
pub mod scenario;
#[cfg(feature = "train")]
pub mod set;
pub mod sky;
pub mod table;
#[cfg(feature = "train")]
pub mod track;

pub use condition::{Light, LightingCondition};
#[cfg(feature = "train")]
pub use draw::ScenarioSampler;
pub use emitters::{EmissionFacets, Emitters};
pub use environment::EnvironmentMap;
pub use gather::{Arrived, LightGather};
pub use image::EnvironmentImage;
#[cfg(feature = "train")]
pub use image::{EnvironmentError, EnvironmentImages};
#[cfg(feature = "train")]
pub use path::{LightPath, LightPathError};
#[cfg(feature = "train")]
pub use sampled::{Sampled, SampledGather};
#[cfg(feature = "train")]
pub use scenario::{Kind, KindWeights, Scenario, ScenarioError};
#[cfg(feature = "train")]
pub use set::LightSet;
pub use sky::Sky;
pub use table::{LightEntry, LightTable};
