//! A robed figure on a plinth, in free space on a round ground: folds, arms that stand off the body, and a hollow under the
//! chin shade and light one another. Polygonised from a smooth union of distances (Quilez, *Smooth Minimum*, 2013).

use glam::{UVec3, Vec2, Vec3};

use super::MeshBuilder;
use super::builder::ring;
use super::polygonise::{Lattice, surface_net};
use crate::scene::{Asset, Camera};

/// Side of the polygonisation's cells, metres.
const SPACING_M: f32 = 0.034;

pub const GROUND_RADIUS_M: f32 = 2.4;
const GROUND_SEGMENTS: usize = 48;
/// Radii of the ground's rings, metres; finer near the statue, where its shade varies.
const GROUND_RINGS: [f32; 7] = [0.6, 0.75, 0.95, 1.2, 1.55, 1.95, GROUND_RADIUS_M];

pub fn statue() -> Asset {
    // The lowest row of cells straddles the ground, in which its vertices come to lie.
    let lattice =
        Lattice { corner: Vec3::new(-0.6, -0.5 * SPACING_M, -0.6), spacing: SPACING_M, cells: UVec3::new(36, 60, 36) };
    // Below the ground the figure goes straight on.
    let (mut positions, triangles) = surface_net(lattice, |p| figure(p.with_y(p.y.max(0.0))));
    for p in &mut positions {
        let on_ground = p.y < 0.5 * SPACING_M;
        // A net's vertices lie off the surface where it curves; a Newton step brings them near it.
        let step = (gradient(*p) * figure(*p)).clamp_length_max(0.2 * SPACING_M);
        *p -= if on_ground { step.with_y(p.y) } else { step };
    }
    let normals = smooth_normals(&positions, &triangles);
    let foot = border(&positions, &triangles);

    let mut mesh = MeshBuilder::default();
    let marble = mesh.lambert("marble", Vec3::new(0.76, 0.72, 0.65));
    let ground = mesh.lambert("ground", Vec3::new(0.45, 0.28, 0.17));
    mesh.free_mesh(&positions, &normals, &triangles, marble);
    let mut inner = ring(Vec3::ZERO, Vec2::new(GROUND_RINGS[0], 0.0), GROUND_SEGMENTS);
    inner.reverse();
    mesh.polygon_with_holes(&inner, &[foot], ground);
    // Walked inwards, the outside of a flat profile is up.
    let rings: Vec<Vec2> = GROUND_RINGS.iter().rev().map(|&r| Vec2::new(r, 0.0)).collect();
    mesh.lathe(Vec3::ZERO, &rings, GROUND_SEGMENTS, ground);
    let camera =
        Camera { eye: Vec3::new(1.7, 1.75, 3.3), target: Vec3::new(0.0, 0.82, 0.0), up: Vec3::Y, vertical_fov: 36.0 };
    mesh.finish("statue", camera)
}

