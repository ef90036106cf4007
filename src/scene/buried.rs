//! Which texels, and which parts of them, light can reach: a floor that runs on under a wall is dark there, and would
//! bleed that dark, or the next room's light, into the room by interpolation.
//!
//! A texel that other geometry cuts is divided into the regions between which a point just above the surface can move;
//! regions that are buried in a solid do not count, and of the others only the largest does. All of it is a function of
//! the mesh alone, not of lights.

use glam::{DVec2, Vec2, Vec3};
use rayon::prelude::*;

use super::proximity::Proximity;
use super::texels::{CELLS, Cells, WHOLE, set_bits};
use super::uv_check::charts;
use super::{Aabb, Fragment, Lightmap, Mesh, Surface, TexelPoint, TexelSampler, Tracer};
use crate::math::{Frame, Sampler, warp};

/// Height above the surface at which it is asked what cuts a texel, relative to the texel's diagonal: things lower than
/// that lie on the surface rather than cut it.
const RELATIVE_HEIGHT: f32 = 1.0 / 16.0;

/// Paths from a region by which it is judged.
const PATHS: u32 = 32;

/// Of these, the most that may come out into the open from a buried region: cracks of a solid.
const MOST_OPEN: u8 = 1;

/// Reflections that a path may take among front faces that themselves lie in a solid.
const MAX_BOUNCES: u32 = 4;

/// A texel with less surface than this share of it takes a neighbour's value: a sliver on a chart's border lies so near
/// to the adjoining wall that rounding decides on which side of it paths start.
const SLIVER: f64 = 1.0 / (CELLS * CELLS) as f64;

/// A texel with more than this share of it on either side of a wall shows one room's light in the other.
const MUCH: f64 = 1.0 / 4.0;

/// A fixed seed: whether a texel is buried is no matter of the bake's randomness.
const SEED: u64 = 0x6275_7269_6564;

impl Lightmap {
    /// The texels of the asset's lightmap that light can reach, each with the part of it that light can reach.
    ///
    /// A chart that is buried whole stays as it is: nobody may see it, or light may reach it after all (inside a shell
    /// whose faces look outwards).
    pub fn open(tracer: &Tracer, size: usize) -> Self {
        let mesh = &tracer.asset().mesh;
        let all = Self::new(mesh, size);
        let triangle_charts = charts(mesh, &mesh.lightmap_uvs);
        let judge = Judge { tracer, proximity: Proximity::new(mesh), mesh, lightmap: &all };
        let count = all.texels.len();
        let judged: Vec<Judged> = (0..count).into_par_iter().map(|t| judge.cells(t)).collect();
        let chart_of = |t: usize| {
            let largest = all.clip_largest(mesh, t);
            triangle_charts[largest as usize]
        };
        let texel_charts: Vec<u32> = (0..count).into_par_iter().map(chart_of).collect();
        let mut cells: Vec<Cells> = judged.iter().map(|j| j.cells).collect();
        let astride = judged.iter().filter(|j| j.astride).count();
        judge.refine_edges(&mut cells, &texel_charts);
        let slivers = judge.slivers(&judged, &cells, &texel_charts);
        let mut chart_is_open = vec![false; mesh.triangles.len()];
        (0..count).filter(|&t| cells[t] != 0).for_each(|t| chart_is_open[texel_charts[t] as usize] = true);
        for t in (0..count).filter(|&t| !chart_is_open[texel_charts[t] as usize]) {
            cells[t] = WHOLE;
        }
        drop(judge);
        let mut kept = all.keep(mesh, &cells, &slivers, &texel_charts);
        kept.astride = astride;
        kept
    }

    /// The triangle with the most surface in a texel.
    fn clip_largest(&self, mesh: &Mesh, texel: usize) -> u32 {
        if let [only] = self.triangles(texel) {
            return *only;
        }
        let fragments = self.fragments(mesh, texel);
        let largest = fragments.iter().max_by(|a, b| a.area_m2.total_cmp(&b.area_m2));
        largest.map_or(self.triangles(texel)[0], |f| f.triangle)
    }
}

struct Judge<'t, 'a> {
    tracer: &'t Tracer<'a>,
    proximity: Proximity,
    mesh: &'t Mesh,
    lightmap: &'t Lightmap,
}

