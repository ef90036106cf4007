//! Gathers imported primitives into one world-space mesh, repairing what can be repaired and counting what cannot.

use glam::{Mat3, Mat4, Vec2, Vec3};

use super::Mesh;

/// More triangles than this are refused: at about 100 bytes each they would fill tens of gigabytes.
const MAX_TRIANGLES: usize = 200_000_000;

/// One piece of indexed geometry as a file holds it. Every index is in range.
#[derive(Default)]
pub(super) struct Primitive {
    pub positions: Vec<Vec3>,
    /// Per vertex; flat normals are made where a file has none.
    pub normals: Option<Vec<Vec3>>,
    pub uvs: [Option<Vec<Vec2>>; 2],
    pub colours: Option<Vec<Vec3>>,
    pub triangles: Vec<[u32; 3]>,
    /// Per triangle.
    pub materials: Vec<u32>,
}

/// What was repaired or left out, over all primitives.
#[derive(Default)]
struct Repairs {
    no_area: usize,
    not_finite: usize,
    normals: usize,
    uvs: usize,
    colours: usize,
}

/// Builds the asset's mesh primitive by primitive.
#[derive(Default)]
pub(super) struct MeshBuilder {
    mesh: Mesh,
    has_uvs: [bool; 2],
    has_colours: bool,
    repairs: Repairs,
}

impl MeshBuilder {
    /// Appends a primitive placed by `world`, whose mirror images keep their front side.
    ///
    /// # Errors
    /// The mesh would grow beyond what can be held.
    pub fn add(&mut self, primitive: &Primitive, world: Mat4) -> Result<(), String> {
        if self.mesh.triangles.len() + primitive.triangles.len() > MAX_TRIANGLES {
            return Err(format!("more than {MAX_TRIANGLES} triangles with all instances expanded; reduce its detail"));
        }
        let positions: Vec<Vec3> = primitive.positions.iter().map(|&p| world.transform_point3(p)).collect();
        let mirrored = world.determinant() < 0.0;
        let kept = self.kept_triangles(&positions, primitive, mirrored);
        match &primitive.normals {
            Some(normals) => {
                let normals = self.placed_normals(normals, &positions, &kept, world, mirrored);
                self.append_indexed(primitive, &positions, &normals, &kept);
            }
            None => self.append_flat(primitive, &positions, &kept),
        }
        Ok(())
    }

    /// The mesh and one line for each kind of repair.
    pub fn finish(mut self) -> (Mesh, Vec<String>) {
        let vertices = self.mesh.positions.len();
        for (uvs, present) in self.mesh.uvs.iter_mut().zip(self.has_uvs) {
            if present {
                uvs.resize(vertices, Vec2::ZERO);
            }
        }
        if self.has_colours {
            self.mesh.colours.resize(vertices, Vec3::ONE);
        }
        let r = &self.repairs;
        let warnings = [
            (r.no_area, "triangles without area were left out"),
            (r.not_finite, "triangles with positions that are not finite were left out"),
            (r.normals, "vertex normals that were zero or not finite were made anew from the triangles around them"),
            (r.uvs, "texture coordinates that were not finite were set to 0"),
            (r.colours, "vertex colours that were negative or not finite were set to 0"),
        ];
        let warnings = warnings.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")).collect();
        (self.mesh, warnings)
    }

    /// Triangles that have an area, in world winding, with their materials.
    fn kept_triangles(&mut self, positions: &[Vec3], primitive: &Primitive, mirrored: bool) -> Vec<([u32; 3], u32)> {
        let mut kept = Vec::with_capacity(primitive.triangles.len());
        for (&[i, j, k], &material) in primitive.triangles.iter().zip(&primitive.materials) {
            let [a, b, c] = [i, j, k].map(|v| positions[v as usize]);
            let cross = (b - a).cross(c - a);
            // Later squares of lengths must stay finite as well.
            if !cross.length_squared().is_finite() {
                self.repairs.not_finite += 1;
                continue;
            }
            let longest = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
            // Its height is under the rounding of its longest edge: the normal would be noise.
            let flat = cross.length() <= f32::EPSILON * longest;
            if flat || cross.length_squared() < f32::MIN_POSITIVE {
                self.repairs.no_area += 1;
                continue;
            }
            kept.push((if mirrored { [i, k, j] } else { [i, j, k] }, material));
        }
        kept
    }

