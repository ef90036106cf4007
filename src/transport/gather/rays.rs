//! Rays of texels and patches, LANES at a time: sent into the scene, they note where the lightmap knows their light.
//!
//! A ray that meets something near goes on from there, together with others that do; what the lightmap does not know is path
//! traced when all have been sent. What a texel's rays find depends on no other texel.

use glam::{Vec2, Vec3};

use super::patches::{Patches, Place};
use super::receivers::{Departure, Receivers, Vectors};
use super::rows::Term;
use super::samples::Samples;
use crate::light::LightSet;
use crate::math::{LANES, Rgb, warp};
use crate::scene::{Hit, Surface, lanes};
use crate::transport::path::Collector;
use crate::transport::{LightSums, Walk};

/// Sends rays for some accounts: the halves of texels' rays, or patches.
pub struct Rays<'w, 'a> {
    /// Per account, what its rays read.
    pub found: Vec<Found>,
    /// Light that was path traced, `[channel][column]`, by account and near hits of the ray before; few accounts have any.
    traced: Vec<(u32, u32, Vec<f32>)>,
    pending: Vec<Ray>,
    unknown: Vec<Unknown>,
    sums: LightSums<'w, 'a>,
    /// Of light: one a light, one for emission where it is asked for, and what fills the last line.
    columns: usize,
    /// Whether near hits are told apart.
    tells_near_hits: bool,
    sent: u64,
}

/// What rays read, weighted with what is reflected of it on the way: of rays that had met no near hit before, one, and more.
#[derive(Default)]
pub struct Found {
    /// All light of a patch.
    pub patches: ByNearHits,
    /// The direct light of a texel.
    pub texels: ByNearHits,
}

/// `[near hits of the ray before]`: each is a bounce, and the light that is read after it must have one fewer.
pub type ByNearHits = [Vec<Term>; MOST_NEAR_HITS + 1];

/// A ray goes on from so many near hits at most; the next reads all light of its patch, however near it is. On the Cornell box
/// the bias is that with sixteen, with one it is a third higher.
pub const MOST_NEAR_HITS: usize = 2;

/// A ray that goes on from a near hit.
struct Ray {
    account: u32,
    /// Number of its sample point.
    point: u32,
    weight: Rgb,
    position: Vec3,
    geometric_normal: Vec3,
    normal: Vec3,
    u: Vec2,
    /// Whether the hit was lit anew: then light that this ray meets by itself is part of what it was lit with.
    lit_anew: bool,
}

/// Light that the lightmap does not know.
struct Unknown {
    account: u32,
    point: u32,
    bounce: u32,
    kind: Kind,
    /// The surface that the ray left, and its normal.
    from: (Vec3, Vec3),
    direction: Vec3,
    /// What arrives of light along it.
    arriving: Rgb,
    pdf: f32,
    hit: Hit,
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    /// A ray from a point that was lit anew met nothing.
    Escaped,
    /// Or met a surface that may emit.
    Met,
    /// The back of a surface.
    Back,
    /// A hit so near that it is lit anew. The last, so that an account's lie together at its end.
    Near,
}

/// Lanes of rays: for whom they are sent, and what they carry.
struct Carried {
    account: [u32; LANES],
    point: [u32; LANES],
    weight: [Rgb; LANES],
    lit_anew: u32,
    bounce: u32,
    /// Whether they are not reflected again.
    last: bool,
}

/// Of how many hits that are to be lit anew, at most, one is lit for all: they lie within a texel of each other.
const LARGEST_GROUP: usize = 8;

/// So many are lit at least for an account that has as many: in coarse lightmaps light changes within a texel.
const LEAST_GROUPS: usize = 8;

/// What a number is drawn for beside a ray: which of a group is lit anew.
const NEAR_CHOICE: u32 = 4;

impl<'w, 'a> Rays<'w, 'a> {
    pub fn new(walk: &Walk<'w, 'a>, set: &'w LightSet, columns: usize, tells_near_hits: bool) -> Self {
        let sums = LightSums::new(set, walk.tracer);
        Self {
            found: vec![],
            traced: vec![],
            pending: vec![],
            unknown: vec![],
            sums,
            columns,
            tells_near_hits,
            sent: 0,
        }
    }

    /// Segments of paths and shadow rays so far.
    pub fn sent(&self) -> u64 {
        self.sent + self.sums.rays()
    }

    /// Opens `count` empty accounts.
    pub fn open(&mut self, count: usize) {
        self.found.resize_with(count, Found::default);
        for found in &mut self.found {
            found.patches.iter_mut().chain(&mut found.texels).for_each(Vec::clear);
        }
        self.traced.clear();
    }

