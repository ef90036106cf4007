//! A small mesh as parallelograms and triangles, LANES side by side, each tested by three affine functions of position.
//!
//! Where a plane is met and where in it a piece ends is told by functions made once (Havel, Herout, *Yet Faster Ray-Triangle
//! Intersection*, 2010), a third of the work of the exact test of [`super::block`]. They round; so every answer that could be
//! another in exact arithmetic is marked, and the exact test asked instead: what is left has no gaps either.
//!
//! How far they round, with u = 2⁻²⁴, R the distance of the ray's origin plus that of the furthest corner from zero, and a ray
//! that meets the piece, so that |t·d| ≤ R: g at the origin errs by at most 8u|∇g|R, its slope by 8u|∇g||d|, so t by
//! 16u|∇g|R / |slope of g|; the point met rounds by 4uR, and u and v there by 21u|∇|R. ∇g is scaled such that |∇g||∇u| and
//! |∇g||∇v| are at most 1: u and v err by less than 48u R|d| / |slope of g|. The exact test moves corners across the ray by up
//! to 9uR, and [`PARALLEL`] allows them to be off the piece by 8uR, which is as much again of u and v; pieces in one plane are met
//! there together, and may be off it by another 8uR. [`BAND`] is nearly twice the sum of 73u.

use std::ops::Range;

use glam::{DVec3, Vec3};

use super::Segments;
use super::lanes::lanes;
use super::packet::Hits;
use super::simd16::{F32x16, dot, splat};
use crate::math::LANES;
use crate::scene::Hit;

/// Of R|d| / |slope of g|: where u and v are that close to the piece's edge the exact test decides.
const BAND: f32 = 64.0 * f32::EPSILON;

/// Of the furthest corner's distance from zero: how far a parallelogram's fourth corner may be off, and corners off a plane.
const PARALLEL: f64 = 4.0 * f32::EPSILON as f64;

/// All triangles of a mesh but those without area, which no ray hits.
pub struct Pieces {
    pub blocks: Vec<Block>,
    /// All pieces, plane by plane.
    planes: Vec<Plane>,
    /// Metres: the furthest corner's distance from zero.
    pub size: f32,
}

/// LANES pieces, structure of arrays.
#[repr(align(64))]
pub struct Block {
    /// `[u, v, g][x, y, z, 1][lane]`: a piece is where |u| and |v| are at most 1, g is 0, and u + v at most `limit`.
    functions: [[[f32; LANES]; 4]; 3],
    /// Half the limit: 1 for a parallelogram, which is a limit to none, and 0 for a triangle.
    half_limit: [f32; LANES],
    /// Bit i is set where piece i is a triangle.
    pub triangles: u32,
    /// Bit i is set where there is a piece i.
    pub present: u32,
    /// The triangles on either side of u + v = 0.
    halves: [[Half; 2]; LANES],
}

/// Pieces that lie in one plane, such as those of a floor.
struct Plane {
    /// g by x, y, z and 1, for all of them as flat as that of the piece that is the least sure of u and v.
    function: [f32; 4],
    pieces: Range<usize>,
}

/// A triangle of a piece.
#[derive(Clone, Copy, Default)]
struct Half {
    triangle: u32,
    /// Per second and third vertex, the barycentric coordinate: its value at u = v = 0, and its changes with u and v.
    weights: [[f32; 3]; 2],
}

/// What pieces say of a ray.
pub enum Answer {
    Nothing,
    Hit(Hit),
    /// Ask the exact test.
    Unsure,
}

/// What u and v can be off by in a ray's answer, times |slope of g|. In lanes, although all are the same: as numbers the
/// compiler would load a vector's parts in pairs, which waits for their stores to leave the processor.
#[inline(always)]
pub fn band(size: f32, origin: &[F32x16; 3], direction: &[F32x16; 3]) -> F32x16 {
    // No less than a vector's length.
    let length = |v: &[F32x16; 3]| v[0].abs() + v[1].abs() + v[2].abs();
    F32x16::splat(BAND) * (F32x16::splat(size) + length(origin)) * length(direction)
}

