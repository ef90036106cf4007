//! Triangulation of a polygon with holes by ear clipping (Eberly, *Triangulation by Ear Clipping*, 2008).

use glam::DVec2;

/// Triangles, as indices into `points`, of the polygon whose outline is the first ring and whose holes are the others.
/// `rings` holds the length of each; their points follow one another. The outline runs counter-clockwise, holes clockwise.
pub fn triangulate(points: &[DVec2], rings: &[usize]) -> Vec<[u32; 3]> {
    let mut start = 0;
    let mut rings: Vec<Vec<usize>> = rings
        .iter()
        .map(|&length| {
            start += length;
            (start - length..start).collect()
        })
        .collect();
    let mut ring = rings.remove(0);
    // Rightmost holes first: a bridge from one cannot be cut by those that follow.
    let rightmost = |hole: &Vec<usize>| hole.iter().map(|&i| points[i].x).fold(f64::MIN, f64::max);
    rings.sort_by(|a, b| rightmost(b).total_cmp(&rightmost(a)));
    while !rings.is_empty() {
        let hole = rings.remove(0);
        join(points, &mut ring, &hole, &rings);
    }
    clip_ears(points, ring)
}

fn cross(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - a)
}

/// Makes `hole` a part of `ring` by a bridge between their nearest vertices that see each other, walked both ways.
fn join(points: &[DVec2], ring: &mut Vec<usize>, hole: &[usize], others: &[Vec<usize>]) {
    let mut bridges: Vec<(f64, usize, usize)> = Vec::new();
    for (at, &v) in ring.iter().enumerate() {
        for (from, &h) in hole.iter().enumerate() {
            bridges.push((points[v].distance_squared(points[h]), at, from));
        }
    }
    bridges.sort_by(|a, b| a.0.total_cmp(&b.0));
    let crossed = |a: DVec2, b: DVec2, ring: &[usize]| {
        (0..ring.len()).any(|i| {
            let (c, d) = (points[ring[i]], points[ring[(i + 1) % ring.len()]]);
            let shares_an_end = a == c || a == d || b == c || b == d;
            !shares_an_end && cross(a, b, c) * cross(a, b, d) <= 0.0 && cross(c, d, a) * cross(c, d, b) <= 0.0
        })
    };
    let open = bridges.iter().find(|&&(_, at, from)| {
        let (a, b) = (points[ring[at]], points[hole[from]]);
        let n = ring.len();
        // A vertex that earlier bridges pass occurs more than once; the bridge leaves from where the inside is.
        let (before, after) = (points[ring[(at + n - 1) % n]], points[ring[(at + 1) % n]]);
        let inside = if cross(before, a, after) > 0.0 {
            cross(before, a, b) > 0.0 && cross(a, after, b) > 0.0
        } else {
            cross(before, a, b) > 0.0 || cross(a, after, b) > 0.0
        };
        inside && !crossed(a, b, ring) && !crossed(a, b, hole) && !others.iter().any(|o| crossed(a, b, o))
    });
    if let Some(&(_, at, from)) = open {
        let around = hole[from..].iter().chain(&hole[..=from]).copied();
        let there_and_back: Vec<usize> = around.chain([ring[at]]).collect();
        ring.splice(at + 1..at + 1, there_and_back);
    }
}

/// Cuts off the best-shaped ear until a triangle is left.
fn clip_ears(points: &[DVec2], mut ring: Vec<usize>) -> Vec<[u32; 3]> {
    let mut triangles = Vec::with_capacity(ring.len());
    while ring.len() > 3 {
        let n = ring.len();
        let corners = |i: usize| [ring[(i + n - 1) % n], ring[i], ring[(i + 1) % n]];
        let ear = (0..n).map(|i| (shape(corners(i).map(|v| points[v])), i)).filter(|&(quality, i)| {
            quality > 0.0 && !ring.iter().any(|&v| contains(corners(i).map(|v| points[v]), points[v]))
        });
        let Some((_, i)) = ear.max_by(|a, b| a.0.total_cmp(&b.0)) else {
            // What is left has no area.
            return triangles;
        };
        triangles.push(corners(i).map(|v| v as u32));
        ring.remove(i);
    }
    triangles.push([ring[0], ring[1], ring[2]].map(|v| v as u32));
    triangles
}

/// Twice the signed area over the sum of squared edges: greatest for an equilateral triangle, negative where clockwise.
fn shape([a, b, c]: [DVec2; 3]) -> f64 {
    cross(a, b, c) / (a.distance_squared(b) + b.distance_squared(c) + c.distance_squared(a))
}

/// Whether `p` lies in the triangle or on its border but is none of its corners.
fn contains([a, b, c]: [DVec2; 3], p: DVec2) -> bool {
    p != a && p != b && p != c && cross(a, b, p) >= 0.0 && cross(b, c, p) >= 0.0 && cross(c, a, p) >= 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A polygon of V vertices with H holes has V + 2H − 2 triangles, all counter-clockwise, of its area together.
    #[test]
    fn triangles_cover_a_square_with_round_holes() {
        let mut points: Vec<DVec2> = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)].map(DVec2::from).to_vec();
        let mut rings = vec![4];
        let mut area = 16.0;
        for (x, y) in [(1.0, 1.0), (3.0, 1.0), (1.0, 3.0), (3.0, 3.0), (2.0, 2.0)] {
            const SIDES: usize = 12;
            points.extend((0..SIDES).map(|i| {
                let angle = -(i as f64) / SIDES as f64 * std::f64::consts::TAU;
                DVec2::new(x, y) + 0.45 * DVec2::from_angle(angle)
            }));
            rings.push(SIDES);
            area -= 0.5 * SIDES as f64 * 0.45f64.powi(2) * (std::f64::consts::TAU / SIDES as f64).sin();
        }
        let triangles = triangulate(&points, &rings);
        assert_eq!(triangles.len(), points.len() + 2 * 5 - 2);
        let areas: Vec<f64> = triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| points[i as usize]);
                0.5 * cross(a, b, c)
            })
            .collect();
        assert!(areas.iter().all(|&a| a > 0.0));
        assert!((areas.iter().sum::<f64>() - area).abs() < 1e-12);
    }
}