    /// Sends a ray for each of the first `count` points of `samples` from `receivers`, for the account that `account` names for
    /// a point. Accounts of one call after the other ascend.
    pub fn send(
        &mut self,
        walk: &Walk<'_, 'a>,
        patches: &Patches,
        receivers: &Receivers,
        samples: &Samples,
        count: usize,
        account: impl Fn(usize) -> usize,
    ) {
        if walk.max_bounces == 0 {
            return;
        }
        for first in (0..count).step_by(LANES) {
            let [v0, v1, u0, u1, following @ ..] = samples.points(first / LANES);
            let departure = receivers.depart(&[u0, u1], &[v0, v1]);
            let carried = Carried {
                account: std::array::from_fn(|i| account(first + i) as u32),
                point: std::array::from_fn(|i| (first + i) as u32),
                weight: [Rgb::ONE; LANES],
                lit_anew: 0,
                bounce: 0,
                last: false,
            };
            let active = ((1u64 << (count - first).min(LANES)) - 1) as u32;
            self.trace(walk, patches, &departure, &carried, active, |lane| following.map(|u| u[lane]));
        }
    }

    /// Sends on the rays that met something near, and path traces what the lightmap does not know. `samples` are an account's.
    pub fn finish<'s>(&mut self, walk: &Walk<'_, 'a>, patches: &Patches, samples: impl Fn(usize) -> Samples<'s>) {
        for bounce in 1..=(MOST_NEAR_HITS as u32).min(walk.max_bounces) {
            let mut rays = std::mem::take(&mut self.pending);
            let last = bounce == walk.max_bounces;
            if last {
                // These end here, but what was lit anew still misses what its rays would meet by themselves.
                rays.retain(|ray| ray.lit_anew);
            }
            for rays in rays.chunks(LANES) {
                let (departure, carried) = gathered(rays, bounce, last);
                let active = ((1u64 << rays.len()) - 1) as u32;
                self.trace(walk, patches, &departure, &carried, active, |lane| {
                    samples(carried.account[lane] as usize).following(carried.point[lane] as usize, bounce)
                });
            }
        }
        self.trace_unknown(walk, samples);
    }

    /// Traces the rays of `active`; `following` has four more numbers for each.
    #[inline]
    fn trace(
        &mut self,
        walk: &Walk<'_, 'a>,
        patches: &Patches,
        departure: &Departure,
        carried: &Carried,
        active: u32,
        following: impl Fn(usize) -> [f32; 4],
    ) {
        // A shading normal opens its hemisphere below the surface, too; there is nothing to see there.
        let active = active & departure.above();
        self.sent += u64::from(active.count_ones());
        let origins = departure.origins(walk.tracer.offset);
        let hits = walk.tracer.closest_hits(&origins, &departure.direction, active);
        let unknown = |lane: usize, kind: Kind| Unknown {
            account: carried.account[lane],
            point: carried.point[lane],
            bounce: carried.bounce,
            kind,
            from: (departure.position(lane), departure.geometric_normal(lane)),
            direction: departure.direction(lane),
            // Of the irradiance that arrives, what a ray finds counts albedo by albedo: the π of its density meets the 1/π of
            // diffuse reflection.
            arriving: carried.weight[lane] * std::f32::consts::PI,
            pdf: warp::pdf_cosine_hemisphere(departure.cos[lane]),
            hit: hits.get(lane),
        };
        let lit_anew = active & carried.lit_anew;
        self.unknown.extend(lanes(lit_anew & !hits.hit).map(|lane| unknown(lane, Kind::Escaped)));
        if walk.emitters.is_some() {
            self.unknown.extend(lanes(lit_anew & hits.hit).map(|lane| unknown(lane, Kind::Met)));
        }
        let read = if carried.last { 0 } else { hits.hit };
        let near_hits = self.near_hits(carried.bounce) as usize;
        let tell_near = (carried.bounce as usize) < MOST_NEAR_HITS;
        for lane in lanes(read) {
            let hit = hits.get(lane);
            let account = carried.account[lane];
            let [j0, j1, u0, u1] = following(lane);
            let Some((place, albedo)) = patches.find(&hit, departure.direction(lane), [j0, j1], tell_near) else {
                self.unknown.push(unknown(lane, Kind::Back));
                continue;
            };
            let weight = carried.weight[lane] * albedo;
            let found = &mut self.found[account as usize];
            match place {
                Place::Patch(row) => {
                    found.patches[near_hits].push(Term { row, weight });
                    continue;
                }
                Place::Texel(row) => found.texels[near_hits].push(Term { row, weight }),
                Place::Point => self.unknown.push(unknown(lane, Kind::Near)),
            }
            let [position, geometric_normal, normal] = patches.front(&hit);
            self.pending.push(Ray {
                account,
                point: carried.point[lane],
                weight,
                position,
                geometric_normal,
                normal,
                u: Vec2::new(u0, u1),
                lit_anew: place == Place::Point,
            });
        }
    }

    /// Of a ray that has bounced so often, as far as they are told.
    fn near_hits(&self, bounce: u32) -> u32 {
        if self.tells_near_hits { bounce } else { 0 }
    }

    /// Light that the lightmap does not know, account by account.
    fn trace_unknown<'s>(&mut self, walk: &Walk<'_, 'a>, samples: impl Fn(usize) -> Samples<'s>) {
        // In an order that tells nothing of which rays were traced together.
        let tells = self.tells_near_hits;
        let key = |u: &Unknown| (u.account, if tells { u.bounce } else { 0 });
        self.unknown.sort_by_key(|u| (key(u), u.kind, u.bounce, u.point));
        for of_account in self.unknown.chunk_by(|a, b| key(a) == key(b)) {
            let samples = samples(of_account[0].account as usize);
            self.sums.clear();
            let (other, near) = of_account.split_at(of_account.partition_point(|u| u.kind != Kind::Near));
            other.iter().for_each(|unknown| unknown.trace(walk, &samples, 1.0, &mut self.sums));
            let size = (near.len() / LEAST_GROUPS).clamp(1, LARGEST_GROUP);
            for group in near.chunks(size) {
                let any = samples.sampler(group[0].point as usize, group[0].bounce).aside(NEAR_CHOICE).next_4d()[0];
                group[(any * group.len() as f32) as usize].trace(walk, &samples, group.len() as f32, &mut self.sums);
            }
            let sums = &self.sums.indirect;
            let mut light = vec![0.0; 3 * self.columns];
            for (channel, light) in light.chunks_exact_mut(self.columns.max(1)).enumerate() {
                light.iter_mut().zip(&sums.lights).for_each(|(light, sum)| *light = sum[channel]);
                if let Some(emission) = light.get_mut(sums.lights.len()).filter(|_| walk.emitters.is_some()) {
                    *emission = sums.emission[channel];
                }
            }
            let (account, near_hits) = key(&of_account[0]);
            self.traced.push((account, near_hits, light));
        }
        self.unknown.clear();
    }

    /// Light that was path traced for an account, `[channel][column]`, with the near hits before of the rays that brought it.
    pub fn traced_for(&self, account: usize) -> impl Iterator<Item = (usize, &[f32])> {
        let first = self.traced.partition_point(|t| (t.0 as usize) < account);
        let of_account = self.traced[first..].iter().take_while(move |t| t.0 as usize == account);
        of_account.map(|(_, near_hits, light)| (*near_hits as usize, &light[..]))
    }
}

