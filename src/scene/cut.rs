//! Cuts triangles along lines: the surface stays the same, and edges run along the lines.
//!
//! A line cuts each convex piece that it touches in two, so that pieces stay convex. Edges that pieces share are cut for
//! all of them, so that the surface stays as closed as it was.

use std::collections::HashMap;

use glam::{DVec2, DVec3, Vec2, Vec3};

use super::Mesh;
use super::walls::Wall;

/// Cuts the mesh along the walls. Corners nearer to a line than `snap`, metres, stay as they are.
pub(super) fn cut(mesh: &mut Mesh, walls: &[Wall], snap: f64) {
    let mut pieces = Pieces::new(mesh);
    let mut order: Vec<&Wall> = walls.iter().collect();
    // A long line cuts pieces in two that short ones would cut in many.
    order.sort_by(|a, b| b.line[0].distance(b.line[1]).total_cmp(&a.line[0].distance(a.line[1])));
    for wall in order {
        let normal = mesh.triangle_cross(wall.triangle as usize).as_dvec3().normalize_or_zero();
        let line = wall.line.map(|p| p.as_dvec3());
        let along = (line[1] - line[0]).normalize_or_zero();
        let line = Line { origin: line[0], along, across: normal.cross(along), length: line[0].distance(line[1]) };
        pieces.cut(wall.triangle, &line, snap);
    }
    pieces.write_back(mesh);
}

/// A line in a triangle's plane.
struct Line {
    origin: DVec3,
    along: DVec3,
    across: DVec3,
    length: f64,
}

/// A corner of a piece: its point, and where it is in the piece's triangle, as barycentric coordinates of the second and
/// third vertex.
#[derive(Clone, Copy)]
struct Corner {
    point: u32,
    barycentric: DVec2,
}

/// A convex piece of a triangle, counter-clockwise; several corners may lie on one line.
struct Piece {
    triangle: u32,
    corners: Vec<Corner>,
}

struct Pieces {
    /// Positions, each once.
    points: Vec<DVec3>,
    pieces: Vec<Piece>,
    /// The pieces at an edge from one point to another with a larger number.
    at_edge: HashMap<[u32; 2], Vec<u32>>,
    /// Those of each triangle that is cut.
    of_triangle: HashMap<u32, Vec<u32>>,
}

fn edge(a: u32, b: u32) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

impl Pieces {
    /// One piece for each triangle, with the triangle's number.
    fn new(mesh: &Mesh) -> Self {
        let mut points = Vec::new();
        let mut by_bits = HashMap::new();
        let of_vertex: Vec<u32> = mesh
            .positions
            .iter()
            .map(|p| {
                *by_bits.entry(p.to_array().map(|x| (x + 0.0).to_bits())).or_insert_with(|| {
                    points.push(p.as_dvec3());
                    points.len() as u32 - 1
                })
            })
            .collect();
        let corner = |v: u32, barycentric: DVec2| Corner { point: of_vertex[v as usize], barycentric };
        let pieces: Vec<Piece> = mesh
            .triangles
            .iter()
            .enumerate()
            .map(|(t, &[a, b, c])| Piece {
                triangle: t as u32,
                corners: vec![corner(a, DVec2::ZERO), corner(b, DVec2::X), corner(c, DVec2::Y)],
            })
            .collect();
        let mut at_edge: HashMap<[u32; 2], Vec<u32>> = HashMap::new();
        for (p, piece) in pieces.iter().enumerate() {
            for i in 0..3 {
                let key = edge(piece.corners[i].point, piece.corners[(i + 1) % 3].point);
                at_edge.entry(key).or_default().push(p as u32);
            }
        }
        Self { points, pieces, at_edge, of_triangle: HashMap::new() }
    }

    fn cut(&mut self, triangle: u32, line: &Line, snap: f64) {
        for p in self.of_triangle.entry(triangle).or_insert_with(|| vec![triangle]).clone() {
            self.cut_piece(p, line, snap);
        }
    }

