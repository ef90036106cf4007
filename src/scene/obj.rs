//! Wavefront OBJ import: polygons with positions, texture coordinates, normals and colours, and their MTL materials.
//!
//! Texture coordinates have v upwards in OBJ and downwards here.

use std::collections::HashMap;
use std::path::Path;

use glam::{Mat4, Vec2, Vec3};

use super::build::{MeshBuilder, Primitive};
use super::load::{Source, one_line};
use super::mtl::Library;
use super::obj_normals::corner_normals;
use super::{Asset, Material, SceneError};

/// What a corner without a texture coordinate or normal has in their place.
pub(super) const NONE: u32 = u32::MAX;

/// A triangle of a face. Corners are (position, texture coordinate, normal).
pub(super) struct Triangle {
    pub corners: [[u32; 3]; 3],
    /// Index into [`Geometry::material_names`].
    pub material: u32,
    pub smoothing: Smoothing,
}

/// How a made normal treats the faces around it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Smoothing {
    /// The file says nothing: smooth where faces meet at a small angle.
    ByAngle,
    Flat,
    /// Smooth among the faces of one group.
    Group(u32),
}

/// An OBJ file's statements.
#[derive(Default)]
pub(super) struct Geometry {
    pub positions: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    pub triangles: Vec<Triangle>,
    uvs: Vec<Vec2>,
    /// Empty, or one per position.
    colours: Vec<Vec3>,
    /// In order of first use; the empty name is the default material.
    material_names: Vec<String>,
    libraries: Vec<String>,
    left_out: usize,
}

/// Imports an OBJ file.
pub(super) fn import(source: &Source) -> Result<Asset, SceneError> {
    let text = String::from_utf8_lossy(source.bytes);
    let mut geometry = parse(&text).map_err(|problem| source.invalid(problem))?;
    let mut library = Library::default();
    for name in &geometry.libraries {
        library.read(name, source.directory);
    }
    let materials = materials(&geometry, &mut library, source);
    let mut warnings = std::mem::take(&mut library.warnings);
    if geometry.left_out > 0 {
        warnings.push(format!("{} points and lines were left out", geometry.left_out));
    }
    let mut builder = MeshBuilder::default();
    let primitive = indexed(&mut geometry);
    builder.add(&primitive, Mat4::IDENTITY).map_err(|problem| source.invalid(problem))?;
    let (mesh, repairs) = builder.finish();
    warnings.extend(repairs);
    if mesh.triangles.is_empty() {
        let reason = if warnings.is_empty() { String::new() } else { format!(" ({})", warnings.join("; ")) };
        return Err(SceneError::NoTriangle { file: source.file.to_owned(), reason: one_line(&reason) });
    }
    let textures = library.textures;
    let name = source.name.to_owned();
    Ok(Asset { name, mesh, materials, textures, lights: Vec::new(), cameras: Vec::new(), warnings })
}

fn parse(text: &str) -> Result<Geometry, String> {
    let mut geometry = Geometry::default();
    let mut material = None;
    let mut smoothing = Smoothing::ByAngle;
    let mut names = Names::default();
    let mut joined = String::new();
    for (number, line) in text.lines().enumerate() {
        // A backslash joins a line to the next.
        if let Some(part) = line.strip_suffix('\\') {
            joined.push_str(part);
            joined.push(' ');
            continue;
        }
        joined.push_str(line);
        let statement = std::mem::take(&mut joined);
        let (keyword, rest) = statement.trim().split_once(char::is_whitespace).unwrap_or((statement.trim(), ""));
        let rest = rest.trim();
        let understood = match keyword {
            "v" => geometry.push_position(rest),
            "vt" => numbers(rest, 1).map(|n| geometry.uvs.push(Vec2::new(n[0], 1.0 - n.get(1).unwrap_or(&0.0)))),
            "vn" => numbers(rest, 3).map(|n| geometry.normals.push(Vec3::new(n[0], n[1], n[2]))),
            "f" => {
                let material = *material.get_or_insert_with(|| names.index(""));
                geometry.push_face(rest, material, smoothing).map_err(|e| format!("line {}: {e}", number + 1))?
            }
            "p" | "l" => {
                geometry.left_out += 1;
                Some(())
            }
            "s" => {
                smoothing = match rest {
                    "off" | "0" => Smoothing::Flat,
                    "on" => Smoothing::Group(1),
                    group => group.parse().map_or(Smoothing::ByAngle, Smoothing::Group),
                };
                Some(())
            }
            "usemtl" => {
                material = Some(names.index(rest));
                Some(())
            }
            "mtllib" => {
                geometry.libraries.push(rest.to_owned());
                Some(())
            }
            _ => Some(()),
        };
        if understood.is_none() {
            return Err(format!("line {}: \"{}\" has a number that cannot be read", number + 1, shortened(&statement)));
        }
    }
    if !geometry.colours.is_empty() {
        geometry.colours.resize(geometry.positions.len(), Vec3::ONE);
    }
    geometry.material_names = names.names;
    geometry.check()?;
    Ok(geometry)
}

