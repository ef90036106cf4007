//! Scene files: those that come with the program work, defaults are as documented, and what is written reads back; and the
//! bake of a scene is the same on any number of threads.

use std::path::{Path, PathBuf};

use glam::Vec3;
use proptest::prelude::*;
use relight::dataset::Bytes;
use relight::light::scenario::{Aim, Color, KindWeights, Position, Sky};
use relight::light::{Light, LightingCondition, Scenario};
use relight::model::Channels;
use relight::progress::Silent;
use relight::scene::{Camera, Lightmap, Tracer, UvPolicy, lay_out};
use relight::scene_file::{
    AssetSettings, BakeSettings, Conditions, LightmapSettings, MaterialPolicy, PointSettings, SceneFile, TrainSettings,
};
use relight::transfer::Method;
use relight::transport::{self, Integrator, bake, bake_direct};

fn scenes() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path().join("scene.toml")).collect();
    assert!(files.len() >= 3);
    files
}

#[test]
fn scenes_that_come_with_the_program_load_and_lay_out() {
    for path in scenes() {
        let place = path.display().to_string();
        let scene = SceneFile::read(&path).unwrap_or_else(|e| panic!("{e}"));
        scene.check(&place).unwrap();
        scene.scenario.validate().unwrap();
        let mut asset = scene.load_asset(&place).unwrap();
        lay_out(&mut asset, scene.lightmap.size, scene.lightmap.uv).unwrap_or_else(|e| panic!("{place}: {e}"));
        let lightmap = Lightmap::new(&asset.mesh, scene.lightmap.size as usize);
        let covered = lightmap.texels.len() as f64 / (lightmap.size * lightmap.size) as f64;
        assert!(covered > 0.2 && covered < 1.0, "{place}: {covered} of the page is covered");
        let tracer = Tracer::new(&asset);
        scene.scenario.sampler(&tracer).unwrap().conditions(1, 8).unwrap_or_else(|e| panic!("{place}: {e}"));
    }
}

/// `scenes/cornell/scene.toml` says that what a section leaves out has the default written there: outside `[asset]`,
/// `[camera]` and the Cornell box's own lights, leaving everything out changes nothing.
#[test]
fn defaults_are_what_the_documented_scene_says() {
    let cornell = SceneFile::cornell();
    let default = SceneFile::default();
    assert_eq!(cornell.lightmap, default.lightmap);
    assert_eq!(cornell.points, default.points);
    assert_eq!(cornell.bake, default.bake);
    assert_eq!(cornell.train, default.train);
    let (own, usual) = (&cornell.scenario, &default.scenario);
    assert_eq!((own.lights_per_condition, own.kinds, own.aim), (usual.lights_per_condition, usual.kinds, usual.aim));
    assert_eq!((own.sky, own.inner_cone, own.color), (usual.sky, usual.inner_cone, usual.color));
    assert_eq!(toml::from_str::<SceneFile>("").unwrap(), default);
}

fn range(low: f32, high: f32) -> impl Strategy<Value = [f32; 2]> {
    (low..high, low..high).prop_map(|(a, b)| [a.min(b), a.max(b)])
}

fn vector() -> impl Strategy<Value = Vec3> {
    [-1e6f32..1e6, -1f32..1.0, -100f32..100.0].prop_map(Vec3::from_array)
}

fn position() -> impl Strategy<Value = Position> {
    prop_oneof![
        Just(Position::Near),
        Just(Position::Inside),
        (range(0.0, 5.0), any::<bool>()).prop_map(|(radius, above)| Position::Around { radius, above }),
        (vector(), vector()).prop_map(|(a, b)| Position::Box { min: a.min(b), max: a.max(b) }),
    ]
}

fn scenario() -> impl Strategy<Value = Scenario> {
    let aim = prop_oneof![
        Just(Aim::Surface),
        Just(Aim::Bounds),
        Just(Aim::Any),
        (vector(), vector()).prop_map(|(a, b)| Aim::Box { min: a.min(b), max: a.max(b) }),
    ];
    let color = prop_oneof![
        Just(Color::White),
        (range(0.0, 1.0), range(0.0, 1.0)).prop_map(|(hue, saturation)| Color::Random { hue, saturation }),
    ];
    let kinds = (0f32..9.0, 0.1f32..9.0, 0f32..9.0, 0f32..9.0, any::<[bool; 5]>());
    let kinds = kinds.prop_map(|(point, spot, directional, rect, others)| {
        let [disk, sphere, environment, sky, emissive] = others.map(|present| present as u32 as f32);
        KindWeights { point, spot, directional, rect, disk, sphere, environment, sky, emissive }
    });
    let skies = (range(0.0, 1.5), range(1.7, 10.0), range(0.0, 1.0), range(1e-3, 1e3));
    let others = (skies, proptest::option::of(range(0.01, 9.0)), any::<bool>());
    let some = (proptest::option::of(range(1e-6, 1e9)), proptest::option::of(0f32..10.0), range(1e-3, 1e6));
    let angles = (range(0.001, 1.57), range(0.0, 1.0), prop_oneof![Just(Sky::Above), Just(Sky::Everywhere)]);
    ((1u32..1025, 1u32..1025), kinds, position(), aim, color, some, angles, others).prop_map(
        |((a, b), kinds, position, aim, color, (intensity, clearance, illuminance), angles, others)| Scenario {
            lights_per_condition: [a.min(b), a.max(b)],
            kinds,
            position,
            aim,
            sky: angles.2,
            outer_cone_angle: angles.0,
            inner_cone: angles.1,
            intensity,
            illuminance,
            color,
            clearance,
            size: others.1,
            environments: if others.2 { vec![PathBuf::from("maps/\"λ\".exr")] } else { Vec::new() },
            sun_elevation: others.0.0,
            turbidity: others.0.1,
            ground_albedo: others.0.2,
            emission: others.0.3,
        },
    )
}

