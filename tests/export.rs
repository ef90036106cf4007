//! An exported folder holds the model, for readers that know nothing of this crate.

#[path = "common/room.rs"]
mod room;

use std::path::Path;
use std::process::Command;

use glam::{Vec2, Vec3};
use half::f16;
use libtest_mimic::{Arguments, Failed, Trial};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use relight::export::write;
use relight::math::Rgb;
use relight::model::{Channels, Model};
use safetensors::SafeTensors;

fn main() {
    let python = std::env::var_os("RELIGHT_PYTHON");
    let no_python = python.is_none();
    let python = std::path::PathBuf::from(python.unwrap_or_default());
    let in_python = |name: &str, body: fn(&Path)| {
        let python = python.clone();
        let run = move || -> Result<(), Failed> {
            body(&python);
            Ok(())
        };
        Trial::test(name, run).with_ignored_flag(no_python)
    };
    let trial = |name: &str, body: fn()| {
        let run = move || -> Result<(), Failed> {
            body();
            Ok(())
        };
        Trial::test(name, run)
    };
    let trials = vec![
        trial("textures_hold_the_basis", textures_hold_the_basis),
        trial("tables_hold_matrices_and_points", tables_hold_matrices_and_points),
        trial("the_asset_has_its_lightmap_coordinates", the_asset_has_its_lightmap_coordinates),
        trial("the_page_names_every_file_and_shaders_parse", the_page_names_every_file_and_shaders_parse),
        in_python("numpy_makes_the_light_of_the_exported_files", numpy_makes_the_light_of_the_exported_files),
        in_python("numpy_makes_the_picture_of_the_exported_files", numpy_makes_the_picture_of_the_exported_files),
    ];
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}

/// Half floats and bytes, mono and multi, with anchors and without, with a mean and without; last layers that are not full.
fn models() -> [Model; 6] {
    [
        room::model(Channels::Mono, 6, false),
        room::model(Channels::Mono, 4, true),
        room::model(Channels::Multi, 5, true),
        room::local_model(Channels::Mono, 5),
        room::local_model(Channels::Multi, 4),
        room::raised(room::model(Channels::Mono, 6, false)),
    ]
}

fn exported(model: &Model) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let files = write(model, folder.path()).unwrap();
    for (name, bytes) in files {
        assert_eq!(std::fs::metadata(folder.path().join(name)).unwrap().len(), bytes, "{name}");
    }
    folder
}

fn textures_hold_the_basis() {
    for model in models() {
        let folder = exported(&model);
        let basis = &model.basis;
        let texels = basis.size * basis.size;
        let reader = ktx2::Reader::new(std::fs::read(folder.path().join("basis.ktx2")).unwrap()).unwrap();
        let header = reader.header();
        let per_layer = if basis.components == 1 { 4 } else { 1 };
        assert_eq!(header.layer_count as usize, basis.elements.div_ceil(per_layer));
        assert_eq!((header.pixel_width as usize, header.pixel_height as usize), (basis.size, basis.size));
        let data = reader.levels().next().unwrap().data.to_vec();
        let half = header.format == Some(ktx2::Format::R16G16B16A16_SFLOAT);
        assert!(half || header.format == Some(ktx2::Format::R8G8B8A8_SNORM));
        let value = |i: usize| match half {
            true => f16::from_le_bytes([data[2 * i], data[2 * i + 1]]).to_f32(),
            false => data[i] as i8 as f32 / 127.0,
        };
        let exr = exr::prelude::read_first_flat_layer_from_file(folder.path().join("basis.exr")).unwrap();
        for element in 0..basis.elements {
            for component in 0..basis.components {
                let plane = element * basis.components + component;
                let (layer, channel) =
                    if basis.components == 1 { (element / 4, element % 4) } else { (element, component) };
                let suffix = if basis.components == 1 { "" } else { [".R", ".G", ".B"][component] };
                let name = format!("element.{element:03}{suffix}");
                let of_exr = exr.layer_data.channel_data.list.iter().find(|c| c.name.to_string() == name).unwrap();
                let of_exr: Vec<f32> = of_exr.sample_data.values_as_f32().collect();
                for t in 0..texels {
                    let want = basis.values.get(plane * texels + t);
                    assert_eq!(value((layer * texels + t) * 4 + channel), want);
                    let scale = basis.anchors.as_ref().map_or(1.0, |a| a.scale(t));
                    assert_eq!(of_exr[t], want * scale);
                }
            }
        }
        if let Some(anchors) = &basis.anchors {
            for (name, codes) in [("anchors.ktx2", &anchors.indices), ("shares.ktx2", &anchors.shares)] {
                let reader = ktx2::Reader::new(std::fs::read(folder.path().join(name)).unwrap()).unwrap();
                assert_eq!(reader.levels().next().unwrap().data, codes.as_flattened(), "{name}");
            }
        }
    }
}

