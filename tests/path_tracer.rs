//! The path tracer against closed forms.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};
use relight::light::{Emitters, Light, LightSet};
use relight::math::{Sampler, warp};
use relight::scene::{Asset, Material, Mesh, Surface, Tracer};
use relight::transport::{LightSums, Walk};

const SEED: u64 = 7;

/// Quads given by a corner and two edges; each faces edge 0 × edge 1.
fn asset_of(quads: &[[Vec3; 3]], materials: Vec<Material>, material_of: impl Fn(usize) -> u32) -> Asset {
    let mut mesh = Mesh::default();
    for (i, &[corner, e0, e1]) in quads.iter().enumerate() {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend([corner, corner + e0, corner + e0 + e1, corner + e1]);
        mesh.normals.extend([e0.cross(e1).normalize(); 4]);
        mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        mesh.triangle_materials.extend([material_of(i); 2]);
    }
    Asset { name: "test".into(), mesh, materials, textures: vec![], lights: vec![], cameras: vec![], warnings: vec![] }
}

/// The inside of a box of the given size, centred at the origin.
fn room(size: Vec3) -> Vec<[Vec3; 3]> {
    let h = size / 2.0;
    let mut quads = Vec::new();
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let axes = [Vec3::X, Vec3::Y, Vec3::Z];
            let (u, v) = (axes[(axis + 1) % 3] * size, axes[(axis + 2) % 3] * size);
            let corner = axes[axis] * h * side - (u + v) / 2.0;
            // u × v points along +axis: swap the edges on that side so that every quad faces inwards.
            quads.push(if side < 0.0 { [corner, u, v] } else { [corner, v, u] });
        }
    }
    quads
}

struct Estimate {
    mean: f64,
    sigma: f64,
}

impl Estimate {
    fn of(values: &[f64]) -> Self {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
        Self { mean, sigma: (variance / n).sqrt() }
    }

    /// Four standard errors: a true law fails once in 16,000 seeds.
    #[track_caller]
    fn assert_is(&self, expected: f64) {
        let Self { mean, sigma } = self;
        assert!(
            (mean - expected).abs() <= 4.0 * sigma + 1e-6 * expected.abs(),
            "{mean} ± {sigma}, expected {expected}"
        );
    }
}

/// A point uniform over the surface.
fn random_receiver(asset: &Asset, sampler: &mut Sampler) -> Surface {
    let areas: Vec<f32> = (0..asset.mesh.triangles.len()).map(|t| asset.mesh.triangle_cross(t).length()).collect();
    let [u0, u1, u2, _] = sampler.next_4d();
    let mut x = u0 * areas.iter().sum::<f32>();
    let triangle = areas.iter().position(|&a| {
        x -= a;
        x < 0.0
    });
    let b = warp::sample_uniform_triangle(Vec2::new(u1, u2));
    asset.surface(triangle.unwrap_or(areas.len() - 1), b.x, b.y, Vec3::ZERO)
}

/// Path-traced irradiance (direct emission, indirect emission, indirect light of `lights`) at `count` receivers.
fn irradiances(asset: &Asset, lights: &[Light], count: u32, receiver: Option<Surface>) -> [Vec<f64>; 3] {
    let tracer = Tracer::new(asset);
    let set = LightSet::new(lights);
    let emitters = Emitters::new(asset);
    let walk = Walk { tracer: &tracer, emitters: emitters.as_ref(), max_bounces: 200 };
    let mut sums = LightSums::new(&set, &tracer);
    let mut out: [Vec<f64>; 3] = Default::default();
    for i in 0..count {
        let mut sampler = Sampler::new(SEED, i as u64, 0);
        let from = receiver.unwrap_or_else(|| random_receiver(asset, &mut sampler));
        let [u0, u1, ..] = sampler.next_4d();
        sums.clear();
        walk.from_receiver(&from, Vec2::new(u0, u1), &mut sampler, &mut sums);
        out[0].push(sums.direct.emission.x as f64);
        out[1].push(sums.indirect.emission.x as f64);
        let light: f32 = sums.indirect.lights.iter().enumerate().map(|(l, &sum)| (sum * set.colour(l)).x).sum();
        out[2].push(light as f64);
    }
    out
}