/// What is found of a texel.
struct Judged {
    /// Those that count.
    cells: Cells,
    /// Share of the texel that its surface covers.
    coverage: f64,
    /// Whether it lies astride a wall with rooms on both sides.
    astride: bool,
}

/// A cell of a texel that holds surface.
struct Cell {
    bit: usize,
    area_m2: f64,
    /// What is in it.
    fragments: Vec<Fragment>,
    /// A point of it, and the same moved off the surface.
    middle: TexelPoint,
    above: Vec3,
}

impl Judge<'_, '_> {
    fn cells(&self, t: usize) -> Judged {
        let fragments = self.lightmap.fragments(self.mesh, t);
        let coverage = fragments.iter().map(|f| f.coverage).sum();
        let obstacles = self.obstacles(t, &fragments);
        if obstacles.0.is_empty() {
            let buried = self.is_buried(&TexelSampler::new(&fragments), t as u64);
            return Judged { cells: if buried { 0 } else { WHOLE }, coverage, astride: false };
        }
        let cells = self.cells_of(t, obstacles.1);
        let regions = regions(&cells, |a, b| {
            obstacles.0.iter().any(|&o| crosses(a, b, &self.mesh.triangle_positions(o as usize)))
        });
        let is_open = |region: &&Vec<usize>| {
            // From the middle of cells: their other points may lie across the obstacle.
            !is_enclosed(self.tracer, t as u64, |[u, _]| {
                let cell = &cells[region[((u * region.len() as f32) as usize).min(region.len() - 1)]];
                self.tracer.asset().surface(cell.middle.triangle as usize, cell.middle.u, cell.middle.v, Vec3::ZERO)
            })
        };
        let open: Vec<&Vec<usize>> = regions.iter().filter(is_open).collect();
        let area = |region: &Vec<usize>| region.iter().map(|&c| cells[c].area_m2).sum::<f64>();
        // Of equal ones the last, always the same.
        let kept = open.iter().max_by(|a, b| area(a).total_cmp(&area(b)));
        let all: f64 = cells.iter().map(|c| c.area_m2).sum();
        let astride = open.iter().filter(|region| area(region) > MUCH * all).count() > 1;
        let cells = match kept {
            Some(kept) if kept.len() == cells.len() => WHOLE,
            kept => kept.into_iter().copied().flatten().fold(0, |bits, &c| bits | 1 << cells[c].bit),
        };
        Judged { cells, coverage, astride }
    }

    /// Triangles that cut the space just above the texel's surface, and how high that is, metres.
    fn obstacles(&self, t: usize, fragments: &[Fragment]) -> (Vec<u32>, f32) {
        let corners: Vec<Vec3> =
            fragments.iter().flat_map(|f| f.polygon().iter().map(|&b| self.position(f.triangle, b))).collect();
        let bounds = Aabb::from_points(&corners);
        let height = (bounds.diagonal() * RELATIVE_HEIGHT).max(self.tracer.offset);
        let bounds = Aabb { min: bounds.min - height, max: bounds.max + height };
        let own = self.lightmap.triangles(t);
        let mut obstacles = Vec::new();
        self.proximity.for_each_near(&bounds, |candidate| {
            if own.binary_search(&candidate).is_ok() || self.tracer.asset().may_be_cut_out(candidate as usize) {
                return;
            }
            let corners = self.mesh.triangle_positions(candidate as usize);
            let of_candidate = Aabb::from_points(&corners);
            if of_candidate.min.cmpgt(bounds.max).any() || of_candidate.max.cmplt(bounds.min).any() {
                return;
            }
            let cuts = |triangle: &u32| {
                let normal = self.normal(*triangle);
                let origin = self.mesh.triangle_positions(*triangle as usize)[0];
                let [a, b, c] = corners.map(|p| normal.dot(p - origin) - height);
                a.min(b).min(c) < 0.0 && a.max(b).max(c) > 0.0
            };
            if own.iter().any(cuts) {
                obstacles.push(candidate);
            }
        });
        obstacles.sort_unstable();
        (obstacles, height)
    }

