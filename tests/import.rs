//! Import of glTF and OBJ: what the formats define, what is repaired, and real assets.

mod common;

use std::f32::consts::FRAC_PI_2;

use common::{GltfBuilder, asset_trial, load_files, png, trial};
use glam::{Vec2, Vec3};
use libtest_mimic::Arguments;
use relight::scene::{Asset, PunctualKind, Reflectance, load};
use serde_json::json;

fn main() {
    let trials = vec![
        trial("data_uri_and_glb_load_alike", data_uri_and_glb_load_alike),
        trial("node_transforms_reach_world_space", node_transforms_reach_world_space),
        trial("mirrored_instance_keeps_its_front", mirrored_instance_keeps_its_front),
        trial("strips_and_fans_keep_winding", strips_and_fans_keep_winding),
        trial("missing_normals_are_flat_and_zero_ones_repaired", missing_normals_are_flat_and_zero_ones_repaired),
        trial("quantized_positions_and_uvs", quantized_positions_and_uvs),
        trial("sparse_substitutes_elements", sparse_substitutes_elements),
        trial("degenerate_and_infinite_triangles_are_dropped", degenerate_and_infinite_triangles_are_dropped),
        trial("materials_lights_and_cameras", materials_lights_and_cameras),
        trial("texture_transform_and_missing_texture", texture_transform_and_missing_texture),
        trial("errors_name_file_and_thing", errors_name_file_and_thing),
        trial("obj_faces_materials_and_normals", obj_faces_materials_and_normals),
        trial("obj_takes_the_image_beside_it", obj_takes_the_image_beside_it),
        trial("obj_errors_name_the_line", obj_errors_name_the_line),
        asset_trial("cornell_box_glb", "CornellBox/CornellBox.glb", |p| {
            let a = real(p, 36, [-556.0, 0.0, -559.2], [0.0, 548.8, 0.0]);
            assert!(a.warnings.is_empty() && !a.mesh.uvs[1].is_empty() && !a.mesh.colours.is_empty());
            assert!(a.materials.iter().any(|m| m.emissive.max_element() > 1.0), "KHR_materials_emissive_strength");
        }),
        asset_trial("mixed_lighting", "MixedLightingExample/MixedLightingExample.gltf", |p| {
            let a = real(p, 40898, [-1.5535, 0.0, -1.5535], [1.5535, 0.6862, 1.5535]);
            assert_eq!(a.lights.len(), 1);
            assert_eq!((a.lights[0].kind, a.lights[0].intensity), (PunctualKind::Directional, Vec3::splat(2049.0)));
            assert_eq!(a.warnings.len(), 1);
        }),
        asset_trial("barn_lamp", "AnisotropyBarnLamp/AnisotropyBarnLamp.gltf", |p| {
            let a = real(p, 10203, [-0.1046, -0.1983, 0.0], [0.0862, 0.0569, 0.2265]);
            assert!(a.warnings.iter().any(|w| w.contains("KTX2") && w.contains("Lamp Metal")), "{:?}", a.warnings);
        }),
        asset_trial("flight_helmet", "FlightHelmet/FlightHelmet.gltf", |p| {
            let a = real(p, 94722, [-0.2036, 0.0, -0.1715], [0.1629, 0.716, 0.2]);
            assert_eq!((a.materials.len(), a.textures.len()), (6, 10));
        }),
        asset_trial("fox", "Fox/Fox.glb", |p| {
            let a = real(p, 576, [-12.593, -0.1218, -88.095], [12.593, 78.907, 66.625]);
            assert!(a.warnings.iter().any(|w| w.contains("skinned")));
        }),
        asset_trial("living_room", "godot_living_room/living_room.glb", |p| {
            let a = real(p, 1543, [-5.0, -1.5, -2.5], [5.0, 4.0, 12.0]);
            assert_eq!(a.warnings, ["3545 triangles without area were left out"]);
        }),
        asset_trial("viking_room", "viking_room/viking_room.obj", |p| {
            let a = real(p, 3828, [-0.5853, -0.721, -0.1076], [0.7419, 0.7395, 0.9249]);
            assert!(a.materials[0].base_colour_texture.is_some() && a.warnings[0].contains("viking_room.mtl"));
        }),
        asset_trial("spot", "spot/spot_triangulated.obj", |p| {
            let a = real(p, 5856, [-0.4716, -0.7368, -0.6689], [0.4716, 0.9536, 1.049]);
            assert_eq!(a.textures[0].name, "spot_texture.png");
        }),
        asset_trial("embree_cornell_box", "embree_models/cornell_box.obj", |p| {
            let a = real(p, 34, [0.0, 0.0, 0.0], [556.0, 548.8, 559.2]);
            assert!(a.warnings.is_empty() && a.materials.iter().all(|m| m.reflectance == Reflectance::Lambert));
        }),
    ];
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}

