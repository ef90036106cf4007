//! What several tests share: where real assets are, tests that need one, and files made by a test.

#![allow(dead_code)]

use std::path::PathBuf;

use libtest_mimic::{Failed, Trial};

/// The folder of real assets: `RELIGHT_ASSETS`, or `shared/assets` beside the repository.
pub fn assets() -> PathBuf {
    match std::env::var_os("RELIGHT_ASSETS") {
        Some(folder) => folder.into(),
        None => PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/assets"),
    }
}

/// A test that always runs.
pub fn trial(name: &str, body: fn()) -> Trial {
    Trial::test(name, move || {
        body();
        Ok(())
    })
}

/// A test of one real asset; reported as ignored where the file is absent.
pub fn asset_trial(name: &str, file: &'static str, body: fn(PathBuf)) -> Trial {
    let path = assets().join(file);
    let absent = !path.exists();
    let run = move || -> Result<(), Failed> {
        body(path);
        Ok(())
    };
    Trial::test(name, run).with_ignored_flag(absent)
}

/// A glTF document built up by a test, its one buffer kept as a data URI or a GLB chunk.
pub struct GltfBuilder {
    pub json: serde_json::Value,
    bin: Vec<u8>,
}

impl GltfBuilder {
    pub fn new() -> Self {
        let json = serde_json::json!({
            "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }],
            "nodes": [{ "mesh": 0 }], "meshes": [{ "primitives": [{ "attributes": {} }] }],
            "accessors": [], "bufferViews": [],
        });
        Self { json, bin: Vec::new() }
    }

    /// One triangle (0,0,0), (1,0,0), (0,1,0) without normals.
    pub fn triangle() -> Self {
        let mut gltf = Self::new();
        let positions = gltf.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        gltf.attribute("POSITION", positions);
        gltf
    }

    /// Appends an accessor of raw little-endian components.
    pub fn accessor(&mut self, kind: &str, component_type: u32, count: usize, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let views = self.json["bufferViews"].as_array_mut().unwrap();
        views.push(serde_json::json!({ "buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len() }));
        let view = views.len() - 1;
        self.bin.extend_from_slice(bytes);
        let accessors = self.json["accessors"].as_array_mut().unwrap();
        let accessor = serde_json::json!({
            "bufferView": view, "componentType": component_type, "count": count, "type": kind,
        });
        accessors.push(accessor);
        accessors.len() - 1
    }

    pub fn floats(&mut self, kind: &str, values: &[f32]) -> usize {
        let components = match kind {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            _ => 4,
        };
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.accessor(kind, 5126, values.len() / components, &bytes)
    }

    pub fn indices(&mut self, values: &[u16]) {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let accessor = self.accessor("SCALAR", 5123, values.len(), &bytes);
        self.json["meshes"][0]["primitives"][0]["indices"] = accessor.into();
    }

    pub fn attribute(&mut self, semantic: &str, accessor: usize) {
        self.json["meshes"][0]["primitives"][0]["attributes"][semantic] = accessor.into();
    }

    /// The document with its buffer as a data URI.
    pub fn gltf(&self) -> Vec<u8> {
        use base64::Engine;
        let data = base64::engine::general_purpose::STANDARD.encode(&self.bin);
        let uri = format!("data:application/octet-stream;base64,{data}");
        let mut json = self.json.clone();
        json["buffers"] = serde_json::json!([{ "byteLength": self.bin.len(), "uri": uri }]);
        serde_json::to_vec(&json).unwrap()
    }

    /// The document as a GLB.
    pub fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        json["buffers"] = serde_json::json!([{ "byteLength": self.bin.len() }]);
        let mut text = serde_json::to_vec(&json).unwrap();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bin = self.bin.clone();
        bin.resize(bin.len().next_multiple_of(4), 0);
        let mut glb = b"glTF".to_vec();
        let length = 12 + 8 + text.len() + 8 + bin.len();
        glb.extend([2u32, length as u32, text.len() as u32].iter().flat_map(|w| w.to_le_bytes()));
        glb.extend(b"JSON");
        glb.extend(&text);
        glb.extend((bin.len() as u32).to_le_bytes());
        glb.extend(b"BIN\0");
        glb.extend(&bin);
        glb
    }
}

/// Writes files into a new folder and loads the first of them.
pub fn load_files(files: &[(&str, &[u8])]) -> Result<relight::scene::Asset, relight::scene::SceneError> {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    relight::scene::load(&folder.path().join(files[0].0))
}

/// A 1 × 1 PNG of one colour.
pub fn png(rgba: [u8; 4]) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbaImage::from_pixel(1, 1, image::Rgba(rgba)).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}