impl Unknown {
    /// `count`: for how many it stands.
    fn trace(&self, walk: &Walk, samples: &Samples, count: f32, sums: &mut LightSums) {
        let from = Surface::front(self.from.0, self.from.1, self.from.1);
        let surface = || walk.tracer.surface(&self.hit, self.direction);
        let mut sampler = samples.sampler(self.point as usize, self.bounce);
        match self.kind {
            Kind::Escaped => sums.escaped(self.direction, self.arriving, self.pdf, self.bounce),
            Kind::Met => {
                let Some(emitters) = walk.emitters else { return };
                let origin = walk.tracer.leave(&from, self.direction);
                let radiance = emitters.met(&self.hit, &surface(), origin, self.direction, self.pdf);
                sums.emission(self.arriving * radiance, self.bounce);
            }
            Kind::Near => walk.light(&surface(), -self.direction, count * self.arriving, self.bounce, &sampler, sums),
            Kind::Back => {
                let walk = Walk { max_bounces: walk.max_bounces - self.bounce, ..*walk };
                walk.continue_along(&from, self.direction, self.arriving, self.pdf, &mut sampler, sums);
            }
        }
    }
}

/// At most LANES rays, lane by lane.
fn gathered(rays: &[Ray], bounce: u32, last: bool) -> (Departure, Carried) {
    let [mut position, mut geometric_normal, mut normal]: [Vectors; 3] = Default::default();
    let mut u = [[0.0; LANES]; 2];
    let mut carried =
        Carried { account: [0; LANES], point: [0; LANES], weight: [Rgb::ZERO; LANES], lit_anew: 0, bounce, last };
    for (i, ray) in rays.iter().enumerate() {
        for axis in 0..3 {
            position[axis][i] = ray.position[axis];
            geometric_normal[axis][i] = ray.geometric_normal[axis];
            normal[axis][i] = ray.normal[axis];
        }
        (u[0][i], u[1][i]) = (ray.u.x, ray.u.y);
        (carried.account[i], carried.point[i], carried.weight[i]) = (ray.account, ray.point, ray.weight);
        carried.lit_anew |= u32::from(ray.lit_anew) << i;
    }
    (Departure::new(position, geometric_normal, &normal, &u), carried)
}