/// Loads a real asset and holds it to its triangle count, its bounds, and what every asset must satisfy.
fn real(path: std::path::PathBuf, triangles: usize, min: [f32; 3], max: [f32; 3]) -> Asset {
    let asset = load(&path).unwrap_or_else(|e| panic!("{e}"));
    check_invariants(&asset);
    assert_eq!(asset.mesh.triangles.len(), triangles);
    let bounds = asset.mesh.bounds();
    let tolerance = 1e-3 * bounds.diagonal();
    assert!(
        bounds.min.abs_diff_eq(min.into(), tolerance) && bounds.max.abs_diff_eq(max.into(), tolerance),
        "{bounds:?}"
    );
    asset
}

fn check_invariants(asset: &Asset) {
    let mesh = &asset.mesh;
    let vertices = mesh.positions.len();
    assert_eq!(mesh.normals.len(), vertices);
    assert!(mesh.normals.iter().all(|n| n.is_normalized()));
    assert!(mesh.uvs.iter().all(|u| u.is_empty() || u.len() == vertices));
    assert!(mesh.colours.is_empty() || mesh.colours.len() == vertices);
    assert!(mesh.triangles.iter().flatten().all(|&v| (v as usize) < vertices));
    assert_eq!(mesh.triangle_materials.len(), mesh.triangles.len());
    assert!(mesh.triangle_materials.iter().all(|&m| (m as usize) < asset.materials.len()));
    assert!((0..mesh.triangles.len()).all(|t| mesh.triangle_cross(t).length_squared() > 0.0));
    assert!(asset.warnings.iter().all(|w| !w.contains('\n')));
}

fn loaded(gltf: &GltfBuilder) -> Asset {
    let asset = load_files(&[("asset.gltf", &gltf.gltf())]).unwrap_or_else(|e| panic!("{e}"));
    check_invariants(&asset);
    asset
}

fn face_normal(asset: &Asset, triangle: usize) -> Vec3 {
    asset.mesh.triangle_cross(triangle).normalize()
}

fn data_uri_and_glb_load_alike() {
    let gltf = GltfBuilder::triangle();
    let (a, b) = (loaded(&gltf), load_files(&[("asset.glb", &gltf.glb())]).unwrap());
    assert_eq!(a.mesh.positions, b.mesh.positions);
    assert_eq!((a.name.as_str(), a.materials[0].reflectance), ("asset", Reflectance::MetallicRoughness));
    let mut lambert = a;
    lambert.make_lambert();
    assert_eq!(lambert.materials[0].reflectance, Reflectance::Lambert);
}

