//! The `.relight` file: safetensors (named tensors, JSON metadata), so that it opens in Python with
//! `safetensors.numpy.load_file`. `docs/FORMAT.md` lists the tensors.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use bytemuck::Pod;
use glam::{Vec2, Vec3};
use half::f16;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};

use super::{Anchors, Basis, Channels, Model, Scope, TrainingRecord, Transfer, Values};
use crate::files::write_whole;
use crate::measure::{MeasurementPoint, MeasurementPoints};
use crate::scene::material::Wrap;
use crate::scene::{Asset, Camera, Material, Mesh, PunctualLight, Texture};

/// Raised whenever a file of the old shape would be misread.
const FORMAT: u32 = 2;

/// The metadata key that holds everything that is not a tensor, as JSON. One key, since the order of several is not defined.
const METADATA_KEY: &str = "relight";

#[derive(Debug, thiserror::Error)]
pub enum ModelFileError {
    #[error("{}: cannot be read: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{}: cannot be written: {source}; choose another place with -o", path.display())]
    Write { path: PathBuf, source: std::io::Error },
    #[error("{}: not a relight model ({why}); models are made by `relight train`", path.display())]
    NotAModel { path: PathBuf, why: String },
    #[error("{}: format {found}, this build reads {FORMAT}; run `relight train` again", path.display())]
    Format { path: PathBuf, found: u32 },
    #[error("{}: damaged: {why}; run `relight train` again", path.display())]
    Damaged { path: PathBuf, why: String },
}

#[derive(Serialize, Deserialize)]
struct Metadata {
    format: u32,
    name: String,
    channels: Channels,
    mean_scaled_by_norm: bool,
    gamma: f32,
    materials: Vec<Material>,
    textures: Vec<TextureMetadata>,
    lights: Vec<PunctualLight>,
    cameras: Vec<Camera>,
    /// Kinds of light that `scope` tells from the scenario's; none where there is no such tensor.
    scope: Vec<String>,
    record: TrainingRecord,
}

#[derive(Serialize, Deserialize)]
struct TextureMetadata {
    name: String,
    srgb: bool,
    wrap: [Wrap; 2],
}

