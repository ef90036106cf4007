//! Where transfer arrives: the texels of the lightmap, or the mesh's vertices, which texels interpolate between.

use glam::Vec3;
use rayon::prelude::*;

use crate::math::{Rgb, Sampler};
use crate::scene::{Asset, Lightmap, Mesh, Surface};

/// Surface points that share a transfer vector.
pub trait Receivers: Sync {
    fn count(&self) -> usize;

    /// Draws a point of one receiver from u in [0, 1)²; none where the receiver has no surface.
    fn points(&self, receiver: usize) -> impl Fn([f32; 2]) -> Option<Surface>;
}

/// One receiver per covered texel, its points uniform by area.
pub struct TexelReceivers<'l, 'a> {
    pub asset: &'a Asset,
    pub lightmap: &'l Lightmap,
}

impl Receivers for TexelReceivers<'_, '_> {
    fn count(&self) -> usize {
        self.lightmap.texels.len()
    }

    fn points(&self, receiver: usize) -> impl Fn([f32; 2]) -> Option<Surface> {
        let sampler = self.lightmap.sampler(&self.asset.mesh, receiver);
        move |u| {
            let point = sampler.sample(u);
            Some(self.asset.surface(point.triangle as usize, point.u, point.v, Vec3::ZERO))
        }
    }
}

/// One receiver per vertex.
pub struct VertexReceivers<'a> {
    asset: &'a Asset,
    /// Vertex v has `corners[starts[v]..starts[v + 1]]`.
    starts: Vec<usize>,
    /// Triangle, and which of its corners the vertex is.
    corners: Vec<(u32, u8)>,
}

/// How far into its triangles a vertex receives, as a share of the way to their opposite sides: a vertex in a corner of a
/// room must not lie in the other walls.
const INWARDS: f32 = 0.01;

impl<'a> VertexReceivers<'a> {
    pub fn new(asset: &'a Asset) -> Self {
        let mesh = &asset.mesh;
        let mut of_vertex: Vec<Vec<(u32, u8)>> = vec![Vec::new(); mesh.positions.len()];
        for (t, triangle) in mesh.triangles.iter().enumerate() {
            for (corner, &v) in triangle.iter().enumerate() {
                of_vertex[v as usize].push((t as u32, corner as u8));
            }
        }
        let mut starts = vec![0];
        starts.extend(of_vertex.iter().scan(0, |end, corners| {
            *end += corners.len();
            Some(*end)
        }));
        Self { asset, starts, corners: of_vertex.concat() }
    }
}

impl Receivers for VertexReceivers<'_> {
    fn count(&self) -> usize {
        self.starts.len() - 1
    }

    fn points(&self, receiver: usize) -> impl Fn([f32; 2]) -> Option<Surface> {
        let corners = &self.corners[self.starts[receiver]..self.starts[receiver + 1]];
        move |u| {
            let &(triangle, corner) = corners.get((u[0] * corners.len() as f32) as usize)?;
            let mut barycentric = [0.5 * INWARDS; 3];
            barycentric[corner as usize] = 1.0 - INWARDS;
            Some(self.asset.surface(triangle as usize, barycentric[1], barycentric[2], Vec3::ZERO))
        }
    }
}

/// Values at lightmap texels as weighted means of values at vertices.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VertexWeights {
    /// Texel t has `entries[starts[t]..starts[t + 1]]`.
    starts: Vec<usize>,
    /// Vertex and weight; the weights of a texel add up to 1.
    entries: Vec<(u32, f32)>,
}

/// Points per texel over which interpolated values are averaged.
const POINTS_PER_TEXEL: u32 = 16;

impl VertexWeights {
    /// The mean over each texel of the interpolation between the vertices of its triangles.
    pub fn new(mesh: &Mesh, lightmap: &Lightmap) -> Self {
        let of_texel: Vec<Vec<(u32, f32)>> = (0..lightmap.texels.len())
            .into_par_iter()
            .map(|texel| {
                let points = lightmap.sampler(mesh, texel);
                let mut weights: Vec<(u32, f32)> = Vec::new();
                for i in 0..POINTS_PER_TEXEL {
                    let [u0, u1, ..] = Sampler::new(0, lightmap.texels[texel].index as u64, i).next_4d();
                    let point = points.sample([u0, u1]);
                    let barycentric = [1.0 - point.u - point.v, point.u, point.v];
                    for (&vertex, b) in mesh.triangles[point.triangle as usize].iter().zip(barycentric) {
                        let weight = b / POINTS_PER_TEXEL as f32;
                        match weights.iter_mut().find(|(v, _)| *v == vertex) {
                            Some((_, sum)) => *sum += weight,
                            None => weights.push((vertex, weight)),
                        }
                    }
                }
                weights
            })
            .collect();
        let mut starts = vec![0];
        starts.extend(of_texel.iter().scan(0, |end, weights| {
            *end += weights.len();
            Some(*end)
        }));
        Self { starts, entries: of_texel.concat() }
    }

    /// From one value per vertex to one per texel.
    pub fn interpolate(&self, at_vertices: &[Rgb]) -> Vec<Rgb> {
        let entries = self.starts.windows(2).map(|w| &self.entries[w[0]..w[1]]);
        entries.map(|e| e.iter().map(|&(vertex, weight)| at_vertices[vertex as usize] * weight).sum()).collect()
    }
}