fn tables_hold_matrices_and_points() {
    for model in models() {
        let folder = exported(&model);
        let json: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(folder.path().join("transfer.json")).unwrap()).unwrap();
        let bytes = std::fs::read(folder.path().join("transfer.safetensors")).unwrap();
        let tensors = SafeTensors::deserialize(&bytes).unwrap();
        let floats = |name: &str| -> Vec<f32> { bytemuck::pod_collect_to_vec(tensors.tensor(name).unwrap().data()) };
        let of_json = |value: &serde_json::Value| -> Vec<f32> {
            fn flatten(value: &serde_json::Value, out: &mut Vec<f32>) {
                match value.as_array() {
                    Some(items) => items.iter().for_each(|item| flatten(item, out)),
                    None => out.push(value.as_f64().unwrap() as f32),
                }
            }
            let mut out = Vec::new();
            flatten(value, &mut out);
            out
        };
        assert_eq!(floats("transfer"), model.transfer.matrices.concat());
        assert_eq!(of_json(&json["matrices"]), model.transfer.matrices.concat());
        let flat = |values: Vec<Vec3>| -> Vec<f32> { values.iter().flat_map(|v| v.to_array()).collect() };
        for (name, places) in [("points", &model.points.points), ("sub_points", &model.points.sub_points)] {
            for (field, values) in [
                ("position", flat(places.iter().map(|p| p.position).collect())),
                ("normal", flat(places.iter().map(|p| p.normal).collect())),
                ("geometric_normal", flat(places.iter().map(|p| p.geometric_normal).collect())),
                ("albedo", flat(places.iter().map(|p| p.albedo).collect())),
            ] {
                assert_eq!(floats(&format!("{name}.{field}")), values);
                assert_eq!(of_json(&json[name][field]), values);
            }
        }
        let neighbours: Vec<u32> = bytemuck::pod_collect_to_vec(tensors.tensor("points.neighbours").unwrap().data());
        assert_eq!(neighbours, model.points.neighbours);
        assert_eq!(json["basis"]["anchors"], model.basis.anchors.as_ref().map_or(0, |a| a.count));
        assert_eq!(json["mean_scaled_by_norm"], model.transfer.mean_scaled_by_norm);
    }
}

fn the_asset_has_its_lightmap_coordinates() {
    let model = room::model(Channels::Mono, 4, false);
    let folder = exported(&model);
    let asset = relight::scene::load(&folder.path().join("asset.glb")).unwrap();
    let (read, mesh) = (&asset.mesh, &model.asset.mesh);
    assert_eq!(read.triangles.len(), mesh.triangles.len());
    // A corner is found by its place and its lightmap coordinates.
    let corners = |positions: &[Vec3], uvs: &[Vec2], triangles: &[[u32; 3]]| {
        let mut all: Vec<String> =
            triangles.iter().flatten().map(|&i| format!("{} {}", positions[i as usize], uvs[i as usize])).collect();
        all.sort();
        all
    };
    let of_file = corners(&read.positions, &read.uvs[1], &read.triangles);
    assert_eq!(of_file, corners(&mesh.positions, &mesh.lightmap_uvs, &mesh.triangles));
    assert_eq!(asset.materials.len(), model.asset.materials.len());
}