struct Tensor {
    name: String,
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

fn tensor<T: Pod>(name: impl Into<String>, dtype: Dtype, shape: &[usize], values: &[T]) -> Tensor {
    Tensor { name: name.into(), dtype, shape: shape.to_vec(), bytes: bytemuck::cast_slice(values).to_vec() }
}

fn vectors(name: impl Into<String>, values: &[Vec3]) -> Tensor {
    tensor(name, Dtype::F32, &[values.len(), 3], values)
}

fn basis_values(basis: &Basis) -> Tensor {
    let shape = [basis.elements, basis.components, basis.size, basis.size];
    match &basis.values {
        Values::Half(values) => tensor("basis", Dtype::F16, &shape, values),
        Values::Byte(codes) => tensor("basis", Dtype::I8, &shape, codes),
    }
}

impl Model {
    /// Writes the model. Returns its size in bytes.
    ///
    /// # Errors
    /// [`ModelFileError::Write`] when the folder cannot be made or written to.
    pub fn save(&self, path: &Path) -> Result<u64, ModelFileError> {
        let bytes = self.to_bytes();
        write_whole(path, &bytes).map_err(|source| ModelFileError::Write { path: path.to_owned(), source })?;
        Ok(bytes.len() as u64)
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mesh = &self.asset.mesh;
        let (basis, transfer, points) = (&self.basis, &self.transfer, &self.points);
        let rows = transfer.matrices.first().map_or(0, |m| m.len() / transfer.elements.max(1));
        let triangles: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
        let mut tensors = vec![
            basis_values(basis),
            tensor(
                "transfer",
                Dtype::F16,
                &[transfer.matrices.len(), transfer.elements, rows],
                &transfer.halves().concat(),
            ),
            tensor("transfer.scale", Dtype::F32, &[1], &[transfer.scale()]),
            tensor(
                "points.neighbours",
                Dtype::U32,
                &[points.points.len(), points.neighbours_per_point()],
                &points.neighbours,
            ),
            vectors("mesh.positions", &mesh.positions),
            vectors("mesh.normals", &mesh.normals),
            tensor("mesh.lightmap_uvs", Dtype::F32, &[mesh.lightmap_uvs.len(), 2], &mesh.lightmap_uvs),
            tensor("mesh.triangles", Dtype::U32, &[mesh.triangles.len(), 3], &triangles),
            tensor("mesh.triangle_materials", Dtype::U32, &[mesh.triangle_materials.len()], &mesh.triangle_materials),
        ];
        if let Some(anchors) = &basis.anchors {
            let shape = [basis.size, basis.size, 4];
            tensors.push(tensor("anchors.indices", Dtype::U8, &shape, &anchors.indices));
            tensors.push(tensor("anchors.shares", Dtype::U8, &shape, &anchors.shares));
        }
        for (set, uvs) in mesh.uvs.iter().enumerate().filter(|(_, uvs)| !uvs.is_empty()) {
            tensors.push(tensor(format!("mesh.uvs.{set}"), Dtype::F32, &[uvs.len(), 2], uvs));
        }
        if !mesh.colours.is_empty() {
            tensors.push(vectors("mesh.colours", &mesh.colours));
        }
        if let Some(scope) = &self.scope {
            tensors.push(tensor("scope", Dtype::F32, &[scope.kinds.len(), 2 * scope.points + 1], &scope.weights));
        }
        for (prefix, set) in [("points", &points.points), ("sub_points", &points.sub_points)] {
            let field = |of: fn(&MeasurementPoint) -> Vec3| set.iter().map(of).collect::<Vec<_>>();
            tensors.push(vectors(format!("{prefix}.position"), &field(|p| p.position)));
            tensors.push(vectors(format!("{prefix}.normal"), &field(|p| p.normal)));
            tensors.push(vectors(format!("{prefix}.geometric_normal"), &field(|p| p.geometric_normal)));
            tensors.push(vectors(format!("{prefix}.albedo"), &field(|p| p.albedo)));
        }
        for (i, texture) in self.asset.textures.iter().enumerate() {
            let shape = [texture.height as usize, texture.width as usize, 4];
            let values: Vec<u8> = texture.texels.iter().flatten().copied().collect();
            tensors.push(tensor(format!("texture.{i}"), Dtype::U8, &shape, &values));
        }
        let metadata = Metadata {
            format: FORMAT,
            name: self.asset.name.clone(),
            channels: transfer.channels,
            mean_scaled_by_norm: transfer.mean_scaled_by_norm,
            gamma: transfer.gamma,
            materials: self.asset.materials.clone(),
            textures: (self.asset.textures.iter())
                .map(|t| TextureMetadata { name: t.name.clone(), srgb: t.srgb, wrap: t.wrap })
                .collect(),
            lights: self.asset.lights.clone(),
            cameras: self.asset.cameras.clone(),
            scope: self.scope.as_ref().map_or_else(Vec::new, |s| s.kinds.clone()),
            record: self.record.clone(),
        };
        let json = serde_json::to_string(&metadata).expect("metadata has no map with keys other than strings");
        let views: Vec<(&str, TensorView)> = tensors
            .iter()
            .map(|t| {
                let view = TensorView::new(t.dtype, t.shape.clone(), &t.bytes).expect("shape of our own tensor");
                (t.name.as_str(), view)
            })
            .collect();
        safetensors::serialize(views, Some(HashMap::from([(METADATA_KEY.to_owned(), json)])))
            .expect("tensors of our own making serialise")
    }

