//! Comparison of methods on held-out lights, its plots and pictures, and the HTML page.

pub mod figures;
pub mod plot;


/// A picture with what it shows.
pub struct Image {
    pub caption: String,
    pub png: Vec<u8>,
}
