//! Which triangles a chart may hold together, so that no chart has surface on both sides of a thin wall.
//!
//! Triangles join across their common edges as long as no two that a wall parts come together: near walls first, so that
//! what lies beside a wall is one part along all of it and parts meet away from walls, as in the middle of a doorway.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap, HashSet};

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::buried::comes_out;
use super::proximity::Proximity;
use super::walls::Wall;
use super::{Aabb, Mesh, Tracer};
use crate::math::warp;

/// How far from a wall its sides are kept apart, texels: further off, lookups do not meet.
const REACH: f32 = 2.0;

/// Surface nearer to a side's border than that, in texels, is not on that side.
const BORDER: f32 = 1.0 / 16.0;

/// Cosine between two triangles' normals under which their edge is a crease, where charts end anyway: 45°.
const CREASE: f32 = 0.7;

/// Cosine between normals of what a wall stands on.
const FLAT: f32 = 0.94;

/// A triangle inside a wall is looked at in this many parts along each axis of the unit square that samples it.
/// And none may have more paths than this share that come out into the open: a few do not meet a back in a corner.
const PARTS: u32 = 6;
const OPEN_PART: f32 = 0.25;

/// A side of a wall: its number, and which.
type Side = (u32, bool);

/// For each triangle the number of its part, from 0. `texel` in metres.
pub(super) fn parts(mesh: &Mesh, walls: &[Wall], texel: f32) -> Vec<u32> {
    let sides = sides(mesh, walls, texel);
    let mut edges = edges(mesh);
    let distances = distances(mesh, &edges, &sides);
    let order = |e: &Edge| {
        let [a, b] = e.triangles.map(|t| distances[t as usize]);
        (e.crease, a.max(b), Reverse(e.length))
    };
    edges.sort_by(|a, b| {
        let ((ca, da, la), (cb, db, lb)) = (order(a), order(b));
        ca.cmp(&cb).then(da.total_cmp(&db)).then(lb.0.total_cmp(&la.0))
    });
    let mut joined = Joined { parent: (0..mesh.triangles.len() as u32).collect(), sides };
    edges.iter().for_each(|e| joined.join(e.triangles));
    let mut numbers = HashMap::new();
    (0..mesh.triangles.len() as u32)
        .map(|t| {
            let root = joined.root(t);
            let next = numbers.len() as u32;
            *numbers.entry(root).or_insert(next)
        })
        .collect()
}

/// For each triangle whether it lies inside a wall, where light cannot reach it.
pub(super) fn inside(tracer: &Tracer, walls: &[Wall], texel: f32) -> Vec<bool> {
    let mesh = &tracer.asset().mesh;
    let proximity = Proximity::new(mesh);
    let mut may_be = vec![false; mesh.triangles.len()];
    for wall in walls {
        let range = (-0.75 * wall.depth, -0.25 * wall.depth);
        for_each_beside(mesh, &proximity, wall, range, texel, |t| may_be[t as usize] = true);
    }
    // A small part of it may look out of the wall's end: each part is asked.
    let part = |t: usize, p: u32| {
        !comes_out(tracer, t as u64, OPEN_PART, |u| {
            let cell = Vec2::new((p % PARTS) as f32, (p / PARTS) as f32);
            let b = warp::sample_uniform_triangle((cell + Vec2::from(u)) / PARTS as f32);
            tracer.asset().surface(t, b.x, b.y, Vec3::ZERO)
        })
    };
    let enclosed = |t: usize| (0..PARTS * PARTS).all(|p| part(t, p));
    (0..may_be.len()).into_par_iter().map(|t| may_be[t] && enclosed(t)).collect()
}

/// For each triangle the sides of walls that it lies on; none for one that lies on both.
fn sides(mesh: &Mesh, walls: &[Wall], texel: f32) -> Vec<HashSet<Side>> {
    let mut sides = vec![HashSet::new(); mesh.triangles.len()];
    let proximity = Proximity::new(mesh);
    let (reach, border) = (REACH * texel, BORDER * texel);
    for (number, wall) in walls.iter().enumerate() {
        let ranges = [(border, reach), (-wall.depth - reach, -wall.depth - border)];
        for (range, front) in ranges.into_iter().zip([true, false]) {
            for_each_beside(mesh, &proximity, wall, range, texel, |t| {
                let sides: &mut HashSet<Side> = &mut sides[t as usize];
                // The front comes first.
                if front || !sides.remove(&(number as u32, true)) {
                    sides.insert((number as u32, front));
                }
            });
        }
    }
    sides
}

/// Visits the triangles that lie about in the plane on which a wall stands and reach into the strip along the wall's line
/// between the distances in `range` from it, outwards.
fn for_each_beside(
    mesh: &Mesh,
    proximity: &Proximity,
    wall: &Wall,
    range: (f32, f32),
    texel: f32,
    mut visit: impl FnMut(u32),
) {
    let [p, q] = wall.line;
    let (length, along) = (p.distance(q), (q - p).normalize_or_zero());
    let normal = along.cross(wall.outwards);
    let end = (BORDER * texel).min(0.25 * length);
    let (lo, hi) = ([end, range.0], [length - end, range.1]);
    let corners = [lo[0], hi[0]].map(|a| [lo[1], hi[1]].map(|s| p + along * a + wall.outwards * s));
    let bounds = Aabb::from_points(corners.as_flattened());
    let bounds = Aabb { min: bounds.min - texel, max: bounds.max + texel };
    proximity.for_each_near(&bounds, |t| {
        let cross = mesh.triangle_cross(t as usize);
        let corners = mesh.triangle_positions(t as usize).map(|c| c - p);
        let off = corners.map(|c| c.dot(normal).abs());
        let lies_there = cross.dot(normal).abs() > FLAT * cross.length() && off[0].min(off[1]).min(off[2]) < texel;
        if lies_there && reaches_into(&corners.map(|c| [c.dot(along), c.dot(wall.outwards)]), lo, hi) {
            visit(t);
        }
    });
}

