//! Light of every light of a table at one surface point, shadows included: the dense inner loop of the bake.
//!
//! Cheap tests come first (cone, horizon, range), LANES lights at a time; those that pass are packed and cast their shadow
//! rays together, since all of them start at the same point.

use super::LightTable;
use super::table::Arrival;
use crate::math::LANES;
use crate::scene::{ShadowRays, Surface, Tracer, above_zero, packed};

/// Finds what every light of a table sends to a surface point, shadows included.
pub struct LightGather<'t, 'a> {
    table: &'t LightTable,
    tracer: &'t Tracer<'a>,
    shadows: ShadowRays<'t, 'a>,
    packet: Packet,
    /// Shadow rays cast so far.
    pub rays: u64,
}

/// Lights that passed the cheap tests and wait for their shadow rays: fewer than LANES, and those that join them.
#[repr(align(64))]
struct Packet {
    segment: [Waiting; 3],
    direction: [Waiting; 3],
    irradiance: Waiting,
    /// Indices into the table, as bits.
    light: Waiting,
    len: usize,
}

/// A number each.
type Waiting = [f32; 2 * LANES];

/// LANES lights that reach the point, less those whose bit in `open` is not set.
pub struct Arrived<'p> {
    /// Indices into the table.
    pub light: &'p [u32; LANES],
    /// Unit vectors towards the lights.
    pub direction: &'p [[f32; LANES]; 3],
    /// Irradiance (cosine included) of the light with unit colour.
    pub irradiance: &'p [f32; LANES],
    pub open: u32,
}

impl<'t, 'a> LightGather<'t, 'a> {
    pub fn new(table: &'t LightTable, tracer: &'t Tracer<'a>) -> Self {
        let none = [0.0; 2 * LANES];
        let packet = Packet { segment: [none; 3], direction: [none; 3], irradiance: none, light: none, len: 0 };
        Self { table, tracer, shadows: tracer.shadow_rays(table.bounds()), packet, rays: 0 }
    }

    /// Hands every light that reaches the surface to `arrived`, up to LANES at a time.
    #[inline]
    pub fn gather(&mut self, surface: &Surface, mut arrived: impl FnMut(Arrived)) {
        // Light is evaluated where its shadow rays start, so that they end at the lights.
        let origin = self.tracer.leave(surface, surface.geometric_normal);
        self.shadows.start_from(origin);
        for block in 0..self.table.block_count() {
            let arrival = self.table.arrive(block, origin, surface.normal, self.tracer.extent);
            let g = surface.geometric_normal;
            let mut above = [0.0; LANES];
            for i in 0..LANES {
                let [x, y, z] = [arrival.direction[0][i], arrival.direction[1][i], arrival.direction[2][i]];
                above[i] = x * g.x + y * g.y + z * g.z;
            }
            let reaching = above_zero(&arrival.irradiance) & above_zero(&above);
            if reaching == 0 {
                continue;
            }
            self.packet.join(&arrival, block, reaching);
            if self.packet.len >= LANES {
                self.flush(LANES, &mut arrived);
            }
        }
        if self.packet.len > 0 {
            self.flush(self.packet.len, &mut arrived);
        }
    }

    /// Casts the shadow rays of the first `count` that wait.
    fn flush(&mut self, count: usize, arrived: &mut impl FnMut(Arrived)) {
        let p = &mut self.packet;
        let active = ((1u64 << count) - 1) as u32;
        let open = self.shadows.unoccluded(&p.segment.each_ref().map(first), active);
        let light = first(&p.light).map(f32::to_bits);
        let direction = &p.direction.each_ref().map(first);
        arrived(Arrived { light: &light, direction, irradiance: &first(&p.irradiance), open });
        self.rays += count as u64;
        p.len -= count;
        p.columns().for_each(|waiting| waiting.copy_within(LANES.., 0));
    }
}

impl Packet {
    fn join(&mut self, arrival: &Arrival, block: usize, reaching: u32) {
        let numbers = std::array::from_fn(|i| f32::from_bits((block * LANES + i) as u32));
        let len = self.len;
        let join = |waiting: &mut Waiting, values: &[f32; LANES]| {
            waiting[len..len + LANES].copy_from_slice(&packed(values, reaching));
        };
        for axis in 0..3 {
            join(&mut self.segment[axis], &arrival.segment[axis]);
            join(&mut self.direction[axis], &arrival.direction[axis]);
        }
        join(&mut self.irradiance, &arrival.irradiance);
        join(&mut self.light, &numbers);
        self.len += reaching.count_ones() as usize;
    }

    fn columns(&mut self) -> impl Iterator<Item = &mut Waiting> {
        let vectors = self.segment.iter_mut().chain(&mut self.direction);
        vectors.chain([&mut self.irradiance, &mut self.light])
    }
}

fn first(waiting: &Waiting) -> [f32; LANES] {
    *waiting.first_chunk().expect("twice as long")
}
