//! All lights of N conditions, as path tracing takes them.

use std::sync::Arc;

use super::area::{AreaTable, Placed};
use super::environment::EnvironmentMap;
use super::{Light, LightTable, LightingCondition};
use crate::math::Rgb;

/// The lights of N conditions. Each has a number, or several where it is made of several: first those of single points and
/// directions, then area lights, then environments.
pub struct LightSet {
    pub punctual: LightTable,
    pub areas: AreaTable,
    pub environments: EnvironmentTable,
    /// Of area lights and environments.
    colours: Vec<Rgb>,
    conditions: Vec<u32>,
    /// Per condition, the scale of the asset's own emission.
    emission: Vec<f32>,
}

/// Environments, each a map that is turned.
#[derive(Default)]
pub struct EnvironmentTable {
    pub maps: Vec<Arc<EnvironmentMap>>,
    /// What is drawn once and serves every turn of a map: index of the map, and the slot that shifts u.
    pub draws: Vec<(u32, u32)>,
    pub entries: Vec<EnvironmentEntry>,
}

/// One environment.
#[derive(Clone, Copy, Debug)]
pub struct EnvironmentEntry {
    /// Index into the draws.
    pub draw: u32,
    /// Index of the map.
    pub map: u32,
    /// Of the angle about +y, in turns.
    pub turns: f32,
    /// Its sine and cosine.
    pub turn: [f32; 2],
}

impl LightSet {
    /// The lights of one condition.
    pub fn new<'l>(lights: impl IntoIterator<Item = &'l Light>) -> Self {
        Self::lay_out(&[lights.into_iter().collect()])
    }

    /// All lights of all `conditions`.
    pub fn from_conditions(conditions: &[LightingCondition]) -> Self {
        Self::lay_out(&conditions.iter().map(|c| c.lights.iter().collect()).collect::<Vec<_>>())
    }

    fn lay_out(conditions: &[Vec<&Light>]) -> Self {
        let lights =
            || conditions.iter().enumerate().flat_map(|(c, lights)| lights.iter().map(move |&l| (c as u32, l)));
        let mut entries = Vec::new();
        lights().for_each(|(c, light)| light.punctual(&mut |entry, colour| entries.push((c, entry, colour))));
        let punctual = LightTable::lay_out(entries, conditions.len());

        let (mut placed, mut colours, mut owners) = (Vec::new(), Vec::new(), Vec::new());
        let mut environments = EnvironmentTable::default();
        // The place of each light among its condition's is what decides its random numbers, so that no other condition has
        // a say in them.
        let mut slots = vec![0; conditions.len()];
        let mut next_slot = |c: u32| {
            slots[c as usize] += 1;
            slots[c as usize] - 1
        };
        for (c, light) in lights() {
            if matches!(light, Light::Rect { .. } | Light::Disk { .. } | Light::Sphere { .. }) {
                let number = (punctual.len + colours.len()) as u32;
                placed.push(Placed { number, slot: next_slot(c), light });
                colours.push(light.radiant());
                owners.push(c);
            }
        }
        let areas = AreaTable::new(&placed);
        let mut slots = vec![0; conditions.len()];
        for (c, light) in lights() {
            let (map, rotation) = match light {
                Light::Environment { image, rotation, .. } => (image.map().clone(), *rotation),
                Light::Sky(sky) => (Arc::new(sky.tabulate()), sky.rotation()),
                _ => continue,
            };
            environments.add(map, slots[c as usize], rotation);
            slots[c as usize] += 1;
            colours.push(light.radiant());
            owners.push(c);
        }
        let scale = |light: &&Light| if let Light::Emissive { scale } = light { *scale } else { 0.0 };
        let emission = conditions.iter().map(|lights| lights.iter().map(scale).sum()).collect();
        Self { punctual, areas, environments, colours, conditions: owners, emission }
    }

    /// How many numbers there are.
    pub fn len(&self) -> usize {
        self.punctual.len + self.colours.len()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// N.
    pub fn condition_count(&self) -> usize {
        self.emission.len()
    }

    /// The number of the first environment.
    pub fn first_environment(&self) -> usize {
        self.len() - self.environments.entries.len()
    }

    /// What light `number`, gathered with unit colour, is multiplied with.
    pub fn colour(&self, number: usize) -> Rgb {
        match number.checked_sub(self.punctual.len) {
            None => self.punctual.colour(number),
            Some(i) => self.colours[i],
        }
    }

    /// Which condition light `number` belongs to.
    pub fn condition(&self, number: usize) -> usize {
        match number.checked_sub(self.punctual.len) {
            None => self.punctual.condition(number),
            Some(i) => self.conditions[i] as usize,
        }
    }

    /// Per condition, the scale of the asset's own emission.
    pub fn emission(&self) -> &[f32] {
        &self.emission
    }

    /// Whether any condition has the asset's own emission.
    pub fn wants_emission(&self) -> bool {
        self.emission.iter().any(|&scale| scale != 0.0)
    }
}

impl EnvironmentTable {
    fn add(&mut self, map: Arc<EnvironmentMap>, slot: u32, rotation: f32) {
        let known = self.maps.iter().position(|m| Arc::ptr_eq(m, &map));
        let map = known.unwrap_or_else(|| {
            self.maps.push(map);
            self.maps.len() - 1
        }) as u32;
        let draw = self.draws.iter().position(|&d| d == (map, slot)).unwrap_or_else(|| {
            self.draws.push((map, slot));
            self.draws.len() - 1
        }) as u32;
        let turns = (rotation / std::f32::consts::TAU).rem_euclid(1.0);
        self.entries.push(EnvironmentEntry { draw, map, turns, turn: rotation.sin_cos().into() });
    }
}
