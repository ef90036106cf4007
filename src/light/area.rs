//! Rectangles, disks and spheres, sampled LANES at a time.
//!
//! Rectangles and disks are sampled uniformly by area, spheres uniformly by the solid angle of the cone that they fill
//! (Shirley, Wang, Zimmerman, *Monte Carlo Techniques for Direct Lighting Calculations*, 1996). All are one-sided.

use glam::{Vec2, Vec3};

use super::Light;
use crate::math::{LANES, warp};
use crate::scene::Aabb;

/// Area lights in structure-of-arrays form: first the flat ones, then the spheres.
#[derive(Default)]
pub struct AreaTable {
    flat: Vec<FlatBlock>,
    spheres: Vec<SphereBlock>,
    /// Numbers of the lights in each lane, padded: `[block][lane]`, flat blocks first.
    numbers: Vec<[u32; LANES]>,
    /// Most area lights of one condition.
    slots: u32,
}

/// LANES rectangles and disks; padding has no area.
#[repr(align(64))]
#[derive(Clone)]
struct FlatBlock {
    centre: [[f32; LANES]; 3],
    /// Half axes.
    u: [[f32; LANES]; 3],
    v: [[f32; LANES]; 3],
    normal: [[f32; LANES]; 3],
    area: [f32; LANES],
    /// Which of the sample points it takes.
    point: [u32; LANES],
}

/// LANES spheres; padding has no radius.
#[repr(align(64))]
#[derive(Clone)]
struct SphereBlock {
    centre: [[f32; LANES]; 3],
    radius: [f32; LANES],
    point: [u32; LANES],
}

/// Points sampled on LANES lights.
#[repr(align(64))]
pub struct AreaSample {
    /// Unit vectors towards them.
    pub direction: [[f32; LANES]; 3],
    /// The same as far as the light.
    pub segment: [[f32; LANES]; 3],
    /// Steradians per unit of density; 0 where the light cannot be seen.
    pub inverse_pdf: [f32; LANES],
}

/// An area light and its place among those of its condition.
pub struct Placed<'l> {
    pub number: u32,
    pub slot: u32,
    pub light: &'l Light,
}

impl AreaTable {
    pub fn new(lights: &[Placed]) -> Self {
        let slots = lights.iter().map(|p| p.slot + 1).max().unwrap_or(0);
        let is_flat = |p: &&Placed| p.light.half_axes().is_some();
        let flat_lights: Vec<&Placed> = lights.iter().filter(is_flat).collect();
        let sphere_lights: Vec<&Placed> = lights.iter().filter(|p| !is_flat(p)).collect();
        let zero = [[0.0; LANES]; 3];
        let set = |to: &mut [[f32; LANES]; 3], lane: usize, v: Vec3| (0..3).for_each(|axis| to[axis][lane] = v[axis]);
        let no_flat = FlatBlock { centre: zero, u: zero, v: zero, normal: zero, area: [0.0; LANES], point: [0; LANES] };
        let no_sphere = SphereBlock { centre: zero, radius: [0.0; LANES], point: [0; LANES] };
        let mut table = Self { slots, ..Default::default() };
        for chunk in flat_lights.chunks(LANES) {
            let mut block = no_flat.clone();
            for (lane, placed) in chunk.iter().enumerate() {
                let (position, direction, round) = match *placed.light {
                    Light::Rect { position, direction, .. } => (position, direction, false),
                    Light::Disk { position, direction, .. } => (position, direction, true),
                    _ => unreachable!("only these have half axes"),
                };
                let ([u, v], area) = placed.light.half_axes().expect("flat");
                set(&mut block.centre, lane, position);
                set(&mut block.u, lane, u);
                set(&mut block.v, lane, v);
                set(&mut block.normal, lane, direction);
                block.area[lane] = area;
                block.point[lane] = 2 * placed.slot + round as u32;
            }
            table.flat.push(block);
        }
        for chunk in sphere_lights.chunks(LANES) {
            let mut block = no_sphere.clone();
            for (lane, placed) in chunk.iter().enumerate() {
                let Light::Sphere { position, radius, .. } = *placed.light else { unreachable!("not flat") };
                set(&mut block.centre, lane, position);
                block.radius[lane] = radius;
                block.point[lane] = 2 * placed.slot + 1;
            }
            table.spheres.push(block);
        }
        for chunk in flat_lights.chunks(LANES).chain(sphere_lights.chunks(LANES)) {
            table.numbers.push(std::array::from_fn(|lane| chunk.get(lane).map_or(0, |p| p.number)));
        }
        table
    }

    pub fn is_empty(&self) -> bool {
        self.numbers.is_empty()
    }

    /// Blocks of LANES lights.
    pub fn block_count(&self) -> usize {
        self.numbers.len()
    }

