//! Draws lighting conditions from a [`Scenario`].

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::scenario::{Aim, Color, Kind, Position, Scenario, ScenarioError, Sky as Directions};
use super::{EmissionFacets, EnvironmentError, EnvironmentImage, EnvironmentImages, Light, LightingCondition, Sky};
use crate::math::colour::luminance;
use crate::math::sampler::mix64;
use crate::math::{Rgb, warp};
use crate::scene::proximity::Proximity;
use crate::scene::{Aabb, Tracer};

/// Positions drawn for one light before the scenario is called impossible.
const MOST_TRIES: u32 = 10_000;

/// Default clearance, as a fraction of the asset's extent.
const CLEARANCE: f32 = 0.05;

/// Draws conditions for one asset.
pub struct ScenarioSampler<'t, 'a> {
    scenario: Scenario,
    tracer: &'t Tracer<'a>,
    proximity: Proximity,
    bounds: Aabb,
    clearance: f32,
    /// Candela.
    intensity: [f32; 2],
    /// Metres.
    size: [f32; 2],
    /// With the illuminance of each on a level surface under a mean sky of the same radiance.
    environments: Vec<(EnvironmentImage, f32)>,
    /// `cumulative[t]`: area of the triangles 0..=t.
    cumulative_area: Vec<f64>,
}

impl Scenario {
    /// Readies the scenario for an asset.
    ///
    /// # Errors
    /// [`ScenarioError`]: a setting out of range, an environment that cannot be read, an asset without area, or without
    /// emission where that is asked for.
    pub fn sampler<'t, 'a>(&self, tracer: &'t Tracer<'a>) -> Result<ScenarioSampler<'t, 'a>, ScenarioError> {
        self.validate()?;
        let mesh = &tracer.asset().mesh;
        let mut total = 0.0;
        let cumulative_area: Vec<f64> = (0..mesh.triangles.len())
            .map(|t| {
                total += 0.5 * mesh.triangle_cross(t).length() as f64;
                total
            })
            .collect();
        if !total.is_finite() || total <= 0.0 {
            return Err(ScenarioError::NoSurface);
        }
        if self.kinds.emissive > 0.0 && EmissionFacets::of(tracer.asset()).0.is_empty() {
            return Err(ScenarioError::NothingEmits);
        }
        let mut images = EnvironmentImages::default();
        let wanted = if self.kinds.environment > 0.0 { &self.environments[..] } else { &[] };
        let environments = wanted
            .iter()
            .map(|path| {
                let image = images.read(path)?;
                let mean = PI * luminance(image.map().mean());
                Ok((image, mean))
            })
            .collect::<Result<_, EnvironmentError>>()?;
        // π lux at half the extent, so that a white surface there has a radiance of about 1.
        let usual = PI * (0.5 * tracer.extent).powi(2);
        Ok(ScenarioSampler {
            tracer,
            proximity: Proximity::new(mesh),
            bounds: mesh.bounds(),
            clearance: self.clearance.unwrap_or(CLEARANCE * tracer.extent),
            intensity: self.intensity.unwrap_or([0.5 * usual, 2.0 * usual]),
            size: self.size.unwrap_or([0.05 * tracer.extent, 0.2 * tracer.extent]),
            environments,
            cumulative_area,
            scenario: self.clone(),
        })
    }
}

impl ScenarioSampler<'_, '_> {
    /// Condition `index` of the run that `seed` names. It depends on these two alone, so that a set of conditions can grow.
    ///
    /// # Errors
    /// [`ScenarioError::NoRoom`] when no position far enough from the surface was found.
    pub fn condition(&self, seed: u64, index: u32) -> Result<LightingCondition, ScenarioError> {
        let mut random = Random(Pcg64Mcg::seed_from_u64(mix64(mix64(seed) ^ index as u64)));
        let [fewest, most] = self.scenario.lights_per_condition;
        let count = fewest + ((most - fewest + 1) as f32 * random.unit()) as u32;
        let lights = (0..count).map(|_| self.light(&mut random)).collect::<Result<_, _>>()?;
        Ok(LightingCondition { lights })
    }

