//! Builds a mesh from flat polygons, surfaces of revolution and free triangles, and lays out its lightmap cells.

use std::f32::consts::TAU;

use glam::{DVec2, Vec2, Vec3};

use super::pack::{LIGHTMAP_SIZE, pack};
use super::triangulate::triangulate;
use crate::math::Rgb;
use crate::scene::{Asset, Camera, Material, Mesh};

/// A mesh under construction. TEXCOORD_0 is in metres along the surface. TEXCOORD_1 gives each patch a cell of its own,
/// sized by its area, unless a free mesh is among them: then the lightmap is left to the unwrapper.
#[derive(Default)]
pub struct MeshBuilder {
    mesh: Mesh,
    materials: Vec<Material>,
    patches: Vec<Patch>,
    has_free_mesh: bool,
}

/// Vertices that share a lightmap cell; their TEXCOORD_0 lies within (0, 0) to `size`.
struct Patch {
    first_vertex: usize,
    vertex_count: usize,
    /// Metres.
    size: Vec2,
}

/// What hides a face of a [`MeshBuilder::prism`] where it touches something else.
pub enum Cover {
    Whole,
    /// The outlines of what touches it.
    Parts(Vec<Vec<Vec3>>),
}

impl MeshBuilder {
    /// A Lambert material of the given linear reflectance.
    pub fn lambert(&mut self, name: &str, reflectance: Rgb) -> u32 {
        self.materials.push(Material::lambert(name, reflectance));
        self.materials.len() as u32 - 1
    }

    /// A flat polygon; `outline` runs counter-clockwise as seen from its front, which decides the normal. A corner that
    /// lies off the plane is kept where it is.
    pub fn polygon(&mut self, outline: &[Vec3], material: u32) {
        self.polygon_with_holes(outline, &[], material);
    }

    /// A flat polygon with holes, whose outlines may run either way.
    pub fn polygon_with_holes(&mut self, outline: &[Vec3], holes: &[Vec<Vec3>], material: u32) {
        let normal = area_vector(outline).normalize_or(Vec3::Y);
        // Lying cells pack better than standing ones.
        let edges = (0..outline.len()).map(|i| outline[(i + 1) % outline.len()] - outline[i]);
        let longest = edges.max_by(|a, b| a.length_squared().total_cmp(&b.length_squared())).unwrap_or(Vec3::X);
        let u = longest.reject_from(normal).normalize_or(Vec3::X);
        let v = normal.cross(u);
        let mut points = outline.to_vec();
        for hole in holes {
            if area_vector(hole).dot(normal) > 0.0 {
                points.extend(hole.iter().rev());
            } else {
                points.extend(hole);
            }
        }
        let flat: Vec<Vec2> = points.iter().map(|p| Vec2::new(p.dot(u), p.dot(v))).collect();
        let rings: Vec<usize> = [outline.len()].into_iter().chain(holes.iter().map(Vec::len)).collect();
        let flat_f64: Vec<DVec2> = flat.iter().map(|p| p.as_dvec2()).collect();
        let triangles = triangulate(&flat_f64, &rings);
        self.patch(&points, &vec![normal; points.len()], &flat, &triangles, material);
    }

    /// The solid that `outline` sweeps along `extrude`, without what `covers` says is covered.
    pub fn prism(&mut self, outline: &[Vec3], extrude: Vec3, covers: &[(Vec3, Cover)], material: u32) {
        let mut outline = outline.to_vec();
        if area_vector(&outline).dot(extrude) < 0.0 {
            outline.reverse();
        }
        let n = outline.len();
        let mut faces: Vec<Vec<Vec3>> = (0..n)
            .map(|i| {
                let (a, b) = (outline[i], outline[(i + 1) % n]);
                vec![a, b, b + extrude, a + extrude]
            })
            .collect();
        faces.push(outline.iter().map(|&p| p + extrude).collect());
        faces.push(outline.into_iter().rev().collect());
        for face in faces {
            let normal = area_vector(&face).normalize_or(Vec3::Y);
            match covers.iter().find(|(covered, _)| covered.dot(normal) > 0.999) {
                None => self.polygon(&face, material),
                Some((_, Cover::Whole)) => {}
                Some((_, Cover::Parts(outlines))) => self.polygon_with_holes(&face, outlines, material),
            }
        }
    }