fn the_page_names_every_file_and_shaders_parse() {
    for model in models() {
        let folder = exported(&model);
        let page = std::fs::read_to_string(folder.path().join("README.md")).unwrap();
        for file in std::fs::read_dir(folder.path()).unwrap() {
            let (path, name) = {
                let file = file.unwrap();
                (file.path(), file.file_name().into_string().unwrap())
            };
            assert!(name == "README.md" || page.contains(&format!("`{name}`")), "{name} is not on the page");
            if name.ends_with(".wgsl") {
                let text = std::fs::read_to_string(path).unwrap();
                naga::front::wgsl::parse_str(&text).unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(&text)));
            }
        }
        assert!(page.lines().count() < 60, "one page");
    }
}

/// What the page says, done by someone who has nothing but the folder, Python and numpy: steps 2 to 4, of the exitance of the
/// sub-points to the light of the lightmap, or its root.
const LIGHT: &str = r#"
import json, struct, sys
import numpy

def ktx2(file):
    data = open(file, "rb").read()
    assert data[:12] == b"\xabKTX 20\xbb\r\n\x1a\n"
    vk, _, width, height, _, layers, _, levels, compressed = struct.unpack_from("<9I", data, 12)
    assert levels == 1 and compressed == 0
    start, length, _ = struct.unpack_from("<3Q", data, 80)
    kind = {97: "<f2", 38: "i1", 37: "u1", 41: "u1"}[vk]
    texels = numpy.frombuffer(data[start:start + length], kind).reshape(max(layers, 1), height, width, 4).astype("f8")
    return texels / {97: 1, 38: 127, 37: 255, 41: 1}[vk]

