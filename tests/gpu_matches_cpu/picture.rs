//! Whole pictures: shading, shadows, and the mean of samples.

use std::collections::HashMap;

use glam::Vec2;
use relight::gpu::{Gpu, GpuError, Lookup, Runtime};
use relight::light::Light;
use relight::model::{Channels, Model, Picture, Shown, View, ViewError};
use relight::scene::Tracer;

use crate::room;

/// Samples that a rasteriser may give to another surface than a ray: it rounds vertices to 1/256 of a sample, which moves
/// an outline by at most half of that along each axis. Outlines of shadows on the surfaces move as much, once a light.
/// The count is nearly Poisson; five sigmas above its mean.
pub fn flipped_samples(model: &Model, view: &View, lights: usize) -> f32 {
    let clip_from_world = view.pinhole().unwrap().clip_from_world(1e-3);
    let size = Vec2::from_array(view.samples().map(|s| s as f32));
    let mesh = &model.asset.mesh;
    // None behind the camera; what lies beside the picture counts as its border.
    let on_screen = |vertex: u32| {
        let clip = clip_from_world * mesh.positions[vertex as usize].extend(1.0);
        let place = (Vec2::new(clip.x, -clip.y) / clip.w + 1.0) * 0.5 * size;
        (clip.w > 0.0).then(|| place.clamp(Vec2::ZERO, size))
    };
    let edges = |t: &[u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
    let faces_eye = |triangle: usize| {
        let corner = mesh.positions[mesh.triangles[triangle][0] as usize];
        mesh.triangle_cross(triangle).dot(view.camera.eye - corner) > 0.0
    };
    let triangles = mesh.triangles.iter().enumerate();
    let all: HashMap<[u32; 2], usize> = triangles.flat_map(|(i, t)| edges(t).map(|edge| (edge, i))).collect();
    // An edge that two triangles of one surface share is an outline only where one of them looks away.
    let outlines = all.iter().filter(|&(&[a, b], &here)| {
        let other = all.get(&[b, a]);
        other.is_none_or(|&other| faces_eye(other) != faces_eye(here))
    });
    let length: f32 = outlines.filter_map(|(&[a, b], _)| Some(on_screen(a)?.distance(on_screen(b)?))).sum();
    let width = 2.0 * std::f32::consts::SQRT_2 / 512.0;
    let mean = length * width * (1 + lights) as f32;
    mean + 5.0 * mean.sqrt()
}

/// Pixels that differ by more than rounding: what the picture changes over 1/64 of a pixel, and 1e-4 of its brightest light
/// for the specular lobe, which magnifies the rounding of its half vector by about 1/α².
pub fn differing_pixels(gpu: &Picture, cpu: &Picture) -> Vec<(u32, u32, f32)> {
    let brightest = cpu.pixels.iter().map(|p| p.max_element()).fold(0.0, f32::max);
    let mut differing = Vec::new();
    for y in 0..cpu.height {
        for x in 0..cpu.width {
            let here = cpu.pixel(x, y);
            let mut change = 0f32;
            for ny in y.saturating_sub(1)..(y + 2).min(cpu.height) {
                for nx in x.saturating_sub(1)..(x + 2).min(cpu.width) {
                    change = change.max((cpu.pixel(nx, ny) - here).abs().max_element());
                }
            }
            let difference = (gpu.pixel(x, y) - here).abs().max_element();
            if difference.is_nan() || difference > change / 64.0 + 1e-4 * brightest {
                differing.push((x, y, difference));
            }
        }
    }
    differing
}

pub fn whole_picture() {
    let view = room::view(160, 120);
    let lights = room::lights();
    let local = room::local_model(Channels::Mono, 4);
    for model in [room::model(Channels::Mono, 6, false), room::model(Channels::Multi, 3, false), local] {
        for shown in [Shown::Full, Shown::Direct, Shown::Indirect, Shown::IndirectOnWhite] {
            picture_matches(&model, &view, &lights, shown);
        }
    }
}

/// Holds a picture of each light's own entry against the CPU's.
pub fn picture_matches(model: &Model, view: &View, lights: &[Light], shown: Shown) {
    let what = format!("{}: {:?} {shown:?}", model.asset.name, model.transfer.channels);
    let tracer = Tracer::new(&model.asset);
    // A local basis is looked up texel by texel by either; a global one is filtered otherwise by the texture unit.
    let lookup = if model.basis.anchors.is_some() { Lookup::Fragment } else { Lookup::Texture };
    let mut runtime = Runtime::with(Gpu::new().unwrap(), model, lookup).unwrap();
    let cpu = model.render(&tracer, view, lights, shown).unwrap();
    let gpu = runtime.render(view, lights, shown).unwrap();
    let allowed = flipped_samples(model, view, lights.len());
    let differing = differing_pixels(&gpu, &cpu);
    println!("{what}: {} pixels differ, {allowed:.0} may", differing.len());
    if differing.len() as f32 > allowed {
        panic!("{what}: {} differ, {allowed} may; see {}", differing.len(), evidence(&gpu, &cpu));
    }
    let mut brighter = gpu.clone();
    brighter.pixels.iter_mut().for_each(|p| *p *= 1.05);
    assert!(differing_pixels(&brighter, &cpu).len() as f32 > allowed, "{what}: 5 % more light goes unnoticed");
}

/// Leaves both pictures and their difference beside each other.
pub fn evidence(gpu: &Picture, cpu: &Picture) -> String {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR"));
    let pixels = gpu.pixels.iter().zip(&cpu.pixels).map(|(g, c)| (*g - *c).abs()).collect();
    let difference = Picture { pixels, ..*gpu };
    for (name, picture) in [("gpu", gpu), ("cpu", cpu), ("difference", &difference)] {
        picture.write_exr(&folder.join(format!("{name}.exr"))).unwrap();
    }
    folder.display().to_string()
}

pub fn absurd_views() {
    let model = room::model(Channels::Mono, 4, false);
    let mut runtime = Runtime::new(&model).unwrap();
    let mut render = |width, height| runtime.render(&room::view(width, height), &room::lights(), Shown::Full);
    assert!(matches!(render(0, 0), Err(GpuError::View(ViewError::Size { width: 0, height: 0 }))));
    assert!(matches!(render(32768, 1), Err(GpuError::TooLarge { .. })));
    assert_eq!(render(16, 9).unwrap().pixels.len(), 16 * 9);
}
