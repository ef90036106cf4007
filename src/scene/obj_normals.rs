//! Normals for OBJ faces that have none.

use glam::Vec3;

use super::obj::{Geometry, NONE, Smoothing, Triangle};

/// Faces that meet at less than 60° are smooth across their edge where the file says nothing about smoothing: the facets
/// of a coarse sphere stay below it, the sides of a box above.
const COS_CREASE: f32 = 0.5;

/// Faces around one position, beyond which its normals stay flat: each face there is compared with every other.
const MAX_VALENCE: usize = 256;

/// Per triangle and corner, a unit normal: the mean of the smooth faces around it, weighted by their angles there
/// (Thürmer and Wüthrich 1998). Only corners without a normal of their own are meaningful.
pub(super) fn corner_normals(geometry: &Geometry) -> Vec<[Vec3; 3]> {
    let triangles = &geometry.triangles;
    if triangles.iter().all(|t| t.corners.iter().all(|c| c[2] != NONE)) {
        return vec![[Vec3::ZERO; 3]; triangles.len()];
    }
    let position = |t: usize, corner: usize| geometry.positions[triangles[t].corners[corner][0] as usize];
    let faces: Vec<Vec3> = (0..triangles.len())
        .map(|t| {
            let [a, b, c] = [0, 1, 2].map(|corner| position(t, corner));
            (b - a).cross(c - a).normalize_or_zero()
        })
        .collect();
    // Corners by position, as offsets into one list.
    let mut starts = vec![0usize; geometry.positions.len() + 1];
    for corner in triangles.iter().flat_map(|t| t.corners) {
        starts[corner[0] as usize + 1] += 1;
    }
    for i in 1..starts.len() {
        starts[i] += starts[i - 1];
    }
    let mut next = starts.clone();
    let mut around = vec![(0u32, 0.0f32); triangles.len() * 3];
    for (t, triangle) in triangles.iter().enumerate() {
        for corner in 0..3 {
            let p = position(t, corner);
            let (to_next, to_last) = (position(t, (corner + 1) % 3) - p, position(t, (corner + 2) % 3) - p);
            let angle = to_next.cross(to_last).length().atan2(to_next.dot(to_last));
            let slot = &mut next[triangle.corners[corner][0] as usize];
            around[*slot] = (t as u32, if angle.is_finite() { angle } else { 0.0 });
            *slot += 1;
        }
    }
    let mean = |t: usize, corner: usize| {
        let p = triangles[t].corners[corner][0] as usize;
        let neighbours = &around[starts[p]..starts[p + 1]];
        if neighbours.len() > MAX_VALENCE {
            return faces[t];
        }
        let smooth = neighbours.iter().filter(|&&(other, _)| {
            other as usize == t
                || is_smooth(&triangles[t], &triangles[other as usize], faces[t].dot(faces[other as usize]))
        });
        let sum: Vec3 = smooth.map(|&(other, angle)| faces[other as usize] * angle).sum();
        sum.normalize_or(faces[t])
    };
    (0..triangles.len()).map(|t| [0, 1, 2].map(|corner| mean(t, corner))).collect()
}

fn is_smooth(a: &Triangle, b: &Triangle, cos_angle: f32) -> bool {
    match (a.smoothing, b.smoothing) {
        (Smoothing::ByAngle, Smoothing::ByAngle) => cos_angle > COS_CREASE,
        (Smoothing::Group(a), Smoothing::Group(b)) => a == b,
        _ => false,
    }
}