fn scene_file() -> impl Strategy<Value = SceneFile> {
    let path = prop_oneof![Just("a b/\"λ\".glb"), Just("c:\\mesh.obj"), Just("../x.gltf")];
    let asset = (prop::option::of(path), prop::option::of("[a-z]{0,9}"), any::<bool>());
    let numbers = (8u32..8193, 1usize..65537, 1usize..257, 1usize..65537, 1usize..65537, 1u32..1 << 20);
    let more = (1u32..1025, any::<u64>(), 1usize..1025, proptest::option::of(0f64..1e9), any::<[bool; 3]>());
    let camera = proptest::option::of((vector(), vector(), 0.1f32..179.0));
    (asset, numbers, more, camera, scenario()).prop_map(|(asset, numbers, more, camera, scenario)| {
        let (size, count, sub_points, conditions, held_out, paths) = numbers;
        let (max_bounces, seed, basis, lambda, [belcour, multi, second]) = more;
        SceneFile {
            asset: AssetSettings {
                path: asset.0.map(PathBuf::from),
                generator: asset.1,
                materials: if asset.2 { MaterialPolicy::Lambert } else { MaterialPolicy::File },
            },
            lightmap: LightmapSettings { size, uv: if second { UvPolicy::Unwrap } else { UvPolicy::Auto } },
            scenario,
            points: PointSettings { count, sub_points: multi.then_some(sub_points) },
            bake: BakeSettings {
                conditions: if second { Conditions::Auto } else { Conditions::Count(conditions) },
                held_out,
                paths,
                max_bounces,
                denoise: belcour.then_some(multi),
                seed,
                integrator: Integrator::Auto,
            },
            train: TrainSettings {
                method: if belcour { Method::Belcour } else { Method::Linear },
                basis: second.then_some(basis),
                channels: if multi { Channels::Multi } else { Channels::Mono },
                lambda,
                anchors: sub_points,
                bits: if multi { 8 } else { 16 },
                gamma: belcour.then_some(2.2),
                prior: multi,
                max_error: second.then_some(0.05),
                max_bytes: multi.then_some(Bytes(sub_points as u64)),
            },
            camera: camera.map(|(eye, target, vertical_fov)| Camera { eye, target, up: Vec3::Y, vertical_fov }),
        }
    })
}

proptest! {
    /// A model carries its settings as TOML: they come back to the last digit.
    #[test]
    fn settings_survive_being_written_and_read(scene in scene_file()) {
        let text = toml::to_string(&scene).unwrap();
        let back: SceneFile = toml::from_str(&text).unwrap();
        prop_assert_eq!(&back, &scene);
        prop_assert_eq!(toml::to_string(&back).unwrap(), text);
    }
}

/// Two lights in one condition, one in another, and the corner's own emission: all that sums are made of.
#[test]
fn bakes_have_the_same_bits_on_any_number_of_threads() {
    let scene = SceneFile::cornell();
    let mut asset = scene.load_asset("cornell").unwrap();
    asset.materials[1].emissive = Vec3::new(0.5, 0.25, 0.0);
    lay_out(&mut asset, 24, UvPolicy::Auto).unwrap();
    let lightmap = Lightmap::new(&asset.mesh, 24);
    let tracer = Tracer::new(&asset);
    let light =
        |x: f32| Light::Point { position: Vec3::new(x, 4.0, 2.0), color: Vec3::ONE, intensity: 20.0, range: None };
    let conditions = [
        LightingCondition { lights: vec![light(1.0), light(4.0)] },
        LightingCondition { lights: vec![light(2.0), Light::Emissive { scale: 1.0 }] },
    ];
    let run = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let settings = transport::BakeSettings { paths: 16, max_bounces: 8, seed, integrator: Integrator::Auto };
            let baked = bake(&tracer, &lightmap, &conditions, &settings, &Silent).unwrap();
            let direct = bake_direct(&tracer, &lightmap, &conditions, seed, &Silent).unwrap();
            let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
            (bits(&baked.indirect), bits(&baked.noise), bits(&direct), baked.rays)
        })
    };
    let one = run(1, 7);
    assert!(one.0.iter().any(|&bits| bits != 0));
    assert!(one == run(2, 7) && one == run(3, 7));
    assert!(one.0 != run(2, 8).0, "another seed");
}