    /// The first `count` conditions.
    ///
    /// # Errors
    /// As [`ScenarioSampler::condition`].
    pub fn conditions(&self, seed: u64, count: u32) -> Result<Vec<LightingCondition>, ScenarioError> {
        (0..count).map(|index| self.condition(seed, index)).collect()
    }

    fn light(&self, random: &mut Random) -> Result<Light, ScenarioError> {
        let kind = self.kind(random);
        let color = self.color(random);
        let scenario = &self.scenario;
        match kind {
            Kind::Directional => {
                let from = warp::sample_uniform_sphere(random.square());
                let from = if scenario.sky == Directions::Above { from.with_y(from.y.abs()) } else { from };
                let intensity = random.log_uniform(scenario.illuminance);
                return Ok(Light::Directional { direction: -from, color, intensity });
            }
            Kind::Environment => {
                let choice = (random.unit() * self.environments.len() as f32) as usize;
                let (image, mean) = &self.environments[choice.min(self.environments.len() - 1)];
                let rotation = random.within([0.0, TAU]);
                let intensity = random.log_uniform(scenario.illuminance) / mean;
                return Ok(Light::Environment { image: image.clone(), rotation, color, intensity });
            }
            Kind::Sky => {
                let mut sky = Sky {
                    sun_azimuth: random.within([0.0, TAU]),
                    turbidity: random.within(scenario.turbidity),
                    ground_albedo: random.within(scenario.ground_albedo),
                    color,
                    ..Sky::at(random.within(scenario.sun_elevation))
                };
                sky.intensity = random.log_uniform(scenario.illuminance) / luminance(sky.illuminance());
                return Ok(Light::Sky(sky));
            }
            Kind::Emissive => return Ok(Light::Emissive { scale: random.log_uniform(scenario.emission) }),
            Kind::Point | Kind::Spot | Kind::Rect | Kind::Disk | Kind::Sphere => {}
        }
        let position = self.position(random)?;
        let intensity = random.log_uniform(self.intensity);
        if kind == Kind::Point {
            return Ok(Light::Point { position, color, intensity, range: None });
        }
        if kind == Kind::Spot {
            let outer_cone_angle = random.within(scenario.outer_cone_angle);
            let inner_cone_angle = outer_cone_angle * random.within(scenario.inner_cone);
            let direction = self.direction(position, random);
            return Ok(Light::Spot {
                position,
                direction,
                color,
                intensity,
                range: None,
                inner_cone_angle,
                outer_cone_angle,
            });
        }
        let size = [random.log_uniform(self.size), random.log_uniform(self.size)];
        let radius = 0.5 * size[0];
        let disk_area = PI * radius * radius;
        Ok(match kind {
            Kind::Sphere => Light::Sphere { position, radius, color, radiance: intensity / disk_area },
            Kind::Disk => {
                let direction = self.direction(position, random);
                Light::Disk { position, direction, radius, color, radiance: intensity / disk_area }
            }
            _ => {
                let direction = self.direction(position, random);
                let up = warp::sample_uniform_sphere(random.square());
                Light::Rect { position, direction, up, size, color, radiance: intensity / (size[0] * size[1]) }
            }
        })
    }

    fn kind(&self, random: &mut Random) -> Kind {
        let kinds = self.scenario.kinds.all();
        let mut rest = random.unit() * kinds.iter().map(|(_, weight)| weight).sum::<f32>();
        let drawn = kinds.iter().find(|&&(_, weight)| {
            rest -= weight;
            rest < 0.0
        });
        // Rounding may leave a rest: then it is the last kind of any weight.
        drawn.or_else(|| kinds.iter().rfind(|(_, weight)| *weight > 0.0)).map_or(Kind::Spot, |&(kind, _)| kind)
    }