    /// Numbers of the lights of a block.
    pub fn numbers(&self, block: usize) -> &[u32; LANES] {
        &self.numbers[block]
    }

    /// Bounds of all lights, `None` where there are none.
    pub fn bounds(&self) -> Option<Aabb> {
        let mut bounds = Aabb::EMPTY;
        let mut grow = |centre: &[[f32; LANES]; 3], lane: usize, reach: Vec3| {
            let centre = Vec3::from_array(centre.map(|axis| axis[lane]));
            bounds = Aabb { min: bounds.min.min(centre - reach), max: bounds.max.max(centre + reach) };
        };
        for block in &self.flat {
            for lane in (0..LANES).filter(|&lane| block.area[lane] > 0.0) {
                let [u, v] = [block.u, block.v].map(|a| Vec3::from_array(a.map(|axis| axis[lane])).abs());
                grow(&block.centre, lane, u + v);
            }
        }
        for block in &self.spheres {
            for lane in (0..LANES).filter(|&lane| block.radius[lane] > 0.0) {
                grow(&block.centre, lane, Vec3::splat(block.radius[lane]));
            }
        }
        bounds.min.is_finite().then_some(bounds)
    }

    /// The points that lights sample for one `u`: for each slot one of the square (−1, 1)² and one of the unit disk. Each
    /// slot shifts u (Cranley and Patterson 1976) along the R2 sequence, so that the lights of one condition are sampled
    /// evenly together, and alike whatever other conditions there are.
    pub fn points(&self, u: Vec2, points: &mut Vec<Vec2>) {
        points.clear();
        for slot in 0..self.slots {
            let u = slot_shift(u, slot);
            points.extend([2.0 * u - 1.0, warp::sample_concentric_disk(u)]);
        }
    }

    /// Samples the lights of `block` as seen from `from`, with the `points` of one u.
    #[inline]
    pub fn sample(&self, block: usize, points: &[Vec2], from: Vec3) -> AreaSample {
        match self.flat.get(block) {
            Some(flat) => flat.sample(points, from),
            None => self.spheres[block - self.flat.len()].sample(points, from),
        }
    }

    /// Tells `meet` of every light that a ray meets within `reach` metres, with the inverse of the density (in steradians)
    /// with which sampling draws its direction.
    pub fn meet(&self, origin: Vec3, direction: Vec3, reach: f32, mut meet: impl FnMut(u32, f32)) {
        for block in 0..self.block_count() {
            let inverse_pdf = match self.flat.get(block) {
                Some(flat) => flat.meet(origin, direction, reach),
                None => self.spheres[block - self.flat.len()].meet(origin, direction, reach),
            };
            for lane in 0..LANES {
                if inverse_pdf[lane] > 0.0 {
                    meet(self.numbers[block][lane], inverse_pdf[lane]);
                }
            }
        }
    }
}

impl AreaSample {
    const NONE: AreaSample =
        AreaSample { direction: [[0.0; LANES]; 3], segment: [[0.0; LANES]; 3], inverse_pdf: [0.0; LANES] };
}

/// Both coordinates of the sample points that LANES lights take.
#[inline]
fn points_of(which: &[u32; LANES], points: &[Vec2]) -> ([f32; LANES], [f32; LANES]) {
    (which.map(|point| points[point as usize].x), which.map(|point| points[point as usize].y))
}

/// `u` as the light of this slot takes it.
pub(super) fn slot_shift(u: Vec2, slot: u32) -> Vec2 {
    (u + slot as f32 * Vec2::new(0.754_877_7, 0.569_840_3)).fract()
}

impl FlatBlock {
    #[inline]
    fn sample(&self, points: &[Vec2], from: Vec3) -> AreaSample {
        let mut out = AreaSample::NONE;
        let (a, b) = points_of(&self.point, points);
        for i in 0..LANES {
            let to_x = self.centre[0][i] + a[i] * self.u[0][i] + b[i] * self.v[0][i] - from.x;
            let to_y = self.centre[1][i] + a[i] * self.u[1][i] + b[i] * self.v[1][i] - from.y;
            let to_z = self.centre[2][i] + a[i] * self.u[2][i] + b[i] * self.v[2][i] - from.z;
            let d2 = (to_x * to_x + to_y * to_y + to_z * to_z).max(1e-8);
            let inverse_d = 1.0 / d2.sqrt();
            let (wx, wy, wz) = (to_x * inverse_d, to_y * inverse_d, to_z * inverse_d);
            let cos = -(wx * self.normal[0][i] + wy * self.normal[1][i] + wz * self.normal[2][i]);
            out.direction[0][i] = wx;
            out.direction[1][i] = wy;
            out.direction[2][i] = wz;
            out.segment[0][i] = to_x;
            out.segment[1][i] = to_y;
            out.segment[2][i] = to_z;
            out.inverse_pdf[i] = self.area[i] * cos.max(0.0) / d2;
        }
        out
    }

