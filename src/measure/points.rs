//! Placement of measurement points: blue noise over the surface by weighted sample elimination (Yuksel, *Sample Elimination
//! for Generating Poisson Disk Sample Sets*, 2015; paper 4.1).
//!
//! Random candidates are thinned to the sub-points, and the sub-points to the points, so that every point is a sub-point.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use glam::{IVec3, Vec3};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::{MeasurementPoint, MeasurementPoints};
use crate::scene::Asset;

/// Candidates for each sub-point that is kept. Yuksel recommends five; more changes little.
const CANDIDATES_PER_SAMPLE: usize = 5;

/// Normals that differ by a right angle count as this share of the asset's extent when neighbours are looked for, so that
/// the two sides of a wall are not averaged.
const NORMAL_DISTANCE: f32 = 0.2;

#[derive(Debug, thiserror::Error)]
pub enum PointsError {
    #[error("points: count must be at least 1 (it is 0)")]
    None,
    #[error("points: {count} points of {sub_points} sub-points each are more than {LIMIT} in all; ask for fewer")]
    TooMany { count: usize, sub_points: usize },
    #[error("the asset has no surface area to put measurement points on")]
    NoSurface,
}

/// Sub-points in all beyond which a model would not be practical.
const LIMIT: usize = 1 << 20;

impl MeasurementPoints {
    /// How many sub-points `count` points have that average `sub_points` each.
    ///
    /// # Errors
    /// [`PointsError`] when nothing is asked for, or too much is.
    pub fn check(count: usize, sub_points: usize) -> Result<usize, PointsError> {
        if count == 0 {
            return Err(PointsError::None);
        }
        let all = count.checked_mul(sub_points.max(1)).filter(|&n| n <= LIMIT);
        all.ok_or(PointsError::TooMany { count, sub_points })
    }

    /// Places `count` points over the asset's surface, each the mean of its `sub_points` nearest out of
    /// `count · sub_points` sub-points.
    ///
    /// # Errors
    /// [`PointsError`] when nothing is asked for, too much is, or the asset has no area.
    pub fn place(asset: &Asset, count: usize, sub_points: usize, seed: u64) -> Result<Self, PointsError> {
        let per_point = sub_points.max(1);
        let dense = Self::check(count, sub_points)?;
        let mesh = &asset.mesh;
        let mut cumulative = Vec::with_capacity(mesh.triangles.len());
        let mut area = 0f64;
        for triangle in 0..mesh.triangles.len() {
            area += mesh.triangle_cross(triangle).length() as f64 * 0.5;
            cumulative.push(area);
        }
        if area.is_nan() || area <= 0.0 {
            return Err(PointsError::NoSurface);
        }

        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let candidates: Vec<MeasurementPoint> =
            (0..dense * CANDIDATES_PER_SAMPLE).map(|_| random_point(asset, &cumulative, area, &mut rng)).collect();
        let kept = eliminate(&candidates, dense, area as f32);
        let sub_points: Vec<MeasurementPoint> = kept.iter().map(|&i| candidates[i]).collect();
        let points: Vec<MeasurementPoint> =
            eliminate(&sub_points, count, area as f32).iter().map(|&i| sub_points[i]).collect();

        let scale = normal_scale(asset);
        let neighbours = points.iter().flat_map(|p| nearest(p, &sub_points, per_point, scale)).collect();
        Ok(Self { points, sub_points, neighbours })
    }
}

/// A point on the surface, uniform by area.
fn random_point(asset: &Asset, cumulative: &[f64], area: f64, rng: &mut impl Rng) -> MeasurementPoint {
    let x = rng.random::<f64>() * area;
    let triangle = cumulative.partition_point(|&c| c <= x).min(cumulative.len() - 1);
    let b = crate::math::warp::sample_uniform_triangle(glam::Vec2::new(rng.random(), rng.random()));
    let surface = asset.surface(triangle, b.x, b.y, Vec3::ZERO);
    MeasurementPoint {
        position: surface.position,
        normal: surface.normal,
        geometric_normal: surface.geometric_normal,
        albedo: surface.bsdf.albedo(),
    }
}

/// Indices of `keep` of the `samples`, ascending, removed one by one where they crowd most (Yuksel 2015, algorithm 1).
fn eliminate(samples: &[MeasurementPoint], keep: usize, area: f32) -> Vec<usize> {
    if samples.len() <= keep {
        return (0..samples.len()).collect();
    }
    // The radius at which `keep` disks would be packed hexagonally over the area (equation 3, d = 2).
    let r_max = (area / (2.0 * 3f32.sqrt() * keep as f32)).sqrt();
    let reach = 2.0 * r_max;
    // Weight limiting, with the paper's β = 0.65 and γ = 1.5 (equation 6).
    let r_min = r_max * (1.0 - (keep as f32 / samples.len() as f32).powf(1.5)) * 0.65;
    let weight = |a: &MeasurementPoint, b: &MeasurementPoint| {
        let d = a.position.distance(b.position).max(2.0 * r_min);
        // The two faces of a thin wall see different light: they do not crowd each other.
        if d >= reach || a.normal.dot(b.normal) < 0.0 { 0.0 } else { (1.0 - d / reach).powi(8) }
    };

    let cell_of = |p: Vec3| (p / reach).floor().as_ivec3();
    let mut cells: HashMap<IVec3, Vec<u32>> = HashMap::new();
    for (i, s) in samples.iter().enumerate() {
        cells.entry(cell_of(s.position)).or_default().push(i as u32);
    }
    let around = |i: usize| {
        let cell = cell_of(samples[i].position);
        let cells = &cells;
        (-1..=1)
            .flat_map(move |x| (-1..=1).flat_map(move |y| (-1..=1).map(move |z| cell + IVec3::new(x, y, z))))
            .filter_map(move |cell| cells.get(&cell))
            .flatten()
            .map(|&j| j as usize)
            .filter(move |&j| j != i)
    };

    let mut weights: Vec<f32> =
        (0..samples.len()).map(|i| around(i).map(|j| weight(&samples[i], &samples[j])).sum()).collect();
    // A heap of (weight, index) with stale entries left in place: an entry counts only while it states the present weight.
    let entry = |weight: f32, i: usize| (weight.to_bits(), Reverse(i));
    let mut heap: BinaryHeap<_> = weights.iter().enumerate().map(|(i, &w)| entry(w, i)).collect();
    let mut alive = vec![true; samples.len()];
    let mut count = samples.len();
    while count > keep {
        let Some((bits, Reverse(i))) = heap.pop() else { break };
        if !alive[i] || bits != weights[i].to_bits() {
            continue;
        }
        alive[i] = false;
        count -= 1;
        for j in around(i).filter(|&j| alive[j]) {
            let w = weight(&samples[i], &samples[j]);
            if w > 0.0 {
                // Never below zero by rounding: the order of bits is the order of values only for non-negative ones.
                weights[j] = (weights[j] - w).max(0.0);
                heap.push(entry(weights[j], j));
            }
        }
    }
    (0..samples.len()).filter(|&i| alive[i]).collect()
}