    fn color(&self, random: &mut Random) -> Rgb {
        match self.scenario.color {
            Color::White => Vec3::ONE,
            Color::Random { hue, saturation } => {
                let (hue, saturation) = (random.within(hue), random.within(saturation));
                // From hue and saturation at value 1 (Smith, *Color Gamut Transform Pairs*, 1978).
                let pure = |offset: f32| (((hue + offset).fract() * 6.0 - 3.0).abs() - 1.0).clamp(0.0, 1.0);
                let pure = Vec3::new(pure(0.0), pure(2.0 / 3.0), pure(1.0 / 3.0));
                Vec3::ONE.lerp(pure, saturation)
            }
        }
    }

    /// A position with clearance, in the open.
    fn position(&self, random: &mut Random) -> Result<Vec3, ScenarioError> {
        let (mut too_near, mut inside_solid) = (0, 0);
        for _ in 0..MOST_TRIES {
            let position = match self.scenario.position {
                Position::Near => {
                    let grown = Vec3::splat(0.5 * self.tracer.extent);
                    random.in_box(self.bounds.min - grown.with_y(0.0), self.bounds.max + grown)
                }
                Position::Inside => random.in_box(self.bounds.min, self.bounds.max),
                Position::Box { min, max } => random.in_box(min, max),
                Position::Around { radius: [low, high], above } => {
                    // Uniform by volume: the cube of the radius is uniform.
                    let radius = random.within([low.powi(3), high.powi(3)]).cbrt() * 0.5 * self.bounds.diagonal();
                    let out = warp::sample_uniform_sphere(random.square());
                    let out = if above { out.with_y(out.y.abs()) } else { out };
                    self.bounds.centre() + out * radius
                }
            };
            if self.proximity.distance(position, self.clearance) < self.clearance {
                too_near += 1;
            } else if self.is_inside_solid(position) {
                inside_solid += 1;
            } else {
                return Ok(position);
            }
        }
        Err(ScenarioError::NoRoom {
            tries: MOST_TRIES,
            position: match self.scenario.position {
                Position::Near => format!("near the bounds {} to {}", self.bounds.min, self.bounds.max),
                Position::Inside => format!("inside the bounds {} to {}", self.bounds.min, self.bounds.max),
                Position::Around { radius: [low, high], .. } => format!("around, radius {low} to {high}"),
                Position::Box { min, max } => format!("box {min} to {max}"),
            },
            too_near,
            inside_solid,
            clearance: self.clearance,
        })
    }

    /// Whether most of what is seen from `position` are backs of one-sided surfaces: in directions all around, and towards
    /// the middle of each octant of the bounds, so that a light far behind the asset is told, too.
    fn is_inside_solid(&self, position: Vec3) -> bool {
        let around = (0..PROBES).map(|i| {
            // A Fibonacci lattice (Swinbank and Purser 2006): even over the sphere, along no axis of a room.
            let turn = (i as f32 * 0.618_034 + 0.137).fract();
            warp::sample_uniform_sphere(Vec2::new((i as f32 + 0.5) / PROBES as f32, turn))
        });
        let quarter = 0.25 * (self.bounds.max - self.bounds.min);
        let octants = (0..8).map(|i| {
            let side = |bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
            self.bounds.centre() + quarter * Vec3::new(side(0), side(1), side(2)) - position
        });
        let asset = self.tracer.asset();
        let (mut fronts, mut backs) = (0, 0);
        for direction in around.chain(octants) {
            if let Some(hit) = self.tracer.closest_hit(position, direction, f32::INFINITY) {
                let triangle = hit.triangle as usize;
                let material = &asset.materials[asset.mesh.triangle_materials[triangle] as usize];
                let back = asset.mesh.triangle_cross(triangle).dot(direction) > 0.0;
                if back && !material.double_sided {
                    backs += 1;
                } else {
                    fronts += 1;
                }
            }
        }
        backs > fronts
    }

