//! D of a rendered dataset: from a table, looked up in direct lightmaps, or measured from the lights.

use rayon::prelude::*;

use super::super::DatasetError;
use super::super::manifest::points_hash;
use super::manifest::{FILE, Rendered};
use super::{lightmap, table};
use crate::light::{EmissionFacets, LightTable, LightingCondition};
use crate::measure::MeasurementPoints;
use crate::scene::{Lightmap, Tracer};

/// Where D comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Direct {
    /// A file of [`table::FILES`].
    Table(&'static str),
    /// A lightmap of each condition.
    Lightmaps,
    /// Measured from the lights, as the run time does.
    Measured,
}

impl Direct {
    /// In one line, for the user.
    pub fn line(self) -> String {
        match self {
            Direct::Table(file) => format!("direct light from {file}"),
            Direct::Lightmaps => "direct light looked up in direct lightmaps".into(),
            Direct::Measured => "direct light measured from the lights".into(),
        }
    }
}

impl Rendered {
    /// How D of the `selected` conditions is to be had.
    pub(super) fn direct_source(&self, selected: &[usize]) -> Result<Direct, DatasetError> {
        let tables: Vec<&str> = table::FILES.into_iter().filter(|name| self.folder.join(name).exists()).collect();
        match tables[..] {
            [] => {}
            [one] => return Ok(Direct::Table(one)),
            [one, other, ..] => return Err(self.wrong(one, format!("{other} holds direct light, too; keep one"))),
        }
        let conditions = &self.manifest.conditions;
        let with = selected.iter().filter(|&&i| conditions[i].direct.is_some()).count();
        if with == selected.len() {
            return Ok(Direct::Lightmaps);
        }
        if let Some(&i) = selected.iter().find(|&&i| with > 0 && conditions[i].direct.is_none()) {
            return Err(
                self.wrong(FILE, format!("condition {i} has no `direct` lightmap, others have; give all or none"))
            );
        }
        match selected.iter().find(|&&i| conditions[i].lights.is_empty()) {
            None => Ok(Direct::Measured),
            Some(i) => {
                let why = format!(
                    "condition {i} lists no lights, and without them its direct light must be given: as direct.csv, \
                     direct.npy or direct.safetensors, or as `direct` lightmaps"
                );
                Err(self.wrong(FILE, why))
            }
        }
    }

    /// D, `[point][channel][condition]`, of the `selected` conditions, whose lights are `lights`.
    pub(super) fn direct(
        &self,
        source: Direct,
        selected: &[usize],
        lights: &[LightingCondition],
        tracer: &Tracer,
        lightmap: &Lightmap,
        points: &MeasurementPoints,
    ) -> Result<Vec<f32>, DatasetError> {
        let (count, n) = (points.points.len(), selected.len());
        let table = match source {
            Direct::Measured => {
                let table = LightTable::from_conditions(lights, &EmissionFacets::of(tracer.asset()));
                return Ok(points.direct_matrix(tracer, &table));
            }
            Direct::Table(file) => {
                if self.manifest.points_hash != points_hash(points) {
                    let why = "is of other measurement points than this run's; give the --points, --sub-points and --seed \
                               that the conditions were exported with";
                    return Err(self.wrong(file, why));
                }
                let all = self.manifest.conditions.len();
                let table = table::read(&self.folder.join(file), count, all).map_err(|why| self.wrong(file, why))?;
                let row = |p: usize| selected.iter().flat_map(move |&i| [0, 1, 2].map(|c| 3 * (p * all + i) + c));
                (0..count).flat_map(row).map(|at| table[at]).collect::<Vec<f32>>()
            }
            Direct::Lightmaps => self.looked_up(selected, tracer, lightmap, points)?,
        };
        let at = |p: usize, channel: usize, c: usize| table[3 * (p * n + c) + channel];
        Ok((0..count).flat_map(|p| (0..3).flat_map(move |ch| (0..n).map(move |c| at(p, ch, c)))).collect())
    }

    /// Exitance at the points, `[point][condition][channel]`, from lightmaps of direct irradiance.
    fn looked_up(
        &self,
        selected: &[usize],
        tracer: &Tracer,
        map: &Lightmap,
        points: &MeasurementPoints,
    ) -> Result<Vec<f32>, DatasetError> {
        let weights = lookups(tracer, map, points);
        let per_point = points.neighbours_per_point().max(1);
        let columns = (selected.par_iter())
            .map(|&i| {
                let file = self.manifest.conditions[i].direct.as_ref().expect("the source was chosen by it");
                let irradiance = lightmap::read(&self.folder.join(file), "direct", map.size, &map.texels)
                    .map_err(|why| self.wrong(file, format!("condition {i}: {why}")))?;
                let sub_point = |s: u32, channel: usize| -> f32 {
                    let looked_up = weights[s as usize].iter().map(|&(t, w)| w * irradiance[3 * t as usize + channel]);
                    points.sub_points[s as usize].albedo[channel] * looked_up.sum::<f32>()
                };
                let neighbours = points.neighbours.chunks_exact(per_point);
                let mean =
                    |of: &[u32], channel| of.iter().map(|&s| sub_point(s, channel)).sum::<f32>() / per_point as f32;
                Ok(neighbours.flat_map(|of| [0, 1, 2].map(|channel| mean(of, channel))).collect::<Vec<f32>>())
            })
            .collect::<Result<Vec<_>, DatasetError>>()?;
        let row = |p: usize| columns.iter().flat_map(move |column| column[3 * p..3 * p + 3].to_vec());
        Ok((0..points.points.len()).flat_map(row).collect())
    }
}

/// Per sub-point, the four texels that a bilinear lookup there reads, and their weights. Texels without surface are read
/// where their value comes from.
fn lookups(tracer: &Tracer, lightmap: &Lightmap, points: &MeasurementPoints) -> Vec<[(u32, f32); 4]> {
    let (sources, mesh, size) = (lightmap.sources(), &tracer.asset().mesh, lightmap.size);
    (points.sub_points.par_iter())
        .map(|point| {
            // The point is on the surface: the first that is met from just above it.
            let above = point.position + point.geometric_normal * tracer.offset;
            let hit = tracer.closest_hit(above, -point.geometric_normal, 4.0 * tracer.offset);
            let Some(hit) = hit else { return [(0, 0.0); 4] };
            let uv = mesh.interpolate(&mesh.lightmap_uvs, hit.triangle as usize, hit.u, hit.v);
            let place = uv * size as f32 - 0.5;
            let (corner, share) = (place.floor(), place - place.floor());
            [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| {
                let clamp = |c: f32, d: i32| (c as i32 + d).clamp(0, size as i32 - 1) as usize;
                let (x, y) = (clamp(corner.x, dx), clamp(corner.y, dy));
                let along = |share: f32, d: i32| if d == 1 { share } else { 1.0 - share };
                (sources[y * size + x], along(share.x, dx) * along(share.y, dy))
            })
        })
        .collect()
}
