//! The tree against the whole-mesh test, and both against what is known.

use glam::{Mat3, Vec2, Vec3};

use super::pieces::Pieces;
use super::{SEGMENT_END, Search, Segments, Tracer};
use crate::math::{LANES, Sampler, warp};
use crate::scene::{Asset, Hit, Material, Mesh, Texture, TextureRef, Wrap};

fn asset(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Asset {
    let mesh = Mesh {
        normals: vec![Vec3::Y; positions.len()],
        triangle_materials: vec![0; triangles.len()],
        positions,
        triangles,
        ..Mesh::default()
    };
    let materials = vec![Material::lambert("grey", Vec3::splat(0.5))];
    Asset { name: "test".into(), mesh, materials, textures: vec![], lights: vec![], cameras: vec![], warnings: vec![] }
}

/// Points, directions and numbers, one after the other.
struct Random(Sampler);

impl Random {
    fn new(seed: u64) -> Self {
        Self(Sampler::new(seed, 0, 0))
    }

    fn four(&mut self) -> [f32; 4] {
        self.0.next_4d()
    }

    /// In [−1, 1]³.
    fn point(&mut self) -> Vec3 {
        let [x, y, z, _] = self.four();
        Vec3::new(x, y, z) * 2.0 - 1.0
    }
}

/// Triangles of all sorts in [−1, 1]³: large, tiny, slivers, without area, in the planes of the axes, twice the same, and a
/// grid of boxes, whose faces share planes and edges.
fn soup(random: &mut Random, count: usize) -> Vec<[Vec3; 3]> {
    let mut triangles: Vec<[Vec3; 3]> = Vec::new();
    while triangles.len() < count {
        let (at, [kind, size, ..]) = (random.point(), random.four());
        let edge = |random: &mut Random, size: f32| random.point() * size;
        let (e, f) = (edge(random, size * 0.5), edge(random, size * 0.5));
        triangles.push(match (kind * 12.0) as u32 {
            0 if size < 0.3 => [at, random.point(), random.point()],
            1 => [at, at + e * 1e-4, at + f * 1e-4],
            2 => [at, at + e, at + e * 0.5 + f * 1e-5],
            3 => [at, at + e, at + e],
            4 => [at, at + e * Vec3::new(1.0, 0.0, 1.0), at + f * Vec3::new(1.0, 0.0, 1.0)],
            5 if !triangles.is_empty() => triangles[triangles.len() / 2],
            _ => [at, at + e * 0.2, at + f * 0.2],
        });
    }
    triangles
}

/// A rounded position of a lattice, for what happens on edges and in planes.
fn snapped(p: Vec3) -> Vec3 {
    (p * 4.0).round() / 4.0
}

/// Rays of all sorts: from anywhere, from far away, along axes, towards and from corners, in the planes of boxes.
fn ray(random: &mut Random, triangles: &[[Vec3; 3]], scale: f32, shift: Vec3) -> (Vec3, Vec3) {
    let [kind, which, corner, _] = random.four();
    let vertex = triangles[(which * triangles.len() as f32) as usize % triangles.len()][(corner * 3.0) as usize % 3];
    let (p, q) = (random.point() * scale + shift, random.point() * scale + shift);
    let snapped = |p: Vec3| snapped((p - shift) / scale) * scale + shift;
    match (kind * 8.0) as u32 {
        0 => (p + (p - q) * 30.0, (q - p) * 31.0),
        1 => (p, Vec3::AXES[(which * 3.0) as usize % 3] * (corner - 0.5)),
        2 => (snapped(p), Vec3::AXES[(which * 3.0) as usize % 3]),
        3 => (snapped(p), snapped(q) - snapped(p)),
        4 => (p, vertex - p),
        5 => (vertex, p - vertex),
        _ => (p, q - p),
    }
}

/// By how much t of a hit may round, in f64 from the hit's plane.
fn rounding(asset: &Asset, hit: &Hit, origin: Vec3, direction: Vec3) -> f64 {
    let [a, b, c] = asset.mesh.triangle_positions(hit.triangle as usize).map(Vec3::as_dvec3);
    let size = asset.mesh.positions.iter().fold(0.0, |size: f32, p| size.max(p.length()));
    let slope = (b - a).cross(c - a).normalize().dot(direction.as_dvec3()).abs();
    f64::from(16.0 * f32::EPSILON * (origin.length() + size)) / slope
}

/// How far the point that a hit's barycentric coordinates name is from the ray's at t, in units of t.
fn apart(asset: &Asset, hit: &Hit, origin: Vec3, direction: Vec3) -> f64 {
    let [a, b, c] = asset.mesh.triangle_positions(hit.triangle as usize).map(Vec3::as_dvec3);
    let (u, v) = (f64::from(hit.u), f64::from(hit.v));
    let on_ray = origin.as_dvec3() + direction.as_dvec3() * f64::from(hit.t);
    (a * (1.0 - u - v) + b * u + c * v).distance(on_ray) / direction.as_dvec3().length()
}

/// The hits are the same to within rounding, whatever the size of the scene; where there is none, both say so.
#[test]
fn the_tree_finds_what_the_whole_mesh_test_finds() {
    for (seed, scale, shift) in [(1, 1.0, 0.0), (2, 1e-6, 0.0), (3, 1e6, 0.0), (4, 1.0, 300.0)] {
        let mut random = Random::new(seed);
        let mut triangles = soup(&mut random, 250);
        triangles.extend(boxes(2));
        triangles.iter_mut().flatten().for_each(|v| *v = *v * scale + Vec3::splat(shift));
        let indices = (0..triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let asset = asset(triangles.concat(), indices);
        let [brute, tree] = [Search::Brute, Search::Tree].map(|search| Tracer::with_search(&asset, search));
        let (mut hits, mut hidden, mut apart_by_bits, mut in_plane) = (0, 0, 0, 0);
        const RAYS: usize = 60_000;
        for _ in 0..RAYS {
            let (origin, direction) = ray(&mut random, &triangles, scale, Vec3::splat(shift));
            let hit = brute.closest_hit(origin, direction, f32::INFINITY);
            let through = tree.closest_hit(origin, direction, f32::INFINITY);
            let within = |hit: &Hit| rounding(&asset, hit, origin, direction);
            // Who starts in a triangle's plane may hit it.
            if [hit, through].iter().flatten().any(|hit| f64::from(hit.t) <= within(hit)) {
                in_plane += 1;
                continue;
            }
            assert_eq!(hit.is_some(), through.is_some(), "{scale}: {origin} {direction}");
            let occluded = brute.occluded(origin, direction);
            assert_eq!(tree.occluded(origin, direction), occluded, "{scale}: {origin} {direction}");
            // Control: occlusion is a hit before the segment's end.
            assert_eq!(brute.closest_hit(origin, direction, SEGMENT_END).is_some(), occluded);
            for (hit, through) in hit.iter().zip(&through) {
                let off = f64::from(hit.t - through.t).abs();
                assert!(off <= within(hit) + within(through), "{scale}: {origin} {direction}: {hit:?}, {through:?}");
                let off = apart(&asset, hit, origin, direction);
                assert!(hit == through || off <= 4.0 * within(hit), "{scale}: {origin} {direction}: {hit:?} {off}");
                apart_by_bits += usize::from(hit != through);
            }
            hits += usize::from(hit.is_some());
            hidden += usize::from(occluded);
        }
        // Control: they do round differently, and most rays are held against each other.
        assert!(
            apart_by_bits > hits / 4 && in_plane < RAYS / 10,
            "{scale}: {apart_by_bits} differ, {in_plane} in a plane"
        );
        assert!(hits > RAYS / 4 && hits < RAYS, "{scale}: {hits} rays hit");
        assert!(hidden > RAYS / 20 && hidden < RAYS * 19 / 20, "{scale}: {hidden} segments hidden");
    }
}

/// `side`³ boxes that touch, on a lattice in [−1, 1]³.
fn boxes(side: usize) -> Vec<[Vec3; 3]> {
    let mut triangles = Vec::new();
    let cell = 2.0 / side as f32;
    for (i, j, k) in (0..side).flat_map(|i| (0..side).flat_map(move |j| (0..side).map(move |k| (i, j, k)))) {
        if (i + j + k) % 2 == 0 {
            let low = Vec3::new(i as f32, j as f32, k as f32) * cell - 1.0;
            for axis in 0..3 {
                let [n, u, v] =
                    [Vec3::AXES[axis], Vec3::AXES[(axis + 1) % 3], Vec3::AXES[(axis + 2) % 3]].map(|a| a * cell);
                for at in [low, low + n] {
                    triangles.extend([[at, at + u, at + u + v], [at, at + u + v, at + v]]);
                }
            }
        }
    }
    triangles
}

/// A turned square of 2·`side`² triangles, of which no two make a parallelogram: in one plane but for what their corners round.
fn tiles(random: &mut Random, side: usize) -> Vec<[Vec3; 3]> {
    let turn = Mat3::from_rotation_x(0.7) * Mat3::from_rotation_y(0.4);
    let corners: Vec<Vec3> = (0..(side + 1) * (side + 1))
        .map(|i| Vec3::new((i % (side + 1)) as f32, 0.0, (i / (side + 1)) as f32) * (2.0 / side as f32) - 1.0)
        .map(|at| turn * (at + random.point() * Vec3::new(0.2, 0.0, 0.2) / side as f32) + 0.3)
        .collect();
    let cell = |i: usize| [0, 1, side + 1, side + 2].map(|step| corners[i / side * (side + 1) + i % side + step]);
    (0..side * side).map(cell).flat_map(|[a, b, c, d]| [[a, b, d], [a, d, c]]).collect()
}

/// Coplanar pieces are met as one plane, to within what corners round.
#[test]
fn tiles_lie_in_one_plane() {
    let tiles = tiles(&mut Random::new(3), 4);
    assert_eq!(Pieces::new(&tiles, |_| true).planes(), 1);
    let bent: Vec<_> = tiles.iter().map(|t| t.map(|corner| corner + 1e-4 * corner.x * corner.x)).collect();
    assert!(Pieces::new(&bent, |_| true).planes() > 20, "a control");
}

/// Materials that cut out where alpha is low beside opaque ones: closest hits, segments and packets see what f64 tells of each
/// triangle by itself.
#[test]
fn what_is_cut_out_is_neither_hit_nor_hides() {
    let mut random = Random::new(11);
    let triangles: Vec<[Vec3; 3]> = (0..150)
        .map(|_| {
            let at = random.point();
            [at, at + random.point() * 0.5, at + random.point() * 0.5]
        })
        .collect();
    let indices = (0..triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let mut asset = asset(triangles.concat(), indices);
    // A ramp from clear to opaque: what lies left of the middle is cut out.
    let ramp = Texture {
        name: "ramp".into(),
        width: 2,
        height: 1,
        texels: vec![[255, 255, 255, 0], [255; 4]],
        srgb: false,
        wrap: [Wrap::Clamp; 2],
    };
    asset.textures.push(ramp);
    let texture = Some(TextureRef { texture: 0, uv_set: 0, transform: Mat3::IDENTITY });
    let leaf = Material { alpha_cutoff: Some(0.5), base_colour_texture: texture, ..asset.materials[0].clone() };
    asset.materials.push(leaf);
    asset.mesh.triangle_materials.iter_mut().step_by(2).for_each(|material| *material = 1);
    asset.mesh.uvs[0] = (0..asset.mesh.positions.len()).map(|_| Vec2::new(random.four()[0], 0.5)).collect();
    // Where the ray meets triangle t, and whether there is something; None where it is too close to tell.
    let met = |t: usize, origin: Vec3, segment: Vec3| -> Option<(f64, bool)> {
        let [a, b, c] = triangles[t].map(Vec3::as_dvec3);
        let (origin, segment) = (origin.as_dvec3(), segment.as_dvec3());
        let normal = (b - a).cross(c - a);
        let distance = normal.dot(a - origin) / normal.dot(segment);
        let at = origin + segment * distance;
        let v = (b - a).cross(at - a).dot(normal) / normal.length_squared();
        let u = (at - a).cross(c - a).dot(normal) / normal.length_squared();
        let corners = [0, 1, 2].map(|i| f64::from(asset.mesh.uvs[0][3 * t + i].x));
        let right = corners[0] * (1.0 - u - v) + corners[1] * u + corners[2] * v - 0.5;
        let inside = u.min(v).min(1.0 - u - v);
        let near_a_bound = [inside, right, distance, distance - 1.0].iter().any(|value| value.abs() < 1e-4);
        let solid = asset.mesh.triangle_materials[t] == 0 || right > 0.0;
        (!near_a_bound).then_some((distance, inside > 0.0 && solid))
    };
    for search in [Search::Brute, Search::Tree] {
        let tracer = Tracer::with_search(&asset, search);
        let mut shadows = tracer.shadow_rays(None);
        let (mut told, mut hidden, mut through) = (0, 0, 0);
        for _ in 0..1_000 {
            let origin = random.point() * 1.5;
            shadows.start_from(origin);
            let ends: [Vec3; LANES] = std::array::from_fn(|_| random.point() * 1.5);
            let segments: Segments = [0, 1, 2].map(|axis| ends.map(|end| (end - origin)[axis]));
            let open = shadows.unoccluded(&segments, 0xffff);
            for (lane, end) in ends.into_iter().enumerate() {
                let segment = end - origin;
                let all: Option<Vec<(f64, bool)>> = (0..triangles.len()).map(|t| met(t, origin, segment)).collect();
                let Some(all) = all else { continue };
                let ahead = all.iter().filter(|(t, there)| *there && *t > 0.0).map(|(t, _)| *t);
                let nearest = ahead.fold(f64::INFINITY, f64::min);
                let hit = tracer.closest_hit(origin, segment, f32::INFINITY);
                assert_eq!(hit.is_some(), nearest.is_finite(), "{search:?}: {origin} {segment}");
                if let Some(hit) = hit {
                    assert!((f64::from(hit.t) - nearest).abs() < 1e-3, "{search:?}: {origin} {segment}");
                }
                assert_eq!(tracer.occluded(origin, segment), nearest < 1.0, "{search:?}: {origin} {segment}");
                assert_eq!(open >> lane & 1 == 0, nearest < 1.0, "{search:?}: {origin} {segment}, in a packet");
                told += 1;
                hidden += usize::from(nearest < 1.0);
                let opaque = |t: usize| tracer.asset().mesh.triangle_materials[t] == 0;
                through += usize::from(hit.is_some_and(|hit| !opaque(hit.triangle as usize)));
            }
        }
        // Control: most rays are told, of both sorts, and many end on what is left of a masked triangle.
        assert!(told > 8_000 && hidden > told / 10 && hidden < told * 9 / 10, "{hidden} of {told} are hidden");
        assert!(through > told / 20, "{through} of {told} end on masked triangles");
    }
}

/// From one origin, packets see the same through the tree as through the whole mesh, whole packets and parts.
#[test]
fn packets_see_the_same_through_the_tree() {
    let mut random = Random::new(7);
    let mut triangles = soup(&mut random, 150);
    triangles.extend(boxes(3));
    let indices = (0..triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let asset = asset(triangles.concat(), indices);
    let [brute, tree] = [Search::Brute, Search::Tree].map(|search| Tracer::with_search(&asset, search));
    let bounds = asset.mesh.bounds();
    let targets = super::Aabb { min: bounds.min * 2.0, max: bounds.max * 2.0 };
    let (mut all, mut near) = (brute.shadow_rays(None), brute.shadow_rays(Some(targets)));
    let mut through = tree.shadow_rays(None);
    let mut open = 0;
    const ORIGINS: usize = 4_000;
    for _ in 0..ORIGINS {
        let origin = random.point();
        [&mut all, &mut near, &mut through].into_iter().for_each(|shadows| shadows.start_from(origin));
        let ends: [Vec3; LANES] = std::array::from_fn(|_| random.point() * 1.9);
        let segments: Segments = [0, 1, 2].map(|axis| ends.map(|end| (end - origin)[axis]));
        let one_by_one =
            (0..LANES).filter(|&i| !tree.occluded(origin, ends[i] - origin)).fold(0, |mask, i| mask | 1 << i);
        for active in [0x0100, 0xffff, 0x0ff0, 0x8003] {
            let expected = all.unoccluded(&segments, active);
            assert_eq!(through.unoccluded(&segments, active), expected, "from {origin}");
            assert_eq!(expected, one_by_one & active, "from {origin}, one by one");
            assert_eq!(near.unoccluded(&segments, active), expected, "from {origin}, fewer triangles");
            open += expected.count_ones() as usize;
        }
    }
    let cast = ORIGINS * (1 + 16 + 8 + 3);
    assert!(open > cast / 20 && open < cast * 19 / 20, "{open} of {cast} are open");
}

/// Rays of their own origins hit together what each hits by itself, to within rounding, and the same bits in any company.
#[test]
fn rays_hit_together_what_they_hit_alone() {
    let mut random = Random::new(13);
    let mut triangles = soup(&mut random, 60);
    triangles.extend(boxes(2));
    triangles.extend(tiles(&mut random, 4));
    let indices = (0..triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let asset = asset(triangles.concat(), indices);
    for search in [Search::Brute, Search::Tree] {
        let tracer = Tracer::with_search(&asset, search);
        let (mut met, mut missed) = (0, 0);
        for _ in 0..3_000 {
            let rays: [(Vec3, Vec3); LANES] =
                std::array::from_fn(|_| ray(&mut random, &triangles, 1.0, Vec3::splat(0.0)));
            let origins: Segments = [0, 1, 2].map(|axis| rays.map(|(origin, _)| origin[axis]));
            let directions: Segments = [0, 1, 2].map(|axis| rays.map(|(_, direction)| direction[axis]));
            let together = tracer.closest_hits(&origins, &directions, 0xffff);
            for (i, (origin, direction)) in rays.into_iter().enumerate() {
                let others = tracer.closest_hits(&origins, &directions, 1 << i);
                assert_eq!(others.hit, together.hit & 1 << i);
                let alone = tracer.closest_hit(origin, direction, f32::INFINITY);
                let hit = (together.hit >> i & 1 != 0).then(|| together.get(i));
                let within = |hit: &Hit| rounding(&asset, hit, origin, direction);
                // Who starts in a triangle's plane may hit it.
                if [hit, alone].iter().flatten().any(|hit| f64::from(hit.t) <= within(hit)) {
                    continue;
                }
                assert_eq!(hit.is_some(), alone.is_some(), "{origin} {direction}");
                missed += usize::from(hit.is_none());
                if let (Some(hit), Some(alone)) = (hit, alone) {
                    assert_eq!(others.get(i), hit, "alone in its packet");
                    let off = f64::from(hit.t - alone.t).abs();
                    assert!(off <= within(&hit) + within(&alone), "{origin} {direction}: {hit:?}, {alone:?}");
                    assert!(hit == alone || apart(&asset, &hit, origin, direction) <= 4.0 * within(&hit));
                    met += 1;
                }
            }
        }
        assert!(met > 10_000 && missed > 1_000, "{search:?}: {met} rays hit, {missed} do not");
    }
}

/// From inside a closed surface every ray hits, also through its vertices and edges; through a surface with a triangle missing
/// some do not.
#[test]
fn no_ray_slips_between_triangles() {
    let turn = Mat3::from_rotation_y(0.7) * Mat3::from_rotation_x(0.4);
    const ROWS: u32 = 24;
    let at = |row: u32, column: u32| {
        let (theta, phi) =
            (std::f32::consts::PI * row as f32 / ROWS as f32, std::f32::consts::TAU * column as f32 / 32.0);
        turn * Vec3::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin())
    };
    // The rows' last vertices are their first, and the poles are one vertex each.
    let vertex = |row: u32, column: u32| match row {
        0 => 0,
        ROWS => 1,
        row => 2 + (row - 1) * 32 + column % 32,
    };
    let mut positions = vec![at(0, 0), at(ROWS, 0)];
    (1..ROWS).for_each(|row| positions.extend((0..32).map(|column| at(row, column))));
    let mut triangles = Vec::new();
    for (row, column) in (0..ROWS).flat_map(|row| (0..32).map(move |column| (row, column))) {
        let [a, b] = [vertex(row, column), vertex(row, column + 1)];
        let [c, d] = [vertex(row + 1, column), vertex(row + 1, column + 1)];
        triangles.extend([[a, b, d], [a, d, c]].into_iter().filter(|t| t[0] != t[1] && t[1] != t[2]));
    }
    let missed = |asset: &Asset, search: Search| {
        let tracer = Tracer::with_search(asset, search);
        let mut shadows = tracer.shadow_rays(None);
        let mut random = Random::new(11);
        let mut missed = [0; 3];
        for i in 0..6_000 {
            let origin = random.point() * 0.5;
            let [which, weight, u, v] = random.four();
            let [a, b, _] = asset.mesh.triangle_positions((which * asset.mesh.triangles.len() as f32) as usize);
            let direction = match i % 3 {
                0 => a - origin,
                1 => a.lerp(b, weight) - origin,
                _ => warp::sample_uniform_sphere(glam::Vec2::new(u, v)),
            };
            missed[0] += usize::from(tracer.closest_hit(origin, direction, f32::INFINITY).is_none());
            shadows.start_from(origin);
            let segments: Segments = [0, 1, 2].map(|axis| [direction[axis] * 9.0; LANES]);
            missed[1] += shadows.unoccluded(&segments, 0xffff).count_ones() as usize;
            let origins: Segments = [0, 1, 2].map(|axis| [origin[axis]; LANES]);
            missed[2] += LANES - tracer.closest_hits(&origins, &segments, 0xffff).hit.count_ones() as usize;
        }
        missed
    };
    for search in [Search::Brute, Search::Tree] {
        let closed = asset(positions.clone(), triangles.clone());
        assert_eq!(missed(&closed, search), [0; 3], "{search:?}");
        let open = asset(positions.clone(), triangles[1..].to_vec());
        assert!(missed(&open, search).iter().all(|&count| count > 0), "{search:?}: the control is closed, too");
    }
}

/// Nothing to hit is no hit, and no panic.
#[test]
fn meshes_of_nothing_are_never_hit() {
    let point = asset(vec![Vec3::ONE; 3], vec![[0, 1, 2]; 100]);
    for asset in [asset(vec![], vec![]), point] {
        for search in [Search::Brute, Search::Tree] {
            let tracer = Tracer::with_search(&asset, search);
            assert_eq!(tracer.closest_hit(Vec3::ZERO, Vec3::ONE, f32::INFINITY), None);
            assert!(!tracer.occluded(Vec3::ZERO, Vec3::ONE * 2.0));
            let mut shadows = tracer.shadow_rays(None);
            shadows.start_from(Vec3::ZERO);
            assert_eq!(shadows.unoccluded(&[[2.0; LANES]; 3], 0xffff), 0xffff);
        }
    }
}