    /// Cuts a piece in two where the line reaches into it.
    fn cut_piece(&mut self, p: u32, line: &Line, snap: f64) {
        let position = |c: &Corner| self.points[c.point as usize] - line.origin;
        let side = |across: f64| if across.abs() <= snap { 0 } else { across.signum() as i32 };
        let corners = &self.pieces[p as usize].corners;
        let across: Vec<f64> = corners.iter().map(|c| position(c).dot(line.across)).collect();
        let sides: Vec<i32> = across.iter().map(|&a| side(a)).collect();
        if !sides.contains(&1) || !sides.contains(&-1) {
            return;
        }
        // Where along the line it enters and leaves the piece.
        let count = corners.len();
        let mut reach = (f64::INFINITY, f64::NEG_INFINITY);
        for i in 0..count {
            let j = (i + 1) % count;
            let [a, b] = [i, j].map(|k| position(&corners[k]).dot(line.along));
            let at = match (sides[i], sides[j]) {
                (0, _) => a,
                (1, -1) | (-1, 1) => a + (b - a) * across[i] / (across[i] - across[j]),
                _ => continue,
            };
            reach = (reach.0.min(at), reach.1.max(at));
        }
        if reach.1.min(line.length) - reach.0.max(0.0) <= snap {
            return;
        }
        let crossed: Vec<([u32; 2], f64)> = (0..count)
            .filter(|&i| sides[i] * sides[(i + 1) % count] < 0)
            .map(|i| {
                let j = (i + 1) % count;
                let t = across[i] / (across[i] - across[j]);
                let ends = [corners[i].point, corners[j].point];
                if ends[0] < ends[1] { (ends, t) } else { (edge(ends[0], ends[1]), 1.0 - t) }
            })
            .collect();
        crossed.into_iter().for_each(|(ends, t)| self.cut_edge(ends, t));
        let corners = std::mem::take(&mut self.pieces[p as usize].corners);
        let sides: Vec<i32> =
            corners.iter().map(|c| side((self.points[c.point as usize] - line.origin).dot(line.across))).collect();
        let part = |keep: i32| -> Vec<Corner> {
            corners.iter().zip(&sides).filter(|&(_, &s)| s * keep >= 0).map(|(&c, _)| c).collect()
        };
        let triangle = self.pieces[p as usize].triangle;
        let new = self.pieces.len() as u32;
        let moved = part(-1);
        for i in 0..moved.len() {
            let key = edge(moved[i].point, moved[(i + 1) % moved.len()].point);
            let at = self.at_edge.entry(key).or_default();
            match at.iter_mut().find(|at| **at == p) {
                Some(at) => *at = new,
                None => at.push(new),
            }
        }
        self.pieces[p as usize].corners = part(1);
        self.pieces.push(Piece { triangle, corners: moved });
        self.of_triangle.entry(triangle).or_default().push(new);
        let kept = &self.pieces[p as usize].corners;
        for i in 0..kept.len() {
            let at = self.at_edge.entry(edge(kept[i].point, kept[(i + 1) % kept.len()].point)).or_default();
            if !at.contains(&p) {
                at.push(p);
            }
        }
    }

    /// Puts a point at share `t` of the way along an edge, for all the pieces there.
    fn cut_edge(&mut self, ends: [u32; 2], t: f64) {
        let point = self.points.len() as u32;
        let [a, b] = ends.map(|p| self.points[p as usize]);
        // To be the mesh's position later on.
        self.points.push(a.lerp(b, t).as_vec3().as_dvec3());
        let pieces = self.at_edge.remove(&ends).unwrap_or_default();
        for &p in &pieces {
            let corners = &mut self.pieces[p as usize].corners;
            let count = corners.len();
            let found = (0..count).find(|&i| edge(corners[i].point, corners[(i + 1) % count].point) == ends);
            let Some(i) = found else { continue };
            let (from, to) = (corners[i], corners[(i + 1) % count]);
            let t = if from.point == ends[0] { t } else { 1.0 - t };
            corners.insert(i + 1, Corner { point, barycentric: from.barycentric.lerp(to.barycentric, t) });
        }
        self.at_edge.insert(edge(ends[0], point), pieces.clone());
        self.at_edge.insert(edge(ends[1], point), pieces);
    }

