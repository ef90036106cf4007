//! Many lights laid out for vector units: the light that arrives at one surface point from each of them, LANES at a time.
//! Every light is one entry or several: `facets.rs` says what stands for an area light or an environment.
//!
//! Falloff is KHR_lights_punctual's: inverse square, a smooth window at the range, a squared cosine ramp between the cones.
//! GPU twin: `shaders/light.wgsl`.

use glam::Vec3;

use super::{EmissionFacets, Light, LightingCondition};
use crate::math::{LANES, Rgb};
use crate::scene::Aabb;

/// Entries in structure-of-arrays form, padded to whole blocks with some that emit nothing.
pub struct LightTable {
    /// Entries that stand for something; the rest of the last block is padding.
    pub len: usize,
    blocks: Vec<LightBlock>,
    colours: Vec<Rgb>,
    /// Which condition each light belongs to.
    conditions: Vec<u32>,
    condition_count: usize,
}

/// LANES lights. Directional lights have `local` = 0 and `position` = the direction towards the light.
#[repr(align(64))]
#[derive(Clone)]
struct LightBlock {
    position: [[f32; LANES]; 3],
    direction: [[f32; LANES]; 3],
    /// 1 for point and spot, 0 for directional.
    local: [f32; LANES],
    /// 1/range⁴, 0 for an unbounded light.
    inverse_range4: [f32; LANES],
    /// Angular attenuation saturate(cos·scale + offset)²; scale 0 and offset 1 for a light without cone, both 0 for padding.
    cone_scale: [f32; LANES],
    cone_offset: [f32; LANES],
    /// 1 where the attenuation is not squared: the cosine lobe of a facet.
    lobe: [f32; LANES],
}

/// The entry of one light in a [`LightTable`], fields as in its blocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightEntry {
    /// Metres; for a directional light the unit vector towards it.
    pub position: Vec3,
    /// Unit axis of a spot.
    pub direction: Vec3,
    /// 1 for point and spot, 0 for directional.
    pub local: f32,
    /// 1/range⁴ in m⁻⁴, 0 for an unbounded light.
    pub inverse_range4: f32,
    pub cone_scale: f32,
    pub cone_offset: f32,
    /// 1 for a facet, whose attenuation is not squared; otherwise 0.
    pub lobe: f32,
}

impl LightEntry {
    /// A light that shines alike in all directions.
    pub fn point(position: Vec3, range: Option<f32>) -> Self {
        Self {
            position,
            direction: Vec3::Z,
            local: 1.0,
            inverse_range4: range.map_or(0.0, |r| r.powi(-4)),
            cone_scale: 0.0,
            cone_offset: 1.0,
            lobe: 0.0,
        }
    }

    /// A light infinitely far away, `towards` which is a unit vector.
    pub fn distant(towards: Vec3) -> Self {
        Self { local: 0.0, ..Self::point(towards, None) }
    }

    /// A piece of surface that shines with the cosine of the angle to its `normal`.
    pub fn facet(position: Vec3, normal: Vec3) -> Self {
        Self { direction: normal, cone_scale: 1.0, cone_offset: 0.0, lobe: 1.0, ..Self::point(position, None) }
    }
}

/// What LANES lights of unit colour send to a point.
#[repr(align(64))]
pub struct Arrival {
    /// Unit vectors towards the lights.
    pub direction: [[f32; LANES]; 3],
    /// Vector from the point to the light, or as far as `far` metres for directional lights: the shadow ray's whole length.
    pub segment: [[f32; LANES]; 3],
    /// Irradiance over cos θ: what arrives on a surface that faces the light, without shadow.
    pub normal_irradiance: [f32; LANES],
    /// The same times max(cos θ, 0).
    pub irradiance: [f32; LANES],
}