    /// World-space unit normals; one that is unusable becomes the area-weighted mean of its triangles' normals.
    fn placed_normals(
        &mut self,
        normals: &[Vec3],
        positions: &[Vec3],
        kept: &[([u32; 3], u32)],
        world: Mat4,
        mirrored: bool,
    ) -> Vec<Vec3> {
        // The cofactor matrix is the inverse transpose times the determinant, and exists for flat scalings too.
        let m = Mat3::from_mat4(world);
        let cofactor = Mat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
        let sign = if mirrored { -1.0 } else { 1.0 };
        let mut placed: Vec<Vec3> = normals
            .iter()
            .map(|&n| unit(cofactor * unit(n).unwrap_or(Vec3::ZERO) * sign).unwrap_or(Vec3::ZERO))
            .collect();
        let unusable: Vec<bool> = placed.iter().map(|n| *n == Vec3::ZERO).collect();
        if unusable.iter().any(|&u| u) {
            let mut used = vec![false; placed.len()];
            for &([i, j, k], _) in kept {
                let [a, b, c] = [i, j, k].map(|v| positions[v as usize]);
                for v in [i, j, k].map(|v| v as usize).into_iter().filter(|&v| unusable[v]) {
                    placed[v] += (b - a).cross(c - a);
                    used[v] = true;
                }
            }
            for v in (0..placed.len()).filter(|&v| used[v]) {
                placed[v] = unit(placed[v]).unwrap_or(Vec3::Y);
                self.repairs.normals += 1;
            }
        }
        placed
    }

    /// Appends the vertices that the kept triangles use, each once.
    fn append_indexed(
        &mut self,
        primitive: &Primitive,
        positions: &[Vec3],
        normals: &[Vec3],
        kept: &[([u32; 3], u32)],
    ) {
        const UNUSED: u32 = u32::MAX;
        let mut renumbered = vec![UNUSED; positions.len()];
        for &(triangle, material) in kept {
            let triangle = triangle.map(|v| {
                let source = v as usize;
                if renumbered[source] == UNUSED {
                    renumbered[source] = self.push_vertex(primitive, source, positions[source], normals[source]);
                }
                renumbered[source]
            });
            self.mesh.triangles.push(triangle);
            self.mesh.triangle_materials.push(material);
        }
    }

    /// Appends every triangle with three vertices of its own and its face normal (glTF 2.0, section 3.7.2.1).
    fn append_flat(&mut self, primitive: &Primitive, positions: &[Vec3], kept: &[([u32; 3], u32)]) {
        for &(triangle, material) in kept {
            let [a, b, c] = triangle.map(|v| positions[v as usize]);
            let normal = unit((b - a).cross(c - a)).unwrap_or(Vec3::Y);
            let triangle = triangle.map(|v| self.push_vertex(primitive, v as usize, positions[v as usize], normal));
            self.mesh.triangles.push(triangle);
            self.mesh.triangle_materials.push(material);
        }
    }

    fn push_vertex(&mut self, primitive: &Primitive, source: usize, position: Vec3, normal: Vec3) -> u32 {
        let index = self.mesh.positions.len();
        self.mesh.positions.push(position);
        self.mesh.normals.push(normal);
        for set in 0..2 {
            if let Some(uvs) = &primitive.uvs[set] {
                let uv = uvs[source];
                self.has_uvs[set] = true;
                self.repairs.uvs += !uv.is_finite() as usize;
                // Vertices of earlier primitives without this set are filled up here.
                self.mesh.uvs[set].resize(index, Vec2::ZERO);
                self.mesh.uvs[set].push(if uv.is_finite() { uv } else { Vec2::ZERO });
            }
        }
        if let Some(colours) = &primitive.colours {
            let colour = colours[source];
            let usable = colour.is_finite() && colour.min_element() >= 0.0;
            self.has_colours = true;
            self.repairs.colours += !usable as usize;
            self.mesh.colours.resize(index, Vec3::ONE);
            self.mesh.colours.push(if usable { colour } else { Vec3::ZERO });
        }
        index as u32
    }
}

/// The unit vector along `v`, or `None` for a vector that is zero or not finite.
fn unit(v: Vec3) -> Option<Vec3> {
    // Scaled by its largest element first, so that very small and very large vectors neither vanish nor overflow.
    let scaled = v / v.abs().max_element();
    scaled.is_finite().then(|| scaled.normalize())
}