def lightmap(folder, model, e):
    x = e[numpy.array(model["neighbours"])].mean(axis=1) ** (1 / model["gamma"])
    m = numpy.array(model["matrices"])
    if model["channels"] == "mono":
        u = numpy.einsum("cji,ic->jc", m, x)
        norm = numpy.sqrt((x ** 2).sum(axis=0))
    else:
        u = numpy.repeat((m[0] @ x.reshape(-1))[:, None], 3, axis=1)
        norm = numpy.sqrt((x ** 2).sum())
    if model["mean_scaled_by_norm"]:
        u[0] = norm

    n, scalar = model["basis"]["elements"], model["basis"]["components"] == 1
    layers = ktx2(folder + "/basis.ktx2")
    if scalar:
        values = [numpy.repeat(layers[j // 4, :, :, j % 4, None], 3, axis=2) for j in range(n)]
    else:
        values = [layers[j, :, :, :3] for j in range(n)]
    if model["basis"]["anchors"] == 0:
        return sum(u[j] * values[j] for j in range(n))
    anchors = ktx2(folder + "/anchors.ktx2")[0].astype(int)
    shares = ktx2(folder + "/shares.ktx2")[0]
    phi = shares.copy()
    phi[:, :, 3] = 1 - shares[:, :, :3].sum(axis=2)
    light = sum(values[j] * sum(phi[:, :, k, None] * u[n * anchors[:, :, k] + j] for k in range(4)) for j in range(n))
    return light * 2 ** ((shares[:, :, 3, None] - 1) * 255 / 16)
"#;

/// The lightmap of given exitance.
const SHADE: &str = r#"
folder, exitance, out = sys.argv[1:]
model = json.load(open(folder + "/transfer.json"))
e = numpy.fromfile(exitance, "<f4").reshape(-1, 3).astype("f8")
assert e.shape == numpy.array(model["sub_points"]["position"]).shape
(numpy.maximum(lightmap(folder, model, e), 0) ** model["gamma"]).astype("<f4").tofile(out)
"#;

/// A picture of the indirect light of a point light, steps 1 to 5: shadow rays at the sub-points, rays through the pixels.
const PICTURE: &str = r#"
folder, asked, out = sys.argv[1:]
asked = json.loads(asked)
model = json.load(open(folder + "/transfer.json"))

# The asset: its only node has no transform.
glb = open(folder + "/asset.glb", "rb").read()
length = struct.unpack_from("<I", glb, 12)[0]
gltf, binary = json.loads(glb[20:20 + length]), glb[28 + length:]

def accessor(index):
    a = gltf["accessors"][index]
    kind, width = {5125: "<u4", 5126: "<f4"}[a["componentType"]], {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[a["type"]]
    at = gltf["bufferViews"][a["bufferView"]]["byteOffset"]
    return numpy.frombuffer(binary, kind, a["count"] * width, at).reshape(-1, width)

corners, uvs, albedo = [], [], []
for primitive in gltf["meshes"][0]["primitives"]:
    index = accessor(primitive["indices"]).reshape(-1, 3)
    material = gltf["materials"][primitive["material"]]
    assert not material.get("doubleSided") and "baseColorTexture" not in material["pbrMetallicRoughness"]
    corners.append(accessor(primitive["attributes"]["POSITION"])[index])
    uvs.append(accessor(primitive["attributes"]["TEXCOORD_1"])[index])
    albedo += [material["pbrMetallicRoughness"]["baseColorFactor"][:3]] * len(index)
corners, uvs = numpy.concatenate(corners).astype("f8"), numpy.concatenate(uvs).astype("f8")
albedo = numpy.array(albedo)
edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
normal = numpy.cross(*edges)

def unit(v):
    return v / numpy.linalg.norm(v, axis=-1, keepdims=True)

def hits(origin, towards, fronts):
    """Distance, triangle and barycentric coordinates of the nearest hit of each ray (Moeller, Trumbore 1997)."""
    p = numpy.cross(towards[:, None], edges[1])
    with numpy.errstate(all="ignore"):
        inverse = 1 / (edges[0] * p).sum(-1)
        from_corner = origin[:, None] - corners[:, 0]
        u = (from_corner * p).sum(-1) * inverse
        q = numpy.cross(from_corner, edges[0])
        v = (towards[:, None] * q).sum(-1) * inverse
        t = (edges[1] * q).sum(-1) * inverse
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    if fronts:
        inside &= towards @ normal.T < 0
    t = numpy.where(inside, t, numpy.inf)
    triangle = t.argmin(axis=1)
    ray = numpy.arange(len(t))
    return t[ray, triangle], triangle, u[ray, triangle], v[ray, triangle]

# 1. Measure.
points = {name: numpy.array(values) for name, values in model["sub_points"].items()}
start = points["position"] + 1e-4 * points["geometric_normal"]
to_light = numpy.array(asked["light"]) - start
distance = numpy.linalg.norm(to_light, axis=1)
cosine = numpy.maximum((unit(to_light) * points["normal"]).sum(-1), 0)
seen = (hits(start, unit(to_light), False)[0] > distance) & ((to_light * points["geometric_normal"]).sum(-1) > 0)
exitance = points["albedo"] * (asked["intensity"] * cosine / distance ** 2 * seen)[:, None]

# 2 to 4, and 5 at four samples a pixel.
light = lightmap(folder, model, exitance)
width, height = asked["size"]
eye, target = numpy.array(asked["eye"], "f8"), numpy.array(asked["target"], "f8")
forward = unit(target - eye)
right = unit(numpy.cross(forward, [0, 1, 0]))
up = numpy.cross(right, forward)
half = numpy.tan(numpy.radians(asked["vertical_fov"]) / 2)
x, y = numpy.meshgrid((numpy.arange(2 * width) + 0.5) / width - 1, (numpy.arange(2 * height) + 0.5) / height - 1)
rays = unit(forward + (x.ravel() * half * width / height)[:, None] * right - (y.ravel() * half)[:, None] * up)
t, triangle, u, v = hits(numpy.repeat(eye[None], len(rays), 0), rays, True)
uv = uvs[triangle, 0] * (1 - u - v)[:, None] + uvs[triangle, 1] * u[:, None] + uvs[triangle, 2] * v[:, None]
size = light.shape[0]
place = uv * size - 0.5
base = numpy.floor(place).astype(int)
fx, fy = (place - base).T[:, :, None]
texel = lambda dx, dy: light[numpy.clip(base[:, 1] + dy, 0, size - 1), numpy.clip(base[:, 0] + dx, 0, size - 1)]
root = (texel(0, 0) * (1 - fx) + texel(1, 0) * fx) * (1 - fy) + (texel(0, 1) * (1 - fx) + texel(1, 1) * fx) * fy
radiance = numpy.where(numpy.isfinite(t)[:, None], albedo[triangle] / numpy.pi * numpy.maximum(root, 0) ** model["gamma"], 0)
radiance.reshape(height, 2, width, 2, 3).mean(axis=(1, 3)).astype("<f4").tofile(out)
"#;

fn numpy_makes_the_light_of_the_exported_files(python: &Path) {
    let mut rng = Pcg64::seed_from_u64(3);
    for model in models() {
        let folder = exported(&model);
        let at = |name: &str| folder.path().join(name);
        let exitance: Vec<Rgb> =
            model.points.sub_points.iter().map(|_| Rgb::new(rng.random(), rng.random(), rng.random())).collect();
        std::fs::write(at("exitance"), bytemuck::cast_slice::<Rgb, u8>(&exitance)).unwrap();
        let run = Command::new(python)
            .args(["-c", &format!("{LIGHT}{SHADE}")])
            .args([folder.path().to_path_buf(), at("exitance"), at("light")])
            .output()
            .unwrap_or_else(|e| panic!("RELIGHT_PYTHON = {}: {e}", python.display()));
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        let bytes = std::fs::read(at("light")).unwrap();
        let theirs: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes);

        let direct = model.points.average(&exitance);
        let u = model.transfer.coefficients(&direct);
        let ours = model.basis.reconstruct(&u).values;
        assert_eq!(theirs.len(), 3 * ours.len());
        // Ours rounds each of 3 P and n terms in f32; the largest coefficient of a matrix of magnitudes bounds them.
        let mut magnitudes = model.transfer.clone();
        magnitudes.matrices.iter_mut().flatten().for_each(|m| *m = m.abs());
        let largest = magnitudes.coefficients(&direct).iter().map(|u| u.max_element()).fold(0.0, f32::max);
        let terms = (3 * direct.len() + 4 * model.basis.elements + 16) as f32;
        let tolerance = terms * f32::EPSILON * largest * 1.4 * model.basis.elements as f32;
        let misses = |scale: f32| {
            let theirs = theirs.chunks_exact(3).map(Rgb::from_slice);
            let differs = |(ours, theirs): &(Rgb, Rgb)| {
                let gamma = model.basis.gamma;
                let root = ours.max(Vec3::ZERO);
                let light = root.powf(gamma) * scale;
                let difference = (light - *theirs).abs();
                // What an error of the root does to its power, and the power's own rounding.
                let most = (root + tolerance).powf(gamma - 1.0) * gamma * tolerance + light * 8.0 * f32::EPSILON;
                !difference.cmple(most).all()
            };
            ours.iter().copied().zip(theirs).filter(differs).count()
        };
        let what = format!("{:?}, anchors {}", model.transfer.channels, model.basis.anchors.is_some());
        assert_eq!(misses(1.0), 0, "{what}");
        assert!(misses(1.01) > ours.len() / 4, "{what}: light brighter by a hundredth goes unnoticed");
    }
}

/// The program trains, exports and renders; numpy makes the same picture of the exported folder. Each method, as it stores.
fn numpy_makes_the_picture_of_the_exported_files(python: &Path) {
    let folder = tempfile::tempdir().unwrap();
    let relight = |words: &str, more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_relight"));
        let output = command.current_dir(folder.path()).args(words.split(' ')).args(more).output().unwrap();
        assert!(output.status.success(), "{words}: {}", String::from_utf8_lossy(&output.stderr));
    };
    let (light, intensity, size) = ([3.5, 4.0, 2.0], 25.0, [48, 36]);
    let (eye, target, vertical_fov) = ([2.5, 2.8, -7.0], [2.8, 2.6, 2.0], 42.0);
    let asked = |intensity: f64| {
        serde_json::json!({
            "light": light, "intensity": intensity, "size": size,
            "eye": eye, "target": target, "vertical_fov": vertical_fov,
        })
        .to_string()
    };
    for method in ["local", "linear", "belcour"] {
        let train =
            "train --size 32 --conditions 32 --held-out 8 --paths 16 --points 24 --basis 4 --dataset d -o m.relight";
        relight(train, &["--method", method]);
        relight("export m.relight -o", &[method]);
        let camera = format!("{{eye={eye:?}, target={target:?}, vertical_fov={vertical_fov}}}");
        let lamp = format!("{{type=\"point\", position={light:?}, intensity={intensity}}}");
        let render = format!("render m.relight --cpu --show indirect --size {}x{} -o a.exr", size[0], size[1]);
        relight(&render, &["--camera", &camera, "--light", &lamp]);
        let ours = exr::prelude::read_first_rgba_layer_from_file(
            folder.path().join("a.exr"),
            |size, _| vec![Rgb::ZERO; size.area()],
            move |pixels, at, (r, g, b, _): (f32, f32, f32, f32)| pixels[at.y() * size[0] + at.x()] = Rgb::new(r, g, b),
        );
        let ours = ours.unwrap().layer_data.channel_data.pixels;
        let numpys = |intensity: f64| -> Vec<Rgb> {
            let run = Command::new(python)
                .args(["-c", &format!("{LIGHT}{PICTURE}")])
                .args([folder.path().join(method).to_str().unwrap(), &asked(intensity)])
                .arg(folder.path().join("picture"))
                .output()
                .unwrap_or_else(|e| panic!("RELIGHT_PYTHON = {}: {e}", python.display()));
            assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
            let values: Vec<f32> = bytemuck::pod_collect_to_vec(&std::fs::read(folder.path().join("picture")).unwrap());
            values.chunks_exact(3).map(Rgb::from_slice).collect()
        };
        let brightest = ours.iter().map(|p| p.max_element()).fold(0.0, f32::max);
        let lit = ours.iter().filter(|p| p.max_element() > 0.02 * brightest).count();
        assert!(brightest > 0.0 && lit > ours.len() / 2, "{method}: {lit} of {} pixels are lit", ours.len());
        // Numpy sums in doubles: what is left are the roundings of single precision, of sums of some hundred terms of either
        // sign. A sample on an edge may fall to either side of it, and none does in most pictures.
        let misses = |theirs: &[Rgb]| {
            assert_eq!(theirs.len(), ours.len());
            let differs = |(a, b): &(&Rgb, &Rgb)| !(**a - **b).abs().cmple(Vec3::splat(2e-4 * brightest)).all();
            ours.iter().zip(theirs).filter(differs).count()
        };
        let missed = misses(&numpys(intensity));
        println!("{method}: {missed} of {} pixels differ", ours.len());
        assert!(missed <= ours.len() / 500, "{method}: {missed} of {} pixels differ", ours.len());
        let brighter = misses(&numpys(1.02 * intensity));
        assert!(brighter > lit / 2, "{method}: a fiftieth more light goes unnoticed: {brighter} of {lit}");
    }
}
