//! A small model made by hand: a room with a box, a textured quad, an alpha-masked quad and a metallic one, a random basis and
//! random matrices. What it reconstructs means nothing; every path of the shaders is taken.

#![allow(dead_code)]

use glam::{Mat3, Vec2, Vec3, Vec4};
use half::f16;
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64;
use relight::light::Light;
use relight::math::Rgb;
use relight::measure::{MeasurementPoint, MeasurementPoints};
use relight::model::{Anchors, Basis, Channels, HeldOut, Model, Scope, TrainingRecord, Transfer, Values, View};
use relight::scene::{Asset, Camera, Material, Mesh, Reflectance, Texture, TextureRef, Wrap};

/// Texels on a side of the lightmap.
const LIGHTMAP: usize = 32;

/// Quads, each with its own rectangle of the lightmap.
struct Room {
    mesh: Mesh,
    materials: Vec<Material>,
    quads: usize,
}

impl Room {
    fn material(&mut self, material: Material) -> u32 {
        self.materials.push(material);
        self.materials.len() as u32 - 1
    }

    /// A parallelogram that faces along `u` × `v`.
    fn quad(&mut self, corner: Vec3, u: Vec3, v: Vec3, material: u32) {
        let first = self.mesh.positions.len() as u32;
        let cell = Vec2::new((self.quads % 5) as f32, (self.quads / 5) as f32) / 5.0;
        self.quads += 1;
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            self.mesh.positions.push(corner + u * x + v * y);
            self.mesh.normals.push(u.cross(v).normalize());
            self.mesh.uvs[0].push(Vec2::new(x, 1.0 - y));
            self.mesh.uvs[1].push(Vec2::new(1.0 - x, y) * 0.7);
            self.mesh.lightmap_uvs.push(cell + Vec2::new(0.02 + 0.16 * x, 0.02 + 0.16 * y));
        }
        self.mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        self.mesh.triangle_materials.extend([material, material]);
    }

    /// An axis-aligned box turned about y.
    fn block(&mut self, centre: Vec3, half: Vec3, angle: f32, material: u32) {
        let turn = Mat3::from_rotation_y(angle);
        for (normal, u) in [(Vec3::X, Vec3::Y), (Vec3::Y, Vec3::Z), (Vec3::Z, Vec3::X)] {
            for side in [1.0, -1.0] {
                let (n, u) = (normal * side, u);
                let v = n.cross(u);
                let corner = turn * ((n - u - v) * half) + centre;
                self.quad(corner, turn * (2.0 * u * half), turn * (2.0 * v * half), material);
            }
        }
    }
}

fn texture(rng: &mut Pcg64, width: u32, height: u32, srgb: bool, wrap: [Wrap; 2]) -> Texture {
    let texels = (0..width * height).map(|_| rng.next_u32().to_le_bytes()).collect();
    Texture { name: format!("noise {width} x {height}"), width, height, texels, srgb, wrap }
}

fn texture_ref(texture: u32, uv_set: u32, transform: Mat3) -> Option<TextureRef> {
    Some(TextureRef { texture, uv_set, transform })
}