    /// Gives the mesh the pieces instead of its triangles; those that are whole keep their number's order.
    fn write_back(&self, mesh: &mut Mesh) {
        // New vertices: on an edge of the mesh one for the triangles that share the edge's vertices, else one a triangle.
        let mut vertices: HashMap<(u32, [u32; 2]), u32> = HashMap::new();
        let old = std::mem::take(&mut mesh.triangles);
        let materials = std::mem::take(&mut mesh.triangle_materials);
        for piece in &self.pieces {
            let of_triangle = old[piece.triangle as usize];
            let whole = piece.corners.len() == 3 && !self.of_triangle.contains_key(&piece.triangle);
            let corners: Vec<u32> = piece
                .corners
                .iter()
                .map(|c| {
                    let weights = [1.0 - c.barycentric.x - c.barycentric.y, c.barycentric.x, c.barycentric.y];
                    if let Some(i) = (0..3).find(|&i| weights[i] == 1.0) {
                        return of_triangle[i];
                    }
                    let ends = match weights.iter().position(|w| w.abs() < ON_EDGE) {
                        Some(i) => edge(of_triangle[(i + 1) % 3], of_triangle[(i + 2) % 3]),
                        None => [u32::MAX, piece.triangle],
                    };
                    *vertices.entry((c.point, ends)).or_insert_with(|| {
                        let position = self.points[c.point as usize].as_vec3();
                        push_vertex(mesh, of_triangle, weights.map(|w| w as f32), position)
                    })
                })
                .collect();
            let material = materials[piece.triangle as usize];
            let triangles = if whole { vec![[0, 1, 2]] } else { self.triangulated(&piece.corners) };
            mesh.triangles.extend(triangles.iter().map(|t| t.map(|i| corners[i])));
            mesh.triangle_materials.resize(mesh.triangles.len(), material);
        }
    }

    /// Triangles of corners of a convex polygon, the flattest of which is as good as can be (Klincsek, *Minimal
    /// Triangulations of Polygonal Domains*, 1980, with another measure).
    fn triangulated(&self, corners: &[Corner]) -> Vec<[usize; 3]> {
        let at: Vec<DVec3> = corners.iter().map(|c| self.points[c.point as usize]).collect();
        let quality = |i: usize, j: usize, k: usize| {
            let (a, b, c) = (at[j] - at[i], at[k] - at[j], at[i] - at[k]);
            let longest = a.length_squared().max(b.length_squared()).max(c.length_squared());
            a.cross(b).length() / longest.max(f64::MIN_POSITIVE)
        };
        let count = corners.len();
        // For each part of the polygon from corner i to corner k: the best apex of the triangle on i–k, and the quality.
        let mut best = vec![(0, f64::INFINITY); count * count];
        for span in 2..count {
            for i in 0..count - span {
                let k = i + span;
                let of = |j: usize| quality(i, j, k).min(best[i * count + j].1).min(best[j * count + k].1);
                let apex = (i + 1..k).max_by(|&a, &b| of(a).total_cmp(&of(b))).unwrap_or(i + 1);
                best[i * count + k] = (apex, of(apex));
            }
        }
        let mut triangles = Vec::new();
        let mut parts = vec![(0, count - 1)];
        while let Some((i, k)) = parts.pop() {
            if k - i >= 2 {
                let j = best[i * count + k].0;
                triangles.push([i, j, k]);
                parts.extend([(i, j), (j, k)]);
            }
        }
        triangles
    }
}

/// A barycentric coordinate that is zero but for rounding.
const ON_EDGE: f64 = 1e-12;

/// A vertex in the middle of a triangle.
fn push_vertex(mesh: &mut Mesh, triangle: [u32; 3], weights: [f32; 3], position: Vec3) -> u32 {
    fn mean<T>(attribute: &mut Vec<T>, triangle: [u32; 3], weights: [f32; 3])
    where
        T: Copy + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>,
    {
        if !attribute.is_empty() {
            let [a, b, c] = triangle.map(|v| attribute[v as usize]);
            attribute.push(a * weights[0] + b * weights[1] + c * weights[2]);
        }
    }
    let vertex = mesh.positions.len() as u32;
    mesh.positions.push(position);
    mean::<Vec3>(&mut mesh.normals, triangle, weights);
    if let Some(normal) = mesh.normals.last_mut() {
        *normal = normal.normalize_or(Vec3::Y);
    }
    mesh.uvs.iter_mut().for_each(|uvs| mean::<Vec2>(uvs, triangle, weights));
    mean::<Vec3>(&mut mesh.colours, triangle, weights);
    vertex
}
