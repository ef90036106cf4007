//! Patches: groups of neighbouring texels of one chart, the coarse level on which light is bounced.

use glam::{Vec2, Vec3};

use crate::math::Rgb;
use crate::scene::{Asset, Hit, Lightmap, Mesh, Reflectance, TexelPoint, charts};

/// More patches than this are joined to larger ones, so that their light stays in the cache.
const MOST_PATCHES: usize = 16_384;

/// Side of the smallest patches, texels.
const SIDE: usize = 2;

/// Where hits find their light: which patch and texel lie at a point of a triangle, and what it reflects.
pub struct Patches<'t, 'a> {
    asset: &'a Asset,
    lightmap: &'t Lightmap,
    triangles: Vec<Triangle>,
    fronts: Vec<Front>,
    /// Side of a patch, texels.
    pub side: usize,
    /// Cells of `side` × `side` texels along the map.
    cells_along: usize,
    /// Patches of cell c: `patches[starts[c]..starts[c + 1]]`, as (chart, patch).
    starts: Vec<u32>,
    by_cell: Vec<(u32, u32)>,
    /// The first of each cell; no chart where it has none.
    first_in_cell: Vec<(u32, u32)>,
    /// `[y · size + x]`: the covered texel, or `u32::MAX`.
    texel_at: Vec<u32>,
    /// Per texel.
    pub patch_of_texel: Vec<u32>,
    chart_of_texel: Vec<u32>,
    /// Patch p's texels, with the share of its area up to the end of each.
    texel_starts: Vec<u32>,
    texels: Vec<(u32, f32)>,
}

/// What is looked up of a triangle at each hit: a cache line.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Triangle {
    /// Lightmap coordinates in texels of the first corner, and the way to the others.
    origin: Vec2,
    to_second: Vec2,
    to_third: Vec2,
    /// Unit, of the front.
    normal: Vec3,
    chart: u32,
    /// Side of a texel on this triangle, metres.
    texel_side: f32,
    /// Diffuse reflectance over the whole triangle; not a number where a texture or vertex colours change it.
    albedo: Rgb,
}

/// What is looked up of a triangle that rays go on from.
struct Front {
    /// Position of the first corner, and the way to the others, metres.
    corner: Vec3,
    edges: [Vec3; 2],
    /// Unit.
    normal: Vec3,
    /// Whether the shading normal is that everywhere.
    flat: bool,
}

/// Where the light of a hit is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Far enough that all the light of its patch stands for it.
    Patch(u32),
    /// So near that its patch would show: the texel's direct light is known, its indirect light is to be gathered.
    Texel(u32),
    /// So near that texels would show: its direct light is to be found anew.
    Point,
}

/// Hits nearer than this many patch sides are near. On the Cornell box at 128² the bias is 0.49 % at 3 and 0.37 % at 6, where
/// noise is a sixth higher.
const NEAR: f32 = 4.0;

/// Hits nearer than this many texel sides are lit anew.
const CLOSE: f32 = 1.0;

impl<'t, 'a> Patches<'t, 'a> {
    pub fn new(asset: &'a Asset, lightmap: &'t Lightmap) -> Self {
        let charts = charts(&asset.mesh, &asset.mesh.lightmap_uvs);
        let size = lightmap.size;
        let mut texel_at = vec![u32::MAX; size * size];
        for (t, texel) in lightmap.texels.iter().enumerate() {
            texel_at[texel.index as usize] = t as u32;
        }
        // A texel that several charts share counts with its first triangle's.
        let chart_of_texel: Vec<u32> =
            (0..lightmap.texels.len()).map(|t| charts[lightmap.triangles(t)[0] as usize]).collect();
        let mut patches = Self {
            asset,
            lightmap,
            triangles: (0..asset.mesh.triangles.len()).map(|t| Triangle::new(asset, t, charts[t], size)).collect(),
            fronts: (0..asset.mesh.triangles.len()).map(|t| Front::new(asset, t)).collect(),
            side: SIDE,
            cells_along: 0,
            starts: Vec::new(),
            by_cell: Vec::new(),
            first_in_cell: Vec::new(),
            texel_at,
            patch_of_texel: Vec::new(),
            chart_of_texel,
            texel_starts: Vec::new(),
            texels: Vec::new(),
        };
        patches.group();
        while patches.len() > MOST_PATCHES && patches.side < size {
            let before = patches.len();
            patches.side *= 2;
            patches.group();
            // Many small charts: larger cells join nothing.
            if patches.len() > before * 3 / 4 {
                break;
            }
        }
        patches
    }