/// A room of 2 m, open towards +z, with a box, and three quads in it.
pub fn asset() -> Asset {
    let mut rng = Pcg64::seed_from_u64(11);
    let textures = vec![
        texture(&mut rng, 16, 16, true, [Wrap::Repeat, Wrap::Mirror]),
        texture(&mut rng, 7, 5, true, [Wrap::Clamp, Wrap::Repeat]),
        texture(&mut rng, 8, 3, false, [Wrap::Mirror, Wrap::Clamp]),
    ];
    let mut room = Room { mesh: Mesh::default(), materials: Vec::new(), quads: 0 };
    let white = room.material(Material::lambert("white", Vec3::new(0.75, 0.75, 0.7)));
    let red = room.material(Material::lambert("red", Vec3::new(0.6, 0.06, 0.05)));
    let green = room.material(Material::lambert("green", Vec3::new(0.12, 0.45, 0.1)));
    let textured = room.material(Material {
        base_colour_texture: texture_ref(
            0,
            0,
            Mat3::from_scale_angle_translation(Vec2::new(2.3, 1.7), 0.4, Vec2::new(-0.8, 0.3)),
        ),
        emissive: Vec3::new(0.1, 0.05, 0.02),
        emissive_texture: texture_ref(1, 1, Mat3::from_scale(Vec2::new(3.0, -2.0))),
        ..Material::lambert("textured", Vec3::ONE)
    });
    let masked = room.material(Material {
        base_colour: Vec4::new(0.8, 0.7, 0.2, 0.9),
        base_colour_texture: texture_ref(1, 0, Mat3::from_translation(Vec2::new(-0.5, 0.1))),
        alpha_cutoff: Some(0.4),
        double_sided: true,
        ..Material::lambert("masked", Vec3::ONE)
    });
    let metal = room.material(Material {
        reflectance: Reflectance::MetallicRoughness,
        base_colour: Vec4::new(0.9, 0.8, 0.5, 1.0),
        metallic: 0.9,
        roughness: 0.7,
        metallic_roughness_texture: texture_ref(2, 1, Mat3::from_scale(Vec2::splat(1.5))),
        ..Material::lambert("metal", Vec3::ONE)
    });
    let (x, y, z) = (2.0 * Vec3::X, 2.0 * Vec3::Y, 2.0 * Vec3::Z);
    room.quad(Vec3::new(-1.0, 0.0, 1.0), x, -z, white);
    room.quad(Vec3::new(-1.0, 2.0, -1.0), x, z, white);
    room.quad(Vec3::new(-1.0, 0.0, -1.0), x, y, white);
    room.quad(Vec3::new(-1.0, 0.0, 1.0), -z, y, red);
    room.quad(Vec3::new(1.0, 0.0, -1.0), z, y, green);
    room.block(Vec3::new(-0.4, 0.35, -0.35), Vec3::new(0.25, 0.35, 0.25), 0.4, white);
    room.block(Vec3::new(0.45, 0.2, 0.1), Vec3::new(0.22, 0.2, 0.22), -0.3, metal);
    room.quad(Vec3::new(-0.7, 1.0, -0.95), x * 0.4, y * 0.4, textured);
    room.quad(Vec3::new(0.2, 0.7, -0.2), x * 0.3, y * 0.3 - z * 0.05, masked);
    let colours = room.mesh.positions.iter().map(|_| Vec3::splat(0.5) + 0.5 * rng.random::<f32>()).collect();
    room.mesh.colours = colours;
    Asset {
        name: "room".to_owned(),
        mesh: room.mesh,
        materials: room.materials,
        textures,
        lights: Vec::new(),
        cameras: Vec::new(),
        warnings: Vec::new(),
    }
}

/// Points spread over the asset's triangles, each with its nearest sub-points.
pub fn measurement_points(asset: &Asset, points: usize, per_point: usize) -> MeasurementPoints {
    let mut rng = Pcg64::seed_from_u64(5);
    let mut draw = |count: usize| -> Vec<MeasurementPoint> {
        (0..count)
            .map(|i| {
                let (u, v) = (rng.random::<f32>() * 0.5, rng.random::<f32>() * 0.5);
                let surface = asset.surface(i % asset.mesh.triangles.len(), u, v, Vec3::ZERO);
                MeasurementPoint {
                    position: surface.position,
                    normal: surface.normal,
                    geometric_normal: surface.geometric_normal,
                    albedo: surface.bsdf.albedo(),
                }
            })
            .collect()
    };
    let (points, sub_points) = (draw(points), draw(points * per_point));
    let neighbours = points
        .iter()
        .flat_map(|p| {
            let mut order: Vec<u32> = (0..sub_points.len() as u32).collect();
            order.sort_by(|&a, &b| {
                let distance = |i: u32| p.position.distance_squared(sub_points[i as usize].position);
                distance(a).total_cmp(&distance(b))
            });
            order.truncate(per_point);
            order
        })
        .collect();
    MeasurementPoints { points, sub_points, neighbours }
}

/// The room with a random basis of `elements` over positive and negative values, and random matrices.
pub fn model(channels: Channels, elements: usize, mean_scaled_by_norm: bool) -> Model {
    let asset = asset();
    let points = measurement_points(&asset, 61, 8);
    model_of(asset, points, LIGHTMAP, channels, elements, mean_scaled_by_norm)
}

