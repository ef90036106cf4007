//! Light kinds in glTF's units, the lighting condition, and the scenarios that conditions are drawn from.

pub mod condition;
pub mod draw;
pub mod gather;
pub mod scenario;
pub mod table;

pub use condition::{Light, LightingCondition};
pub use draw::ScenarioSampler;
pub use gather::{Arrived, LightGather};
pub use scenario::{Scenario, ScenarioError};
pub use table::LightTable;