/// A parent moves by (10, 0, 0), its child scales by 2 and turns by 90° about z: (1, 0, 0) goes to (10, 2, 0). A second
/// instance of the mesh stays where it is.
fn node_transforms_reach_world_space() {
    let mut gltf = GltfBuilder::triangle();
    let (sin, cos) = (FRAC_PI_2 / 2.0).sin_cos();
    gltf.json["nodes"] = json!([
        { "translation": [10.0, 0.0, 0.0], "children": [1] },
        { "mesh": 0, "rotation": [0.0, 0.0, sin, cos], "scale": [2.0, 2.0, 2.0] },
        { "mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] },
    ]);
    gltf.json["scenes"] = json!([{ "nodes": [0, 2] }]);
    let asset = loaded(&gltf);
    assert_eq!(asset.mesh.triangles.len(), 2);
    let [a, b, _] = asset.mesh.triangle_positions(0);
    assert!(a.abs_diff_eq(Vec3::new(10.0, 0.0, 0.0), 1e-5) && b.abs_diff_eq(Vec3::new(10.0, 2.0, 0.0), 1e-5));
    assert_eq!(asset.mesh.triangle_positions(1)[1], Vec3::X);
}

/// Scaled by −1 in x, the triangle still faces +z, as its normals do.
fn mirrored_instance_keeps_its_front() {
    let mut gltf = GltfBuilder::triangle();
    let normals = gltf.floats("VEC3", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    gltf.attribute("NORMAL", normals);
    gltf.json["nodes"] = json!([{ "mesh": 0, "scale": [-1.0, 1.0, 1.0] }]);
    let asset = loaded(&gltf);
    assert_eq!(face_normal(&asset, 0), Vec3::Z);
    assert!(asset.mesh.normals.iter().all(|&n| n == Vec3::Z));
}

fn strips_and_fans_keep_winding() {
    // A unit square twice: as a strip in Z order, as a fan around its rim.
    for (mode, corners) in
        [(5, [[0., 0.], [1., 0.], [0., 1.], [1., 1.]]), (6, [[0., 0.], [1., 0.], [1., 1.], [0., 1.]])]
    {
        let mut gltf = GltfBuilder::new();
        let values: Vec<f32> = corners.iter().flat_map(|&[x, y]: &[f32; 2]| [x, y, 0.0]).collect();
        let positions = gltf.floats("VEC3", &values);
        gltf.attribute("POSITION", positions);
        gltf.json["meshes"][0]["primitives"][0]["mode"] = mode.into();
        let asset = loaded(&gltf);
        assert_eq!(asset.mesh.triangles.len(), 2);
        assert!((0..2).all(|t| face_normal(&asset, t) == Vec3::Z), "mode {mode}");
    }
}

fn missing_normals_are_flat_and_zero_ones_repaired() {
    let mut gltf = GltfBuilder::triangle();
    assert!(loaded(&gltf).mesh.normals.iter().all(|&n| n == Vec3::Z));
    let normals = gltf.floats("VEC3", &[0.0, 0.0, 0.0, 0.0, f32::NAN, 1.0, 0.0, 0.0, 1e-30]);
    gltf.attribute("NORMAL", normals);
    let asset = loaded(&gltf);
    assert!(asset.mesh.normals.iter().all(|&n| n == Vec3::Z), "{:?}", asset.mesh.normals);
    assert!(asset.warnings[0].starts_with("2 vertex normals"), "{:?}", asset.warnings);
}

/// KHR_mesh_quantization: 16-bit positions keep their value, normalised 8-bit ones are divided by 127 or 255.
fn quantized_positions_and_uvs() {
    let mut gltf = GltfBuilder::new();
    let bytes: Vec<u8> = [0i16, 0, 0, 300, 0, 0, 0, -200, 0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let positions = gltf.accessor("VEC3", 5122, 3, &bytes);
    let normals = gltf.accessor("VEC3", 5120, 3, &[0, 0, 0x81, 0, 0, 0x81, 0, 0, 0x81]);
    let uvs = gltf.accessor("VEC2", 5121, 3, &[0, 0, 255, 0, 0, 51]);
    for accessor in [normals, uvs] {
        gltf.json["accessors"][accessor]["normalized"] = true.into();
    }
    for (semantic, accessor) in [("POSITION", positions), ("NORMAL", normals), ("TEXCOORD_0", uvs)] {
        gltf.attribute(semantic, accessor);
    }
    gltf.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    let mesh = loaded(&gltf).mesh;
    assert_eq!(mesh.positions, [Vec3::ZERO, Vec3::X * 300.0, Vec3::Y * -200.0]);
    assert_eq!(mesh.normals[0], Vec3::NEG_Z);
    assert_eq!(mesh.uvs[0][1..], [Vec2::X, Vec2::new(0.0, 0.2)]);
}

fn sparse_substitutes_elements() {
    let mut gltf = GltfBuilder::triangle();
    let indices = gltf.accessor("SCALAR", 5121, 1, &[2]);
    let values = gltf.floats("VEC3", &[0.0, 5.0, 0.0]);
    let view = |accessor: usize| gltf.json["accessors"][accessor]["bufferView"].clone();
    let sparse = json!({
        "count": 1,
        "indices": { "bufferView": view(indices), "componentType": 5121 },
        "values": { "bufferView": view(values) },
    });
    gltf.json["accessors"][0]["sparse"] = sparse;
    assert_eq!(loaded(&gltf).mesh.positions[2], Vec3::Y * 5.0);
}

fn degenerate_and_infinite_triangles_are_dropped() {
    let mut gltf = GltfBuilder::new();
    let p = [0., 0., 0., 1., 0., 0., 0., 1., 0., 2., 0., 0., f32::INFINITY, 0., 0.];
    let positions = gltf.floats("VEC3", &p);
    gltf.attribute("POSITION", positions);
    gltf.indices(&[0, 1, 2, 0, 1, 3, 0, 1, 1, 0, 2, 4]);
    let asset = loaded(&gltf);
    assert_eq!(asset.mesh.triangles.len(), 1);
    assert_eq!(asset.warnings.len(), 2);
    assert!(asset.warnings[0].starts_with("2 triangles without area"), "{:?}", asset.warnings);
    assert!(asset.warnings[1].starts_with("1 triangles with positions"), "{:?}", asset.warnings);
}

fn materials_lights_and_cameras() {
    let mut gltf = GltfBuilder::triangle();
    gltf.json["meshes"][0]["primitives"][0]["material"] = 0.into();
    gltf.json["materials"] = json!([{
        "name": "lamp", "doubleSided": true, "alphaMode": "MASK", "alphaCutoff": 0.25, "emissiveFactor": [1.0, 0.5, 0.0],
        "pbrMetallicRoughness": { "baseColorFactor": [0.5, 0.25, 0.125, 1.0], "metallicFactor": 0.5, "roughnessFactor": 0.75 },
        "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 10.0 } },
        "extras": { "anything": [1, "goes"] },
    }]);
    gltf.json["extensions"] = json!({ "KHR_lights_punctual": { "lights": [
        { "type": "spot", "intensity": 40.0, "color": [1.0, 0.5, 0.25], "range": 3.0, "extras": { "a": 1 },
          "spot": { "innerConeAngle": 0.1, "outerConeAngle": 0.2 } },
        { "type": "laser" },
    ] } });
    gltf.json["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": FRAC_PI_2, "znear": 0.1 } }]);
    let (sin, cos) = (-FRAC_PI_2 / 2.0).sin_cos();
    gltf.json["nodes"] = json!([
        { "mesh": 0 },
        // Turned by −90° about x, −z points down.
        { "translation": [1.0, 2.0, 3.0], "rotation": [sin, 0.0, 0.0, cos], "extensions": { "KHR_lights_punctual": { "light": 0 } } },
        { "extensions": { "KHR_lights_punctual": { "light": 1 } } },
        { "translation": [0.0, 0.0, 5.0], "camera": 0 },
    ]);
    gltf.json["scenes"] = json!([{ "nodes": [0, 1, 2, 3] }]);
    let asset = loaded(&gltf);
    let material = &asset.materials[0];
    assert_eq!((material.metallic, material.roughness, material.alpha_cutoff), (0.5, 0.75, Some(0.25)));
    assert_eq!((material.emissive, material.double_sided), (Vec3::new(10.0, 5.0, 0.0), true));
    assert_eq!(asset.lights.len(), 1);
    let light = &asset.lights[0];
    assert_eq!(light.kind, PunctualKind::Spot { inner_cone_angle: 0.1, outer_cone_angle: 0.2 });
    assert_eq!((light.position, light.intensity), (Vec3::new(1.0, 2.0, 3.0), Vec3::new(40.0, 20.0, 10.0)));
    assert_eq!(light.range, Some(3.0));
    assert!(light.direction.abs_diff_eq(Vec3::NEG_Y, 1e-6), "{}", light.direction);
    assert!(asset.warnings.iter().any(|w| w.contains("light 1 was left out")), "{:?}", asset.warnings);
    let camera = &asset.cameras[0];
    assert_eq!((camera.eye, camera.target, camera.up), (Vec3::Z * 5.0, Vec3::Z * 4.0, Vec3::Y));
    assert!((camera.vertical_fov - 90.0).abs() < 1e-4);
}

