//! Indirect light in Bevy: the run time works on Bevy's device and queue, in its render world, and its lightmap is Bevy's.
//!
//! Bevy draws and shades as it does; only the `Lightmap` of the meshes is made anew for each frame, from where its `PointLight`s
//! stand. Usage: cargo run --release -- MODEL.relight

use std::f32::consts::{FRAC_1_PI, PI, TAU};
use std::sync::Arc;

use bevy::asset::RenderAssetUsages;
use bevy::camera::Exposure;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::image::ImageSampler;
use bevy::light::GlobalAmbientLight;
use bevy::mesh::{Indices, PrimitiveTopology};
use bevy::pbr::Lightmap;
use bevy::prelude::*;
use bevy::render::render_asset::RenderAssets;
use bevy::render::render_resource::{Extent3d, TextureDimension, TextureFormat};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::texture::GpuImage;
use bevy::render::{Extract, ExtractSchedule, Render, RenderApp, RenderStartup, RenderSystems};
use relight::gpu::{Lookup, Measure, Relighter, Settings};
use relight::light::Light;
use relight::model::Model;

#[derive(Resource, Clone)]
struct Trained(Arc<Model>);

/// The lightmap that Bevy shades with.
#[derive(Resource, Clone)]
struct Indirect(Handle<Image>);

/// Where Bevy's lights stand, as the run time knows lights.
#[derive(Resource, Default)]
struct Lights(Vec<Light>);

#[derive(Resource)]
struct Run(Relighter);

fn main() {
    let Some(path) = std::env::args().nth(1) else {
        eprintln!("usage: relight-in-bevy MODEL.relight");
        std::process::exit(2);
    };
    let model = Model::load(path.as_ref()).unwrap_or_else(|error| {
        eprintln!("error: {error}");
        std::process::exit(2);
    });
    if model.transfer.gamma != 1.0 {
        eprintln!("error: {path}: its lightmap holds roots of light, which Bevy's cannot; train with --gamma 1");
        std::process::exit(2);
    }
    let mut app = App::new();
    app.add_plugins(DefaultPlugins)
        .insert_resource(Trained(Arc::new(model)))
        .insert_resource(GlobalAmbientLight::NONE)
        .insert_resource(ClearColor(Color::BLACK))
        .add_systems(Startup, furnish)
        .add_systems(Update, go_around);
    let (model, image) = {
        let model = app.world().resource::<Trained>().clone();
        let image = app.world_mut().resource_mut::<Assets<Image>>().add(lightmap(model.0.basis.size as u32));
        (model, Indirect(image))
    };
    app.insert_resource(image.clone());
    app.sub_app_mut(RenderApp)
        .insert_resource(model)
        .insert_resource(image)
        .init_resource::<Lights>()
        .add_systems(RenderStartup, start)
        .add_systems(ExtractSchedule, extract)
        .add_systems(Render, relight.in_set(RenderSystems::PrepareBindGroups));
    app.run();
}

/// Filled by the run time; in its format, so that it is copied on the GPU.
fn lightmap(size: u32) -> Image {
    let extent = Extent3d { width: size, height: size, depth_or_array_layers: 1 };
    let (dimension, format) = (TextureDimension::D2, TextureFormat::Rgba32Float);
    let mut image = Image::new_fill(extent, dimension, &[0; 16], format, RenderAssetUsages::RENDER_WORLD);
    // 32-bit floats are filtered by all desktop GPUs, whose features Bevy asks for.
    image.sampler = ImageSampler::linear();
    image
}

