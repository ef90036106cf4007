//! Whether a UV set serves as lightmap coordinates: inside the page, without overlap, every triangle on some texels,
//! charts apart.

use glam::{DVec2, Vec2};

use super::Mesh;
use super::texels::Lightmap;

/// What is wrong with a UV set.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct UvFault {
    /// Whether it makes the set useless as a lightmap, rather than wasteful.
    pub unusable: bool,
    /// To follow the set's name in a message.
    pub reason: String,
}

/// Least raster for the overlap test; a small lightmap must not hide it.
const MIN_RASTER: usize = 1024;

/// Share of the covered texels that may be covered twice: rounding where exporters pack charts edge to edge.
const MAX_OVERLAP: f64 = 1e-3;

/// How far coordinates may leave [0, 1]: a tenth of a texel at 1024², rounding of exporters.
const MAX_OUTSIDE: f32 = 1e-4;

/// Share of the surface that may have no UV area.
const MAX_WITHOUT_UV: f64 = 1e-5;

/// Less of the page than this in use is waste.
const MIN_COVERAGE: f64 = 0.1;

/// A triangle with less than this part of the mean texels per area is starved.
const STARVED: f64 = 1.0 / 64.0;

/// Share of the surface that may be starved.
const MAX_STARVED: f64 = 0.05;

/// Share of the lightmap's texels that may hold parts of two charts and so mix their light.
const MAX_SHARED: f64 = 0.02;

/// Layers of triangles over the whole page beyond which rasterising more tells nothing new.
const MAX_LAYERS: usize = 64;

/// The faults of UV set `set` for a lightmap of `size`² texels, the worst first; none if it serves.
pub(super) fn check_uvs(mesh: &Mesh, set: usize, size: u32) -> Vec<UvFault> {
    let unusable = |reason: String| vec![UvFault { unusable: true, reason }];
    let uvs = &mesh.uvs[set];
    if uvs.is_empty() {
        return unusable("does not exist".to_owned());
    }
    let outside = |uv: &&Vec2| (uv.min_element() < -MAX_OUTSIDE) | (uv.max_element() > 1.0 + MAX_OUTSIDE);
    if let Some(uv) = uvs.iter().find(outside) {
        return unusable(format!("leaves [0, 1] (at {:.3}, {:.3})", uv.x, uv.y));
    }
    let areas = Areas::new(mesh, uvs);
    if areas.without_uv > MAX_WITHOUT_UV {
        return unusable(format!("has no area for {} of the surface", percent(areas.without_uv)));
    }
    let raster = (size as usize).max(MIN_RASTER);
    let (covered, overlapped) = overlap(mesh, uvs, raster);
    let share = overlapped as f64 / covered.max(1) as f64;
    if share > MAX_OVERLAP {
        return unusable(format!("overlaps itself on {} of its texels", percent(share)));
    }
    let mut faults = Vec::new();
    let mut wasteful = |reason: String| faults.push(UvFault { unusable: false, reason });
    let coverage = covered as f64 / (raster * raster) as f64;
    if coverage < MIN_COVERAGE {
        wasteful(format!("covers only {} of the page", percent(coverage)));
    }
    if areas.starved > MAX_STARVED {
        wasteful(format!("gives {} of the surface under 1/64 of the mean texel density", percent(areas.starved)));
    }
    let shared = shared_between_charts(mesh, uvs, size as usize);
    if shared > MAX_SHARED {
        let at = format!("at {size} × {size} texels");
        wasteful(format!("has charts so close that {} of its texels hold two {at}", percent(shared)));
    }
    faults
}

fn percent(share: f64) -> String {
    format!("{:.1} %", share * 100.0)
}

/// Shares of the surface, by area.
struct Areas {
    without_uv: f64,
    starved: f64,
}

impl Areas {
    fn new(mesh: &Mesh, uvs: &[Vec2]) -> Self {
        let areas: Vec<(f64, f64)> = (0..mesh.triangles.len())
            .map(|t| {
                let [a, b, c] = mesh.triangles[t].map(|v| uvs[v as usize].as_dvec2());
                (mesh.triangle_cross(t).as_dvec3().length() * 0.5, (b - a).perp_dot(c - a).abs() * 0.5)
            })
            .collect();
        let world: f64 = areas.iter().map(|a| a.0).sum();
        let mean = areas.iter().map(|a| a.1).sum::<f64>() / world;
        // Under the rounding of f32 coordinates near 1, an area is nothing.
        let none = f64::from(f32::EPSILON).powi(2);
        let without_uv: f64 = areas.iter().filter(|a| a.1 <= none).map(|a| a.0).sum();
        let starved: f64 = areas.iter().filter(|a| a.1 < STARVED * mean * a.0).map(|a| a.0).sum();
        Self { without_uv: without_uv / world, starved: starved / world }
    }
}