/// Whether a triangle and a rectangle of the plane have an area in common: their edges' directions are all the axes along
/// which convex shapes may be apart.
fn reaches_into(triangle: &[[f32; 2]; 3], lo: [f32; 2], hi: [f32; 2]) -> bool {
    let rectangle = [lo, [hi[0], lo[1]], hi, [lo[0], hi[1]]];
    let edge_normal = |i: usize| {
        let (a, b) = (triangle[i], triangle[(i + 1) % 3]);
        [b[1] - a[1], a[0] - b[0]]
    };
    let axes = [[1.0, 0.0], [0.0, 1.0], edge_normal(0), edge_normal(1), edge_normal(2)];
    axes.iter().all(|axis| {
        let extent = |points: &[[f32; 2]]| {
            let along = points.iter().map(|p| p[0] * axis[0] + p[1] * axis[1]);
            along.fold((f32::INFINITY, f32::NEG_INFINITY), |(lo, hi), x| (lo.min(x), hi.max(x)))
        };
        let (a, b) = (extent(triangle), extent(&rectangle));
        a.0 < b.1 && b.0 < a.1
    })
}

/// An edge of two triangles.
struct Edge {
    triangles: [u32; 2],
    length: f32,
    crease: bool,
}

fn edges(mesh: &Mesh) -> Vec<Edge> {
    let bits = |v: u32| mesh.positions[v as usize].to_array().map(|x| (x + 0.0).to_bits());
    let mut first = HashMap::new();
    let mut edges = Vec::new();
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for i in 0..3 {
            let ends = [triangle[i], triangle[(i + 1) % 3]];
            let [a, b] = ends.map(bits);
            let other = *first.entry([a.min(b), a.max(b)]).or_insert(t as u32);
            if other != t as u32 {
                let [n, m] = [t, other as usize].map(|t| mesh.triangle_cross(t).normalize_or_zero());
                let [p, q] = ends.map(|v| mesh.positions[v as usize]);
                edges.push(Edge { triangles: [other, t as u32], length: p.distance(q), crease: n.dot(m) < CREASE });
            }
        }
    }
    edges
}

/// How far each triangle is from those beside walls, from centre to centre along the surface; metres.
fn distances(mesh: &Mesh, edges: &[Edge], sides: &[HashSet<Side>]) -> Vec<f32> {
    let mut around = vec![Vec::new(); mesh.triangles.len()];
    for &[a, b] in edges.iter().map(|e| &e.triangles) {
        around[a as usize].push(b);
        around[b as usize].push(a);
    }
    let centre = |t: u32| mesh.triangle_positions(t as usize).iter().sum::<Vec3>() / 3.0;
    let mut distances = vec![f32::INFINITY; mesh.triangles.len()];
    let beside = (0..sides.len()).filter(|&t| !sides[t].is_empty());
    // Distances are not negative, so that their bits are in their order.
    let mut queue: BinaryHeap<Reverse<(u32, u32)>> = beside.map(|t| Reverse((0, t as u32))).collect();
    queue.iter().for_each(|Reverse((_, t))| distances[*t as usize] = 0.0);
    while let Some(Reverse((distance, t))) = queue.pop() {
        let distance = f32::from_bits(distance);
        if distance > distances[t as usize] {
            continue;
        }
        for &next in &around[t as usize] {
            let through = distance + centre(t).distance(centre(next));
            if through < distances[next as usize] {
                distances[next as usize] = through;
                queue.push(Reverse((through.to_bits(), next)));
            }
        }
    }
    distances
}

/// Triangles that joined, as trees, with the sides of walls that each tree lies on at its root.
struct Joined {
    parent: Vec<u32>,
    sides: Vec<HashSet<Side>>,
}

impl Joined {
    fn root(&mut self, mut t: u32) -> u32 {
        while self.parent[t as usize] != t {
            let up = self.parent[t as usize];
            self.parent[t as usize] = self.parent[up as usize];
            t = up;
        }
        t
    }

    /// Joins two triangles' parts unless they lie on both sides of a wall.
    fn join(&mut self, triangles: [u32; 2]) {
        let [a, b] = triangles.map(|t| self.root(t));
        if a == b {
            return;
        }
        let [fewer, more] = if self.sides[a as usize].len() < self.sides[b as usize].len() { [a, b] } else { [b, a] };
        let moved = std::mem::take(&mut self.sides[fewer as usize]);
        if moved.iter().any(|&(wall, side)| self.sides[more as usize].contains(&(wall, !side))) {
            self.sides[fewer as usize] = moved;
            return;
        }
        self.sides[more as usize].extend(moved);
        self.parent[fewer as usize] = more;
    }
}
