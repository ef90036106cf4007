//! The lightmap's texels: which triangles lie in each, how much of them, and points on them uniform by area.
//!
//! Rasterisation is conservative: every texel square that holds a part of a triangle's UV footprint is a texel. The parts,
//! or fragments, are the triangles clipped to the square (Sutherland and Hodgman, *Reentrant Polygon Clipping*, 1974).
//! They are clipped anew on demand, so that only triangle lists are kept.

use glam::{DVec2, Vec2};

use super::{Mesh, TexelPoint};
use crate::math::warp::sample_uniform_triangle;

/// A covered texel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texel {
    /// y · size + x. Texel (x, y) covers UV [x, x+1] × [y, y+1] / size; row 0 is at v = 0.
    pub index: u32,
    /// Surface in it, m².
    pub area: f32,
}

/// The covered texels of a square lightmap, in row-major order, with the triangles in each.
///
/// [`Lightmap::new`] has every texel that holds surface; [`Lightmap::open`] those that light can reach, and of each the
/// part that it can reach.
#[derive(Clone, Debug)]
pub struct Lightmap {
    /// Texels along a side.
    pub size: usize,
    pub texels: Vec<Texel>,
    /// Texel t's triangles are `triangles[starts[t]..starts[t + 1]]`, ascending.
    starts: Vec<usize>,
    triangles: Vec<u32>,
    /// Texels of which only a part counts: position in `texels`, ascending, and the cells that count.
    parts: Vec<(u32, Cells)>,
    /// Texels with surface that were left out, in the order of their index.
    pub(super) left_out: Vec<LeftOut>,
    /// The chart of each texel; empty where every texel that holds surface is one.
    pub(super) charts: Vec<u32>,
    /// Texels astride a wall thinner than they are, which hold one side's light: what lies on the other side reads it, too.
    pub astride: usize,
}

/// A texel with surface that takes its value from another one.
#[derive(Clone, Copy, Debug)]
pub(super) struct LeftOut {
    pub index: u32,
    pub chart: u32,
    /// Whether light cannot reach it, rather than that it has hardly any surface.
    pub buried: bool,
}

/// A subset of the [`CELLS`]² square cells of a texel: bit `CELLS` · row + column.
pub(super) type Cells = u64;

/// Cells along a texel's side.
pub(super) const CELLS: usize = 8;

/// All of a texel.
pub(super) const WHOLE: Cells = Cells::MAX;

/// The part of a triangle in one texel.
#[derive(Clone, Copy, Debug)]
pub struct Fragment {
    pub triangle: u32,
    corners: [DVec2; MAX_CORNERS],
    count: usize,
    pub area_m2: f64,
    /// Share of the texel, or of the texel's cell, that it covers.
    pub coverage: f64,
}

/// A triangle cut by the four sides of a square.
const MAX_CORNERS: usize = 7;

impl Fragment {
    /// Corners of the convex polygon, in barycentric coordinates of the triangle's second and third vertex.
    pub fn polygon(&self) -> &[DVec2] {
        &self.corners[..self.count]
    }
}

impl Lightmap {
    /// The texels of a mesh whose lightmap is laid out. `size` is at most 65,535.
    pub fn new(mesh: &Mesh, size: usize) -> Self {
        let mut areas = vec![0.0f64; size * size];
        let mut counts = vec![0u32; size * size];
        let mut pairs = Vec::new();
        for triangle in 0..mesh.triangles.len() {
            Footprint::new(mesh, triangle, size).for_each_fragment(size, |index, fragment| {
                areas[index] += fragment.area_m2;
                counts[index] += 1;
                pairs.push((index as u32, triangle as u32));
            });
        }
        let mut texels = Vec::new();
        let mut starts = vec![0];
        // Where the next triangle of each texel square goes.
        let mut next = vec![0usize; size * size];
        let mut total = 0;
        for index in (0..size * size).filter(|&i| counts[i] > 0) {
            texels.push(Texel { index: index as u32, area: areas[index] as f32 });
            next[index] = total;
            total += counts[index] as usize;
            starts.push(total);
        }
        let mut triangles = vec![0; total];
        for (index, triangle) in pairs {
            let slot = &mut next[index as usize];
            triangles[*slot] = triangle;
            *slot += 1;
        }
        Self {
            size,
            texels,
            starts,
            triangles,
            parts: Vec::new(),
            left_out: Vec::new(),
            charts: Vec::new(),
            astride: 0,
        }
    }