/// Texel centres that some triangle covers, and those that several do.
fn overlap(mesh: &Mesh, uvs: &[Vec2], raster: usize) -> (usize, usize) {
    let mut layers = vec![0u8; raster * raster];
    let mut budget = MAX_LAYERS * raster * raster;
    for triangle in &mesh.triangles {
        let corners = triangle.map(|v| uvs[v as usize].as_dvec2() * raster as f64);
        for_each_centre(corners, raster, &mut budget, |x, y| {
            let layer = &mut layers[y * raster + x];
            *layer = layer.saturating_add(1);
        });
    }
    let covered = layers.iter().filter(|&&l| l > 0).count();
    (covered, layers.iter().filter(|&&l| l > 1).count())
}

/// Visits the texel centres inside a triangle; one on an edge belongs to the triangle on the edge's left, so that
/// triangles which share an edge never share a centre. Takes each row and centre that it looks at off `budget`.
fn for_each_centre(corners: [DVec2; 3], raster: usize, budget: &mut usize, mut visit: impl FnMut(usize, usize)) {
    let [a, b, c] = corners;
    let doubled_area = (b - a).perp_dot(c - a);
    if doubled_area == 0.0 {
        return;
    }
    let edges = if doubled_area > 0.0 { [(a, b), (b, c), (c, a)] } else { [(b, a), (c, b), (a, c)] };
    // Both triangles at an edge evaluate it from the same end, and so get the same rounding.
    let left_of = |(p, q): (DVec2, DVec2), centre: DVec2| {
        let forwards = (p.x, p.y) < (q.x, q.y);
        let (from, to) = if forwards { (p, q) } else { (q, p) };
        let side = (to - from).perp_dot(centre - from);
        if forwards { side >= 0.0 } else { side < 0.0 }
    };
    let rows = centres(a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y), raster);
    for y in rows {
        let v = y as f64 + 0.5;
        // Where the row enters and leaves the triangle, one texel wider for rounding.
        let (mut lo, mut hi) = (f64::INFINITY, f64::NEG_INFINITY);
        for (p, q) in edges {
            if (p.y <= v) != (q.y <= v) || p.y == v || q.y == v {
                let x = if p.y == q.y { p.x } else { p.x + (q.x - p.x) * (v - p.y) / (q.y - p.y) };
                (lo, hi) = (lo.min(x), hi.max(x));
            }
        }
        let columns = centres(lo - 1.0, hi + 1.0, raster);
        let cost = 1 + columns.len();
        if *budget < cost {
            return;
        }
        *budget -= cost;
        for x in columns {
            if edges.iter().all(|&edge| left_of(edge, DVec2::new(x as f64 + 0.5, v))) {
                visit(x, y);
            }
        }
    }
}

/// Texels whose centres lie between `lo` and `hi`.
fn centres(lo: f64, hi: f64, raster: usize) -> std::ops::Range<usize> {
    let first = (lo - 0.5).ceil().max(0.0) as usize;
    let end = ((hi + 0.5).floor().max(0.0) as usize).min(raster);
    first..end.max(first)
}

/// Share of the lightmap's covered texels that hold parts of more than one chart.
fn shared_between_charts(mesh: &Mesh, uvs: &[Vec2], size: usize) -> f64 {
    let charts = charts(mesh, uvs);
    let mesh = Mesh {
        positions: mesh.positions.clone(),
        triangles: mesh.triangles.clone(),
        lightmap_uvs: uvs.to_vec(),
        ..Mesh::default()
    };
    let lightmap = Lightmap::new(&mesh, size);
    let shared = (0..lightmap.texels.len()).filter(|&t| {
        let triangles = lightmap.triangles(t);
        triangles.iter().any(|&other| charts[other as usize] != charts[triangles[0] as usize])
    });
    shared.count() as f64 / lightmap.texels.len().max(1) as f64
}

/// Per triangle, a number that triangles of one chart share: those connected through equal positions and coordinates.
pub fn charts(mesh: &Mesh, uvs: &[Vec2]) -> Vec<u32> {
    let key = |v: u32| (mesh.positions[v as usize].to_array(), uvs[v as usize].to_array());
    let bits = |v: u32| {
        let (p, uv) = key(v);
        [p[0], p[1], p[2], uv[0], uv[1]].map(|x| (x + 0.0).to_bits())
    };
    let mut first_use = std::collections::HashMap::new();
    let mut parent: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
    fn root(parent: &mut [u32], mut t: u32) -> u32 {
        while parent[t as usize] != t {
            let up = parent[t as usize];
            parent[t as usize] = parent[up as usize];
            t = up;
        }
        t
    }
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for &v in triangle {
            let other = *first_use.entry(bits(v)).or_insert(t as u32);
            let (a, b) = (root(&mut parent, t as u32), root(&mut parent, other));
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    (0..parent.len() as u32).map(|t| root(&mut parent, t)).collect()
}