impl LightTable {
    /// Lays out the lights of one condition. `emission` stands for the asset's own.
    pub fn new<'l>(lights: impl IntoIterator<Item = &'l Light>, emission: &EmissionFacets) -> Self {
        let mut entries = Vec::new();
        lights.into_iter().for_each(|light| light.stand_ins(emission, &mut |e, colour| entries.push((0, e, colour))));
        Self::lay_out(entries, 1)
    }

    /// Lays out all lights of all `conditions`, condition after condition.
    pub fn from_conditions(conditions: &[LightingCondition], emission: &EmissionFacets) -> Self {
        let mut entries = Vec::new();
        for (c, condition) in conditions.iter().enumerate() {
            for light in &condition.lights {
                light.stand_ins(emission, &mut |entry, colour| entries.push((c as u32, entry, colour)));
            }
        }
        Self::lay_out(entries, conditions.len())
    }

    /// Lays out (condition, entry, colour).
    pub(super) fn lay_out(entries: Vec<(u32, LightEntry, Rgb)>, condition_count: usize) -> Self {
        let padding = LightBlock {
            position: [[0.0; LANES]; 3],
            direction: [[0.0; LANES], [0.0; LANES], [1.0; LANES]],
            local: [1.0; LANES],
            inverse_range4: [0.0; LANES],
            cone_scale: [0.0; LANES],
            cone_offset: [0.0; LANES],
            lobe: [0.0; LANES],
        };
        let mut blocks = vec![padding; entries.len().div_ceil(LANES)];
        for (i, (_, entry, _)) in entries.iter().enumerate() {
            let (block, lane) = (&mut blocks[i / LANES], i % LANES);
            for axis in 0..3 {
                block.position[axis][lane] = entry.position[axis];
                block.direction[axis][lane] = entry.direction[axis];
            }
            block.local[lane] = entry.local;
            block.inverse_range4[lane] = entry.inverse_range4;
            block.cone_scale[lane] = entry.cone_scale;
            block.cone_offset[lane] = entry.cone_offset;
            block.lobe[lane] = entry.lobe;
        }
        Self {
            len: entries.len(),
            blocks,
            colours: entries.iter().map(|&(_, _, colour)| colour).collect(),
            conditions: entries.iter().map(|&(condition, ..)| condition).collect(),
            condition_count,
        }
    }

    /// Bounds of all point and spot lights; `None` where a light is infinitely far or there is none.
    pub fn bounds(&self) -> Option<Aabb> {
        let mut bounds = Aabb::EMPTY;
        for i in 0..self.len {
            let (block, lane) = (&self.blocks[i / LANES], i % LANES);
            if block.local[lane] == 0.0 {
                return None;
            }
            if block.cone_scale[lane] != 0.0 || block.cone_offset[lane] != 0.0 {
                let position = Vec3::from_array(std::array::from_fn(|axis| block.position[axis][lane]));
                bounds = Aabb { min: bounds.min.min(position), max: bounds.max.max(position) };
            }
        }
        bounds.min.is_finite().then_some(bounds)
    }

    /// Blocks of LANES lights.
    pub fn block_count(&self) -> usize {
        self.blocks.len()
    }

    /// N: the conditions that the lights belong to.
    pub fn condition_count(&self) -> usize {
        self.condition_count
    }

    /// Colour times intensity of light `i`.
    pub fn colour(&self, i: usize) -> Rgb {
        self.colours[i]
    }

    /// Which condition light `i` belongs to.
    pub fn condition(&self, i: usize) -> usize {
        self.conditions[i] as usize
    }

    /// One light's entry, for the GPU's list of lights.
    pub fn entry(&self, i: usize) -> LightEntry {
        let (b, lane) = (&self.blocks[i / LANES], i % LANES);
        LightEntry {
            position: Vec3::from_array(b.position.map(|axis| axis[lane])),
            direction: Vec3::from_array(b.direction.map(|axis| axis[lane])),
            local: b.local[lane],
            inverse_range4: b.inverse_range4[lane],
            cone_scale: b.cone_scale[lane],
            cone_offset: b.cone_offset[lane],
            lobe: b.lobe[lane],
        }
    }

    /// What the lights of `block`, with unit colour, send to `point` with `normal` (METHOD eq. 2). Directional lights
    /// lie `far` metres away, beyond all geometry.
    #[inline]
    pub fn arrive(&self, block: usize, point: Vec3, normal: Vec3, far: f32) -> Arrival {
        let b = &self.blocks[block];
        let mut out = Arrival {
            direction: [[0.0; LANES]; 3],
            segment: [[0.0; LANES]; 3],
            normal_irradiance: [0.0; LANES],
            irradiance: [0.0; LANES],
        };
        for i in 0..LANES {
            let local = b.local[i];
            let to_x = b.position[0][i] - local * point.x;
            let to_y = b.position[1][i] - local * point.y;
            let to_z = b.position[2][i] - local * point.z;
            // Not closer than a tenth of a millimetre, so that a light on the surface stays finite.
            let d2 = (to_x * to_x + to_y * to_y + to_z * to_z).max(1e-8);
            let inverse_d = 1.0 / d2.sqrt();
            let (wx, wy, wz) = (to_x * inverse_d, to_y * inverse_d, to_z * inverse_d);
            let reach = local + (1.0 - local) * far;
            let window = (1.0 - d2 * d2 * b.inverse_range4[i]).clamp(0.0, 1.0);
            let falloff = local * window / d2 + (1.0 - local);
            let cos_cone = -(wx * b.direction[0][i] + wy * b.direction[1][i] + wz * b.direction[2][i]);
            let ramp = (cos_cone * b.cone_scale[i] + b.cone_offset[i]).clamp(0.0, 1.0);
            let e = falloff * ramp * ramp.max(b.lobe[i]);
            let cos_surface = (wx * normal.x + wy * normal.y + wz * normal.z).max(0.0);
            out.direction[0][i] = wx;
            out.direction[1][i] = wy;
            out.direction[2][i] = wz;
            out.segment[0][i] = to_x * reach;
            out.segment[1][i] = to_y * reach;
            out.segment[2][i] = to_z * reach;
            out.normal_irradiance[i] = e;
            out.irradiance[i] = e * cos_surface;
        }
        out
    }
}

/// Scale and offset of the ramp between the cones (KHR_lights_punctual, "Inner and Outer Cone Angles").
pub fn cone_ramp(inner: f32, outer: f32) -> (f32, f32) {
    // A cone narrower than this blurs less than a pixel; it keeps the ramp finite where the angles are equal.
    let scale = 1.0 / (inner.cos() - outer.cos()).max(1e-4);
    (scale, -outer.cos() * scale)
}