fn glowing(albedo: f32, radiance: f32) -> Material {
    Material { emissive: Vec3::splat(radiance), ..Material::lambert("glowing", Vec3::splat(albedo)) }
}

/// Closed box, albedo a, uniform emission 1: radiance is 1 + a + a² + … = 1/(1−a); direct irradiance is π, so indirect is
/// π·a/(1−a).
#[test]
fn furnace_indirect_is_pi_a_over_one_minus_a() {
    for albedo in [0.0f32, 0.5, 0.8] {
        let asset = asset_of(&room(Vec3::new(1.0, 2.0, 3.0)), vec![glowing(albedo, 1.0)], |_| 0);
        let [direct, indirect, _] = irradiances(&asset, &[], 20_000, None);
        Estimate::of(&direct).assert_is(PI as f64);
        Estimate::of(&indirect).assert_is((PI * albedo / (1.0 - albedo)) as f64);
    }
}

/// A two-sided emitter fills the furnace from its back as well: the same box inside out.
#[test]
fn furnace_of_two_sided_emitters_met_from_the_back_is_the_same() {
    let outside = room(Vec3::new(1.0, 2.0, 3.0)).iter().map(|&[corner, e0, e1]| [corner, e1, e0]).collect::<Vec<_>>();
    let receiver = |asset: &Asset| asset.surface(0, 0.3, 0.3, asset.mesh.normals[0]);
    for (double_sided, expected) in [(true, PI as f64), (false, 0.0)] {
        let asset = asset_of(&outside, vec![Material { double_sided, ..glowing(0.5, 1.0) }], |_| 0);
        let [direct, ..] = irradiances(&asset, &[], 20_000, Some(receiver(&asset)));
        Estimate::of(&direct).assert_is(expected);
    }
}

/// The control: a box with a hole in it is darker than the furnace.
#[test]
fn furnace_with_an_open_side_is_darker() {
    let asset = asset_of(&room(Vec3::ONE)[..5], vec![glowing(0.5, 1.0)], |_| 0);
    let [direct, ..] = irradiances(&asset, &[], 20_000, None);
    let estimate = Estimate::of(&direct);
    assert!(estimate.mean + 10.0 * estimate.sigma < PI as f64);
}

/// In any closed room of uniform albedo a, what is absorbed is what the light emits: (1−a) ∫E dA = Φ. The direct part of ∫E dA
/// is Φ itself, so the indirect part is Φ·a/(1−a); for a point light of I candela Φ = 4πI.
#[test]
fn indirect_flux_in_a_closed_room_is_a_over_one_minus_a_of_the_light() {
    let size = Vec3::new(2.0, 1.0, 3.0);
    let area = 2.0 * (size.x * size.y + size.y * size.z + size.z * size.x);
    for albedo in [0.3f32, 0.7] {
        let asset = asset_of(&room(size), vec![Material::lambert("white", Vec3::splat(albedo))], |_| 0);
        let light = Light::Point { position: Vec3::new(0.3, -0.1, 0.5), color: Vec3::ONE, intensity: 2.0, range: None };
        let [.., indirect] = irradiances(&asset, &[light], 100_000, None);
        let flux: Vec<f64> = indirect.iter().map(|e| e * area as f64).collect();
        Estimate::of(&flux).assert_is((4.0 * PI * 2.0 * albedo / (1.0 - albedo)) as f64);
    }
}

/// The same for a spot light with a hard edge, whose flux is 2πI(1 − cos θ).
#[test]
fn indirect_flux_of_a_hard_spot_is_that_of_its_cone() {
    let asset = asset_of(&room(Vec3::ONE * 2.0), vec![Material::lambert("white", Vec3::splat(0.5))], |_| 0);
    let outer = 0.6f32;
    let light = Light::Spot {
        position: Vec3::new(0.1, 0.2, 0.3),
        direction: Vec3::new(1.0, 2.0, -1.0).normalize(),
        color: Vec3::ONE,
        intensity: 3.0,
        range: None,
        inner_cone_angle: outer,
        outer_cone_angle: outer,
    };
    let [.., indirect] = irradiances(&asset, &[light], 200_000, None);
    let flux: Vec<f64> = indirect.iter().map(|e| e * 24.0).collect();
    Estimate::of(&flux).assert_is((2.0 * PI * 3.0 * (1.0 - outer.cos())) as f64);
}