impl Pieces {
    /// Of those triangles that are `wanted`.
    pub fn new(triangles: &[[Vec3; 3]], wanted: impl Fn(usize) -> bool) -> Self {
        let size = triangles.iter().flatten().fold(0.0, |size: f32, v| size.max(v.length()));
        let mut left: Vec<usize> = (0..triangles.len()).rev().filter(|&t| wanted(t)).collect();
        let mut pieces = Vec::new();
        while let Some(first) = left.pop() {
            let tolerance = PARALLEL * f64::from(size);
            let partner = left.iter().enumerate().rev().find_map(|(at, &second)| {
                let order = parallelogram(&triangles[first], &triangles[second], tolerance)?;
                Some((at, order))
            });
            match partner {
                Some((at, order)) => {
                    pieces.push(Piece { first, second: Some((left.remove(at), order.second)), corners: order.first })
                }
                None => pieces.push(Piece { first, second: None, corners: [0, 1, 2] }),
            }
        }
        let functions = pieces.into_iter().filter_map(|p| Some((p.functions(&triangles[p.first])?, p)));
        let coplanar = coplanar(functions, triangles, PARALLEL * f64::from(size));
        let mut first = 0;
        let planes = coplanar.iter().map(|pieces| {
            first += pieces.len();
            Plane { function: flattest(pieces), pieces: first - pieces.len()..first }
        });
        let planes = planes.collect();
        let functions: Vec<_> = coplanar.into_iter().flatten().collect();
        let block = |pieces: &[(Functions, Piece)]| {
            // Where there is no piece g is 0 everywhere, which no ray meets.
            let mut block = Block {
                functions: [[[0.0; LANES]; 4]; 3],
                half_limit: [0.0; LANES],
                triangles: 0,
                present: 0,
                halves: Default::default(),
            };
            for (lane, (functions, piece)) in pieces.iter().enumerate() {
                for (f, i) in (0..3).flat_map(|f| (0..4).map(move |i| (f, i))) {
                    block.functions[f][i][lane] = functions[f][i];
                }
                block.half_limit[lane] = if piece.second.is_some() { 1.0 } else { 0.0 };
                block.triangles |= u32::from(piece.second.is_none()) << lane;
                block.present |= 1 << lane;
                block.halves[lane] = piece.halves();
            }
            block
        };
        Self { blocks: functions.chunks(LANES).map(block).collect(), planes, size }
    }

    /// How many planes they lie in.
    #[cfg(test)]
    pub fn planes(&self) -> usize {
        self.planes.len()
    }