    /// Keeps of each texel the given cells; leaves out the texels of which none are kept, and slivers. `charts` has each
    /// texel's chart.
    pub(super) fn keep(self, mesh: &Mesh, cells: &[Cells], slivers: &[bool], charts: &[u32]) -> Self {
        let mut kept = Self { texels: Vec::new(), starts: vec![0], triangles: Vec::new(), ..self.clone() };
        for (t, &cells) in cells.iter().enumerate() {
            if cells == 0 || slivers[t] {
                kept.left_out.push(LeftOut { index: self.texels[t].index, chart: charts[t], buried: cells == 0 });
                continue;
            }
            if cells != WHOLE {
                kept.parts.push((kept.texels.len() as u32, cells));
            }
            kept.texels.push(self.texels[t]);
            kept.triangles.extend(self.triangles(t));
            kept.starts.push(kept.triangles.len());
            kept.charts.push(charts[t]);
        }
        for i in 0..kept.parts.len() {
            let t = kept.parts[i].0 as usize;
            kept.texels[t].area = kept.fragments(mesh, t).iter().map(|f| f.area_m2).sum::<f64>() as f32;
        }
        kept
    }

    /// The triangles that lie in a covered texel (a position in `texels`), ascending.
    pub fn triangles(&self, texel: usize) -> &[u32] {
        &self.triangles[self.starts[texel]..self.starts[texel + 1]]
    }

    /// The parts of those triangles inside the texel, or inside the cells of it that count, in the order of the triangles
    /// in each. `mesh` is the one it was built from.
    pub fn fragments(&self, mesh: &Mesh, texel: usize) -> Vec<Fragment> {
        let index = self.texels[texel].index as usize;
        let (x, y) = (index % self.size, index / self.size);
        match self.part(texel) {
            WHOLE => self.clip(mesh, texel, self.size, (x, y)),
            part => set_bits(part)
                .flat_map(|cell| self.clip(mesh, texel, self.size * CELLS, cell_square((x, y), cell)))
                .collect(),
        }
    }

    /// The cells of a texel that count.
    pub(super) fn part(&self, texel: usize) -> Cells {
        self.parts.binary_search_by_key(&(texel as u32), |p| p.0).map_or(WHOLE, |at| self.parts[at].1)
    }

    /// Whether light can reach the surface at lightmap coordinates `uv`.
    pub(super) fn is_open_at(&self, uv: Vec2) -> bool {
        let [x, y] = (uv * self.size as f32).to_array().map(|c| c.clamp(0.0, self.size as f32 - 0.5));
        let index = y as u32 * self.size as u32 + x as u32;
        let cell = (y.fract() * CELLS as f32) as usize * CELLS + (x.fract() * CELLS as f32) as usize;
        match self.texels.binary_search_by_key(&index, |t| t.index) {
            Ok(texel) => self.part(texel) >> cell & 1 != 0,
            Err(_) => self.left_out.binary_search_by_key(&index, |l| l.index).is_ok_and(|at| !self.left_out[at].buried),
        }
    }

    /// The fragments in one cell of a texel.
    pub(super) fn cell_fragments(&self, mesh: &Mesh, texel: usize, cell: usize) -> Vec<Fragment> {
        let index = self.texels[texel].index as usize;
        let square = cell_square((index % self.size, index / self.size), cell);
        self.clip(mesh, texel, self.size * CELLS, square)
    }

    /// The texel's triangles clipped to a square of the page cut into `size` × `size`.
    fn clip(&self, mesh: &Mesh, texel: usize, size: usize, (x, y): (usize, usize)) -> Vec<Fragment> {
        let clip = |&triangle: &u32| Footprint::new(mesh, triangle as usize, size).fragment(x, y);
        self.triangles(texel).iter().filter_map(clip).collect()
    }

