//! Light kinds in glTF's units, the lighting condition, and the scenarios that conditions are drawn from.

pub mod condition;
pub mod table;

pub use condition::{Light, LightingCondition};
pub use table::LightTable;