/// Metres that a right angle between normals counts as where neighbours are looked for.
pub fn normal_scale(asset: &Asset) -> f32 {
    NORMAL_DISTANCE * asset.mesh.bounds().diagonal()
}

/// Square of the distance between two places, each a position and a normal.
pub(super) fn distance_squared(a: (Vec3, Vec3), b: (Vec3, Vec3), normal_scale: f32) -> f32 {
    let turn = (1.0 - a.1.dot(b.1)).max(0.0) * normal_scale;
    a.0.distance_squared(b.0) + turn * turn
}

/// The `count` sub-points nearest to `point`, by position and normal; ties by index.
fn nearest(point: &MeasurementPoint, sub_points: &[MeasurementPoint], count: usize, normal_scale: f32) -> Vec<u32> {
    let distance =
        |s: &MeasurementPoint| distance_squared((point.position, point.normal), (s.position, s.normal), normal_scale);
    let mut order: Vec<(f32, u32)> = sub_points.iter().enumerate().map(|(i, s)| (distance(s), i as u32)).collect();
    let by_distance = |a: &(f32, u32), b: &(f32, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    if order.len() > count {
        order.select_nth_unstable_by(count - 1, by_distance);
        order.truncate(count);
    }
    order.sort_unstable_by(by_distance);
    order.into_iter().map(|(_, i)| i).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Material, Mesh};

    fn unit_square() -> Asset {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Z, Vec3::Z],
            normals: vec![Vec3::Y; 4],
            triangles: vec![[0, 2, 1], [0, 3, 2]],
            triangle_materials: vec![0, 0],
            ..Mesh::default()
        };
        Asset {
            name: "square".into(),
            mesh,
            materials: vec![Material::lambert("white", Vec3::splat(0.5))],
            textures: vec![],
            lights: vec![],
            cameras: vec![],
            warnings: vec![],
        }
    }

    fn spacing(points: &[MeasurementPoint]) -> f32 {
        let pairs = points.iter().enumerate().flat_map(|(i, a)| points[..i].iter().map(move |b| (a, b)));
        pairs.map(|(a, b)| a.position.distance(b.position)).fold(f32::INFINITY, f32::min)
    }

    /// No two of N points on unit area can all be farther apart than the hexagonal packing's 2 r_max; sample elimination
    /// reaches 0.7 of it and more in the plane (Yuksel 2015, table 1: radius ratio 0.65–0.8), random points about 0.02.
    #[test]
    fn spacing_is_above_two_thirds_of_the_hexagonal_bound() {
        let points = MeasurementPoints::place(&unit_square(), 128, 8, 1).unwrap();
        let bound = 2.0 * (1.0 / (2.0 * 3f32.sqrt() * 128.0)).sqrt();
        let ratio = spacing(&points.points) / bound;
        // The boundary lets points stand on the edge of the square, so the ratio may pass the interior's bound a little.
        assert!(ratio > 0.65 && ratio < 1.2, "ratio {ratio}");
        let random = &points.sub_points[..128];
        assert!(spacing(random) / bound < 0.65, "the control: consecutive sub-points are not spaced");
    }

    #[test]
    fn points_are_among_their_own_neighbours_and_repeat_with_the_seed() {
        let a = MeasurementPoints::place(&unit_square(), 32, 8, 7).unwrap();
        assert_eq!(a, MeasurementPoints::place(&unit_square(), 32, 8, 7).unwrap());
        assert_ne!(a, MeasurementPoints::place(&unit_square(), 32, 8, 8).unwrap());
        assert_eq!(a.sub_points.len(), 256);
        for (point, neighbours) in a.points.iter().zip(a.neighbours.chunks(8)) {
            assert_eq!(a.sub_points[neighbours[0] as usize], *point);
        }
    }

    #[test]
    fn impossible_counts_are_errors() {
        assert!(matches!(MeasurementPoints::place(&unit_square(), 0, 8, 0), Err(PointsError::None)));
        let huge = MeasurementPoints::place(&unit_square(), usize::MAX / 2, 8, 0);
        assert!(matches!(huge, Err(PointsError::TooMany { .. })));
    }
}