    /// Reads a model and checks every shape and index in it.
    ///
    /// # Errors
    /// [`ModelFileError`], one line that says what is wrong and what to do.
    pub fn load(path: &Path) -> Result<Self, ModelFileError> {
        let bytes = std::fs::read(path).map_err(|source| ModelFileError::Read { path: path.to_owned(), source })?;
        let not_a_model = |why: String| ModelFileError::NotAModel { path: path.to_owned(), why };
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|e| not_a_model(e.to_string()))?;
        let json = header.metadata().as_ref().and_then(|m| m.get(METADATA_KEY));
        let json = json.ok_or_else(|| not_a_model("no relight metadata in it".into()))?;
        let format = serde_json::from_str::<FormatOnly>(json).map_err(|e| not_a_model(e.to_string()))?.format;
        if format != FORMAT {
            return Err(ModelFileError::Format { path: path.to_owned(), found: format });
        }
        let damaged = |why: String| ModelFileError::Damaged { path: path.to_owned(), why };
        let metadata: Metadata = serde_json::from_str(json).map_err(|e| damaged(e.to_string()))?;
        let tensors = SafeTensors::deserialize(&bytes).map_err(|e| damaged(e.to_string()))?;
        Reader { tensors }.model(metadata).map_err(damaged)
    }
}

#[derive(Deserialize)]
struct FormatOnly {
    format: u32,
}

/// Reads tensors with their shapes checked; errors are sentences.
struct Reader<'b> {
    tensors: SafeTensors<'b>,
}

/// A dimension that a tensor's shape must have, or may choose.
#[derive(Clone, Copy)]
enum Dim {
    Is(usize),
    Any,
}
use Dim::{Any, Is};

