//! Ray tracing against the asset's triangles: one ray to its closest hit, and packets of shadow rays that share an origin.
//!
//! Small meshes are tested whole ([`brute`]), larger ones through a bounding volume hierarchy ([`wide`]). Both decide by the
//! same exact test what is hit, so they find the same hits, but for rounding of where; neither has gaps between triangles.

mod block;
mod brute;
mod collapse;
mod fans;
mod lanes;
mod packet;
mod pieces;
mod ray;
mod shadow;
mod simd;
mod simd16;
#[cfg(test)]
mod tests;
mod wide;

use glam::Vec3;

use self::block::Nearest;
use self::brute::Brute;
pub use self::lanes::{above_zero, lanes, mask_of, packed};
pub use self::packet::Hits;
pub use self::shadow::ShadowRays;
use self::wide::WideBvh;
use super::{Aabb, Asset, Hit, Surface};
use crate::math::LANES;

/// Meshes of at most this many triangles are tested whole. Of triangles strewn at random, of which no two make a
/// parallelogram, single rays break even with the trees above 240 triangles and shadow packets for 128 lights far above; of
/// boxes, at 480. `benches/trace.rs` measures it.
const BRUTE_FORCE_LIMIT: usize = 256;

/// [`Tracer::offset`] over [`Tracer::extent`]. Positions carry a rounding error of about 1e-7 of the extent; this stays well
/// above it and well below a texel.
pub const RELATIVE_OFFSET: f32 = 1e-5;

/// Vectors from a point to LANES lights, structure of arrays.
pub type Segments = [[f32; LANES]; 3];

/// Traces rays against one asset.
pub struct Tracer<'a> {
    asset: &'a Asset,
    /// Whether each triangle's material cuts out where alpha is low.
    masked: Vec<bool>,
    structure: Structure,
    /// Metres by which a ray's origin is moved off its surface.
    pub offset: f32,
    /// Metres: no segment between two points of the asset is longer.
    pub extent: f32,
}

/// How a tracer searches its triangles; the answers are the same to within rounding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Search {
    /// All of them.
    Brute,
    /// Through a bounding volume hierarchy.
    Tree,
}

enum Structure {
    Brute(Brute),
    Tree(WideBvh),
}

impl<'a> Tracer<'a> {
    pub fn new(asset: &'a Asset) -> Self {
        let small = asset.mesh.triangles.len() <= BRUTE_FORCE_LIMIT;
        Self::with_search(asset, if small { Search::Brute } else { Search::Tree })
    }

    /// A tracer that searches as told; [`Self::new`] takes the faster way.
    pub fn with_search(asset: &'a Asset, search: Search) -> Self {
        let mesh = &asset.mesh;
        let triangles: Vec<[Vec3; 3]> = (0..mesh.triangles.len()).map(|t| mesh.triangle_positions(t)).collect();
        let masked: Vec<bool> =
            mesh.triangle_materials.iter().map(|&m| asset.materials[m as usize].alpha_cutoff.is_some()).collect();
        let extent = mesh.bounds().diagonal();
        let structure = match search {
            Search::Brute => Structure::Brute(Brute::new(&triangles, &masked)),
            Search::Tree => Structure::Tree(WideBvh::new(&triangles, &masked)),
        };
        Self { asset, masked, structure, offset: extent * RELATIVE_OFFSET, extent }
    }

    pub fn asset(&self) -> &'a Asset {
        self.asset
    }

    /// The nearest hit with 0 < t < `t_max`.
    #[inline]
    pub fn closest_hit(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<Hit> {
        let mut nearest = Nearest::below(t_max);
        match &self.structure {
            Structure::Brute(brute) => brute.closest(origin, direction, &mut nearest, |h| self.solid(h)),
            Structure::Tree(tree) => tree.closest(origin, direction, &mut nearest, |h| self.solid(h)),
        }
        (nearest.hit.t < t_max).then_some(nearest.hit)
    }

    /// Whether anything lies on the open segment from `origin` along `segment`.
    #[inline]
    pub fn occluded(&self, origin: Vec3, segment: Vec3) -> bool {
        match &self.structure {
            Structure::Brute(brute) => brute.occluded(origin, segment, SEGMENT_END, |hit| self.solid(hit)),
            Structure::Tree(tree) => tree.occluded(origin, segment, SEGMENT_END, |hit| self.solid(hit)),
        }
    }

    /// The surface at a hit of a ray along `direction`.
    pub fn surface(&self, hit: &Hit, direction: Vec3) -> Surface {
        self.asset.surface(hit.triangle as usize, hit.u, hit.v, direction)
    }

    /// Where a ray that leaves `surface` along `direction` starts: just off the surface, on the side that it leaves to.
    pub fn leave(&self, surface: &Surface, direction: Vec3) -> Vec3 {
        surface.position + surface.geometric_normal * self.offset.copysign(surface.geometric_normal.dot(direction))
    }

    /// Shadow rays against this asset, to be aimed from one point after another. `targets` bounds the lights that they go
    /// to, `None` where some are infinitely far.
    pub fn shadow_rays(&self, targets: Option<Aabb>) -> ShadowRays<'_, 'a> {
        ShadowRays::new(self, targets)
    }

    /// Whether the material is present at a hit.
    fn solid(&self, hit: &Hit) -> bool {
        !self.masked[hit.triangle as usize] || !self.asset.is_cut_out(hit.triangle as usize, hit.u, hit.v)
    }
}

/// A segment ends just before the light, so that a light on a surface is not hidden by it.
const SEGMENT_END: f32 = 1.0 - 1e-4;