    fn cells_of(&self, t: usize, height: f32) -> Vec<Cell> {
        let cell = |bit: usize| {
            let fragments = self.lightmap.cell_fragments(self.mesh, t, bit);
            let largest = fragments.iter().max_by(|a, b| a.area_m2.total_cmp(&b.area_m2))?;
            let polygon = largest.polygon();
            let centre = polygon.iter().sum::<DVec2>() / polygon.len() as f64;
            let above = self.position(largest.triangle, centre) + self.normal(largest.triangle) * height;
            let middle = TexelPoint { triangle: largest.triangle, u: centre.x as f32, v: centre.y as f32 };
            Some(Cell { bit, area_m2: fragments.iter().map(|f| f.area_m2).sum(), middle, above, fragments })
        };
        (0..CELLS * CELLS).filter_map(cell).collect()
    }

    /// Whether a solid encloses the surface that `points` draws from.
    fn is_buried(&self, points: &TexelSampler, stream: u64) -> bool {
        is_enclosed(self.tracer, stream, |u| {
            let point = points.sample(u);
            self.tracer.asset().surface(point.triangle as usize, point.u, point.v, Vec3::ZERO)
        })
    }

    /// Texels that nothing cuts but that lie beside buried ones, as at the edge of a rug or under a sunken stone, are
    /// judged cell by cell.
    fn refine_edges(&self, cells: &mut [Cells], charts: &[u32]) {
        let by_index = self.positions();
        let edge: Vec<usize> = (0..cells.len())
            .filter(|&t| cells[t] == WHOLE)
            .filter(|&t| self.neighbours(&by_index, t).any(|other| cells[other] == 0 && charts[other] == charts[t]))
            .collect();
        let refined: Vec<Cells> = edge
            .par_iter()
            .map(|&t| {
                let all = self.cells_of(t, 0.0);
                let buried = |cell: &Cell| self.is_buried(&TexelSampler::new(&cell.fragments), t as u64);
                let open = all.iter().filter(|cell| !buried(cell)).fold(0, |bits, cell| bits | 1 << cell.bit);
                let some_buried = set_bits(open).count() < all.len();
                if some_buried { open } else { WHOLE }
            })
            .collect();
        edge.into_iter().zip(refined).for_each(|(t, refined)| cells[t] = refined);
    }

    /// Texels with hardly any surface, or hardly any that counts, that have a neighbour in their chart with more.
    fn slivers(&self, judged: &[Judged], cells: &[Cells], charts: &[u32]) -> Vec<bool> {
        let by_index = self.positions();
        let covers = |t: usize| match cells[t] {
            0 => 0.0,
            WHOLE => judged[t].coverage,
            part => judged[t].coverage.min(set_bits(part).count() as f64 * SLIVER),
        };
        let is_sliver = |t: usize| {
            let stands_in = |other: usize| charts[other] == charts[t] && covers(other) > SLIVER;
            cells[t] != 0 && covers(t) <= SLIVER && self.neighbours(&by_index, t).any(stands_in)
        };
        (0..cells.len()).map(is_sliver).collect()
    }

    /// For every texel of the page its position in `texels`, `u32::MAX` where there is none.
    fn positions(&self) -> Vec<u32> {
        let mut positions = vec![u32::MAX; self.lightmap.size * self.lightmap.size];
        self.lightmap.texels.iter().enumerate().for_each(|(t, texel)| positions[texel.index as usize] = t as u32);
        positions
    }

    /// The up to eight texels around texel `t`.
    fn neighbours(&self, positions: &[u32], t: usize) -> impl Iterator<Item = usize> {
        let size = self.lightmap.size as i64;
        let index = self.lightmap.texels[t].index as i64;
        let (x, y) = (index % size, index / size);
        (0..9).filter(|&i| i != 4).filter_map(move |i| {
            let (x, y) = (x + i % 3 - 1, y + i / 3 - 1);
            let inside = (0..size).contains(&x) && (0..size).contains(&y);
            let found = inside.then(|| positions[(y * size + x) as usize])?;
            (found != u32::MAX).then_some(found as usize)
        })
    }

    fn position(&self, triangle: u32, b: DVec2) -> Vec3 {
        let [p, q, r] = self.mesh.triangle_positions(triangle as usize);
        p + (q - p) * b.x as f32 + (r - p) * b.y as f32
    }