/// Signed distance (to within a small factor) to the figure, metres; negative inside.
fn figure(p: Vec3) -> f32 {
    // Left and right are alike but for the arms.
    let robe = {
        // A cone with folds that deepen towards the hem.
        let height = p.y - 0.16;
        let along = (height / 0.95).clamp(0.0, 1.0);
        let angle = p.z.atan2(p.x);
        let fold = 0.032 * (1.0 - along).powi(2) * (9.0 * angle + 1.5 * along).cos();
        let radius = 0.31 - 0.17 * along.sqrt() + fold;
        let flat = Vec2::new(p.x, p.z * 1.15).length() - radius;
        let below = (0.5 - (along - 0.5).abs()).min(0.0);
        // The field is steeper than a distance by the slope of the cone and the folds.
        0.8 * flat.max(height - 0.95).max(-height - 0.05) - below
    };
    let torso = capsule(p, Vec3::new(0.0, 0.98, 0.0), Vec3::new(0.0, 1.3, 0.015), 0.15);
    let shoulders = capsule(p, Vec3::new(-0.17, 1.38, 0.0), Vec3::new(0.17, 1.38, 0.0), 0.075);
    let neck = capsule(p, Vec3::new(0.0, 1.38, 0.0), Vec3::new(0.0, 1.52, 0.02), 0.055);
    let head = (p - Vec3::new(0.0, 1.64, 0.04)).length() - 0.115;
    let body = smooth_min(smooth_min(robe, torso, 0.12), shoulders, 0.08);
    let body = smooth_min(smooth_min(body, neck, 0.04), head, 0.03);
    // One hand on the hip, which leaves a loop; the other arm held forwards with a bowl.
    let elbow = Vec3::new(-0.42, 1.13, -0.04);
    let left = smooth_min(
        capsule(p, Vec3::new(-0.2, 1.38, 0.0), elbow, 0.055),
        capsule(p, elbow, Vec3::new(-0.19, 0.98, 0.06), 0.048),
        0.03,
    );
    let elbow = Vec3::new(0.31, 1.14, 0.08);
    let hand = Vec3::new(0.2, 1.2, 0.36);
    let right = smooth_min(capsule(p, Vec3::new(0.2, 1.38, 0.0), elbow, 0.055), capsule(p, elbow, hand, 0.048), 0.03);
    let bowl_centre = hand + Vec3::new(0.0, 0.16, 0.04);
    let hollow = bowl_centre + Vec3::Y * 0.07;
    let bowl = smooth_max((p - bowl_centre).length() - 0.15, 0.1 - (p - hollow).length(), 0.02);
    let bowl = smooth_max(bowl, p.y - bowl_centre.y, 0.02);
    let bowl = smooth_min(right, bowl, 0.03);
    let arms = left.min(bowl);
    let statue = smooth_min(body, arms, 0.04);
    let plinth = {
        let d = Vec2::new(Vec2::new(p.x, p.z).length() - 0.44, p.y - 0.14);
        d.max(Vec2::ZERO).length() + d.max_element().min(0.0) - 0.03
    };
    smooth_min(statue, plinth, 0.03)
}

fn capsule(p: Vec3, a: Vec3, b: Vec3, radius: f32) -> f32 {
    let along = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
    p.distance(a.lerp(b, along)) - radius
}

/// The minimum, rounded where the two are within `width` of each other.
fn smooth_min(a: f32, b: f32, width: f32) -> f32 {
    let h = (width - (a - b).abs()).max(0.0) / width;
    a.min(b) - h * h * width * 0.25
}

fn smooth_max(a: f32, b: f32, width: f32) -> f32 {
    -smooth_min(-a, -b, width)
}

fn gradient(p: Vec3) -> Vec3 {
    // Small against the features, large against f32 rounding.
    const STEP: f32 = 1e-3;
    let difference = |axis: Vec3| figure(p + axis * STEP) - figure(p - axis * STEP);
    Vec3::new(difference(Vec3::X), difference(Vec3::Y), difference(Vec3::Z)) / (2.0 * STEP)
}

/// Means of the normals of the triangles around each vertex, weighted by area.
fn smooth_normals(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut normals = vec![Vec3::ZERO; positions.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|v| positions[v as usize]);
        triangle.iter().for_each(|&v| normals[v as usize] += (b - a).cross(c - a));
    }
    normals.into_iter().map(|n| n.normalize_or(Vec3::Y)).collect()
}

/// The one closed line along which the mesh is open.
fn border(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let edges: std::collections::HashSet<(u32, u32)> =
        triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]).collect();
    let next: std::collections::BTreeMap<u32, u32> =
        edges.iter().filter(|&&(a, b)| !edges.contains(&(b, a))).copied().collect();
    let mut line = Vec::new();
    if let Some((&start, _)) = next.first_key_value() {
        let mut at = start;
        while let Some(&after) = next.get(&at).filter(|_| line.len() < next.len()) {
            line.push(positions[at as usize]);
            at = after;
        }
    }
    line
}
