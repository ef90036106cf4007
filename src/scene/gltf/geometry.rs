//! Mesh primitives of a node.

use glam::{Vec2, Vec3};
use gltf::json::accessor::Type;
use gltf::json::mesh::{Mode, Primitive as JsonPrimitive, Semantic};
use gltf::json::validation::Checked;
use gltf::json::{Accessor, Index, Root};

use super::accessor::Buffers;
use super::label;
use super::material::Materials;
use super::nodes::Placed;
use crate::scene::build::{MeshBuilder, Primitive};

/// Appends the triangles of a node's mesh.
///
/// # Errors
/// Geometry that points outside its buffers or vertices, named by mesh and primitive.
pub(super) fn append(
    root: &Root,
    buffers: &Buffers,
    placed: &Placed,
    builder: &mut MeshBuilder,
    materials: &mut Materials,
    warnings: &mut Vec<String>,
) -> Result<(), String> {
    let Some(index) = placed.node.mesh else { return Ok(()) };
    let mesh = root.get(index).ok_or_else(|| {
        format!("{}: mesh {index} does not exist", label("node", placed.index, placed.node.name.as_ref()))
    })?;
    let name = label("mesh", index.value(), mesh.name.as_ref());
    let mut warn = |warning: String| {
        if !warnings.contains(&warning) {
            warnings.push(warning);
        }
    };
    if placed.node.skin.is_some() {
        warn(format!("{name} is skinned; it is taken in the pose that its vertices are stored in"));
    }
    if mesh.primitives.iter().any(|p| p.targets.as_ref().is_some_and(|t| !t.is_empty())) {
        warn(format!("{name} has morph targets; it is taken without them"));
    }
    for (i, primitive) in mesh.primitives.iter().enumerate() {
        let Some(mode) = triangle_mode(primitive) else {
            warn(format!("{name} primitive {i} is points or lines and was left out"));
            continue;
        };
        let read = read(buffers, primitive, mode, &mut |what| warn(format!("{name} primitive {i}: {what}")));
        let mut read = read.map_err(|problem| format!("{name} primitive {i}: {problem}"))?;
        if !read.triangles.is_empty() {
            let material = materials.index(primitive.material).map_err(|e| format!("{name} primitive {i}: {e}"))?;
            read.materials = vec![material; read.triangles.len()];
            builder.add(&read, placed.world_from_node)?;
        }
    }
    Ok(())
}

fn triangle_mode(primitive: &JsonPrimitive) -> Option<Mode> {
    match primitive.mode {
        Checked::Valid(mode @ (Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan)) => Some(mode),
        _ => None,
    }
}

fn read(
    buffers: &Buffers,
    primitive: &JsonPrimitive,
    mode: Mode,
    warn: &mut dyn FnMut(String),
) -> Result<Primitive, String> {
    let accessor = |semantic: Semantic| primitive.attributes.get(&Checked::Valid(semantic)).copied();
    let Some(positions) = accessor(Semantic::Positions) else {
        warn("it has no positions and was left out".to_owned());
        return Ok(Primitive::default());
    };
    let positions = vec3s(buffers, positions)?;
    let count = positions.len();
    let check = |what: &str, length: usize| match length == count {
        true => Ok(()),
        false => Err(format!("{length} {what} for {count} positions; export it again")),
    };
    let normals = accessor(Semantic::Normals).map(|a| vec3s(buffers, a)).transpose()?;
    let mut uvs = [None, None];
    for (set, uvs) in uvs.iter_mut().enumerate() {
        *uvs = accessor(Semantic::TexCoords(set as u32)).map(|a| vec2s(buffers, a)).transpose()?;
        check("texture coordinates", uvs.as_ref().map_or(count, Vec::len))?;
    }
    let colours = accessor(Semantic::Colors(0)).map(|a| colours(buffers, a)).transpose()?;
    check("normals", normals.as_ref().map_or(count, Vec::len))?;
    check("colours", colours.as_ref().map_or(count, Vec::len))?;

    let indices = match primitive.indices {
        Some(accessor) => buffers.indices(accessor)?,
        None => (0..u32::try_from(count).map_err(|_| "more than 2³² vertices")?).collect(),
    };
    if let Some(bad) = indices.iter().find(|&&i| i as usize >= count) {
        return Err(format!("index {bad} is out of range for {count} vertices; export it again"));
    }
    if mode == Mode::Triangles && indices.len() % 3 != 0 {
        warn(format!("{} indices do not make whole triangles; the last ones were left out", indices.len()));
    }
    Ok(Primitive { positions, normals, uvs, colours, triangles: triangles(&indices, mode), materials: Vec::new() })
}

/// Triangles of an index list, strip or fan, all with the same winding (glTF 2.0, section 3.7.2.1).
fn triangles(indices: &[u32], mode: Mode) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => {
            let turn = |(i, w): (usize, &[u32])| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[0], w[2], w[1]] };
            indices.windows(3).enumerate().map(turn).collect()
        }
        Mode::TriangleFan => match indices.split_first() {
            Some((&centre, rim)) => rim.windows(2).map(|w| [w[0], w[1], centre]).collect(),
            None => Vec::new(),
        },
        _ => indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    }
}

fn vec3s(buffers: &Buffers, accessor: Index<Accessor>) -> Result<Vec<Vec3>, String> {
    Ok(buffers.floats(accessor, &[Type::Vec3])?.values.chunks_exact(3).map(Vec3::from_slice).collect())
}

fn vec2s(buffers: &Buffers, accessor: Index<Accessor>) -> Result<Vec<Vec2>, String> {
    Ok(buffers.floats(accessor, &[Type::Vec2])?.values.chunks_exact(2).map(Vec2::from_slice).collect())
}

/// Linear RGB; an alpha is dropped.
fn colours(buffers: &Buffers, accessor: Index<Accessor>) -> Result<Vec<Vec3>, String> {
    let floats = buffers.floats(accessor, &[Type::Vec3, Type::Vec4])?;
    Ok(floats.values.chunks_exact(floats.components).map(Vec3::from_slice).collect())
}
