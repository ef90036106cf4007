//! Where the lightmap's coordinates come from: a UV set of the asset that will do, or a fresh unwrap.

use super::texels::Lightmap;
use super::uv_check::{UvFault, check_uvs};
use super::{Asset, Mesh, SceneError};
use glam::Vec2;

/// Which coordinates the lightmap uses.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum UvPolicy {
    /// TEXCOORD_1, else TEXCOORD_0, if it serves as a lightmap; else a fresh unwrap.
    #[default]
    Auto,
    Texcoord0,
    Texcoord1,
    Unwrap,
}

/// Where the coordinates came from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightmapSource {
    Texcoord0,
    Texcoord1,
    Unwrapped {
        charts: u32,
        /// Share of the page that charts cover.
        coverage: f32,
    },
}

/// The choice that [`lay_out`] made.
#[derive(Clone, Debug, PartialEq)]
pub struct LightmapChoice {
    pub source: LightmapSource,
    /// Why, one line each, to be printed.
    pub reasons: Vec<String>,
}

/// Empty texels around each chart at least, so that a bilinear lookup at a chart's border reads no other chart.
const PADDING: u32 = 2;

/// Sides of a lightmap, texels, for each texel of padding beyond that. With 2ᵏ texels around each chart, texels of mip level
/// k on its border hold no other chart, so that a lightmap of 1024² keeps charts apart down to 256², one of 2048² too.
const SIZE_PER_PADDING: u32 = 256;

/// Fills the mesh's `lightmap_uvs` for a lightmap of `size` × `size` texels. An unwrap duplicates vertices along seams.
///
/// # Errors
/// [`SceneError::LightmapUvs`] when a set that `policy` names is missing, leaves [0, 1]², overlaps itself or leaves out
/// triangles; [`SceneError::Unwrap`] when the charts do not fit the page.
pub fn lay_out(asset: &mut Asset, size: u32, policy: UvPolicy) -> Result<LightmapChoice, SceneError> {
    let named = |set: usize| if set == 0 { LightmapSource::Texcoord0 } else { LightmapSource::Texcoord1 };
    let explicit = match policy {
        UvPolicy::Texcoord0 => Some(0),
        UvPolicy::Texcoord1 => Some(1),
        UvPolicy::Auto | UvPolicy::Unwrap => None,
    };
    if let Some(set) = explicit {
        let faults = check_uvs(&asset.mesh, set, size);
        if let Some(fault) = faults.iter().find(|f| f.unusable) {
            let (asset, reason) = (asset.name.clone(), fault.reason.clone());
            return Err(SceneError::LightmapUvs { asset, set: SET_NAMES[set], reason });
        }
        use_set(&mut asset.mesh, set);
        return Ok(LightmapChoice { source: named(set), reasons: faults.iter().map(|f| line(set, f)).collect() });
    }
    let mut reasons = Vec::new();
    if policy == UvPolicy::Auto {
        for set in [1, 0] {
            if asset.mesh.uvs[set].is_empty() {
                continue;
            }
            let faults = check_uvs(&asset.mesh, set, size);
            if faults.is_empty() {
                reasons.push(format!("{} serves as the lightmap's coordinates", SET_NAMES[set]));
                use_set(&mut asset.mesh, set);
                return Ok(LightmapChoice { source: named(set), reasons });
            }
            reasons.extend(faults.iter().map(|f| line(set, f)));
        }
        if reasons.is_empty() {
            reasons.push("no texture coordinates".to_owned());
        }
    }
    let (charts, coverage) = unwrap(asset, size)?;
    let unwrapped = format!("unwrapped anew into {charts} charts, {:.0} % of the page covered", coverage * 100.0);
    match reasons.last_mut() {
        Some(reason) => *reason = format!("{reason}; {unwrapped}"),
        None => reasons.push(unwrapped),
    }
    Ok(LightmapChoice { source: LightmapSource::Unwrapped { charts, coverage }, reasons })
}

const SET_NAMES: [&str; 2] = ["TEXCOORD_0", "TEXCOORD_1"];

fn line(set: usize, fault: &UvFault) -> String {
    format!("{} {}", SET_NAMES[set], fault.reason)
}

fn use_set(mesh: &mut Mesh, set: usize) {
    mesh.lightmap_uvs = mesh.uvs[set].iter().map(|uv| uv.clamp(Vec2::ZERO, Vec2::ONE)).collect();
}

/// Unwraps the whole mesh onto one page. Returns the number of charts and the share of texels that they reach into.
fn unwrap(asset: &mut Asset, size: u32) -> Result<(u32, f32), SceneError> {
    let mesh = &mut asset.mesh;
    let positions: Vec<[f32; 3]> = mesh.positions.iter().map(|p| p.to_array()).collect();
    let indices: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    // Charts keep materials apart, so that unlike surfaces do not share texels; where that makes more charts than the
    // page holds, they may span materials, and at last stand closer together.
    let padding = PADDING.max(size / SIZE_PER_PADDING);
    let attempts = [(true, padding), (false, padding), (false, PADDING), (false, 1)];
    let mut reason = String::new();
    for (by_material, padding) in attempts {
        let input = uvunwrap::MeshInput {
            face_materials: by_material.then_some(&mesh.triangle_materials[..]),
            ..uvunwrap::MeshInput::new(&positions, &indices)
        };
        let density = uvunwrap::Density::Auto { page_size: size };
        let options = uvunwrap::Options { density, padding, ..Default::default() };
        match uvunwrap::generate(&[input], &options) {
            Ok(atlas) if atlas.page_count == 1 => {
                // The page is cropped to the rows in use.
                let scale = Vec2::new(atlas.width as f32, atlas.height as f32) / size as f32;
                adopt(mesh, &atlas.meshes[0], scale);
                let lightmap = Lightmap::new(mesh, size as usize);
                let coverage = lightmap.texels.len() as f32 / (size as f32 * size as f32);
                return Ok((atlas.chart_count, coverage));
            }
            Ok(atlas) => {
                reason = format!("{} charts do not fit {size} × {size} texels", atlas.chart_count);
            }
            Err(error) => reason = error.to_string(),
        }
    }
    Err(SceneError::Unwrap { asset: asset.name.clone(), reason })
}

/// Rebuilds every vertex attribute for the unwrapped vertices.
fn adopt(mesh: &mut Mesh, unwrapped: &uvunwrap::OutputMesh, scale: Vec2) {
    fn gathered<T: Copy>(attribute: &[T], vertices: &[uvunwrap::OutputVertex]) -> Vec<T> {
        if attribute.is_empty() { Vec::new() } else { vertices.iter().map(|v| attribute[v.xref as usize]).collect() }
    }
    let vertices = &unwrapped.vertices;
    mesh.positions = gathered(&mesh.positions, vertices);
    mesh.normals = gathered(&mesh.normals, vertices);
    mesh.colours = gathered(&mesh.colours, vertices);
    mesh.uvs = [gathered(&mesh.uvs[0], vertices), gathered(&mesh.uvs[1], vertices)];
    mesh.lightmap_uvs =
        vertices.iter().map(|v| (Vec2::from_array(v.uv) * scale).clamp(Vec2::ZERO, Vec2::ONE)).collect();
    mesh.triangles = unwrapped.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
}
