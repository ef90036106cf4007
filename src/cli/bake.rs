//! `relight bake`: path traces one lighting condition into direct and indirect lightmap layers.

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage};
use serde_json::json;

use super::lights::{LIGHT_HELP, lights};
use super::pipeline::prepare;
use super::settings::Overrides;
use super::{Failure, Reporter};
use crate::dataset::Bytes;
use crate::light::LightingCondition;
use crate::scene::{Finish, Tracer};
use crate::scene_file::SceneFile;
use crate::transport::{bake, bake_direct};

/// Path trace one lighting condition into a lightmap
#[derive(Args)]
pub struct Bake {
    /// A scene file, or a .glb, .gltf or .obj file
    pub scene: PathBuf,
    #[arg(long = "light", value_name = "LIGHT", help = LIGHT_HELP)]
    pub lights: Vec<String>,
    /// Where the lightmap goes: an OpenEXR file with the layers `direct` and `indirect` (irradiance)
    #[arg(short, long, value_name = "EXR")]
    pub output: PathBuf,
    #[command(flatten)]
    pub overrides: Overrides,
}

impl Bake {
    pub fn run(&self, json: Option<&Path>, reporter: &Reporter) -> Result<(), Failure> {
        if self.output.extension().is_none_or(|e| !e.eq_ignore_ascii_case("exr")) {
            return Err(Failure::Input(format!("{}: lightmaps are written as .exr", self.output.display())));
        }
        let mut scene = SceneFile::read(&self.scene)?;
        let place = self.scene.display().to_string();
        self.overrides.apply(&mut scene, &place)?;
        let prepared = prepare(scene, &place, reporter)?;
        let conditions = [LightingCondition { lights: lights(&self.lights, &prepared.asset)? }];
        super::check_output(&self.output)?;
        let tracer = Tracer::new(&prepared.asset);
        let settings = prepared.bake_settings();
        let start = Instant::now();
        let baked = bake(&tracer, &prepared.lightmap, &conditions, &settings, reporter)?;
        let seconds = start.elapsed().as_secs_f64();
        let direct = bake_direct(&tracer, &prepared.lightmap, &conditions, settings.seed, reporter)?;
        let bytes = exr_of(&prepared.finish(&tracer), &direct, &baked.indirect)
            .map_err(|e| Failure::Work(format!("{}: {e}", self.output.display())))?;
        super::write_file(&self.output, &bytes)?;
        let texels = prepared.lightmap.texels.len();
        say!(
            "{texels} texels, {:.1} M rays in {seconds:.2} s, noise {:.2} %",
            baked.rays as f64 * 1e-6,
            baked.noise[0] * 100.0
        );
        say!("wrote {}", self.output.display());
        super::write_json(
            json,
            &json!({
                "seconds": seconds,
                "rays": baked.rays,
                "texels": texels,
                "paths_per_texel": settings.paths,
                "noise": baked.noise[0],
                "peak_bytes": Bytes::peak(),
            }),
        )
    }
}

/// An OpenEXR file with the channels `LAYER.R`, `.G`, `.B` of finished `[texel][channel]` values.
fn exr_of(finish: &Finish, direct: &[f32], indirect: &[f32]) -> exr::error::Result<Vec<u8>> {
    let mut channels = Vec::new();
    // Shadows' edges are not noise.
    for (layer, values, path_traced) in [("direct", direct, false), ("indirect", indirect, true)] {
        for (c, channel) in ["R", "G", "B"].iter().enumerate() {
            let plane: Vec<f32> = values.iter().skip(c).step_by(3).copied().collect();
            let samples = if path_traced { finish.path_traced_pages(&plane) } else { finish.page(&plane) };
            channels.push(AnyChannel::new(format!("{layer}.{channel}").as_str(), FlatSamples::F32(samples)));
        }
    }
    let size = (finish.size, finish.size);
    let channels = AnyChannels::sort(channels.into_iter().collect());
    let layer = Layer::new(size, LayerAttributes::default(), Encoding::FAST_LOSSLESS, channels);
    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer).write().to_buffered(&mut bytes)?;
    Ok(bytes.into_inner())
}
