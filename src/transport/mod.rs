//! The path tracer: paths that all lighting conditions share, and what is collected along them.

pub mod adjoint;
pub mod bake;
mod bias;
pub mod conditions;
mod gather;
pub mod path;
pub mod reference;

pub use adjoint::{Adjoint, Deposit};
pub use bake::{BakeError, BakeSettings, Baked, BakedTexels, Baker, Integrator, NoiseSums, TILE, bake, bake_direct};
pub use bias::Bias;
pub use conditions::{Collected, LightSums};
pub use path::{Collector, Walk};