    /// An estimate from above of the patches of a lightmap: a third of the texels where charts are small.
    pub fn most(texels: usize) -> usize {
        (texels / 3).min(4 * MOST_PATCHES)
    }

    /// Number of patches.
    pub fn len(&self) -> usize {
        self.texel_starts.len() - 1
    }

    /// Patch p's texels, with the share of its area up to the end of each.
    pub fn texels(&self, patch: usize) -> &[(u32, f32)] {
        &self.texels[self.texel_starts[patch] as usize..self.texel_starts[patch + 1] as usize]
    }

    /// Groups texels by cell and chart. Patches are numbered cell by cell, so that neighbours lie near in memory.
    fn group(&mut self) {
        let (size, side) = (self.lightmap.size, self.side);
        self.cells_along = size.div_ceil(side);
        let cell_of = |t: usize| {
            let index = self.lightmap.texels[t].index as usize;
            (index / size / side) * self.cells_along + index % size / side
        };
        let mut order: Vec<u32> = (0..self.lightmap.texels.len() as u32).collect();
        order.sort_by_key(|&t| (cell_of(t as usize), self.chart_of_texel[t as usize], t));
        self.starts = vec![0; self.cells_along * self.cells_along + 1];
        self.by_cell.clear();
        self.texels.clear();
        self.texel_starts.clear();
        self.patch_of_texel = vec![0; order.len()];
        let mut previous = None;
        for &t in &order {
            let key = (cell_of(t as usize), self.chart_of_texel[t as usize]);
            if previous != Some(key) {
                self.by_cell.push((key.1, self.by_cell.len() as u32));
                self.starts[key.0 + 1] += 1;
                self.texel_starts.push(self.texels.len() as u32);
                previous = Some(key);
            }
            self.patch_of_texel[t as usize] = self.by_cell.len() as u32 - 1;
            self.texels.push((t, self.lightmap.texels[t as usize].area));
        }
        self.texel_starts.push(self.texels.len() as u32);
        for cell in 1..self.starts.len() {
            self.starts[cell] += self.starts[cell - 1];
        }
        let first = |range: &[u32]| *self.by_cell[..range[1] as usize].get(range[0] as usize).unwrap_or(&(u32::MAX, 0));
        self.first_in_cell = self.starts.windows(2).map(first).collect();
        for range in self.texel_starts.windows(2) {
            let texels = &mut self.texels[range[0] as usize..range[1] as usize];
            let total: f32 = texels.iter().map(|t| t.1).sum();
            let mut sum = 0.0;
            for (_, share) in texels {
                sum += *share / total.max(f32::MIN_POSITIVE);
                *share = sum;
            }
        }
    }

    /// Where a ray along `direction` that met `hit` reads its light, and the diffuse reflectance there. `jitter` in [0, 1)²
    /// picks among the texels or patches around the hit with their bilinear weights, so that lookups are interpolated in the
    /// mean. Unless `tell_near`, its patch stands for any hit. None where the lightmap does not tell: on the back of a surface.
    #[inline]
    pub fn find(&self, hit: &Hit, direction: Vec3, jitter: [f32; 2], tell_near: bool) -> Option<(Place, Rgb)> {
        let triangle = &self.triangles[hit.triangle as usize];
        if triangle.normal.dot(direction) >= 0.0 {
            return None;
        }
        let at = triangle.origin + triangle.to_second * hit.u + triangle.to_third * hit.v;
        let offset = Vec2::from_array(jitter) - 0.5;
        let side = self.side as f32;
        // A jittered point off the chart falls back to the place itself.
        let place = if tell_near && hit.t < CLOSE * triangle.texel_side {
            Place::Point
        } else if tell_near && hit.t < NEAR * side * triangle.texel_side {
            let on_chart = |t: &u32| self.chart_of_texel[*t as usize] == triangle.chart;
            Place::Texel(self.texel_at(at + offset).filter(on_chart).or_else(|| self.texel_at(at))?)
        } else {
            let jittered = self.patch_at(at + offset * side, triangle.chart);
            let patch = jittered.or_else(|| self.patch_at(at, triangle.chart));
            Place::Patch(patch.or_else(|| Some(self.patch_of_texel[self.texel_at(at)? as usize]))?)
        };
        let albedo = if triangle.albedo.x.is_nan() {
            self.asset.surface(hit.triangle as usize, hit.u, hit.v, direction).bsdf.diffuse
        } else {
            triangle.albedo
        };
        Some((place, albedo))
    }

