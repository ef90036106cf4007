//! The gather integrator, for diffuse scenes: radiosity of all conditions at once, then a final gather.
//!
//! 1. *Direct* (`direct.rs`): the direct light of every light at every texel.
//! 2. *Bounce* (`bounce.rs`): indirect light between patches of texels, by Jacobi iterations.
//! 3. *Final gather* (here): rays from every texel, which read at their hits the whole light of the patch there. A hit so near
//!    that its patch would show reads the direct light of its texel instead, and the ray goes on (Reichert, *A Two-Pass
//!    Radiosity Method Driven by Lights and Viewer Position*, 1992).
//!
//! Steps 2 and 3 cost little more than a ray and a row of vector operations for all conditions together. Lookups are
//! interpolated between texels and between patches; what is left is a bias that shrinks with the texels. What the lightmap
//! cannot tell, the back of a surface, is path traced.

mod bounce;
mod direct;
mod patches;
mod rows;
mod samples;

use std::ops::Range;

use glam::{Vec2, Vec3};

use self::bounce::Bounced;
use self::direct::Direct;
use self::patches::{Patches, Place};
use self::rows::{Term, place};
use self::samples::{SampleTable, Samples};
use super::conditions::{Collected, LightSums};
use super::path::Collector;
use super::{BakeError, BakeSettings, Walk};
use crate::light::LightSet;
use crate::math::{Frame, Rgb, warp};
use crate::progress::Progress;
use crate::scene::{Lightmap, Surface, TexelPoint, TexelSampler};

/// Everything that the final gather of a texel reads.
pub struct Gather<'t, 'a> {
    lightmap: &'t Lightmap,
    patches: Patches<'t, 'a>,
    direct: Direct,
    bounced: Bounced,
    samples: SampleTable,
    seed: u64,
    /// Rays that went into it.
    pub rays: u64,
}

/// Sends one thread's rays, and adds up the light that they find.
pub struct Gatherer<'t, 'a> {
    rays: Rays<'t, 'a>,
    /// A row of three planes, for a weight of 1 a ray.
    read: Vec<f32>,
}

impl<'t, 'a> Gather<'t, 'a> {
    /// Measures the direct light of `set` and bounces it between patches.
    ///
    /// # Errors
    /// [`BakeError::Cancelled`] when `progress` says so.
    pub fn new(
        walk: &Walk<'_, 'a>,
        lightmap: &'t Lightmap,
        set: &LightSet,
        settings: &BakeSettings,
        progress: &dyn Progress,
    ) -> Result<Self, BakeError> {
        let patches = Patches::new(walk.tracer.asset(), lightmap);
        let direct = Direct::new(walk, lightmap, set, settings, progress)?;
        let bounced = Bounced::new(walk, lightmap, set, &patches, &direct, settings, progress)?;
        let samples = SampleTable::new(settings.seed, settings.paths);
        let rays = direct.rays + bounced.rays;
        Ok(Self { lightmap, patches, direct, bounced, samples, seed: settings.seed, rays })
    }

    /// Bytes held for each light while a lightmap of `texels` texels is gathered.
    pub fn bytes_per_light(texels: usize) -> usize {
        // A bfloat16 a texel, three where the light is coloured; per patch the direct light, three channels of what has bounced
        // once, and two rows of the iteration.
        3 * 2 * texels + (3 * 2 + 3 * 4 + 2 * 3 * 2) * Patches::most(texels)
    }

    /// Bytes held however many lights there are: sample tables, the patches' operator, where texels and patches lie.
    pub fn bytes_fixed(texels: usize, paths: usize) -> usize {
        let terms = Patches::most(texels) * paths * size_of::<Term>();
        2 * SampleTable::bytes(paths) + terms + 32 * texels
    }

    pub fn gatherer<'w>(&self, walk: &Walk<'w, 'a>, set: &'w LightSet) -> Gatherer<'w, 'a> {
        Gatherer { rays: Rays::new(walk, set), read: vec![0.0; 3 * self.direct.light.columns()] }
    }

    /// Sends the rays `range` of a texel, and adds the light that they find to `gatherer`.
    pub fn texel(
        &self,
        walk: &Walk<'_, 'a>,
        texel: usize,
        points: &TexelSampler,
        range: Range<usize>,
        gatherer: &mut Gatherer<'_, 'a>,
    ) {
        let samples = self.samples.of(self.seed, self.lightmap.texels[texel].index as u64);
        gatherer.rays.found.clear();
        for i in range {
            let [u0, u1, u2, u3] = samples.point(i);
            let receiver = self.patches.front(points.sample([u0, u1]));
            gatherer.rays.send(walk, &self.patches, receiver, Vec2::new(u2, u3), &samples, i);
        }
        self.bounced.light.add(&gatherer.rays.found.patches, &mut gatherer.read);
        self.direct.light.add(&gatherer.rays.found.texels, &mut gatherer.read);
    }
}

