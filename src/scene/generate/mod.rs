//! Assets made by program: small scenes that need no file.
//!
//! No surface lies inside a solid and none is covered by another, so that every lightmap texel can be lit.

mod builder;
mod cornell;
mod interior;
mod pack;
mod polygonise;
mod statue;
mod triangulate;

pub use builder::MeshBuilder;

use super::Asset;

/// The names that [`generate`] knows.
pub const NAMES: [&str; 3] = ["cornell", "interior", "statue"];

/// The asset of that name; none where [`NAMES`] does not hold it.
pub fn generate(name: &str) -> Option<Asset> {
    match name {
        "cornell" => Some(cornell::cornell()),
        "interior" => Some(interior::interior()),
        "statue" => Some(statue::statue()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use std::collections::HashMap;

    /// Edges by position, each with the number of triangles that run along it forwards and backwards.
    fn edges(asset: &Asset) -> HashMap<([u32; 3], [u32; 3]), (u32, u32)> {
        let key = |p: Vec3| p.to_array().map(|x| (x + 0.0).to_bits());
        let mut edges = HashMap::new();
        for t in 0..asset.mesh.triangles.len() {
            let corners = asset.mesh.triangle_positions(t).map(key);
            for i in 0..3 {
                let (a, b) = (corners[i], corners[(i + 1) % 3]);
                let entry: &mut (u32, u32) = edges.entry((a.min(b), a.max(b))).or_default();
                if a < b { entry.0 += 1 } else { entry.1 += 1 }
            }
        }
        edges
    }

    #[test]
    fn every_asset_is_whole() {
        for name in NAMES {
            let asset = generate(name).unwrap();
            let mesh = &asset.mesh;
            assert_eq!(mesh.normals.len(), mesh.positions.len(), "{name}");
            assert_eq!(mesh.triangle_materials.len(), mesh.triangles.len(), "{name}");
            assert!(mesh.triangle_materials.iter().all(|&m| (m as usize) < asset.materials.len()), "{name}");
            assert_eq!(asset.cameras.len(), 1, "{name}");
            for t in 0..mesh.triangles.len() {
                let cross = mesh.triangle_cross(t);
                assert!(cross.length() > 1e-8, "{name}: triangle {t} has no area");
                for v in mesh.triangles[t] {
                    let normal = mesh.normals[v as usize];
                    assert!((normal.length() - 1.0).abs() < 1e-5, "{name}: normal {normal}");
                    assert!(normal.dot(cross) > 0.0, "{name}: the normal of vertex {v} points below triangle {t}");
                }
            }
        }
    }

    /// Triangles that share an edge run along it in opposite directions, never more than one each way; where only one
    /// runs, the surface has a border. Borders are where the room opens or the ground ends.
    #[test]
    fn surfaces_are_closed_but_for_their_openings() {
        for (name, on_border) in [
            ("cornell", (|p| p.z < 1e-4) as fn(Vec3) -> bool),
            ("interior", |p| p.x > interior::OUTSIDE_X - 1e-4 || p.z > interior::OUTSIDE_Z - 1e-4),
            ("statue", |p| p.y.abs() < 1e-6 && p.length() > statue::GROUND_RADIUS_M - 1e-3),
        ] {
            let mut borders = 0;
            for ((a, b), (forwards, backwards)) in edges(&generate(name).unwrap()) {
                let [a, b] = [a, b].map(|p| Vec3::from_array(p.map(f32::from_bits)));
                assert!(forwards <= 1 && backwards <= 1, "{name}: {forwards} + {backwards} triangles at {a} to {b}");
                if forwards + backwards == 1 {
                    assert!(on_border(a) && on_border(b), "{name}: the surface is open at {a} to {b}");
                    borders += 1;
                }
            }
            assert!(borders > 0, "{name} has no opening");
        }
    }

    /// Lightmap cells lie in the unit square, and no two share a texel of a 128² lightmap.
    #[test]
    fn lightmap_cells_do_not_overlap() {
        const SIZE: usize = 4 * pack::LIGHTMAP_SIZE;
        for name in ["cornell", "interior"] {
            let mesh = generate(name).unwrap().mesh;
            assert_eq!(mesh.uvs[1].len(), mesh.positions.len(), "{name}");
            let mut owner = vec![u32::MAX; SIZE * SIZE];
            let mut covered = 0;
            for (t, triangle) in mesh.triangles.iter().enumerate() {
                let [a, b, c] = triangle.map(|v| mesh.uvs[1][v as usize] * SIZE as f32);
                let (lo, hi) = (a.min(b).min(c), a.max(b).max(c));
                assert!(lo.min_element() >= 0.0 && hi.max_element() <= SIZE as f32, "{name}: {lo} {hi}");
                for y in lo.y as usize..(hi.y.ceil() as usize).min(SIZE) {
                    for x in lo.x as usize..(hi.x.ceil() as usize).min(SIZE) {
                        let p = glam::Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                        let side = |a: glam::Vec2, b: glam::Vec2| (b - a).perp_dot(p - a);
                        let (u, v, w) = (side(a, b), side(b, c), side(c, a));
                        // Strictly inside: a texel on a shared edge belongs to both triangles.
                        if u.min(v).min(w) > 1e-3 || u.max(v).max(w) < -1e-3 {
                            let owner = &mut owner[y * SIZE + x];
                            assert_eq!(*owner, u32::MAX, "{name}: triangles {t} and {owner} share a texel");
                            *owner = t as u32;
                            covered += 1;
                        }
                    }
                }
            }
            let share = covered as f64 / (SIZE * SIZE) as f64;
            assert!(share > 0.5, "{name}: only {:.0} % of the lightmap is used", share * 100.0);
        }
    }

    #[test]
    fn unknown_names_make_nothing() {
        assert!(generate("teapot").is_none());
    }
}