    fn direction(&self, position: Vec3, random: &mut Random) -> Vec3 {
        let target = match self.scenario.aim {
            Aim::Any => return warp::sample_uniform_sphere(random.square()),
            Aim::Surface => self.surface_point(random),
            Aim::Bounds => random.in_box(self.bounds.min, self.bounds.max),
            Aim::Box { min, max } => random.in_box(min, max),
        };
        // A target at the light itself leaves the direction open.
        (target - position).try_normalize().unwrap_or_else(|| warp::sample_uniform_sphere(random.square()))
    }

    /// Uniform by area.
    fn surface_point(&self, random: &mut Random) -> Vec3 {
        let last = self.cumulative_area.len() - 1;
        let area = random.unit() as f64 * self.cumulative_area[last];
        let triangle = self.cumulative_area.partition_point(|&sum| sum <= area).min(last);
        let [a, b, c] = self.tracer.asset().mesh.triangle_positions(triangle);
        let b_c = warp::sample_uniform_triangle(random.square());
        a * (1.0 - b_c.x - b_c.y) + b * b_c.x + c * b_c.y
    }
}

/// Directions all around that are looked along to tell the inside of a solid.
const PROBES: usize = 15;

struct Random(Pcg64Mcg);

impl Random {
    /// Uniform in [0, 1), 24 bits.
    fn unit(&mut self) -> f32 {
        (self.0.next_u32() >> 8) as f32 / (1 << 24) as f32
    }

    fn square(&mut self) -> Vec2 {
        Vec2::new(self.unit(), self.unit())
    }

    fn within(&mut self, [low, high]: [f32; 2]) -> f32 {
        low + (high - low) * self.unit()
    }

    fn log_uniform(&mut self, [low, high]: [f32; 2]) -> f32 {
        self.within([low.ln(), high.ln()]).exp().clamp(low, high)
    }

