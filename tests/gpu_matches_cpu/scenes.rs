//! Every stage on every scene.

use glam::Vec3;
use half::f16;
use relight::dataset::Draw;
use relight::gpu::{Lookup, Measure, Relighter, Runtime, Settings};
use relight::light::{EmissionFacets, Light, LightTable};
use relight::measure::MeasurementPoints;
use relight::model::{Channels, Model, Shown, Values, View};
use relight::scene::{Tracer, lay_out};
use relight::scene_file::SceneFile;

use crate::embedded::{lookup_misses, places};
use crate::measure::{downsample_matches, measure_matches, measure_parts_match};
use crate::picture::picture_matches;
use crate::transfer::{reconstruct_matches, transfer_misses};
use crate::{host, room};

/// Every scene's asset, unwrapped at a small size, under lights of its own scenario.
pub fn scenes() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let mut seen = 0;
    for entry in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
        for file in std::fs::read_dir(&entry).unwrap().map(|e| e.unwrap().path()) {
            if file.extension().is_some_and(|e| e == "toml") {
                println!("{}", file.display());
                scene(&file);
                seen += 1;
            }
        }
    }
    assert!(seen >= 3, "{seen} scenes");
}

pub fn scene(file: &std::path::Path) {
    const SIZE: usize = 64;
    let scene = SceneFile::read(file).unwrap();
    let mut asset = scene.load_asset(&file.display().to_string()).unwrap();
    lay_out(&mut asset, SIZE as u32, scene.lightmap.uv).unwrap();
    let points = MeasurementPoints::place(&asset, 64, 8, 1).unwrap();
    let global = room::model_of(asset, points, SIZE, Channels::Mono, 16, false);
    let asset = global.asset.clone();
    let tracer = Tracer::new(&asset);
    let draw = Draw { scenario: &scene.scenario, training: 6, held_out: 0 };
    let mut lights: Vec<Light> = Vec::new();
    for condition in draw.conditions(&tracer, 3).unwrap() {
        lights.extend(condition.lights);
    }
    let (single, parts): (Vec<Light>, Vec<Light>) = lights
        .iter()
        .cloned()
        .partition(|l| matches!(l, Light::Point { .. } | Light::Spot { .. } | Light::Directional { .. }));
    if !single.is_empty() {
        let [lit, _] = measure_matches(&global, &single);
        assert!(lit > 100, "{}: {lit} lit", file.display());
    }
    measure_parts_match(&global, &parts);
    downsample_matches(&global, &lights);
    let host = host::Host::new();
    let places = places();
    for model in every_kind(global) {
        let mut runtime = Runtime::new(&model).unwrap();
        let direct = model.points.direct(&tracer, &LightTable::new(&lights, &EmissionFacets::of(&model.asset)));
        let gpu = runtime.coefficients(&direct).unwrap();
        assert_eq!(transfer_misses(&model, &direct, &gpu), 0);
        reconstruct_matches(&model);
        for lookup in [Lookup::Fragment, Lookup::Texture] {
            let settings = Settings { measure: Measure::Points, lookup };
            let relighter = Relighter::new(&host.device, &host.queue, &model, settings).unwrap();
            host.write(relighter.direct(), &direct);
            let gpu = host.look_up(&relighter, &places);
            assert_eq!(lookup_misses(&model, lookup, &direct, &places, &gpu).0, 0, "{lookup:?}");
        }
        // Shade and resolve know lights by their entries: one that is near and one that is far are all there is. The near
        // one, in the eye, casts no shadow that is seen.
        let camera = model.asset.cameras[0].clone();
        let position = camera.eye + (camera.target - camera.eye) * 1e-3;
        let intensity = camera.eye.distance_squared(camera.target);
        let lights = [
            Light::Point { position, color: Vec3::new(1.0, 0.8, 0.6), intensity, range: None },
            Light::Directional { direction: Vec3::new(-0.3, -0.8, -0.5).normalize(), color: Vec3::ONE, intensity: 1.0 },
        ];
        picture_matches(&model, &View::new(camera, 96, 72), &lights, Shown::Full);
    }
}

/// What each method stores, in each way that it can: a global basis mono (`linear`), with a mean (`belcour`) and multi; a local
/// one in bytes and in half floats, mono and multi; and roots of light.
fn every_kind(global: Model) -> Vec<Model> {
    let (asset, points, size) = (global.asset.clone(), global.points.clone(), global.basis.size);
    let of = |channels, elements, mean| room::model_of(asset.clone(), points.clone(), size, channels, elements, mean);
    let local = |channels| room::local(of(channels, 4 * room::ANCHORS, false), 4);
    let halves = |mut model: Model| {
        let values = &model.basis.values;
        model.basis.values = Values::Half((0..values.len()).map(|i| f16::from_f32(values.get(i))).collect());
        model
    };
    vec![
        of(Channels::Mono, 16, true),
        of(Channels::Multi, 7, false),
        of(Channels::Multi, 7, true),
        local(Channels::Mono),
        local(Channels::Multi),
        halves(local(Channels::Mono)),
        halves(local(Channels::Multi)),
        room::raised(of(Channels::Mono, 16, false)),
        room::raised(local(Channels::Mono)),
        global,
    ]
}