/// Scale 2 and a quarter turn, counter-clockwise as seen with v downwards: (1, 0) goes to (0, −2), then is moved.
fn texture_transform_and_missing_texture() {
    let mut gltf = GltfBuilder::triangle();
    gltf.json["meshes"][0]["primitives"][0]["material"] = 0.into();
    gltf.json["images"] = json!([{ "uri": "red%20one.png" }, { "uri": "missing.png", "name": "rough" }]);
    gltf.json["samplers"] = json!([{ "wrapS": 33071, "wrapT": 33648 }]);
    gltf.json["textures"] = json!([{ "source": 0, "sampler": 0 }, { "source": 1 }]);
    let transform = json!({ "offset": [0.5, 0.25], "rotation": FRAC_PI_2, "scale": [2.0, 2.0], "texCoord": 1 });
    gltf.json["materials"] = json!([{ "name": "m", "pbrMetallicRoughness": {
        "baseColorTexture": { "index": 0, "extensions": { "KHR_texture_transform": transform } },
        "metallicRoughnessTexture": { "index": 1 },
    } }]);
    let asset = load_files(&[("asset.gltf", &gltf.gltf()), ("red one.png", &png([255, 0, 0, 255]))]).unwrap();
    let reference = asset.materials[0].base_colour_texture.unwrap();
    assert_eq!(reference.uv_set, 1);
    assert!(reference.transform.transform_point2(Vec2::X).abs_diff_eq(Vec2::new(0.5, -1.75), 1e-6));
    let texture = &asset.textures[0];
    assert_eq!((texture.texels[0], texture.srgb), ([255, 0, 0, 255], true));
    assert_eq!(format!("{:?}", texture.wrap), "[Clamp, Mirror]");
    assert!(asset.materials[0].metallic_roughness_texture.is_none());
    let warning = &asset.warnings[0];
    assert!(["material \"m\"", "missing.png", "factor alone"].iter().all(|s| warning.contains(s)), "{warning}");
}