    #[inline(always)]
    pub fn closest(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Answer {
        let (o, d) = (splat(origin), splat(direction));
        let (zero, k) = (F32x16::splat(0.0), band(self.size, &o, &d));
        let far = F32x16::splat(t_max);
        let Some((first, others)) = self.blocks.split_first() else { return Answer::Nothing };
        // Where the block's pieces are met; at `far` those that are not.
        let meet = |block: &Block| {
            let met = block.meet(&o, &d);
            let slack = met.per_slope.abs() * k;
            let near = zero.at_most(met.margin + slack).and(zero.below(met.t));
            (far.replace(met.t, near), met.u, met.v, met.margin - slack)
        };
        // No branch depends on where the ray goes before all pieces are tested: at this size mispredictions would cost more
        // than the tests.
        let (mut t, mut u, mut v, mut certainty) = meet(first);
        let mut block_of = zero;
        for (i, block) in others.iter().enumerate() {
            let (t_here, u_here, v_here, certainty_here) = meet(block);
            let nearer = t_here.below(t);
            t = t.min(t_here);
            u = u.replace(u_here, nearer);
            v = v.replace(v_here, nearer);
            certainty = certainty.replace(certainty_here, nearer);
            // A number's bits, which nothing but this reads.
            block_of = block_of.replace(F32x16::splat(f32::from_bits(i as u32 + 1)), nearer);
        }
        let best = t.least();
        if best >= t_max {
            return Answer::Nothing;
        }
        let lane = t.at_most(F32x16::splat(best)).bits().trailing_zeros() as usize % LANES;
        if certainty.to_array()[lane] <= 0.0 {
            return Answer::Unsure;
        }
        let block = match others {
            [] => first,
            _ => &self.blocks[block_of.to_array()[lane].to_bits() as usize],
        };
        Answer::Hit(block.hit(lane, best, u.to_array()[lane], v.to_array()[lane]))
    }

    /// What the rays of `active` hit, and those of which the exact test must be asked.
    #[inline]
    pub fn closest_of_each(&self, origins: &Segments, directions: &Segments, active: u32) -> (Hits, u32) {
        let load = |[x, y, z]: &Segments| [F32x16::load(x), F32x16::load(y), F32x16::load(z)];
        let (o, d) = (load(origins), load(directions));
        let (zero, k) = (F32x16::splat(0.0), band(self.size, &o, &d));
        let far = F32x16::splat(f32::INFINITY);
        let mut t = far;
        let [mut u, mut v, mut certainty, mut piece] = [zero; 4];
        // A number's bits, which nothing but this reads.
        let numbered = |piece: usize| F32x16::splat(f32::from_bits(piece as u32));
        for plane in &self.planes {
            let [x, y, z, one] = plane.function.map(F32x16::splat);
            let per_slope = F32x16::splat(-1.0) / dot(&[x, y, z], &d);
            let t_here = z.mul_add(o[2], y.mul_add(o[1], x.mul_add(o[0], one))) * per_slope;
            let at = [d[0].mul_add(t_here, o[0]), d[1].mul_add(t_here, o[1]), d[2].mul_add(t_here, o[2])];
            // The piece that the place is the furthest inside of.
            let first = plane.pieces.start;
            let (mut u_here, mut v_here, mut margin) = self.blocks[first / LANES].place_with(first % LANES, &at);
            let mut piece_here = numbered(first);
            for other in first + 1..plane.pieces.end {
                let (u_other, v_other, margin_other) = self.blocks[other / LANES].place_with(other % LANES, &at);
                let better = margin.below(margin_other);
                u_here = u_here.replace(u_other, better);
                v_here = v_here.replace(v_other, better);
                margin = margin.max(margin_other);
                piece_here = piece_here.replace(numbered(other), better);
            }
            let slack = per_slope.abs() * k;
            let near = zero.at_most(margin + slack);
            let nearer = near.and(zero.below(t_here)).and(t_here.below(t));
            t = t.replace(t_here, nearer);
            u = u.replace(u_here, nearer);
            v = v.replace(v_here, nearer);
            certainty = certainty.replace(margin - slack, nearer);
            piece = piece.replace(piece_here, nearer);
        }
        let mut hits = Hits { t: t.to_array(), u: u.to_array(), v: v.to_array(), ..Hits::NONE };
        hits.hit = t.below(far).bits() & active;
        let piece = piece.to_array();
        for ray in lanes(hits.hit) {
            let at = piece[ray].to_bits() as usize;
            let hit = self.blocks[at / LANES].hit(at % LANES, hits.t[ray], hits.u[ray], hits.v[ray]);
            (hits.triangle[ray], hits.u[ray], hits.v[ray]) = (hit.triangle, hit.u, hit.v);
        }
        let unsure = certainty.at_most(zero).bits() & hits.hit;
        (hits, unsure)
    }

    /// Whether any hit with 0 < t < `t_max`; `None` to ask the exact test.
    #[inline(always)]
    pub fn any(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<bool> {
        let (o, d) = (splat(origin), splat(direction));
        let (zero, k) = (F32x16::splat(0.0), band(self.size, &o, &d));
        let t_max = F32x16::splat(t_max);
        let (mut near, mut sure) = (0, 0);
        for block in &self.blocks {
            let met = block.meet(&o, &d);
            let in_time = zero.below(met.t).and(met.t.below(t_max));
            near |= zero.at_most(met.per_slope.abs().mul_add(k, met.margin)).and(in_time).bits();
            sure |= zero.below(met.per_slope.abs().neg_mul_add(k, met.margin)).and(in_time).bits();
        }
        if sure != 0 {
            Some(true)
        } else if near == 0 {
            Some(false)
        } else {
            None
        }
    }
}

/// Where a ray meets the planes of LANES pieces.
struct Met {
    t: F32x16,
    u: F32x16,
    v: F32x16,
    /// How far u and v are from the edge, positive inside.
    margin: F32x16,
    /// −1 / slope of g.
    per_slope: F32x16,
}

impl Block {
    /// All pieces and the same ray in every lane.
    #[inline(always)]
    fn meet(&self, o: &[F32x16; 3], d: &[F32x16; 3]) -> Met {
        let per_slope = F32x16::splat(-1.0) / dot(&self.gradient(2), d);
        let t = self.value(2, o) * per_slope;
        let at = [d[0].mul_add(t, o[0]), d[1].mul_add(t, o[1]), d[2].mul_add(t, o[2])];
        let (u, v) = (self.value(0, &at), self.value(1, &at));
        let within = F32x16::splat(1.0) - u.abs().max(v.abs());
        let below_limit = (u + v).neg_mul_add(F32x16::splat(0.5), F32x16::load(&self.half_limit));
        Met { t, u, v, margin: within.min(below_limit), per_slope }
    }

    /// u, v and the margin of one piece, at a place of its plane in every lane.
    #[inline(always)]
    fn place_with(&self, piece: usize, at: &[F32x16; 3]) -> (F32x16, F32x16, F32x16) {
        let factor = |f: usize, i: usize| F32x16::splat(self.functions[f][i][piece]);
        let linear = |f: usize| {
            factor(f, 2).mul_add(at[2], factor(f, 1).mul_add(at[1], factor(f, 0).mul_add(at[0], factor(f, 3))))
        };
        let (u, v) = (linear(0), linear(1));
        let mut margin = F32x16::splat(1.0) - u.abs().max(v.abs());
        if self.triangles >> piece & 1 != 0 {
            margin = margin.min((u + v) * F32x16::splat(-0.5));
        }
        (u, v, margin)
    }

    #[inline(always)]
    pub fn value(&self, f: usize, p: &[F32x16; 3]) -> F32x16 {
        let [x, y, z, one] = &self.functions[f];
        F32x16::load(z).mul_add(p[2], F32x16::load(y).mul_add(p[1], F32x16::load(x).mul_add(p[0], F32x16::load(one))))
    }

    /// Of function `f`.
    #[inline(always)]
    pub fn gradient(&self, f: usize) -> [F32x16; 3] {
        let [x, y, z, _] = &self.functions[f];
        [F32x16::load(x), F32x16::load(y), F32x16::load(z)]
    }

    #[inline(always)]
    fn hit(&self, lane: usize, t: f32, u: f32, v: f32) -> Hit {
        let half = &self.halves[lane][usize::from(u + v > 0.0)];
        let [second, third] = half.weights.map(|[at_zero, with_u, with_v]| at_zero + with_u * u + with_v * v);
        Hit { t, triangle: half.triangle, u: second, v: third }
    }
}

/// A parallelogram of two triangles, or a triangle.
struct Piece {
    first: usize,
    /// Its corners that are: the fourth, the first's second, the first's third.
    second: Option<(usize, [usize; 3])>,
    /// The first triangle's corners: u = v = −1, u = 1, v = 1.
    corners: [usize; 3],
}

/// u, v and g of a piece.
type Functions = [[f32; 4]; 3];

/// Pieces that lie in one plane to within `tolerance`, each time.
fn coplanar(
    pieces: impl Iterator<Item = (Functions, Piece)>,
    triangles: &[[Vec3; 3]],
    tolerance: f64,
) -> Vec<Vec<(Functions, Piece)>> {
    // A point and the unit normal of each, and its pieces.
    let mut planes: Vec<[DVec3; 2]> = Vec::new();
    let mut pieces_of: Vec<Vec<(Functions, Piece)>> = Vec::new();
    for (functions, piece) in pieces {
        let [a, b, c] = piece.corners.map(|corner| triangles[piece.first][corner].as_dvec3());
        // The fourth of a parallelogram.
        let corners = [a, b, c, b + c - a];
        let holds = |[point, normal]: &[DVec3; 2]| corners.iter().all(|&c| (c - point).dot(*normal).abs() <= tolerance);
        let plane = planes.iter().position(holds).unwrap_or_else(|| {
            planes.push([a, (b - a).cross(c - a).normalize()]);
            pieces_of.push(Vec::new());
            planes.len() - 1
        });
        pieces_of[plane].push((functions, piece));
    }
    pieces_of
}

/// g of the first of some pieces in one plane, scaled to the least slope of all.
fn flattest(pieces: &[(Functions, Piece)]) -> [f32; 4] {
    let slope = |functions: &Functions| Vec3::from_slice(&functions[2]).length();
    let least = pieces.iter().map(|(functions, _)| slope(functions)).fold(f32::INFINITY, f32::min);
    pieces[0].0[2].map(|factor| factor * (least / slope(&pieces[0].0)))
}

/// Corners of two triangles that make a parallelogram; see [`Piece`].
struct Order {
    first: [usize; 3],
    second: [usize; 3],
}

fn parallelogram(first: &[Vec3; 3], second: &[Vec3; 3], tolerance: f64) -> Option<Order> {
    (0..3).find_map(|i| {
        let corners = [i, (i + 1) % 3, (i + 2) % 3];
        let [apex, p, q] = corners.map(|c| first[c]);
        let at = |position: Vec3| second.iter().position(|&corner| corner == position);
        let (p_at, q_at) = (at(p)?, at(q)?);
        let opposite = 3usize.checked_sub(p_at + q_at)?;
        let off = p.as_dvec3() + q.as_dvec3() - apex.as_dvec3() - second.get(opposite)?.as_dvec3();
        (p_at != q_at && off.length() <= tolerance).then_some(Order { first: corners, second: [opposite, p_at, q_at] })
    })
}

impl Piece {
    /// u, v and g by x, y, z and 1, if there is a plane.
    fn functions(&self, triangle: &[Vec3; 3]) -> Option<Functions> {
        let [a, b, c] = self.corners.map(|corner| triangle[corner].as_dvec3());
        let normal = (b - a).cross(c - a);
        let (u, v) = (
            2.0 * (c - a).cross(normal) / normal.length_squared(),
            2.0 * normal.cross(b - a) / normal.length_squared(),
        );
        let g = normal / (normal.length() * u.length().max(v.length()));
        let function = |gradient: DVec3, at_a: f64| gradient.extend(at_a - gradient.dot(a)).as_vec4().to_array();
        let functions = [function(u, -1.0), function(v, -1.0), function(g, 0.0)];
        functions.iter().flatten().all(|f| f.is_finite()).then_some(functions)
    }

    fn halves(&self) -> [Half; 2] {
        let half = |triangle: usize, corners: [usize; 3], weights: [[f32; 3]; 3]| {
            let of =
                |corner: usize| weights[corners.iter().position(|&c| c == corner).expect("corners are 0, 1 and 2")];
            Half { triangle: triangle as u32, weights: [of(1), of(2)] }
        };
        // Of the corners in a piece's order.
        let first = half(self.first, self.corners, [[0.0, -0.5, -0.5], [0.5, 0.5, 0.0], [0.5, 0.0, 0.5]]);
        let second = self
            .second
            .map(|(triangle, corners)| half(triangle, corners, [[0.0, 0.5, 0.5], [0.5, 0.0, -0.5], [0.5, -0.5, 0.0]]));
        [first, second.unwrap_or(first)]
    }
}