    fn in_box(&mut self, min: Vec3, max: Vec3) -> Vec3 {
        min + (max - min) * Vec3::new(self.unit(), self.unit(), self.unit())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::scenario::KindWeights;
    use crate::scene::Asset;
    use crate::scene::generate::generate;

    fn cornell() -> Asset {
        generate("cornell").unwrap()
    }

    fn points(scenario: &Scenario, asset: &Asset, count: u32) -> Vec<Vec3> {
        let tracer = Tracer::new(asset);
        let conditions = scenario.sampler(&tracer).unwrap().conditions(7, count).unwrap();
        let position = |light: &Light| match *light {
            Light::Point { position, .. } | Light::Spot { position, .. } => Some(position),
            _ => None,
        };
        conditions.iter().flat_map(|c| &c.lights).filter_map(position).collect()
    }

    #[test]
    fn a_condition_depends_on_seed_and_index_alone() {
        let asset = cornell();
        let tracer = Tracer::new(&asset);
        let kinds = KindWeights { point: 1.0, spot: 1.0, directional: 1.0, ..Default::default() };
        let scenario = Scenario { lights_per_condition: [1, 4], kinds, ..Default::default() };
        let few = scenario.sampler(&tracer).unwrap().conditions(1, 10).unwrap();
        let sampler = scenario.sampler(&tracer).unwrap();
        let many = sampler.conditions(1, 40).unwrap();
        assert_eq!(few[..], many[..10]);
        assert_eq!(sampler.condition(1, 33).unwrap(), many[33]);
        assert_ne!(sampler.condition(2, 33).unwrap(), many[33]);
        for light in many.iter().flat_map(|c| &c.lights) {
            light.clone().validated().unwrap();
        }
    }

    /// χ² of positions in 4³ cells of a box in front of the room; 63 degrees of freedom, so 125 has p < 1e-5.
    #[test]
    fn box_positions_are_uniform() {
        let (min, max) = (Vec3::new(0.5, 0.5, -8.0), Vec3::new(5.0, 4.5, -1.0));
        let kinds = KindWeights { point: 1.0, ..Default::default() };
        let scenario = Scenario { position: Position::Box { min, max }, kinds, ..Default::default() };
        let points = points(&scenario, &cornell(), 6400);
        let mut cells = [0f32; 64];
        for p in &points {
            let cell = ((*p - min) / (max - min) * 4.0).as_uvec3();
            cells[(cell.x + 4 * cell.y + 16 * cell.z) as usize] += 1.0;
        }
        let expected = points.len() as f32 / 64.0;
        let chi2: f32 = cells.iter().map(|n| (n - expected).powi(2) / expected).sum();
        assert!(chi2 < 125.0, "χ² = {chi2}");
        // Control: positions in half the box are told apart.
        cells[..32].fill(0.0);
        assert!(cells.iter().map(|n| (n - expected).powi(2) / expected).sum::<f32>() > 125.0);
    }

    /// The shell between r and 2r: ⟨radius³⟩ is half way between r³ and 8r³, and no light is below the centre.
    #[test]
    fn around_is_uniform_by_volume_and_above() {
        let asset = generate("statue").unwrap();
        let position = Position::Around { radius: [1.0, 2.0], above: true };
        let points = points(&Scenario { position, ..Default::default() }, &asset, 4000);
        let bounds = asset.mesh.bounds();
        let radius = 0.5 * bounds.diagonal();
        let cubes: Vec<f32> = points.iter().map(|p| (p.distance(bounds.centre()) / radius).powi(3)).collect();
        assert!(points.iter().all(|p| p.y >= bounds.centre().y - 1e-5));
        let mean = cubes.iter().sum::<f32>() / cubes.len() as f32;
        // Uniform on [1, 8]: σ = 7/√12, four sigmas of the mean; clearance rejects next to nothing out there.
        assert!((mean - 4.5).abs() < 4.0 * 7.0 / (12.0 * cubes.len() as f32).sqrt(), "{mean}");
    }

    #[test]
    fn lights_keep_clear_of_surfaces_and_solids() {
        let asset = cornell();
        let scenario = Scenario { clearance: Some(0.3), position: Position::Inside, ..Default::default() };
        let short_block = |p: Vec3| p.x > 0.82 && p.x < 2.9 && p.z > 0.65 && p.z < 2.72 && p.y < 1.65;
        let mut beside_block = 0;
        for p in points(&scenario, &asset, 1000) {
            let nearest = (0..asset.mesh.triangles.len())
                .map(|t| crate::scene::proximity::nearest_on_triangle(p, &asset.mesh.triangle_positions(t)).distance(p))
                .fold(f32::INFINITY, f32::min);
            assert!(nearest >= 0.3 - 1e-5, "{p} is {nearest} m from a surface");
            // The middles of the blocks have clearance, and are inside.
            assert!(p.distance(Vec3::new(1.86, 0.8, 1.69)) > 0.5, "{p} is inside the short block");
            assert!(p.distance(Vec3::new(3.69, 1.6, 3.51)) > 0.5, "{p} is inside the tall block");
            beside_block += short_block(p) as u32;
        }
        // Corners of the block's bounding box are outside the turned block but near it.
        assert!(beside_block < 20);
    }

    #[test]
    fn inside_of_solids_is_told_from_the_room() {
        let asset = cornell();
        let tracer = Tracer::new(&asset);
        let sampler = Scenario::default().sampler(&tracer).unwrap();
        for (p, inside) in [
            (Vec3::new(1.86, 0.8, 1.69), true),
            (Vec3::new(3.69, 1.6, 3.51), true),
            (Vec3::new(2.78, 4.0, 2.8), false),
            (Vec3::new(2.78, 2.7, -3.0), false),
            (Vec3::new(2.78, 6.5, 2.8), true),
            (Vec3::new(-1.8, 8.7, 10.3), true),
        ] {
            assert_eq!(sampler.is_inside_solid(p), inside, "{p}");
        }
    }

    #[test]
    fn impossible_settings_are_said() {
        let asset = cornell();
        let tracer = Tracer::new(&asset);
        let narrow = Scenario { clearance: Some(4.0), position: Position::Inside, ..Default::default() };
        let error = narrow.sampler(&tracer).unwrap().condition(1, 0).unwrap_err();
        assert!(matches!(error, ScenarioError::NoRoom { too_near: MOST_TRIES, .. }), "{error}");
        let (min, max) = (Vec3::new(1.76, 0.7, 1.6), Vec3::new(1.96, 0.9, 1.8));
        let buried = Scenario { position: Position::Box { min, max }, clearance: Some(0.1), ..Default::default() };
        let error = buried.sampler(&tracer).unwrap().condition(1, 0).unwrap_err();
        assert!(matches!(error, ScenarioError::NoRoom { inside_solid: MOST_TRIES, .. }), "{error}");
        let empty = Asset { mesh: Default::default(), ..cornell() };
        let tracer = Tracer::new(&empty);
        assert!(matches!(Scenario::default().sampler(&tracer), Err(ScenarioError::NoSurface)));
    }

    #[test]
    fn every_kind_is_drawn_with_lights_that_hold() {
        let mut asset = cornell();
        let scenario = Scenario {
            kinds: KindWeights { rect: 1.0, disk: 1.0, sphere: 1.0, sky: 1.0, emissive: 1.0, ..Default::default() },
            lights_per_condition: [1, 3],
            ..Default::default()
        };
        asset.materials.iter_mut().for_each(|m| m.emissive = Vec3::ZERO);
        let dark = scenario.sampler(&Tracer::new(&asset)).map(|_| ()).unwrap_err();
        assert_eq!(dark, ScenarioError::NothingEmits);
        asset.materials[0].emissive = Vec3::ONE;
        let tracer = Tracer::new(&asset);
        let conditions = scenario.sampler(&tracer).unwrap().conditions(3, 400).unwrap();
        let mut counts = [0; 5];
        for light in conditions.iter().flat_map(|c| &c.lights) {
            let valid = light.clone().validated().unwrap();
            let kind = match valid {
                Light::Rect { .. } => 0,
                Light::Disk { .. } => 1,
                Light::Sphere { .. } => 2,
                Light::Sky(sky) => {
                    // Level ground gets what the scenario says.
                    let lux = luminance(sky.illuminance()) * sky.intensity;
                    assert!((1.49..6.01).contains(&lux), "{lux}");
                    3
                }
                Light::Emissive { .. } => 4,
                other => unreachable!("{other:?} has no weight"),
            };
            counts[kind] += 1;
        }
        // About 800 lights, a fifth of each kind: σ = 11.3.
        assert!(counts.iter().all(|&n| (n - 160i32).abs() < 60), "{counts:?}");
        let missing = Scenario {
            kinds: KindWeights { environment: 1.0, ..Default::default() },
            environments: vec!["absent.exr".into()],
            ..Default::default()
        };
        let error = missing.sampler(&tracer).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("absent.exr"), "{error}");
    }

