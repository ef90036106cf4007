//! The sub-point nearest to a place on the surface, by position and normal: a k-d tree over positions (Bentley 1975), in which
//! a turned normal adds to the distance.

use glam::Vec3;

use super::{MeasurementPoint, points::distance_squared};

/// Finds the nearest of some points.
pub struct Nearest {
    normal_scale: f32,
    /// A balanced tree: the middle of a range parts it along the axis of its depth, nearer ones before it.
    nodes: Vec<Node>,
}

#[derive(Clone, Copy)]
struct Node {
    position: Vec3,
    normal: Vec3,
    index: u32,
}

impl Nearest {
    /// `normal_scale`: metres that a right angle between normals counts as.
    pub fn new(points: &[MeasurementPoint], normal_scale: f32) -> Self {
        let nodes = (0..).zip(points).map(|(index, p)| Node { position: p.position, normal: p.normal, index });
        let mut nodes: Vec<Node> = nodes.collect();
        sort(&mut nodes, 0);
        Self { normal_scale, nodes }
    }

    /// The index of the point nearest to a place; none where there are no points.
    pub fn find(&self, position: Vec3, normal: Vec3) -> Option<usize> {
        let mut best = (f32::INFINITY, u32::MAX);
        self.search(&self.nodes, 0, position, normal, &mut best);
        (best.1 != u32::MAX).then_some(best.1 as usize)
    }

    fn search(&self, range: &[Node], depth: usize, position: Vec3, normal: Vec3, best: &mut (f32, u32)) {
        let middle = range.len() / 2;
        let Some(node) = range.get(middle) else { return };
        let d = distance_squared((position, normal), (node.position, node.normal), self.normal_scale);
        // Of equally near ones the first.
        if d < best.0 || (d == best.0 && node.index < best.1) {
            *best = (d, node.index);
        }
        let axis = depth % 3;
        let across = position[axis] - node.position[axis];
        let (before, after) = (&range[..middle], &range[middle + 1..]);
        let (own, other) = if across < 0.0 { (before, after) } else { (after, before) };
        self.search(own, depth + 1, position, normal, best);
        if across * across <= best.0 {
            self.search(other, depth + 1, position, normal, best);
        }
    }
}

fn sort(range: &mut [Node], depth: usize) {
    if range.len() < 2 {
        return;
    }
    let middle = range.len() / 2;
    let along = |node: &Node| node.position[depth % 3];
    range.select_nth_unstable_by(middle, |a, b| along(a).total_cmp(&along(b)).then(a.index.cmp(&b.index)));
    let (before, after) = range.split_at_mut(middle);
    sort(before, depth + 1);
    sort(&mut after[1..], depth + 1);
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// The tree finds what a look at every point finds; without the normals it would often be another one.
    #[test]
    fn the_nearest_point_is_that_of_a_plain_search() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let mut vector = || Vec3::new(rng.random(), rng.random(), rng.random()) * 2.0 - 1.0;
        let points: Vec<MeasurementPoint> = (0..300)
            .map(|_| {
                let normal = vector().normalize();
                MeasurementPoint { position: vector(), normal, geometric_normal: normal, albedo: Vec3::ONE }
            })
            .collect();
        let nearest = Nearest::new(&points, 0.5);
        let mut by_position = 0;
        for _ in 0..500 {
            let (position, normal) = (vector() * 1.5, vector().normalize());
            let plain = |scale: f32| {
                let d =
                    |i: &usize| distance_squared((position, normal), (points[*i].position, points[*i].normal), scale);
                (0..points.len()).min_by(|a, b| d(a).total_cmp(&d(b)))
            };
            assert_eq!(nearest.find(position, normal), plain(0.5));
            by_position += (plain(0.0) == plain(0.5)) as usize;
        }
        assert!(by_position < 400, "normals matter: {by_position} of 500 are the nearest without them, too");
        assert_eq!(Nearest::new(&[], 0.5).find(Vec3::ZERO, Vec3::Y), None);
    }
}
