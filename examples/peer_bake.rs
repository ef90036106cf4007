//! Bakes the open Cornell box under spot lights for the comparison with other renderers in `tests/peers/bake_speed.py`.
//!
//!     peer_bake scene FOLDER                    writes what they need, and a converged reference
//!     peer_bake bake FOLDER INTEGRATOR PATHS    times this program's own bake, and holds it against the reference
//!
//! FOLDER/scene.json: `size`, `max_bounces`, `points_per_texel`, `conditions` (each a list of lights as relight writes them)
//! and `meshes` (one a material: `positions`, `normals`, `lightmap_uvs`, `triangles`, `reflectance`, `emission`). Beside it, f32:
//!
//! - texels.f32, `[texel][3]`: index (y · size + x, row 0 at v = 0), area in m², share of the square that is covered
//! - points.f32, `[texel][point][6]`: position and normal of points uniform by area, as the bake draws them
//! - reference.f32, `[texel][channel][condition]`: indirect irradiance in lux, path traced; reference.json has `noise`,
//!   its relative RMSE per condition

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, Parser, Subcommand};
use glam::Vec3;
use relight::dataset::Draw;
use relight::light::scenario::Position;
use relight::light::{LightingCondition, Scenario};
use relight::math::Sampler;
use relight::progress::Silent;
use relight::scene::{Asset, Lightmap, Tracer, UvPolicy, generate, lay_out};
use relight::transport::{BakeSettings, Integrator, bake};
use serde_json::{Value, json};

/// Of everybody's paths; a Cornell box keeps a twentieth of its light after so many.
const MAX_BOUNCES: u32 = 8;
const POINTS_PER_TEXEL: u32 = 64;
const SEED: u64 = 1;
/// Another, so that a path integrator is not held against its own noise.
const REFERENCE_SEED: u64 = 2;

#[derive(Parser)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Scene {
        folder: PathBuf,
        #[arg(long, default_value_t = 8192)]
        reference_paths: u32,
        #[command(flatten)]
        size: Size,
    },
    Bake {
        folder: PathBuf,
        #[arg(value_enum)]
        integrator: Integrator,
        paths: u32,
        #[command(flatten)]
        size: Size,
        #[arg(long, default_value_t = 2)]
        threads: usize,
        /// Bake only so many of the conditions, one at a time, and reckon the time of all from theirs.
        #[arg(long)]
        alone: Option<usize>,
        /// Bakes, of which the fastest counts.
        #[arg(long, default_value_t = 5)]
        repeats: u32,
    },
}

#[derive(Args, Clone, Copy)]
struct Size {
    /// Texels on a side.
    #[arg(long, default_value_t = 128)]
    size: u32,
    #[arg(long, default_value_t = 128)]
    conditions: usize,
}

fn main() -> Result<(), Box<dyn Error>> {
    match Arguments::parse().command {
        Command::Scene { folder, reference_paths, size } => {
            fs::create_dir_all(&folder)?;
            Scene::new(size)?.write(&folder, reference_paths)
        }
        Command::Bake { folder, integrator, paths, size, threads, alone, repeats } => {
            rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
            let settings = BakeSettings { paths, max_bounces: MAX_BOUNCES, seed: SEED, integrator };
            println!("{}", Scene::new(size)?.measure(&folder, &settings, alone, repeats)?);
            Ok(())
        }
    }
}

struct Scene {
    asset: Asset,
    lightmap: Lightmap,
    conditions: Vec<LightingCondition>,
}

impl Scene {
    fn new(size: Size) -> Result<Self, Box<dyn Error>> {
        let mut asset = generate("cornell").ok_or("unknown generator")?;
        lay_out(&mut asset, size.size, UvPolicy::Auto)?;
        let lightmap = Lightmap::new(&asset.mesh, size.size as usize);
        // Inside the box every light shows; hard cones, since every renderer has a ramp of its own.
        let scenario = Scenario { position: Position::Inside, inner_cone: [1.0, 1.0], ..Default::default() };
        let draw = Draw { scenario: &scenario, training: size.conditions, held_out: 0 };
        let conditions = draw.conditions(&Tracer::new(&asset), SEED)?;
        Ok(Self { asset, lightmap, conditions })
    }

