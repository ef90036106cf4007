//! glTF 2.0 import (Khronos, *glTF 2.0 Specification*, 2021), both .gltf and .glb.
//!
//! The `gltf` crate's JSON types are read without its own validation, which rejects whole files for things that never
//! reach a light path. Every index, range, stride and count is checked here at the place where it is used.

mod accessor;
mod container;
mod geometry;
mod material;
mod nodes;
mod texture;

use gltf::json::Root;

use super::build::MeshBuilder;
use super::load::Source;
use super::{Asset, SceneError};
use accessor::Buffers;
use material::Materials;

/// Extensions that are read.
const READ: [&str; 7] = [
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "EXT_texture_webp",
];

/// Texture formats that are not read: each such texture is warned of and its factor used alone.
const REPLACED: [&str; 3] = ["KHR_texture_basisu", "MSFT_texture_dds", "EXT_texture_avif"];

/// Extensions without influence on how static geometry looks.
const HARMLESS: [&str; 5] =
    ["KHR_materials_variants", "KHR_animation_pointer", "KHR_node_visibility", "KHR_xmp", "KHR_xmp_json_ld"];

/// Imports a glTF file's scene: its default one, else the first, else every root node.
pub(super) fn import(source: &Source) -> Result<Asset, SceneError> {
    let (json, binary) = container::split(source.bytes).map_err(|problem| source.invalid(problem))?;
    let root = container::parse(json).map_err(|problem| source.invalid(problem))?;
    check_required(&root, source)?;
    let mut warnings = Vec::new();
    let unread: Vec<&str> = root
        .extensions_used
        .iter()
        .map(String::as_str)
        .filter(|e| !READ.contains(e) && !REPLACED.contains(e) && !HARMLESS.contains(e))
        .collect();
    if !unread.is_empty() {
        warnings.push(format!("not read: {}; the asset may look different elsewhere", unread.join(", ")));
    }
    let buffers = Buffers::load(&root, binary, source.directory);
    let placed = nodes::placed(&root).map_err(|problem| source.invalid(problem))?;

    let mut builder = MeshBuilder::default();
    let mut materials = Materials::new(&root, &buffers, source.directory);
    for node in &placed {
        geometry::append(&root, &buffers, node, &mut builder, &mut materials, &mut warnings)
            .map_err(|problem| source.invalid(problem))?;
    }
    let (mesh, repairs) = builder.finish();
    let lights = nodes::lights(&root, &placed, &mut warnings);
    let cameras = nodes::cameras(&root, &placed, &mut warnings);
    warnings.extend(repairs);
    let (materials, textures) = materials.finish(&mut warnings);
    if mesh.triangles.is_empty() {
        let reason = if warnings.is_empty() { String::new() } else { format!(" ({})", warnings.join("; ")) };
        let reason = super::load::one_line(&reason);
        return Err(SceneError::NoTriangle { file: source.file.to_owned(), reason });
    }
    Ok(Asset { name: source.name.to_owned(), mesh, materials, textures, lights, cameras, warnings })
}

fn check_required(root: &Root, source: &Source) -> Result<(), SceneError> {
    let known = |e: &str| READ.contains(&e) || REPLACED.contains(&e) || HARMLESS.contains(&e);
    let unknown: Vec<&str> = root.extensions_required.iter().map(String::as_str).filter(|e| !known(e)).collect();
    if unknown.is_empty() {
        return Ok(());
    }
    let extensions = super::load::one_line(&unknown.join(", "));
    Err(SceneError::RequiredExtension { file: source.file.to_owned(), extensions })
}

/// What messages call the `index`th thing of a kind: its name if it has one.
fn label(kind: &str, index: usize, name: Option<&String>) -> String {
    match name {
        Some(name) if !name.is_empty() => format!("{kind} \"{name}\""),
        _ => format!("{kind} {index}"),
    }
}