/// Two infinite parallel plates of albedo a, the lower one glowing with radiance 1, so that the upper one receives π directly.
/// What the upper one reflects and the lower one reflects again arrives there as π·a² + π·a⁴ + … = π·a²/(1−a²); the lower one
/// receives π·a + π·a³ + … = π·a/(1−a²). Squares of half-width w at distance h fall short of infinite plates by a view factor
/// of at most h²/(h² + w²), 2.5e-5 here, well inside the tolerance.
#[test]
fn two_parallel_plates_exchange_a_geometric_series() {
    let (albedo, w, h) = (0.6f32, 200.0, 1.0);
    let lower = [Vec3::new(-w, 0.0, w), Vec3::X * 2.0 * w, Vec3::NEG_Z * 2.0 * w];
    let upper = [Vec3::new(-w, h, -w), Vec3::X * 2.0 * w, Vec3::Z * 2.0 * w];
    let materials = vec![glowing(albedo, 1.0), Material::lambert("white", Vec3::splat(albedo))];
    let asset = asset_of(&[lower, upper], materials, |quad| quad as u32);
    // At the centre of each plate.
    let below = asset.surface(0, 0.0, 0.5, Vec3::ZERO);
    let above = asset.surface(2, 0.0, 0.5, Vec3::ZERO);
    let emitted = PI as f64;
    let (a, a2) = (albedo as f64, (albedo * albedo) as f64);
    let [direct, indirect, _] = irradiances(&asset, &[], 200_000, Some(above));
    Estimate::of(&direct).assert_is(emitted);
    Estimate::of(&indirect).assert_is(emitted * a2 / (1.0 - a2));
    let [_, indirect, _] = irradiances(&asset, &[], 200_000, Some(below));
    Estimate::of(&indirect).assert_is(emitted * a / (1.0 - a2));
}

/// Packets of shadow rays, the tree and the whole-mesh test see the same occlusion.
#[test]
fn packets_agree_with_single_rays_on_a_mesh_of_either_size() {
    use relight::math::LANES;
    for boxes in [2usize, 60] {
        let mut quads = Vec::new();
        for i in 0..boxes {
            let mut sampler = Sampler::new(SEED, i as u64, 9);
            let [x, y, z, s] = sampler.next_4d();
            let centre = Vec3::new(x, y, z) * 10.0;
            quads.extend(room(Vec3::splat(0.3 + s)).iter().map(|&[c, e0, e1]| [c + centre, e0, e1]));
        }
        let asset = asset_of(&quads, vec![Material::lambert("white", Vec3::ONE)], |_| 0);
        let tracer = Tracer::new(&asset);
        let mut shadows = tracer.shadow_rays(None);
        let mut hidden = 0;
        for i in 0..500u64 {
            let mut sampler = Sampler::new(SEED, i, 3);
            let point = |u: [f32; 4]| Vec3::new(u[0], u[1], u[2]) * 10.0;
            let origin = point(sampler.next_4d());
            let mut segments = [[0.0; LANES]; 3];
            let mut expected = 0u32;
            for lane in 0..LANES {
                let segment = point(sampler.next_4d()) - origin;
                (0..3).for_each(|axis| segments[axis][lane] = segment[axis]);
                expected |= u32::from(!tracer.occluded(origin, segment)) << lane;
            }
            shadows.start_from(origin);
            let active = 0xffff;
            assert_eq!(shadows.unoccluded(&segments, active), expected, "{boxes} boxes, origin {origin}");
            hidden += (active & !expected).count_ones();
        }
        assert!(hidden > 100 && hidden < 7900, "the test needs both kinds: {hidden} of 8000 hidden");
    }
}