impl Gatherer<'_, '_> {
    pub fn clear(&mut self) {
        self.read.fill(0.0);
        self.rays.traced.clear();
    }

    /// Irradiance, times the number of rays.
    pub fn collect(&self, out: &mut Collected) {
        let columns = self.read.len() / 3;
        let read = |column: usize| {
            Vec3::from_array(std::array::from_fn(|channel| self.read[place(3, columns, channel, column)]))
        };
        let traced = &self.rays.traced.indirect;
        for (light, (out, &traced)) in out.lights.iter_mut().zip(&traced.lights).enumerate() {
            *out = read(light) + traced;
        }
        out.emission = read(traced.lights.len()) + traced.emission;
    }

    /// Rays so far.
    pub fn rays(&self) -> u64 {
        self.rays.sent + self.rays.traced.rays()
    }
}

/// Sends rays into the scene and notes where the lightmap knows their light; the others are path traced.
struct Rays<'w, 'a> {
    found: Found,
    traced: LightSums<'w, 'a>,
    sent: u64,
}

/// What rays read, weighted with what is reflected of it on the way.
#[derive(Default)]
struct Found {
    /// All light of a patch.
    patches: Vec<Term>,
    /// The direct light of a texel.
    texels: Vec<Term>,
}

impl Found {
    fn clear(&mut self) {
        self.patches.clear();
        self.texels.clear();
    }
}

/// Near hits after which a ray ends; each reflects less of it.
const MOST_NEAR_HITS: u32 = 16;

impl<'w, 'a> Rays<'w, 'a> {
    fn new(walk: &Walk<'w, 'a>, set: &'w LightSet) -> Self {
        Self { found: Found::default(), traced: LightSums::new(set, walk.tracer), sent: 0 }
    }

    /// Sends ray `i` of `samples` from the surface `from` along the cosine-distributed direction of `u`.
    #[inline]
    fn send(
        &mut self,
        walk: &Walk<'_, 'a>,
        patches: &Patches,
        mut from: Surface,
        mut u: Vec2,
        samples: &Samples,
        i: usize,
    ) {
        // Of the irradiance that arrives, what a ray finds counts albedo by albedo: the π of its density meets the 1/π of
        // diffuse reflection.
        let mut weight = Rgb::ONE;
        // Whether `from` was lit anew: then light that the next ray meets by itself is part of what it was lit with.
        let mut lit_anew = false;
        for bounce in 0..MOST_NEAR_HITS.min(walk.max_bounces) {
            let direction = Frame::from_normal(from.normal).world_from_local(warp::sample_cosine_hemisphere(u));
            // A shading normal opens its hemisphere below the surface, too; there is nothing to see there.
            if direction.dot(from.geometric_normal) <= 0.0 {
                return;
            }
            self.sent += 1;
            let arriving = weight * std::f32::consts::PI;
            let pdf = warp::pdf_cosine_hemisphere(direction.dot(from.normal));
            let origin = walk.tracer.leave(&from, direction);
            let Some(hit) = walk.tracer.closest_hit(origin, direction, f32::INFINITY) else {
                if lit_anew {
                    self.traced.escaped(direction, arriving, pdf, bounce);
                }
                return;
            };
            if let Some(emitters) = walk.emitters.filter(|_| lit_anew) {
                let surface = walk.tracer.surface(&hit, direction);
                self.traced.emission(arriving * emitters.met(&hit, &surface, origin, direction, pdf), bounce);
            }
            let mut sampler = samples.sampler(i, bounce);
            let [j0, j1, u0, u1] = samples.following(i, bounce);
            let Some((place, albedo)) = patches.find(&hit, direction, [j0, j1]) else {
                let walk = Walk { max_bounces: walk.max_bounces - bounce, ..*walk };
                walk.continue_along(&from, direction, arriving, pdf, &mut sampler, &mut self.traced);
                return;
            };
            weight *= albedo;
            lit_anew = place == Place::Point;
            match place {
                Place::Patch(row) => {
                    self.found.patches.push(Term { row, weight });
                    return;
                }
                Place::Texel(row) => self.found.texels.push(Term { row, weight }),
                Place::Point => {
                    let surface = walk.tracer.surface(&hit, direction);
                    walk.light(&surface, -direction, arriving, bounce, &sampler, &mut self.traced);
                }
            }
            from = patches.front(TexelPoint { triangle: hit.triangle, u: hit.u, v: hit.v });
            u = Vec2::new(u0, u1);
        }
    }
}