impl Geometry {
    fn push_position(&mut self, rest: &str) -> Option<()> {
        let n = numbers(rest, 3)?;
        // Four numbers have a weight, six a colour.
        let weight = if n.len() == 4 { n[3] } else { 1.0 };
        if n.len() == 6 {
            self.colours.resize(self.positions.len(), Vec3::ONE);
            self.colours.push(Vec3::new(n[3], n[4], n[5]));
        }
        self.positions.push(Vec3::new(n[0], n[1], n[2]) / weight);
        Some(())
    }

    /// Appends a polygon as a fan; `None` if a corner cannot be read.
    fn push_face(&mut self, rest: &str, material: u32, smoothing: Smoothing) -> Result<Option<()>, String> {
        let counts = [self.positions.len(), self.uvs.len(), self.normals.len()];
        let mut corners = Vec::new();
        for word in rest.split_whitespace() {
            let mut corner = [NONE; 3];
            for (i, index) in word.split('/').enumerate() {
                let Some(slot) = corner.get_mut(i) else { return Ok(None) };
                if index.is_empty() && i > 0 {
                    continue;
                }
                let Ok(index) = index.parse::<i64>() else { return Ok(None) };
                let (kind, count) = (["vertex", "texture coordinate", "normal"][i], counts[i]);
                // Indices start at 1; negative ones count from the end of what is defined so far.
                let absolute = if index < 0 { index.checked_add(count as i64) } else { index.checked_sub(1) };
                *slot = absolute
                    .and_then(|a| u32::try_from(a).ok())
                    .filter(|&a| a != NONE)
                    .ok_or_else(|| format!("{kind} {index} does not exist ({count} are defined so far)"))?;
            }
            corners.push(corner);
        }
        if corners.len() < 3 {
            self.left_out += 1;
            return Ok(Some(()));
        }
        let fan = corners[1..].windows(2).map(|w| [corners[0], w[0], w[1]]);
        self.triangles.extend(fan.map(|corners| Triangle { corners, material, smoothing }));
        Ok(Some(()))
    }

    /// Positive indices may point forwards, so they are checked once everything is read.
    fn check(&self) -> Result<(), String> {
        let counts = [self.positions.len(), self.uvs.len(), self.normals.len()];
        for corner in self.triangles.iter().flat_map(|t| t.corners) {
            for (i, kind) in ["vertex", "texture coordinate", "normal"].into_iter().enumerate() {
                if corner[i] as usize >= counts[i] && (i == 0 || corner[i] != NONE) {
                    return Err(format!(
                        "a face refers to {kind} {} of {}; export it again",
                        corner[i].wrapping_add(1),
                        counts[i]
                    ));
                }
            }
        }
        Ok(())
    }
}

