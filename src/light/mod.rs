//! Light kinds in glTF's units, the lighting condition, and the scenarios that conditions are drawn from.

pub mod condition;
pub mod shadowed;
pub mod table;

pub use condition::{Light, LightingCondition};
pub use shadowed::shadowed_irradiance;
pub use table::LightTable;