    fn normal(&self, triangle: u32) -> Vec3 {
        self.mesh.triangle_cross(triangle as usize).normalize_or_zero()
    }
}

/// Whether a solid encloses surface that `start` draws from, but for cracks.
pub(super) fn is_enclosed(tracer: &Tracer, stream: u64, start: impl Fn([f32; 2]) -> Surface) -> bool {
    !comes_out(tracer, stream, f32::from(MOST_OPEN) / PATHS as f32, start)
}

/// Whether more than a share `most` of paths from surface that `start` draws from are in the open, rather than end on backs
/// of one-sided surfaces. A path goes on where it meets a front, which may lie in a solid, too; one that leaves the scene or
/// meets a two-sided surface is in the open.
pub(super) fn comes_out(tracer: &Tracer, stream: u64, most: f32, start: impl Fn([f32; 2]) -> Surface) -> bool {
    let asset = tracer.asset();
    let mut open = 0;
    for path in 0..PATHS {
        let mut sampler = Sampler::new(SEED, stream, path);
        let [u0, u1, ..] = sampler.next_4d();
        let mut from = start([u0, u1]);
        let mut enclosed = false;
        for _ in 0..=MAX_BOUNCES {
            let [u0, u1, ..] = sampler.next_4d();
            let local = warp::sample_cosine_hemisphere(Vec2::new(u0, u1));
            let direction = Frame::from_normal(from.geometric_normal).world_from_local(local);
            let origin = tracer.leave(&from, direction);
            let Some(hit) = tracer.closest_hit(origin, direction, f32::INFINITY) else { break };
            let material = asset.mesh.triangle_materials[hit.triangle as usize];
            if asset.materials[material as usize].double_sided {
                break;
            }
            from = tracer.surface(&hit, direction);
            if from.back {
                enclosed = true;
                break;
            }
        }
        open += u32::from(!enclosed);
        if open as f32 > most * PATHS as f32 {
            return true;
        }
    }
    false
}

/// Groups of cells that are connected through neighbours between which nothing lies.
fn regions(cells: &[Cell], blocked: impl Fn(Vec3, Vec3) -> bool) -> Vec<Vec<usize>> {
    let mut at = [None; CELLS * CELLS];
    cells.iter().enumerate().for_each(|(i, cell)| at[cell.bit] = Some(i));
    let mut regions: Vec<Vec<usize>> = Vec::new();
    let mut seen = vec![false; cells.len()];
    for first in 0..cells.len() {
        if std::mem::replace(&mut seen[first], true) {
            continue;
        }
        let mut region = vec![first];
        let mut next = 0;
        while next < region.len() {
            let cell = &cells[region[next]];
            next += 1;
            let (x, y) = (cell.bit % CELLS, cell.bit / CELLS);
            let around = [
                (x > 0).then(|| cell.bit - 1),
                (x + 1 < CELLS).then(|| cell.bit + 1),
                (y > 0).then(|| cell.bit - CELLS),
                (y + 1 < CELLS).then(|| cell.bit + CELLS),
            ];
            for other in around.into_iter().flatten().filter_map(|bit| at[bit]) {
                if !seen[other] && !blocked(cell.above, cells[other].above) {
                    seen[other] = true;
                    region.push(other);
                }
            }
        }
        region.sort_unstable();
        regions.push(region);
    }
    regions
}

/// Whether the segment from `p` to `q` crosses the triangle.
fn crosses(p: Vec3, q: Vec3, &[a, b, c]: &[Vec3; 3]) -> bool {
    let normal = (b - a).cross(c - a);
    let (from, to) = (normal.dot(p - a), normal.dot(q - a));
    if from * to > 0.0 || from == to {
        return false;
    }
    let x = p + (q - p) * (from / (from - to));
    let side = |a: Vec3, b: Vec3| normal.dot((b - a).cross(x - a));
    let (u, v, w) = (side(a, b), side(b, c), side(c, a));
    // A point on the edge that two triangles share counts for both.
    let slack = 1e-5 * normal.length_squared();
    u.min(v).min(w) >= -slack
}
