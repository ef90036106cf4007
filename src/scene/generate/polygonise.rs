//! Turns a signed distance into triangles by naive surface nets (Gibson, *Constrained Elastic Surface Nets*, 1998).

use glam::{UVec3, Vec3};

/// A lattice of `cells` cubes of side `spacing` from `corner`.
#[derive(Clone, Copy, Debug)]
pub struct Lattice {
    pub corner: Vec3,
    pub spacing: f32,
    pub cells: UVec3,
}

/// Vertices and triangles of the surface `distance` = 0, which faces the positive side: one vertex in each cell that the
/// surface crosses, one quad about each lattice edge that it crosses. The surface is open where it leaves the lattice.
pub fn surface_net(lattice: Lattice, distance: impl Fn(Vec3) -> f32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let Lattice { corner, spacing, cells } = lattice;
    let nodes = cells + 1;
    let position = |node: UVec3| corner + node.as_vec3() * spacing;
    let node_index = |n: UVec3| ((n.z * nodes.y + n.y) * nodes.x + n.x) as usize;
    let mut values = vec![0f32; (nodes.x * nodes.y * nodes.z) as usize];
    for node in points_below(nodes) {
        values[node_index(node)] = distance(position(node));
    }
    let value = |node: UVec3| values[node_index(node)];

    let mut positions = Vec::new();
    let cell_index = |c: UVec3| ((c.z * cells.y + c.y) * cells.x + c.x) as usize;
    let mut vertex_of = vec![u32::MAX; (cells.x * cells.y * cells.z) as usize];
    for cell in points_below(cells) {
        // The mean of the crossings of the cell's twelve edges.
        let (mut sum, mut count) = (Vec3::ZERO, 0);
        for (a, b) in cell_edges() {
            let (a, b) = (cell + a, cell + b);
            let (va, vb) = (value(a), value(b));
            if (va < 0.0) != (vb < 0.0) {
                sum += position(a).lerp(position(b), va / (va - vb));
                count += 1;
            }
        }
        if count > 0 {
            vertex_of[cell_index(cell)] = positions.len() as u32;
            positions.push(sum / count as f32);
        }
    }

    let mut triangles = Vec::new();
    for node in points_below(cells) {
        for axis in 0..3 {
            let along = unit(axis);
            let (u, v) = (unit((axis + 1) % 3), unit((axis + 2) % 3));
            let (inside, next_inside) = (value(node) < 0.0, value(node + along) < 0.0);
            let on_border = node[(axis + 1) % 3] == 0 || node[(axis + 2) % 3] == 0;
            if inside == next_inside || on_border {
                continue;
            }
            let around = [node, node - u, node - u - v, node - v].map(|cell| vertex_of[cell_index(cell)]);
            let [a, b, c, d] = if inside { around } else { [around[3], around[2], around[1], around[0]] };
            // The shorter diagonal.
            let length = |i: u32, j: u32| positions[i as usize].distance_squared(positions[j as usize]);
            if length(a, c) <= length(b, d) {
                triangles.extend([[a, b, c], [a, c, d]]);
            } else {
                triangles.extend([[a, b, d], [b, c, d]]);
            }
        }
    }
    (positions, triangles)
}

fn points_below(end: UVec3) -> impl Iterator<Item = UVec3> {
    (0..end.z).flat_map(move |z| (0..end.y).flat_map(move |y| (0..end.x).map(move |x| UVec3::new(x, y, z))))
}

fn unit(axis: usize) -> UVec3 {
    UVec3::AXES[axis]
}

fn cell_edges() -> impl Iterator<Item = (UVec3, UVec3)> {
    (0..3).flat_map(|axis| {
        let (along, u, v) = (unit(axis), unit((axis + 1) % 3), unit((axis + 2) % 3));
        [UVec3::ZERO, u, v, u + v].map(|start| (start, start + along))
    })
}