fn errors_name_file_and_thing() {
    let error = |change: &dyn Fn(&mut serde_json::Value)| {
        let mut gltf = GltfBuilder::triangle();
        change(&mut gltf.json);
        let error = load_files(&[("asset.gltf", &gltf.gltf())]).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("asset.gltf: ") && !error.contains('\n'), "{error}");
        error
    };
    let required = error(&|j| j["extensionsRequired"] = json!(["KHR_draco_mesh_compression", "KHR_texture_transform"]));
    assert!(required.ends_with("required extension KHR_draco_mesh_compression is not supported; export without it"));
    let cycle = error(&|j| j["nodes"] = json!([{ "mesh": 0, "children": [1], "name": "a\nb" }, { "children": [0] }]));
    assert!(cycle.contains("node \"a b\" is reached twice"), "{cycle}");
    let huge = error(&|j| j["accessors"][0] = json!({ "componentType": 5126, "count": 1u64 << 60, "type": "VEC3" }));
    assert!(huge.contains("mesh 0 primitive 0: accessor 0 claims 1152921504606846976"), "{huge}");
    let past = error(&|j| j["accessors"][0]["count"] = 4.into());
    assert!(past.contains("runs past the end of its buffer view"), "{past}");
    let stride = error(&|j| j["bufferViews"][0]["byteStride"] = u32::MAX.into());
    assert!(stride.contains("runs past the end"), "{stride}");
    let offset = error(&|j| j["bufferViews"][0]["byteOffset"] = u64::MAX.into());
    assert!(offset.contains("buffer view 0 runs past the end of buffer 0"), "{offset}");
    let version = error(&|j| j["asset"]["version"] = "1.0".into());
    assert!(version.contains("glTF version \"1.0\""), "{version}");
    let empty = error(&|j| j["meshes"][0]["primitives"][0]["mode"] = 0.into());
    assert!(empty.contains("no triangle") && empty.contains("points or lines"), "{empty}");
    let kind = load_files(&[("asset.fbx", b"")]).map(|_| ()).unwrap_err().to_string();
    assert!(kind.contains(".gltf, .glb or .obj"), "{kind}");
}

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n";