    #[inline]
    fn meet(&self, o: Vec3, d: Vec3, reach: f32) -> [f32; LANES] {
        let mut inverse_pdf = [0f32; LANES];
        for i in 0..LANES {
            let (nx, ny, nz) = (self.normal[0][i], self.normal[1][i], self.normal[2][i]);
            let (cx, cy, cz) = (self.centre[0][i] - o.x, self.centre[1][i] - o.y, self.centre[2][i] - o.z);
            let cos = -(d.x * nx + d.y * ny + d.z * nz);
            let t = -(cx * nx + cy * ny + cz * nz) / cos;
            let (px, py, pz) = (t * d.x - cx, t * d.y - cy, t * d.z - cz);
            let along = |axis: &[[f32; LANES]; 3]| {
                let (x, y, z) = (axis[0][i], axis[1][i], axis[2][i]);
                (px * x + py * y + pz * z) / (x * x + y * y + z * z)
            };
            let (a, b) = (along(&self.u), along(&self.v));
            let inside = if self.point[i] & 1 == 1 { a * a + b * b <= 1.0 } else { a.abs().max(b.abs()) <= 1.0 };
            if inside & (cos > 0.0) & (t > 0.0) & (t < reach) {
                inverse_pdf[i] = self.area[i] * cos / (t * t);
            }
        }
        inverse_pdf
    }
}

impl SphereBlock {
    #[inline]
    fn sample(&self, points: &[Vec2], from: Vec3) -> AreaSample {
        let mut out = AreaSample::NONE;
        let (a, b) = points_of(&self.point, points);
        for i in 0..LANES {
            let (cx, cy, cz) = (self.centre[0][i] - from.x, self.centre[1][i] - from.y, self.centre[2][i] - from.z);
            let d2 = (cx * cx + cy * cy + cz * cz).max(1e-12);
            let d = d2.sqrt();
            let (zx, zy, zz) = (cx / d, cy / d, cz / d);
            let sin2_most = self.radius[i] * self.radius[i] / d2;
            // 1 − cos θ of the cone, without cancellation; nothing shines inside the sphere.
            let outside = if sin2_most < 1.0 { 1.0 } else { 0.0 };
            let most = sin2_most.min(1.0);
            let cap = most / (1.0 + (1.0 - most).sqrt());
            // The unit disk, uniform by area, maps to the cone, uniform by solid angle, with 1 − cos θ = cap · r².
            let r2 = a[i] * a[i] + b[i] * b[i];
            let cos = 1.0 - cap * r2;
            let sin_over_r = (cap * (2.0 - cap * r2)).sqrt();
            // Duff et al. 2017, as in `Frame::from_normal`.
            let sign = 1f32.copysign(zz);
            let k = -1.0 / (sign + zz);
            let m = zx * zy * k;
            let (x, y) = (a[i] * sin_over_r, b[i] * sin_over_r);
            let wx = (1.0 + sign * zx * zx * k) * x + m * y + zx * cos;
            let wy = sign * m * x + (sign + zy * zy * k) * y + zy * cos;
            let wz = -sign * zx * x - zy * y + zz * cos;
            let half_chord2 = self.radius[i] * self.radius[i] - d2 * sin_over_r * sin_over_r * r2;
            let t = d * cos - half_chord2.max(0.0).sqrt();
            out.direction[0][i] = wx;
            out.direction[1][i] = wy;
            out.direction[2][i] = wz;
            out.segment[0][i] = wx * t;
            out.segment[1][i] = wy * t;
            out.segment[2][i] = wz * t;
            out.inverse_pdf[i] = std::f32::consts::TAU * cap * outside;
        }
        out
    }

    #[inline]
    fn meet(&self, o: Vec3, d: Vec3, reach: f32) -> [f32; LANES] {
        let mut inverse_pdf = [0f32; LANES];
        for i in 0..LANES {
            let (cx, cy, cz) = (self.centre[0][i] - o.x, self.centre[1][i] - o.y, self.centre[2][i] - o.z);
            let along = cx * d.x + cy * d.y + cz * d.z;
            let (px, py, pz) = (cx - along * d.x, cy - along * d.y, cz - along * d.z);
            let (d2, radius2) = (cx * cx + cy * cy + cz * cz, self.radius[i] * self.radius[i]);
            let half_chord2 = radius2 - (px * px + py * py + pz * pz);
            let t = along - half_chord2.max(0.0).sqrt();
            let most = (radius2 / d2).min(1.0);
            if (half_chord2 > 0.0) & (d2 > radius2) & (t > 0.0) & (t < reach) {
                inverse_pdf[i] = std::f32::consts::TAU * most / (1.0 + (1.0 - most).sqrt());
            }
        }
        inverse_pdf
    }
}