    /// Share of the texel that its surface covers, at most 1.
    pub(super) fn coverage(&self, mesh: &Mesh, texel: usize) -> f32 {
        let cell = if self.part(texel) == WHOLE { 1.0 } else { 1.0 / (CELLS * CELLS) as f64 };
        let sum: f64 = self.fragments(mesh, texel).iter().map(|f| f.coverage * cell).sum();
        sum.min(1.0) as f32
    }

    /// Draws points of the texel's surface.
    pub fn sampler(&self, mesh: &Mesh, texel: usize) -> TexelSampler {
        TexelSampler::new(&self.fragments(mesh, texel))
    }
}

/// The cells of a set, ascending.
pub(super) fn set_bits(cells: Cells) -> impl Iterator<Item = usize> {
    (0..CELLS * CELLS).filter(move |&cell| cells >> cell & 1 != 0)
}

/// Points on the surface inside one texel, uniform by area.
#[derive(Clone, Debug)]
pub struct TexelSampler {
    /// Triangles of the fragments' fans: mesh triangle and corners in its barycentric coordinates.
    fans: Vec<(u32, [Vec2; 3])>,
    /// Share of the area up to the end of each; the last is 1.
    cumulative: Vec<f32>,
}

impl TexelSampler {
    pub fn new(fragments: &[Fragment]) -> Self {
        let total: f64 = fragments.iter().map(|f| f.area_m2).sum();
        let mut fans = Vec::new();
        let mut cumulative: Vec<f32> = Vec::new();
        let mut sum = 0.0;
        for fragment in fragments {
            let polygon = fragment.polygon();
            let world_area = fragment.area_m2 / polygon_area(polygon);
            for pair in polygon[1..].windows(2) {
                let corners = [polygon[0], pair[0], pair[1]];
                sum += polygon_area(&corners) * world_area;
                fans.push((fragment.triangle, corners.map(|c| c.as_vec2())));
                cumulative.push((sum / total) as f32);
            }
        }
        if let Some(last) = cumulative.last_mut() {
            *last = 1.0;
        }
        Self { fans, cumulative }
    }

    /// The triangles that the texel's surface is cut into: mesh triangle, corners in its barycentric coordinates, and the share
    /// of the area up to the end of each.
    pub fn fans(&self) -> impl Iterator<Item = (u32, [Vec2; 3], f32)> + '_ {
        self.fans.iter().zip(&self.cumulative).map(|(&(triangle, corners), &end)| (triangle, corners, end))
    }

    /// The point for `u` in the unit square; equal areas of the square map to equal areas of the surface.
    pub fn sample(&self, u: [f32; 2]) -> TexelPoint {
        let fan = self.cumulative.partition_point(|&c| c <= u[0]).min(self.fans.len() - 1);
        // What is left of u[0] inside its interval serves again.
        let start = if fan == 0 { 0.0 } else { self.cumulative[fan - 1] };
        let width = (self.cumulative[fan] - start).max(f32::MIN_POSITIVE);
        let remapped = ((u[0] - start) / width).clamp(0.0, 1.0);
        let b = sample_uniform_triangle(Vec2::new(remapped, u[1]));
        let (triangle, [p, q, r]) = self.fans[fan];
        let point = (p * (1.0 - b.x - b.y) + q * b.x + r * b.y).clamp(Vec2::ZERO, Vec2::ONE);
        TexelPoint { triangle, u: point.x, v: point.y.min(1.0 - point.x) }
    }
}

/// A corner of a triangle being clipped: where it is in texels, and in barycentric coordinates.
#[derive(Clone, Copy, Default)]
struct Corner {
    texel: DVec2,
    barycentric: DVec2,
}

/// A convex polygon of at most [`MAX_CORNERS`] corners.
#[derive(Clone, Copy, Default)]
struct Polygon {
    corners: [Corner; MAX_CORNERS],
    count: usize,
}