    #[test]
    fn kinds_and_colours_follow_their_weights() {
        let asset = cornell();
        let tracer = Tracer::new(&asset);
        let scenario = Scenario {
            kinds: KindWeights { point: 1.0, spot: 2.0, directional: 1.0, ..Default::default() },
            color: Color::Random { hue: [0.0, 0.0], saturation: [0.5, 0.5] },
            ..Default::default()
        };
        let conditions = scenario.sampler(&tracer).unwrap().conditions(3, 4000).unwrap();
        let mut counts = [0f32; 3];
        for light in conditions.iter().flat_map(|c| &c.lights) {
            let (kind, color) = match light {
                Light::Point { color, .. } => (0, color),
                Light::Spot { color, .. } => (1, color),
                Light::Directional { color, direction, .. } => {
                    assert!(direction.y <= 0.0);
                    (2, color)
                }
                other => unreachable!("{other:?} has no weight"),
            };
            counts[kind] += 1.0;
            assert!((*color - Vec3::new(1.0, 0.5, 0.5)).length() < 1e-5, "{color}");
        }
        for (count, share) in counts.iter().zip([0.25f32, 0.5, 0.25]) {
            // Four sigmas of a binomial.
            assert!((count - 4000.0 * share).abs() < 4.0 * (4000.0 * share * (1.0 - share)).sqrt(), "{counts:?}");
        }
    }
}
