//! Light kinds in glTF's units, the lighting condition, and the scenarios that conditions are drawn from.

pub mod condition;
pub mod gather;
pub mod table;

pub use condition::{Light, LightingCondition};
pub use gather::{Arrived, LightGather};
pub use table::LightTable;