    /// A surface of revolution about the vertical axis through `centre`, of which `profile` holds (radius, height),
    /// listed so that the outside lies to the right of the walk. Smooth around, creased between profile segments.
    pub fn lathe(&mut self, centre: Vec3, profile: &[Vec2], segments: usize, material: u32) {
        for pair in profile.windows(2) {
            let [low, high] = [pair[0], pair[1]];
            let along = high - low;
            let outward = Vec2::new(along.y, -along.x).normalize_or(Vec2::X);
            let width = TAU * low.x.max(high.x);
            let (mut positions, mut normals, mut uvs) = (Vec::new(), Vec::new(), Vec::new());
            for i in 0..=segments {
                for (row, end) in [low, high].into_iter().enumerate() {
                    positions.push(ring_point(centre, end, i, segments));
                    let direction = ring_point(Vec3::ZERO, Vec2::X, i, segments);
                    normals.push(direction * outward.x + Vec3::Y * outward.y);
                    uvs.push(Vec2::new(width * i as f32 / segments as f32, along.length() * row as f32));
                }
            }
            let triangles: Vec<[u32; 3]> = (0..segments as u32)
                .flat_map(|i| [[2 * i, 2 * i + 1, 2 * i + 2], [2 * i + 1, 2 * i + 3, 2 * i + 2]])
                .collect();
            self.patch(&positions, &normals, &uvs, &triangles, material);
        }
    }

    /// Triangles without lightmap cells.
    pub fn free_mesh(&mut self, positions: &[Vec3], normals: &[Vec3], triangles: &[[u32; 3]], material: u32) {
        let uvs: Vec<Vec2> = positions.iter().map(|p| Vec2::new(p.x, p.y)).collect();
        self.patch(positions, normals, &uvs, triangles, material);
        self.has_free_mesh = true;
    }

    /// Adds a patch with its vertices' coordinates along the surface, metres.
    fn patch(&mut self, positions: &[Vec3], normals: &[Vec3], uvs: &[Vec2], triangles: &[[u32; 3]], material: u32) {
        let first_vertex = self.mesh.positions.len();
        let (min, max) =
            uvs.iter().fold((Vec2::INFINITY, Vec2::NEG_INFINITY), |(min, max), &uv| (min.min(uv), max.max(uv)));
        self.mesh.positions.extend(positions);
        self.mesh.normals.extend(normals);
        self.mesh.uvs[0].extend(uvs.iter().map(|&uv| uv - min));
        self.mesh.triangles.extend(triangles.iter().map(|t| t.map(|v| v + first_vertex as u32)));
        self.mesh.triangle_materials.resize(self.mesh.triangles.len(), material);
        self.patches.push(Patch { first_vertex, vertex_count: positions.len(), size: max - min });
    }

    /// The asset, with its lightmap cells packed.
    pub fn finish(mut self, name: &str, camera: Camera) -> Asset {
        if !self.has_free_mesh {
            self.lay_out_cells();
        }
        Asset {
            name: name.to_owned(),
            mesh: self.mesh,
            materials: self.materials,
            textures: Vec::new(),
            lights: Vec::new(),
            cameras: vec![camera],
            warnings: Vec::new(),
        }
    }

    fn lay_out_cells(&mut self) {
        let sizes: Vec<Vec2> = self.patches.iter().map(|p| p.size).collect();
        let Some(cells) = pack(&sizes) else {
            return;
        };
        for (patch, cell) in self.patches.iter().zip(cells) {
            let scale = Vec2::new(cell.width as f32, cell.height as f32) / patch.size;
            let corner = Vec2::new(cell.x as f32, cell.y as f32);
            let vertices = patch.first_vertex..patch.first_vertex + patch.vertex_count;
            let [metres, lightmap] = &mut self.mesh.uvs;
            lightmap.extend(metres[vertices].iter().map(|&uv| (corner + uv * scale) / LIGHTMAP_SIZE as f32));
        }
    }
}

/// Twice the area of a polygon times its normal (Newell's method).
fn area_vector(ring: &[Vec3]) -> Vec3 {
    (0..ring.len()).map(|i| (ring[i] - ring[0]).cross(ring[(i + 1) % ring.len()] - ring[0])).sum()
}

/// The horizontal ring that a lathe makes at a profile point.
pub fn ring(centre: Vec3, profile: Vec2, segments: usize) -> Vec<Vec3> {
    (0..segments).map(|i| ring_point(centre, profile, i, segments)).collect()
}

fn ring_point(centre: Vec3, profile: Vec2, i: usize, segments: usize) -> Vec3 {
    // The last point is the first, to the bit.
    let angle = TAU * (i % segments) as f32 / segments as f32;
    centre + Vec3::new(profile.x * angle.cos(), profile.y, profile.x * angle.sin())
}