    /// Position, geometric and shading normal of the front at a hit; [`Asset::front`], quicker on flat triangles.
    #[inline(always)]
    pub fn front(&self, hit: &Hit) -> [Vec3; 3] {
        let front = &self.fronts[hit.triangle as usize];
        if !front.flat {
            let surface = self.asset.front(TexelPoint { triangle: hit.triangle, u: hit.u, v: hit.v });
            return [surface.position, surface.geometric_normal, surface.normal];
        }
        let position = front.corner + front.edges[0] * hit.u + front.edges[1] * hit.v;
        [position, front.normal, front.normal]
    }

    #[inline(always)]
    fn texel_at(&self, at: Vec2) -> Option<u32> {
        let size = self.lightmap.size;
        let t = self.texel_at[inside(at.y, size) * size + inside(at.x, size)];
        (t != u32::MAX).then_some(t)
    }

    #[inline(always)]
    fn patch_at(&self, at: Vec2, chart: u32) -> Option<u32> {
        // Sides are powers of two.
        let cells = at / self.side as f32;
        let cell = inside(cells.y, self.cells_along) * self.cells_along + inside(cells.x, self.cells_along);
        let (first_chart, first) = self.first_in_cell[cell];
        if first_chart == chart { Some(first) } else { self.other_patch_in(cell, chart) }
    }

    #[cold]
    fn other_patch_in(&self, cell: usize, chart: u32) -> Option<u32> {
        let here = &self.by_cell[self.starts[cell] as usize..self.starts[cell + 1] as usize];
        here.iter().find(|(c, _)| *c == chart).map(|(_, patch)| *patch)
    }
}

impl Front {
    fn new(asset: &Asset, triangle: usize) -> Self {
        let mesh = &asset.mesh;
        let [a, b, c] = mesh.triangle_positions(triangle);
        let normal = mesh.triangle_cross(triangle).normalize_or(Vec3::Y);
        Self { corner: a, edges: [b - a, c - a], normal, flat: is_flat(mesh, triangle) }
    }
}

/// Whether a triangle's shading normals are its own.
pub fn is_flat(mesh: &Mesh, triangle: usize) -> bool {
    let normal = mesh.triangle_cross(triangle).normalize_or(Vec3::Y);
    // The sine of the angle between them is under what f32 rounds unit vectors by.
    mesh.triangles[triangle].iter().all(|&v| mesh.normals[v as usize].distance(normal) < 1e-6)
}

/// The cell of `count` that holds a coordinate; the nearest for one outside.
#[inline(always)]
fn inside(x: f32, count: usize) -> usize {
    (x as i32).clamp(0, count as i32 - 1) as usize
}

impl Triangle {
    fn new(asset: &Asset, triangle: usize, chart: u32, size: usize) -> Self {
        let mesh = &asset.mesh;
        let uv = mesh.triangles[triangle].map(|v| mesh.lightmap_uvs[v as usize] * size as f32);
        let (to_second, to_third) = (uv[1] - uv[0], uv[2] - uv[0]);
        let cross = mesh.triangle_cross(triangle);
        let texels = to_second.perp_dot(to_third).abs();
        let material = &asset.materials[mesh.triangle_materials[triangle] as usize];
        let plain = material.base_colour_texture.is_none()
            && mesh.colours.is_empty()
            && material.reflectance == Reflectance::Lambert;
        Self {
            origin: uv[0],
            to_second,
            to_third,
            normal: cross.normalize_or(Vec3::Y),
            chart,
            texel_side: if texels > 0.0 { (cross.length() / texels).sqrt() } else { 0.0 },
            albedo: if plain { asset.surface(triangle, 0.0, 0.0, Vec3::ZERO).bsdf.diffuse } else { Rgb::NAN },
        }
    }
}