/// One vertex for each distinct (position, texture coordinate, normal).
fn indexed(geometry: &mut Geometry) -> Primitive {
    let mut normals = std::mem::take(&mut geometry.normals);
    let made = corner_normals(geometry);
    let mut made_indices: HashMap<[u32; 3], u32> = HashMap::new();
    let mut vertices: HashMap<[u32; 3], u32> = HashMap::new();
    let mut primitive = Primitive::default();
    let (mut positions, mut placed_normals, mut uvs, mut colours) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (t, triangle) in geometry.triangles.iter().enumerate() {
        let corners: [u32; 3] = std::array::from_fn(|c| {
            let mut key = triangle.corners[c];
            if key[2] == NONE {
                let normal = made[t][c];
                key[2] = *made_indices.entry(normal.to_array().map(f32::to_bits)).or_insert_with(|| {
                    normals.push(normal);
                    normals.len() as u32 - 1
                });
            }
            *vertices.entry(key).or_insert_with(|| {
                positions.push(geometry.positions[key[0] as usize]);
                uvs.push(if key[1] == NONE { Vec2::ZERO } else { geometry.uvs[key[1] as usize] });
                placed_normals.push(normals[key[2] as usize]);
                colours.push(geometry.colours.get(key[0] as usize).copied().unwrap_or(Vec3::ONE));
                positions.len() as u32 - 1
            })
        });
        primitive.triangles.push(corners);
        primitive.materials.push(triangle.material);
    }
    let has_uvs = geometry.triangles.iter().any(|t| t.corners.iter().any(|c| c[1] != NONE));
    primitive.positions = positions;
    primitive.normals = Some(placed_normals);
    primitive.uvs = [has_uvs.then_some(uvs), None];
    primitive.colours = (!geometry.colours.is_empty()).then_some(colours);
    primitive
}

/// One material for each name that the file uses, in order of first use.
fn materials(geometry: &Geometry, library: &mut Library, source: &Source) -> Vec<Material> {
    let mut materials: Vec<Material> = Vec::new();
    for name in &geometry.material_names {
        let material = library.get(name).cloned();
        if material.is_none() && !name.is_empty() && !library.is_empty() {
            library.warnings.push(format!("material \"{name}\" is in no library; a grey Lambert surface is used"));
        }
        materials.push(material.unwrap_or_else(|| Library::default_material(&one_line(name))));
    }
    if library.is_empty()
        && !geometry.uvs.is_empty()
        && let Some(image) = image_beside(source)
    {
        let texture = library.texture(&image, source.directory, "the asset");
        if texture.is_some() {
            library.warnings.push(format!("no material library; {image} beside it is used as base colour"));
            for material in &mut materials {
                material.base_colour = glam::Vec4::ONE;
                material.base_colour_texture = texture;
            }
        }
    }
    materials
}

/// An image that is named after the asset: `chair.png`, `chair_texture.png`, and for `chair_triangulated` also
/// `chair_texture.png`.
fn image_beside(source: &Source) -> Option<String> {
    let shorter = source.name.rsplit_once('_').map(|(stem, _)| stem);
    let stems = [
        Some(source.name.to_owned()),
        Some(format!("{}_texture", source.name)),
        shorter.map(|s| format!("{s}_texture")),
    ];
    let names = stems.into_iter().flatten().flat_map(|s| ["png", "jpg", "jpeg"].map(|e| format!("{s}.{e}")));
    names.into_iter().find(|name| source.directory.join(Path::new(name)).is_file())
}

/// Numbers names in order of first use.
#[derive(Default)]
struct Names {
    names: Vec<String>,
    indices: HashMap<String, u32>,
}

impl Names {
    fn index(&mut self, name: &str) -> u32 {
        *self.indices.entry(name.to_owned()).or_insert_with(|| {
            self.names.push(name.to_owned());
            self.names.len() as u32 - 1
        })
    }
}

/// At least `least` numbers, or `None`.
fn numbers(text: &str, least: usize) -> Option<Vec<f32>> {
    let numbers: Vec<f32> = text.split_whitespace().map(|w| w.parse().ok()).collect::<Option<_>>()?;
    (numbers.len() >= least).then_some(numbers)
}

fn shortened(text: &str) -> String {
    one_line(text.trim()).chars().take(60).collect()
}