    fn write(&self, folder: &Path, reference_paths: u32) -> Result<(), Box<dyn Error>> {
        let scene = json!({
            "size": self.lightmap.size, "max_bounces": MAX_BOUNCES, "points_per_texel": POINTS_PER_TEXEL,
            "conditions": self.conditions.iter().map(|c| &c.lights).collect::<Vec<_>>(),
            "meshes": (0..self.asset.materials.len()).map(|m| self.mesh(m)).collect::<Vec<_>>(),
        });
        let tracer = Tracer::new(&self.asset);
        fs::write(folder.join("scene.json"), scene.to_string())?;
        let texels = 0..self.lightmap.texels.len();
        write_floats(&folder.join("texels.f32"), texels.clone().flat_map(|texel| self.texel(texel)))?;
        write_floats(&folder.join("points.f32"), texels.flat_map(|texel| self.points(texel)))?;

        let about = folder.join("reference.json");
        let key = json!({ "scene": scene, "paths": reference_paths });
        let known: Option<Value> = fs::read(&about).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
        if known.is_some_and(|known| known["key"] == key) {
            return Ok(());
        }
        let integrator = Integrator::Path;
        let settings =
            BakeSettings { paths: reference_paths, max_bounces: MAX_BOUNCES, seed: REFERENCE_SEED, integrator };
        let baked = bake(&tracer, &self.lightmap, &self.conditions, &settings, &Silent)?;
        write_floats(&folder.join("reference.f32"), baked.indirect)?;
        Ok(fs::write(about, json!({ "key": key, "noise": baked.noise }).to_string())?)
    }

    fn mesh(&self, material: usize) -> Value {
        let mesh = &self.asset.mesh;
        let triangles = mesh.triangles.iter().zip(&mesh.triangle_materials);
        let triangles: Vec<_> = triangles.filter(|(_, of)| **of as usize == material).map(|(t, _)| *t).collect();
        json!({
            "positions": mesh.positions, "normals": mesh.normals, "lightmap_uvs": mesh.lightmap_uvs,
            "triangles": triangles, "reflectance": self.asset.materials[material].base_colour.truncate(), "emission": Vec3::ZERO,
        })
    }

    fn texel(&self, texel: usize) -> [f32; 3] {
        let mesh = &self.asset.mesh;
        let covered: f64 = self
            .lightmap
            .fragments(mesh, texel)
            .iter()
            .map(|fragment| {
                let triangle = fragment.triangle as usize;
                let [a, b, c] = mesh.triangles[triangle].map(|v| mesh.lightmap_uvs[v as usize].as_dvec2());
                // Both areas are twice the triangle's.
                let squares = (b - a).perp_dot(c - a).abs() * (self.lightmap.size as f64).powi(2);
                fragment.area_m2 * squares / mesh.triangle_cross(triangle).length() as f64
            })
            .sum();
        let about = self.lightmap.texels[texel];
        [about.index as f32, about.area, covered as f32]
    }

    fn points(&self, texel: usize) -> Vec<f32> {
        let points = self.lightmap.sampler(&self.asset.mesh, texel);
        let point = |i| {
            let mut sampler = Sampler::new(SEED, self.lightmap.texels[texel].index as u64, i);
            let [u0, u1, ..] = sampler.next_4d();
            let point = points.sample([u0, u1]);
            let surface = self.asset.surface(point.triangle as usize, point.u, point.v, Vec3::ZERO);
            [surface.position.to_array(), surface.normal.to_array()].concat()
        };
        (0..POINTS_PER_TEXEL).flat_map(point).collect()
    }