impl Polygon {
    /// The part where coordinate `axis` is at least `limit` (`side` = 1) or at most (`side` = −1).
    fn clipped(&self, axis: usize, limit: f64, side: f64) -> Polygon {
        let mut clipped = Polygon::default();
        let mut push = |corner: Corner| {
            // Rounding could make one corner too many of a sliver; it has no area.
            if clipped.count < MAX_CORNERS {
                clipped.corners[clipped.count] = corner;
                clipped.count += 1;
            }
        };
        for i in 0..self.count {
            let (a, b) = (self.corners[i], self.corners[(i + 1) % self.count]);
            let (da, db) = ((a.texel[axis] - limit) * side, (b.texel[axis] - limit) * side);
            if da >= 0.0 {
                push(a);
            }
            if (da > 0.0 && db < 0.0) || (da < 0.0 && db > 0.0) {
                let t = da / (da - db);
                let mut texel = a.texel.lerp(b.texel, t);
                texel[axis] = limit;
                push(Corner { texel, barycentric: a.barycentric.lerp(b.barycentric, t) });
            }
        }
        clipped
    }

    fn extent(&self, axis: usize) -> (f64, f64) {
        let along = self.corners[..self.count].iter().map(|c| c.texel[axis]);
        along.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), x| (lo.min(x), hi.max(x)))
    }
}

/// A triangle's place in the lightmap.
struct Footprint {
    triangle: u32,
    polygon: Polygon,
    area_m2: f64,
}

impl Footprint {
    fn new(mesh: &Mesh, triangle: usize, size: usize) -> Self {
        let [a, b, c] = mesh.triangle_positions(triangle).map(|p| p.as_dvec3());
        let area_m2 = 0.5 * (b - a).cross(c - a).length();
        let mut polygon = Polygon { count: 3, ..Default::default() };
        for (corner, barycentric) in [DVec2::ZERO, DVec2::X, DVec2::Y].into_iter().enumerate() {
            let uv = mesh.lightmap_uvs[mesh.triangles[triangle][corner] as usize].as_dvec2();
            polygon.corners[corner] = Corner { texel: uv * size as f64, barycentric };
        }
        Self { triangle: triangle as u32, polygon, area_m2 }
    }

    fn for_each_fragment(&self, size: usize, mut visit: impl FnMut(usize, Fragment)) {
        for y in texel_range(self.polygon.extent(1), size) {
            let row = self.row(y);
            for x in texel_range(row.extent(0), size) {
                if let Some(fragment) = self.in_column(&row, x) {
                    visit(y * size + x, fragment);
                }
            }
        }
    }

    fn fragment(&self, x: usize, y: usize) -> Option<Fragment> {
        self.in_column(&self.row(y), x)
    }

    fn row(&self, y: usize) -> Polygon {
        self.polygon.clipped(1, y as f64, 1.0).clipped(1, (y + 1) as f64, -1.0)
    }

    /// The part of a row's polygon in column x, if it has an area.
    fn in_column(&self, row: &Polygon, x: usize) -> Option<Fragment> {
        let polygon = row.clipped(0, x as f64, 1.0).clipped(0, (x + 1) as f64, -1.0);
        let corners = polygon.corners.map(|c| c.barycentric);
        // The whole triangle has the area 1/2 in barycentric coordinates.
        let area_m2 = polygon_area(&corners[..polygon.count]) * 2.0 * self.area_m2;
        let coverage = polygon_area(&polygon.corners.map(|c| c.texel)[..polygon.count]);
        let some = area_m2 > 0.0 && coverage > 0.0;
        some.then_some(Fragment { triangle: self.triangle, corners, count: polygon.count, area_m2, coverage })
    }
}

/// The square of a texel's cell, counted in cells over the whole page.
fn cell_square((x, y): (usize, usize), cell: usize) -> (usize, usize) {
    (x * CELLS + cell % CELLS, y * CELLS + cell / CELLS)
}

/// Texels that an interval in texels reaches into.
fn texel_range((lo, hi): (f64, f64), size: usize) -> std::ops::Range<usize> {
    // `as` saturates; an empty polygon has an empty interval.
    let first = lo.floor().max(0.0) as usize;
    let end = (hi.ceil().max(0.0) as usize).min(size);
    first..end.max(first)
}

/// Area of a convex polygon, as a fan from its first corner.
fn polygon_area(corners: &[DVec2]) -> f64 {
    let Some((&first, rest)) = corners.split_first() else { return 0.0 };
    let doubled: f64 = rest.windows(2).map(|w| (w[0] - first).perp_dot(w[1] - first)).sum();
    0.5 * doubled.abs()
}
