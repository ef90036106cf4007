//! Matrices and points, as JSON and as safetensors.

use glam::Vec3;
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde_json::{Value, json};

use crate::measure::MeasurementPoint;
use crate::model::{Model, Values};

/// Everything but the basis, as text.
pub fn json(model: &Model) -> String {
    let (basis, transfer, points) = (&model.basis, &model.transfer, &model.points);
    let row = transfer.matrices[0].len() / transfer.elements.max(1);
    let matrices: Vec<Vec<&[f32]>> = transfer.matrices.iter().map(|m| m.chunks_exact(row).collect()).collect();
    let places = |set: &[MeasurementPoint]| -> Value {
        let of = |field: fn(&MeasurementPoint) -> Vec3| set.iter().map(field).collect::<Vec<_>>();
        json!({
            "position": of(|p| p.position),
            "normal": of(|p| p.normal),
            "geometric_normal": of(|p| p.geometric_normal),
            "albedo": of(|p| p.albedo),
        })
    };
    let neighbours: Vec<&[u32]> = points.neighbours.chunks_exact(points.neighbours_per_point()).collect();
    let value = json!({
        "name": model.asset.name,
        "channels": transfer.channels,
        "mean_scaled_by_norm": transfer.mean_scaled_by_norm,
        "gamma": transfer.gamma,
        "basis": {
            "size": basis.size,
            "elements": basis.elements,
            "components": basis.components,
            "layers": basis.layers(),
            "anchors": basis.anchors.as_ref().map_or(0, |anchors| anchors.count),
            "bits": if matches!(basis.values, Values::Half(_)) { 16 } else { 8 },
        },
        "points": places(&points.points),
        "sub_points": places(&points.sub_points),
        "neighbours": neighbours,
        "matrices": matrices,
    });
    format!("{value}\n")
}

/// A column of a set of points.
type Field = fn(&MeasurementPoint) -> Vec3;

/// Name, type, shape, bytes.
type Tensor = (String, Dtype, Vec<usize>, Vec<u8>);

/// The same numbers as tensors, named as in a model file.
pub fn safetensors(model: &Model) -> Vec<u8> {
    let (transfer, points) = (&model.transfer, &model.points);
    let row = transfer.matrices[0].len() / transfer.elements.max(1);
    let matrices = transfer.matrices.concat();
    let neighbours = vec![points.points.len(), points.neighbours_per_point()];
    let mut tensors: Vec<Tensor> = vec![
        (
            "transfer".into(),
            Dtype::F32,
            vec![transfer.matrices.len(), transfer.elements, row],
            bytemuck::cast_slice(&matrices).to_vec(),
        ),
        ("points.neighbours".into(), Dtype::U32, neighbours, bytemuck::cast_slice(&points.neighbours).to_vec()),
    ];
    let fields: [(&str, Field); 4] = [
        ("position", |p| p.position),
        ("normal", |p| p.normal),
        ("geometric_normal", |p| p.geometric_normal),
        ("albedo", |p| p.albedo),
    ];
    for (set, places) in [("points", &points.points), ("sub_points", &points.sub_points)] {
        for (name, field) in fields {
            let values: Vec<Vec3> = places.iter().map(field).collect();
            let bytes = bytemuck::cast_slice(&values).to_vec();
            tensors.push((format!("{set}.{name}"), Dtype::F32, vec![values.len(), 3], bytes));
        }
    }
    let views = tensors.iter().map(|(name, dtype, shape, bytes)| {
        (name.as_str(), TensorView::new(*dtype, shape.clone(), bytes).expect("our own shapes"))
    });
    safetensors::serialize(views, None).expect("tensors of our own making serialise")
}