fn obj(text: &str, beside: &[(&str, &[u8])]) -> Asset {
    let mut files = vec![("asset_low.obj", text.as_bytes())];
    files.extend_from_slice(beside);
    let asset = load_files(&files).unwrap_or_else(|e| panic!("{e}"));
    check_invariants(&asset);
    asset
}

fn obj_faces_materials_and_normals() {
    let mtl = "newmtl a\nKd 0.5 0.25 0\nKe 2 2 2\nmap_Kd -s 1 1 1 my tex.png\nnewmtl b\nPr 0.5\nd 0.5\nKd x\n";
    let text = format!(
        "mtllib m.mtl\n{SQUARE}usemtl a\nf 1/1 2/2 3/3 4/4\nusemtl b\nf -4 -3 \\\n -2\nusemtl c\nf 1 2 3\nl 1 2\n"
    );
    let asset = obj(&text, &[("m.mtl", mtl.as_bytes()), ("my tex.png", &png([0, 0, 255, 255]))]);
    assert_eq!(asset.mesh.triangle_materials, [0, 0, 1, 2]);
    assert!(asset.mesh.normals.iter().all(|&n| n == Vec3::Z));
    // v is up in the file and down here.
    assert_eq!(asset.mesh.uvs[0][..4], [Vec2::Y, Vec2::ONE, Vec2::X, Vec2::ZERO]);
    let [a, b, _] = &asset.materials[..] else { panic!() };
    assert_eq!((a.base_colour.truncate(), a.emissive), (Vec3::new(0.5, 0.25, 0.0), Vec3::splat(2.0)));
    assert!(a.base_colour_texture.is_some() && a.reflectance == Reflectance::Lambert);
    assert_eq!((b.reflectance, b.roughness, b.metallic), (Reflectance::MetallicRoughness, 0.5, 0.0));
    for what in ["\"Kd x\"", "\"b\" is transparent", "\"c\" is in no library", "1 points and lines"] {
        assert!(asset.warnings.iter().any(|w| w.contains(what)), "{what}: {:?}", asset.warnings);
    }
}

fn obj_takes_the_image_beside_it() {
    let image = png([0, 255, 0, 255]);
    let text = format!("mtllib gone.mtl\n{SQUARE}usemtl x\nf 1/1 2/2 3/3\n");
    for name in ["asset_low.png", "asset_low_texture.png", "asset_texture.png"] {
        let asset = obj(&text, &[(name, &image)]);
        assert!(asset.materials[0].base_colour_texture.is_some());
        assert!(asset.warnings[0].contains("gone.mtl") && asset.warnings[1].contains(name), "{:?}", asset.warnings);
    }
}

fn obj_errors_name_the_line() {
    for (text, expected) in [
        ("v 0 0\nf 1 1 1\n", "line 1: \"v 0 0\""),
        ("v 0 0 0\nf 1 2 -3\n", "line 2: vertex -3 does not exist"),
        ("v 0 0 0\nf 1 0 1\n", "line 2: vertex 0 does not exist"),
        ("v 0 0 0\nf 1 2 3\n", "vertex 2 of 1"),
        ("v 0 0 0\nf 1/5 1/1 1/1\n", "texture coordinate 5 of 0"),
        ("v 0 0 0\n", "no triangle"),
    ] {
        let error = load_files(&[("asset.obj", text.as_bytes())]).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}
