//! The path tracer: paths that all lighting conditions share, and what is collected along them.

pub mod conditions;
pub mod emitters;
pub mod path;

pub use emitters::Emitters;
pub use path::{Collector, Walk};
