//! Comparison of methods on held-out lights, its plots and pictures, and the HTML page.

pub mod assemble;
pub mod comparison;
pub mod figures;
pub mod flip;
pub mod page;
pub mod plot;
pub mod views;

pub use comparison::{Comparison, Row};
pub use views::ViewRow;