/// The same of any asset, with a lightmap of any size.
pub fn model_of(
    asset: Asset,
    points: MeasurementPoints,
    size: usize,
    channels: Channels,
    elements: usize,
    mean_scaled_by_norm: bool,
) -> Model {
    let mut rng = Pcg64::seed_from_u64(9);
    let components = if channels == Channels::Mono { 1 } else { 3 };
    let values =
        (0..elements * components * size * size).map(|_| f16::from_f32(rng.random::<f32>() * 2.0 - 0.6)).collect();
    let count = points.points.len();
    let width = if channels == Channels::Mono { count } else { 3 * count };
    let matrices = (0..4 - components)
        .map(|_| {
            let first_random = if mean_scaled_by_norm { width } else { 0 };
            (0..elements * width)
                .map(|at| if at < first_random { 0.0 } else { (rng.random::<f32>() - 0.4) * 0.05 })
                .collect()
        })
        .collect();
    Model {
        asset,
        points,
        basis: Basis { size, elements, components, values: Values::Half(values), anchors: None, gamma: 1.0 },
        transfer: Transfer { channels, elements, points: count, matrices, mean_scaled_by_norm, gamma: 1.0 }.rounded(),
        scope: Some(Scope {
            kinds: vec!["point".into(), "sky".into()],
            points: count,
            weights: (0..2 * (2 * count + 1)).map(|_| rng.random::<f32>() - 0.5).collect(),
        }),
        record: TrainingRecord {
            version: String::new(),
            scene: String::new(),
            asset_hash: String::new(),
            conditions: 0,
            dropped: 0,
            prior: true,
            lambda: 0.0,
            held_out: HeldOut {
                conditions: 0,
                mean: 0.0,
                median: 0.0,
                worst: 0.0,
                oracle_mean: 0.0,
                noise: None,
                negative: 0.0,
            },
            separation: Vec::new(),
            choices: Vec::new(),
            shortages: Vec::new(),
        },
    }
}

/// The same in gamma space.
pub fn raised(mut model: Model) -> Model {
    (model.basis.gamma, model.transfer.gamma) = (2.2, 2.2);
    model
}

/// Anchors of [`local`].
pub const ANCHORS: usize = 9;

/// The room with a local basis of 8 bits and `channels_a_texel`.
pub fn local_model(channels: Channels, channels_a_texel: usize) -> Model {
    local(model(channels, ANCHORS * channels_a_texel, false), channels_a_texel)
}

/// A model of ANCHORS · `channels_a_texel` elements with a random local basis of 8 bits instead.
pub fn local(mut model: Model, channels_a_texel: usize) -> Model {
    let mut rng = Pcg64::seed_from_u64(31);
    let (size, channels) = (model.basis.size, model.transfer.channels);
    let page = size * size;
    let components = channels.components();
    let codes = (0..channels_a_texel * components * page).map(|_| rng.random_range(-127..=127)).collect();
    let indices = (0..page).map(|_| std::array::from_fn(|_| rng.random_range(0..ANCHORS as u8))).collect();
    let shares = (0..page)
        .map(|_| {
            let [a, b, c] = [(); 3].map(|_| rng.random_range(0..=85));
            [a, b, c, rng.random_range(200..=255)]
        })
        .collect();
    let anchors = Some(Anchors { count: ANCHORS, indices, shares });
    model.basis =
        Basis { size, elements: channels_a_texel, components, values: Values::Byte(codes), anchors, gamma: 1.0 };
    model
}

/// One light of each kind, shining into the room.
pub fn lights() -> Vec<Light> {
    vec![
        Light::Point {
            position: Vec3::new(0.3, 1.8, 0.4),
            color: Vec3::new(1.0, 0.9, 0.8),
            intensity: 2.0,
            range: Some(4.0),
        },
        Light::Spot {
            position: Vec3::new(-0.6, 1.5, 1.8),
            direction: Vec3::new(0.35, -0.4, -0.85).normalize(),
            color: Vec3::new(0.4, 0.6, 1.0),
            intensity: 6.0,
            range: None,
            inner_cone_angle: 0.2,
            outer_cone_angle: 0.6,
        },
        Light::Directional {
            direction: Vec3::new(-0.5, -0.7, -0.6).normalize(),
            color: Vec3::new(1.0, 0.8, 0.6),
            intensity: 0.8,
        },
    ]
}

/// The room seen through its open side.
pub fn view(width: u32, height: u32) -> View {
    let camera =
        Camera { eye: Vec3::new(0.1, 1.05, 4.2), target: Vec3::new(0.0, 0.95, 0.0), up: Vec3::Y, vertical_fov: 38.0 };
    View::new(camera, width, height)
}

/// A coefficient for each element, as random as the basis.
pub fn coefficients(elements: usize) -> Vec<Rgb> {
    let mut rng = Pcg64::seed_from_u64(21);
    (0..elements).map(|_| Rgb::new(rng.random(), rng.random(), rng.random()) - 0.3).collect()
}