    fn measure(
        &self,
        folder: &Path,
        settings: &BakeSettings,
        alone: Option<usize>,
        repeats: u32,
    ) -> Result<Value, Box<dyn Error>> {
        let tracer = Tracer::new(&self.asset);
        let n = self.conditions.len();
        // Bakes: every condition at once, or some of them, evenly spread, each by itself.
        let bakes: Vec<Vec<usize>> = match alone {
            None => vec![(0..n).collect()],
            Some(count) => (0..count).map(|i| vec![i * n / count]).collect(),
        };
        let scale = n as f64 / bakes.iter().map(Vec::len).sum::<usize>() as f64;
        let (mut seconds, mut cpu_seconds) = (f64::INFINITY, f64::INFINITY);
        let mut indirect = Vec::new();
        for _ in 0..repeats {
            let (start, cpu_start) = (Instant::now(), cpu_seconds_so_far());
            indirect.clear();
            for indices in &bakes {
                let conditions: Vec<_> = indices.iter().map(|&i| self.conditions[i].clone()).collect();
                indirect.push(bake(&tracer, &self.lightmap, &conditions, settings, &Silent)?.indirect);
            }
            seconds = seconds.min(start.elapsed().as_secs_f64() * scale);
            cpu_seconds = cpu_seconds.min((cpu_seconds_so_far() - cpu_start) * scale);
        }
        let mut figures = json!({
            "texels": self.lightmap.texels.len(), "conditions": n, "seconds": seconds, "cpu_seconds": cpu_seconds,
        });
        // The reference serves where it is of these very lights and texels.
        let about: Value = serde_json::from_slice(&fs::read(folder.join("reference.json"))?)?;
        let of = &about["key"]["scene"];
        if of["size"] == self.lightmap.size && of["conditions"].as_array().map(Vec::len) == Some(n) {
            let reference = fs::read(folder.join("reference.f32"))?;
            let reference: Vec<f32> = bytemuck::pod_collect_to_vec(&reference);
            let noise: Vec<f64> = serde_json::from_value(about["noise"].clone())?;
            let errors = bakes.iter().zip(&indirect).flat_map(|(indices, baked)| {
                let columns = indices.iter().enumerate();
                columns.map(|(column, &index)| {
                    let (error, level) = self.error(baked, column, indices.len(), &reference, index);
                    // The reference's own noise is independent of the bake's: their squares add up.
                    ((error * error - noise[index] * noise[index]).max(0.0).sqrt(), level)
                })
            });
            let (errors, levels): (Vec<f64>, Vec<f64>) = errors.unzip();
            figures["errors"] = json!(errors);
            figures["levels"] = json!(levels);
        }
        Ok(figures)
    }

    /// Relative RMSE and relative level of one condition, area weighted.
    fn error(&self, baked: &[f32], column: usize, columns: usize, reference: &[f32], index: usize) -> (f64, f64) {
        let n = self.conditions.len();
        let (mut difference, mut signal, mut sum, mut reference_sum) = (0.0, 0.0, 0.0, 0.0);
        for (texel, about) in self.lightmap.texels.iter().enumerate() {
            for row in 3 * texel..3 * texel + 3 {
                let (b, r) = (baked[row * columns + column] as f64, reference[row * n + index] as f64);
                let area = about.area as f64;
                difference += area * (b - r) * (b - r);
                signal += area * r * r;
                sum += area * b;
                reference_sum += area * r;
            }
        }
        ((difference / signal).sqrt(), sum / reference_sum)
    }
}

fn write_floats(path: &Path, values: impl IntoIterator<Item = f32>) -> std::io::Result<()> {
    fs::write(path, values.into_iter().flat_map(f32::to_le_bytes).collect::<Vec<u8>>())
}

/// Processor time of all threads, to a hundredth of a second; not a number where the system does not tell it as Linux does.
fn cpu_seconds_so_far() -> f64 {
    let ticks = || {
        let stat = fs::read_to_string("/proc/self/stat").ok()?;
        // User and system time, the 14th and 15th field; the second is in parentheses and may hold anything.
        let fields: Vec<f64> =
            stat.rsplit_once(')')?.1.split_whitespace().skip(11).take(2).flat_map(str::parse).collect();
        Some(fields.iter().sum::<f64>())
    };
    ticks().map_or(f64::NAN, |ticks| ticks / 100.0)
}
