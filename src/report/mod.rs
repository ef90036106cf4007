//! Comparison of methods on held-out lights, its figures and pictures, and the HTML page.

pub mod assemble;
pub mod comparison;
pub mod cost;
pub mod figures;
pub mod fits;
pub mod flip;
pub mod page;
pub mod pictures;
pub mod plot;
pub mod table;
pub mod temporal;
pub mod views;

pub use comparison::{Comparison, Row};
pub use views::ViewRow;