/// The asset, a mesh for each material, a lamp and a camera.
fn furnish(
    mut commands: Commands,
    model: Res<Trained>,
    indirect: Res<Indirect>,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let asset = &model.0.asset;
    for (number, material) in asset.materials.iter().enumerate() {
        let of_material = asset.mesh.triangles.iter().zip(&asset.mesh.triangle_materials);
        let triangles = of_material.filter(|&(_, &of)| of as usize == number).flat_map(|(corners, _)| *corners);
        let positions: Vec<[f32; 3]> = asset.mesh.positions.iter().map(|p| p.to_array()).collect();
        let normals: Vec<[f32; 3]> = asset.mesh.normals.iter().map(|n| n.to_array()).collect();
        let uvs: Vec<[f32; 2]> = asset.mesh.lightmap_uvs.iter().map(|uv| uv.to_array()).collect();
        let mesh = Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
            .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, positions)
            .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, normals)
            .with_inserted_attribute(Mesh::ATTRIBUTE_UV_0, uvs.clone())
            .with_inserted_attribute(Mesh::ATTRIBUTE_UV_1, uvs)
            .with_inserted_indices(Indices::U32(triangles.collect()));
        let [r, g, b, _] = material.base_colour.to_array();
        let material = StandardMaterial {
            base_color: Color::linear_rgb(r, g, b),
            perceptual_roughness: 1.0,
            reflectance: 0.0,
            // From irradiance to what a white surface sends out of it.
            lightmap_exposure: FRAC_1_PI,
            ..default()
        };
        commands.spawn((
            Mesh3d(meshes.add(mesh)),
            MeshMaterial3d(materials.add(material)),
            Lightmap { image: indirect.0.clone(), ..default() },
        ));
    }
    let bounds = asset.mesh.bounds();
    let candela = PI * (0.5 * bounds.diagonal()).powi(2);
    commands.spawn(PointLight {
        intensity: 4.0 * PI * candela,
        range: 10.0 * bounds.diagonal(),
        shadow_maps_enabled: true,
        ..default()
    });
    let camera = &asset.cameras[0];
    let [eye, target] = [camera.eye, camera.target].map(|v| Vec3::from_array(v.to_array()));
    commands.spawn((
        Camera3d::default(),
        Transform::from_translation(eye).looking_at(target, Vec3::Y),
        Projection::Perspective(PerspectiveProjection { fov: camera.vertical_fov.to_radians(), ..default() }),
        Exposure { ev100: 1.5 },
        Tonemapping::AcesFitted,
    ));
}

/// The lamp goes around the middle of the asset, once in eight seconds.
fn go_around(time: Res<Time>, model: Res<Trained>, mut lamps: Query<&mut Transform, With<PointLight>>) {
    let bounds = model.0.asset.mesh.bounds();
    let centre = Vec3::from_array(bounds.centre().to_array());
    let (sin, cos) = (time.elapsed_secs() * TAU / 8.0).sin_cos();
    for mut lamp in &mut lamps {
        lamp.translation = centre + Vec3::new(cos, 0.9, sin) * (0.17 * bounds.diagonal());
    }
}

/// Once Bevy has its device.
fn start(mut commands: Commands, device: Res<RenderDevice>, queue: Res<RenderQueue>, model: Res<Trained>) {
    let settings = Settings { measure: Measure::Rays, lookup: Lookup::Texture };
    match Relighter::new(device.wgpu_device(), &queue, &model.0, settings) {
        Ok(relighter) => commands.insert_resource(Run(relighter)),
        Err(error) => panic!("{error}"),
    }
}

fn extract(mut lights: ResMut<Lights>, lamps: Extract<Query<(&GlobalTransform, &PointLight)>>) {
    lights.0 = (lamps.iter())
        .map(|(place, lamp)| {
            let color = lamp.color.to_linear();
            Light::Point {
                position: place.translation().to_array().into(),
                color: [color.red, color.green, color.blue].into(),
                // From lumen.
                intensity: lamp.intensity / (4.0 * PI),
                range: None,
            }
        })
        .collect();
}

/// Measures the lamps' light, makes the indirect light of it and copies it to Bevy's lightmap, before anything is drawn.
fn relight(
    mut run: ResMut<Run>,
    lights: Res<Lights>,
    indirect: Res<Indirect>,
    images: Res<RenderAssets<GpuImage>>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
) {
    let Some(image) = images.get(&indirect.0) else { return };
    if let Err(error) = run.0.set_lights(&lights.0) {
        error!("{error}");
        return;
    }
    let mut encoder = device.wgpu_device().create_command_encoder(&Default::default());
    run.0.encode(&mut encoder);
    let irradiance = run.0.irradiance().expect("asked for by Lookup::Texture").texture();
    encoder.copy_texture_to_texture(irradiance.as_image_copy(), image.texture.as_image_copy(), irradiance.size());
    queue.submit([encoder.finish()]);
}