impl Reader<'_> {
    fn read<T: Pod>(&self, name: &str, dtype: Dtype, expected: &[Dim]) -> Result<(Vec<usize>, Vec<T>), String> {
        let view = self.tensors.tensor(name).map_err(|_| format!("tensor {name} is missing"))?;
        let shape = view.shape().to_vec();
        let fits = shape.len() == expected.len()
            && shape.iter().zip(expected).all(|(&s, e)| if let Is(e) = *e { s == e } else { true });
        if view.dtype() != dtype || !fits {
            let expected: Vec<String> =
                expected.iter().map(|d| if let Is(n) = d { n.to_string() } else { "any".into() }).collect();
            let expected = expected.join(", ");
            return Err(format!("tensor {name} is {:?} {shape:?}, expected {dtype:?} [{expected}]", view.dtype()));
        }
        Ok((shape, bytemuck::pod_collect_to_vec(view.data())))
    }

    fn has(&self, name: &str) -> bool {
        self.tensors.tensor(name).is_ok()
    }

    /// Finite vectors, `[count][3]`.
    fn vectors(&self, name: &str, count: Dim) -> Result<Vec<Vec3>, String> {
        let (_, values) = self.read::<Vec3>(name, Dtype::F32, &[count, Is(3)])?;
        if values.iter().all(|v| v.is_finite()) { Ok(values) } else { Err(format!("tensor {name} is not finite")) }
    }

    fn uvs(&self, name: &str, count: usize) -> Result<Vec<Vec2>, String> {
        let (_, values) = self.read::<Vec2>(name, Dtype::F32, &[Is(count), Is(2)])?;
        if values.iter().all(|v| v.is_finite()) { Ok(values) } else { Err(format!("tensor {name} is not finite")) }
    }

    fn indices(&self, name: &str, shape: &[Dim], bound: usize) -> Result<Vec<u32>, String> {
        let (_, values) = self.read::<u32>(name, Dtype::U32, shape)?;
        match values.iter().find(|&&i| i as usize >= bound) {
            Some(i) => Err(format!("tensor {name} has index {i}, but there are only {bound}")),
            None => Ok(values),
        }
    }

    fn model(&self, metadata: Metadata) -> Result<Model, String> {
        let mesh = self.mesh(metadata.materials.len())?;
        let textures = self.textures(&metadata.textures)?;
        for material in &metadata.materials {
            let references =
                [material.base_colour_texture, material.metallic_roughness_texture, material.emissive_texture];
            for reference in references.into_iter().flatten() {
                if reference.texture as usize >= textures.len() || reference.uv_set > 1 {
                    return Err(format!("material \"{}\" refers to a texture that is not there", material.name));
                }
            }
        }
        let points = self.points()?;
        let mut basis = self.basis(metadata.channels.components())?;
        let (groups, rows) = match metadata.channels {
            Channels::Mono => (3, points.points.len()),
            Channels::Multi => (1, 3 * points.points.len()),
        };
        // The transfer tells how many anchors there are.
        let expected = if basis.anchors.is_some() { Any } else { Is(basis.elements) };
        let (shape, halves) = self.read::<f16>("transfer", Dtype::F16, &[Is(groups), expected, Is(rows)])?;
        let (_, scale) = self.read::<f32>("transfer.scale", Dtype::F32, &[Is(1)])?;
        let matrices: Vec<f32> = halves.iter().map(|m| m.to_f32() * scale[0]).collect();
        let elements = shape[1];
        if let Some(anchors) = &mut basis.anchors {
            anchors.count = elements / basis.elements;
            let most = anchors.indices.iter().flatten().max().map_or(0, |&k| k as usize);
            if elements % basis.elements != 0 || most >= anchors.count {
                let n = basis.elements;
                return Err(format!(
                    "tensor transfer is {shape:?}, expected {n} rows for each of {} anchors",
                    most + 1
                ));
            }
        }
        if !matrices.iter().all(|m| m.is_finite()) {
            return Err("tensor transfer is not finite".into());
        }
        if !(0.1..=10.0).contains(&metadata.gamma) {
            return Err(format!("gamma = {} must be from 0.1 to 10", metadata.gamma));
        }
        basis.gamma = metadata.gamma;
        if metadata.mean_scaled_by_norm && basis.anchors.is_some() {
            return Err("a local basis has no mean".into());
        }
        let transfer = Transfer {
            channels: metadata.channels,
            elements,
            points: points.points.len(),
            matrices: matrices.chunks_exact((elements * rows).max(1)).map(<[f32]>::to_vec).collect(),
            mean_scaled_by_norm: metadata.mean_scaled_by_norm,
            gamma: metadata.gamma,
        };
        let scope = self.scope(metadata.scope, points.points.len())?;
        let asset = Asset {
            name: metadata.name,
            mesh,
            materials: metadata.materials,
            textures,
            lights: metadata.lights,
            cameras: metadata.cameras,
            warnings: Vec::new(),
        };
        Ok(Model { asset, points, basis, transfer, scope, record: metadata.record })
    }

    fn scope(&self, kinds: Vec<String>, points: usize) -> Result<Option<Scope>, String> {
        if kinds.is_empty() {
            return Ok(None);
        }
        let (_, weights) = self.read::<f32>("scope", Dtype::F32, &[Is(kinds.len()), Is(2 * points + 1)])?;
        if !weights.iter().all(|w| w.is_finite()) {
            return Err("tensor scope is not finite".into());
        }
        Ok(Some(Scope { kinds, points, weights }))
    }

    fn basis(&self, components: usize) -> Result<Basis, String> {
        let shape = [Any, Is(components), Any, Any];
        let is_bytes = self.tensors.tensor("basis").is_ok_and(|t| t.dtype() == Dtype::I8);
        let (shape, values) = if is_bytes {
            let (shape, codes) = self.read("basis", Dtype::I8, &shape)?;
            (shape, Values::Byte(codes))
        } else {
            let (shape, values) = self.read::<f16>("basis", Dtype::F16, &shape)?;
            if !values.iter().all(|v| v.is_finite()) {
                return Err("tensor basis is not finite".into());
            }
            (shape, Values::Half(values))
        };
        let (elements, size) = (shape[0], shape[2]);
        if shape[3] != size || size == 0 || elements == 0 {
            return Err(format!("tensor basis is {shape:?}, expected square layers and at least one"));
        }
        let anchors = if self.has("anchors.indices") { Some(self.anchors(size)?) } else { None };
        Ok(Basis { size, elements, components, values, anchors, gamma: 1.0 })
    }

    fn anchors(&self, size: usize) -> Result<Anchors, String> {
        let shape = [Is(size), Is(size), Is(4)];
        let (_, indices) = self.read::<[u8; 4]>("anchors.indices", Dtype::U8, &shape)?;
        let (_, shares) = self.read::<[u8; 4]>("anchors.shares", Dtype::U8, &shape)?;
        Ok(Anchors { count: 0, indices, shares })
    }

    fn mesh(&self, materials: usize) -> Result<Mesh, String> {
        let positions = self.vectors("mesh.positions", Any)?;
        let count = positions.len();
        let corners = self.indices("mesh.triangles", &[Any, Is(3)], count)?;
        let triangles: Vec<[u32; 3]> = corners.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
        if triangles.is_empty() {
            return Err("tensor mesh.triangles is empty".into());
        }
        let mut uvs = [Vec::new(), Vec::new()];
        for (set, uvs) in uvs.iter_mut().enumerate() {
            let name = format!("mesh.uvs.{set}");
            if self.has(&name) {
                *uvs = self.uvs(&name, count)?;
            }
        }
        let has_colours = self.has("mesh.colours");
        Ok(Mesh {
            normals: self.vectors("mesh.normals", Is(count))?,
            colours: if has_colours { self.vectors("mesh.colours", Is(count))? } else { Vec::new() },
            lightmap_uvs: self.uvs("mesh.lightmap_uvs", count)?,
            triangle_materials: self.indices("mesh.triangle_materials", &[Is(triangles.len())], materials)?,
            positions,
            uvs,
            triangles,
        })
    }

    fn textures(&self, metadata: &[TextureMetadata]) -> Result<Vec<Texture>, String> {
        let read = |(i, metadata): (usize, &TextureMetadata)| {
            let (shape, bytes) = self.read::<u8>(&format!("texture.{i}"), Dtype::U8, &[Any, Any, Is(4)])?;
            if shape[0] == 0 || shape[1] == 0 || shape[0].max(shape[1]) > u32::MAX as usize {
                return Err(format!("tensor texture.{i} is {shape:?}, expected at least one texel"));
            }
            Ok(Texture {
                name: metadata.name.clone(),
                width: shape[1] as u32,
                height: shape[0] as u32,
                texels: bytes.chunks_exact(4).map(|t| [t[0], t[1], t[2], t[3]]).collect(),
                srgb: metadata.srgb,
                wrap: metadata.wrap,
            })
        };
        metadata.iter().enumerate().map(read).collect()
    }

    fn points(&self) -> Result<MeasurementPoints, String> {
        let set = |prefix: &str| -> Result<Vec<MeasurementPoint>, String> {
            let position = self.vectors(&format!("{prefix}.position"), Any)?;
            let count = Is(position.len());
            let normal = self.vectors(&format!("{prefix}.normal"), count)?;
            let geometric_normal = self.vectors(&format!("{prefix}.geometric_normal"), count)?;
            let albedo = self.vectors(&format!("{prefix}.albedo"), count)?;
            let at = |i| MeasurementPoint {
                position: position[i],
                normal: normal[i],
                geometric_normal: geometric_normal[i],
                albedo: albedo[i],
            };
            Ok((0..position.len()).map(at).collect())
        };
        let (points, sub_points) = (set("points")?, set("sub_points")?);
        let neighbours = self.indices("points.neighbours", &[Is(points.len()), Any], sub_points.len())?;
        if points.is_empty() || neighbours.is_empty() {
            return Err("there are no measurement points".into());
        }
        Ok(MeasurementPoints { points, sub_points, neighbours })
    }
}
