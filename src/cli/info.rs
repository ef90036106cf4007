//! `relight info`: what a model, scene or asset holds, and what is wrong with it.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::{Value, json};

use super::{Failure, Reporter};
use crate::model::Model;
use crate::scene::{Asset, Lightmap, lay_out};
use crate::scene_file::SceneFile;

/// Show what a model, scene or asset holds, and what is wrong with it
#[derive(Args)]
pub struct Info {
    /// A .relight model, a scene file (.toml), or a .glb, .gltf or .obj file
    pub file: PathBuf,
}

impl Info {
    pub fn run(&self, json: Option<&Path>, _: &Reporter) -> Result<(), Failure> {
        let is_model = self.file.extension().is_some_and(|e| e.eq_ignore_ascii_case("relight"));
        let facts = if is_model {
            model_facts(&Model::load(&self.file)?)
        } else {
            scene_facts(&SceneFile::read(&self.file)?, &self.file.display().to_string())?
        };
        print_facts(&facts, 0);
        super::write_json(json, &facts)
    }
}

fn model_facts(model: &Model) -> Value {
    let (record, transfer) = (&model.record, &model.transfer);
    json!({
        "model": model.asset.name,
        "trained by": format!("relight {}", record.version),
        "basis": {
            "elements": model.basis.elements,
            "anchors": model.basis.anchors.as_ref().map_or(Value::from("none: one basis for all texels"), |a| a.count.into()),
            "channels": transfer.channels,
            "mean among them": transfer.mean_scaled_by_norm,
            "gamma": (transfer.gamma as f64 * 1e6).round() * 1e-6,
            "lightmap": format!("{0} x {0}", model.basis.size),
            "bits of a value": 8 * model.basis.values.bytes() / model.basis.values.len().max(1),
            "bytes a texel": model.basis.bytes_per_texel(),
            "bytes": model.basis.bytes_per_texel() * model.basis.size * model.basis.size,
        },
        "measurement": {
            "points": model.points.points.len(),
            "sub-points": model.points.sub_points.len(),
            "sub-points averaged by each": model.points.neighbours_per_point(),
        },
        "training": {
            "conditions": record.conditions,
            "dropped": record.dropped,
            "lambda": record.lambda,
            "chosen": super::train::choice_lines(&record.choices),
            "warnings": record.shortages.iter().map(super::train::shortage_line).collect::<Vec<_>>(),
            "asset hash": record.asset_hash,
        },
        "held-out error": record.held_out,
        "tells other lights (AUC)":
            record.separation.iter().map(|s| format!("{} {:.3}", s.kind, s.auc)).collect::<Vec<_>>(),
        "asset": asset_facts(&model.asset),
        "scene settings": toml::from_str::<Value>(&record.scene).unwrap_or(Value::String(record.scene.clone())),
    })
}

fn scene_facts(scene: &SceneFile, place: &str) -> Result<Value, Failure> {
    scene.check(place)?;
    let mut asset = scene.load_asset(place)?;
    let choice = lay_out(&mut asset, scene.lightmap.size, scene.lightmap.uv)?;
    let lightmap = Lightmap::new(&asset.mesh, scene.lightmap.size as usize);
    let size = lightmap.size;
    let facts = json!({
        "asset": asset_facts(&asset),
        "lightmap": {
            "size": format!("{size} x {size}"),
            "texels covered": lightmap.texels.len(),
            "page covered": format!("{:.1} %", 100.0 * lightmap.texels.len() as f64 / (size * size) as f64),
            "charts": choice.reasons,
        },
        "scene settings": serde_json::to_value(scene).unwrap_or_default(),
    });
    Ok(facts)
}

fn asset_facts(asset: &Asset) -> Value {
    let mesh = &asset.mesh;
    let bounds = mesh.bounds();
    let area: f64 = (0..mesh.triangles.len()).map(|t| 0.5 * mesh.triangle_cross(t).length() as f64).sum();
    let metres = |v: glam::Vec3| format!("{:.3} x {:.3} x {:.3} m", v.x, v.y, v.z);
    json!({
        "name": asset.name,
        "triangles": mesh.triangles.len(),
        "vertices": mesh.positions.len(),
        "size": metres(bounds.max - bounds.min),
        "surface area": format!("{area:.3} m²"),
        "uv sets": mesh.uvs.iter().filter(|uvs| !uvs.is_empty()).count(),
        "materials": asset.materials.iter().map(|m| m.name.clone()).collect::<Vec<_>>(),
        "textures": asset.textures.iter().map(|t| format!("{} ({} x {})", t.name, t.width, t.height)).collect::<Vec<_>>(),
        "lights": asset.lights.iter().map(|l| format!("{} ({:?})", l.name, l.kind)).collect::<Vec<_>>(),
        "emissive materials": asset.materials.iter().filter(|m| m.emissive != crate::math::Rgb::ZERO).count(),
        "cameras": asset.cameras.len(),
        "warnings": asset.warnings,
    })
}

/// Prints nested facts as an indented list.
fn print_facts(facts: &Value, indent: usize) {
    let Value::Object(map) = facts else { return };
    for (name, value) in map {
        match value {
            Value::Object(_) => {
                say!("{:indent$}{name}:", "");
                print_facts(value, indent + 2);
            }
            Value::Array(items) if items.is_empty() => say!("{:indent$}{name}: none", ""),
            Value::Array(items) if items.iter().any(|i| i.as_str().is_some_and(|s| s.len() > 30)) => {
                say!("{:indent$}{name}:", "");
                items.iter().for_each(|item| say!("{:1$}{2}", "", indent + 2, plain(item)));
            }
            Value::Array(items) => {
                say!("{:indent$}{name}: {}", "", items.iter().map(plain).collect::<Vec<_>>().join(", "));
            }
            _ => say!("{:indent$}{name}: {}", "", plain(value)),
        }
    }
}

fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}
