//! Lights that move: smooth paths through a scenario, frame by frame.

use glam::Vec3;

use super::{Light, LightingCondition, Scenario, ScenarioError, Sky};
use crate::math::sampler::mix64;
use crate::scene::Tracer;

/// Separates the ends of paths from other random lights of the same seed.
const STREAM: u64 = 0x6d6f_7469_6f6e;

/// Pairs of lights of the scenario that are tried for each path.
const MOST_TRIES: u32 = 256;

impl Scenario {
    /// At most `count` paths of `frames` conditions each. On each path one light goes evenly from where the scenario puts it to
    /// another place of the scenario, in a straight line that meets no surface, and turns on its way; all else about it stays. Fewer
    /// where no such places are found, and none of lights that cannot move.
    ///
    /// # Errors
    /// When the scenario cannot be drawn from.
    pub fn paths(
        &self,
        tracer: &Tracer,
        seed: u64,
        count: usize,
        frames: usize,
    ) -> Result<Vec<Vec<LightingCondition>>, ScenarioError> {
        let sampler = self.sampler(tracer)?;
        let mut paths = Vec::new();
        for i in (0..2 * MOST_TRIES).step_by(2) {
            if paths.len() == count {
                break;
            }
            let ends = [i, i + 1].map(|i| sampler.condition(mix64(seed ^ STREAM), i));
            let [from, to] = ends.map(|end| end.map(|condition| condition.lights.into_iter().next()));
            let (Some(from), Some(to)) = (from?, to?) else { continue };
            if !is_open(tracer, &from, &to) {
                continue;
            }
            let share = |frame: usize| frame as f32 / (frames.max(2) - 1) as f32;
            let lights: Option<Vec<Light>> = (0..frames).map(|frame| from.moved_towards(&to, share(frame))).collect();
            paths
                .extend(lights.map(|l| l.into_iter().map(|light| LightingCondition { lights: vec![light] }).collect()));
        }
        Ok(paths)
    }
}

/// Whether no surface lies on the straight way between two lights.
fn is_open(tracer: &Tracer, from: &Light, to: &Light) -> bool {
    match (from.position(), to.position()) {
        (Some(from), Some(to)) => {
            let way = to - from;
            way.try_normalize().is_some_and(|towards| tracer.closest_hit(from, towards, way.length()).is_none())
        }
        _ => true,
    }
}

impl Light {
    /// This light at a share of the way to another of its kind: its place and the way it faces. None for another kind, and for
    /// lights that do not move.
    pub fn moved_towards(&self, other: &Self, share: f32) -> Option<Self> {
        let mut light = self.clone();
        match (&mut light, other) {
            (Light::Point { position, .. }, Light::Point { position: to, .. })
            | (Light::Sphere { position, .. }, Light::Sphere { position: to, .. }) => {
                *position = position.lerp(*to, share)
            }
            (Light::Spot { position, direction, .. }, Light::Spot { position: to, direction: facing, .. })
            | (Light::Rect { position, direction, .. }, Light::Rect { position: to, direction: facing, .. })
            | (Light::Disk { position, direction, .. }, Light::Disk { position: to, direction: facing, .. }) => {
                *position = position.lerp(*to, share);
                *direction = turned(*direction, *facing, share);
            }
            (Light::Directional { direction, .. }, Light::Directional { direction: facing, .. }) => {
                *direction = turned(*direction, *facing, share);
            }
            (Light::Environment { rotation, .. }, Light::Environment { rotation: to, .. }) => {
                *rotation += (*to - *rotation) * share;
            }
            (Light::Sky(sky), Light::Sky(to)) => {
                *sky = Sky {
                    sun_azimuth: sky.sun_azimuth + (to.sun_azimuth - sky.sun_azimuth) * share,
                    sun_elevation: sky.sun_elevation + (to.sun_elevation - sky.sun_elevation) * share,
                    ..*sky
                };
            }
            _ => return None,
        }
        Some(light)
    }
}

/// From one unit vector to another at an even speed. Opposite ones are joined by way of any third.
pub(super) fn turned(from: Vec3, to: Vec3, share: f32) -> Vec3 {
    let angle = from.angle_between(to);
    let side = (to - from * from.dot(to)).try_normalize().unwrap_or_else(|| from.any_orthonormal_vector());
    from * (angle * share).cos() + side * (angle * share).sin()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::generate::generate;
    use crate::scene_file::SceneFile;

    #[test]
    fn lights_move_evenly_and_through_nothing() {
        let asset = generate("cornell").unwrap();
        let tracer = Tracer::new(&asset);
        let scenario = SceneFile::cornell().scenario;
        let paths = scenario.paths(&tracer, 1, 3, 16).unwrap();
        assert_eq!((paths.len(), paths[0].len()), (3, 16));
        for path in &paths {
            let steps: Vec<(Vec3, Vec3)> = (path.iter())
                .map(|c| match c.lights[..] {
                    [Light::Spot { position, direction, .. }] => (position, direction),
                    _ => panic!("one spot a frame"),
                })
                .collect();
            let (first, last) = (steps[0].0, steps[15].0);
            let step = (last - first) / 15.0;
            for pair in steps.windows(2) {
                // Rounding of f32 on metres.
                assert!((pair[1].0 - pair[0].0 - step).length() < 1e-5 && (pair[1].1.length() - 1.0).abs() < 1e-5);
            }
            assert!(tracer.closest_hit(first, step.normalize(), first.distance(last)).is_none());
        }
        assert_eq!(paths, scenario.paths(&tracer, 1, 3, 16).unwrap());
        assert_ne!(paths, scenario.paths(&tracer, 2, 3, 16).unwrap());
    }

    /// A right angle in three steps is 30 degrees each; another kind of light is no end of a path.
    #[test]
    fn directions_turn_evenly() {
        let sun = |direction| Light::Directional { direction, color: Vec3::ONE, intensity: 1.0 };
        let Some(Light::Directional { direction, .. }) = sun(Vec3::X).moved_towards(&sun(Vec3::Y), 1.0 / 3.0) else {
            panic!("a sun moves")
        };
        assert!((direction - Vec3::new(0.75f32.sqrt(), 0.5, 0.0)).length() < 1e-6, "{direction}");
        assert_eq!(sun(Vec3::X).moved_towards(&Light::Emissive { scale: 1.0 }, 0.5), None);
        assert_eq!(Light::Emissive { scale: 1.0 }.moved_towards(&Light::Emissive { scale: 1.0 }, 0.5), None);
    }
}
