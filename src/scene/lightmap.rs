//! Where the lightmap's coordinates come from: a UV set of the asset that will do, or a fresh unwrap.

use std::collections::HashMap;

use glam::Vec2;

use super::cut::cut;
use super::texels::Lightmap;
use super::uv_check::{UvFault, check_uvs};
use super::walls::thin_walls;
use super::{Asset, Mesh, SceneError, Tracer, apart};

/// Which coordinates the lightmap uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
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
        /// Share of the surface that lies inside thin walls and on no texel.
        inside: f32,
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

/// Sides of a lightmap, texels, for each texel of padding beyond that. A bilinear lookup on mip level k reads up to
/// 1½ · 2ᵏ − 1 texels of the page beyond the one that it lies in, and as many as the padding around each chart are its own:
/// level 1 is apart everywhere. Half as much again would part level 2 of 1024², but at 512² a third texel of padding
/// cost a furnished room 15 of the 69 % of the page that its charts filled.
const SIZE_PER_PADDING: u32 = 256;

/// Fills the mesh's `lightmap_uvs` for a lightmap of `size` × `size` texels. An unwrap duplicates vertices along seams,
/// and cuts triangles along walls so thin that a texel would hold both sides' light.
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
    let Unwrapped { charts, coverage, inside, cut } = unwrap(asset, size)?;
    let mut unwrapped = format!("unwrapped anew into {charts} charts, {:.0} % of the page covered", coverage * 100.0);
    if cut > 0 {
        unwrapped += &format!(", {cut} triangles more where charts end at thin walls");
    }
    match reasons.last_mut() {
        Some(reason) => *reason = format!("{reason}; {unwrapped}"),
        None => reasons.push(unwrapped),
    }
    Ok(LightmapChoice { source: LightmapSource::Unwrapped { charts, coverage, inside }, reasons })
}

const SET_NAMES: [&str; 2] = ["TEXCOORD_0", "TEXCOORD_1"];

fn line(set: usize, fault: &UvFault) -> String {
    format!("{} {}", SET_NAMES[set], fault.reason)
}

fn use_set(mesh: &mut Mesh, set: usize) {
    mesh.lightmap_uvs = mesh.uvs[set].iter().map(|uv| uv.clamp(Vec2::ZERO, Vec2::ONE)).collect();
}

/// What an unwrap made.
struct Unwrapped {
    charts: u32,
    /// Share of the page's texels that they reach into.
    coverage: f32,
    /// Share of the surface that lies inside thin walls.
    inside: f32,
    /// Triangles that cuts along thin walls made more.
    cut: usize,
}

/// Share of the page that charts are taken to fill before it is known.
const USUAL_COVERAGE: f32 = 0.5;

/// How near to a wall an edge of the mesh may run for the wall not to be cut along again, in texels; but not within the
/// rounding of positions, relative to the asset's extent.
const SNAP: f32 = 1.0 / 256.0;
const ROUNDING: f32 = 2e-6;

/// Unwraps the whole mesh onto one page.
fn unwrap(asset: &mut Asset, size: u32) -> Result<Unwrapped, SceneError> {
    let area_of = |mesh: &Mesh, t: usize| 0.5 * mesh.triangle_cross(t).length() as f64;
    let area: f64 = (0..asset.mesh.triangles.len()).map(|t| area_of(&asset.mesh, t)).sum();
    let texel = (area as f32 / USUAL_COVERAGE).sqrt() / size as f32;
    let tracer = Tracer::new(asset);
    let (walls, extent) = (thin_walls(&tracer, texel), tracer.extent);
    drop(tracer);
    let triangles = asset.mesh.triangles.len();
    let (mut parts, mut inside) = (vec![0; triangles], vec![false; triangles]);
    if !walls.is_empty() {
        cut(&mut asset.mesh, &walls, f64::from((SNAP * texel).max(ROUNDING * extent)));
        parts = apart::parts(&asset.mesh, &walls, texel);
        inside = apart::inside(&Tracer::new(asset), &walls, texel);
    }
    let mesh = &mut asset.mesh;
    let area_inside: f64 = (0..inside.len()).filter(|&t| inside[t]).map(|t| area_of(mesh, t)).sum();
    let positions: Vec<[f32; 3]> = mesh.positions.iter().map(|p| p.to_array()).collect();
    let indices: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    let padding = PADDING.max(size / SIZE_PER_PADDING);
    // Charts keep materials apart, so that unlike surfaces do not share texels; where that makes more charts than the
    // page holds, they may span materials, stand closer together, and at last run on under thin walls.
    let by_material: Vec<(u32, u32)> = parts.iter().copied().zip(mesh.triangle_materials.iter().copied()).collect();
    let (by_material, whole) = (numbered(&by_material), vec![0; parts.len()]);
    let attempts = [(&by_material, padding), (&parts, padding), (&parts, PADDING), (&parts, 1), (&whole, 1)];
    let mut reason = String::new();
    for (groups, padding) in attempts {
        let input = uvunwrap::MeshInput {
            face_materials: Some(groups),
            ignored_faces: Some(&inside),
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
                let (charts, cut) = (atlas.chart_count, mesh.triangles.len() - triangles);
                return Ok(Unwrapped { charts, coverage, inside: (area_inside / area) as f32, cut });
            }
            Ok(atlas) => {
                reason = format!("{} charts do not fit {size} × {size} texels", atlas.chart_count);
            }
            Err(error) => reason = error.to_string(),
        }
    }
    Err(SceneError::Unwrap { asset: asset.name.clone(), reason })
}

/// Numbers for values, the same for equal ones.
fn numbered(values: &[(u32, u32)]) -> Vec<u32> {
    let mut numbers = HashMap::new();
    values
        .iter()
        .map(|value| {
            let next = numbers.len() as u32;
            *numbers.entry(value).or_insert(next)
        })
        .collect()
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
