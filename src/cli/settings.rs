//! Settings of the scene file that the command line can override, under the same names.

use clap::Args;

use super::Failure;
use super::choose::Held;
use crate::dataset::{Bytes, Rendered};
use crate::model::Channels;
use crate::scene::UvPolicy;
use crate::scene_file::{Conditions, MaterialPolicy, SceneFile};
use crate::transfer::Method;
use crate::transport::Integrator;

/// Overrides of the scene file.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Settings (override the scene file)")]
pub struct Overrides {
    /// Side of the lightmap, texels
    #[arg(long)]
    pub size: Option<u32>,
    /// Where the lightmap's charts come from
    #[arg(long)]
    pub uv: Option<UvPolicy>,
    /// Lighting conditions to train on; auto: twice as many as long as that lowers the error by 5 %
    #[arg(long, value_name = "N|auto")]
    pub conditions: Option<Conditions>,
    /// Conditions held out to test on
    #[arg(long)]
    pub held_out: Option<usize>,
    /// Paths per texel, shared by all conditions
    #[arg(long)]
    pub paths: Option<u32>,
    /// How light is carried
    #[arg(long)]
    pub integrator: Option<Integrator>,
    /// Reflections after which a path ends
    #[arg(long)]
    pub max_bounces: Option<u32>,
    /// Whether path traced lightmaps are filtered along equal normals [default: with up to 256 paths]
    #[arg(long)]
    pub denoise: Option<bool>,
    /// Measurement points
    #[arg(long)]
    pub points: Option<usize>,
    /// Sub-points that each point averages [default: so many that there are 4096 in all, from 8 to 64]
    #[arg(long)]
    pub sub_points: Option<usize>,
    /// Basis elements; channels a texel of a local basis [default: 16; 4 for local]
    #[arg(long)]
    pub basis: Option<usize>,
    /// Anchors of a local basis
    #[arg(long)]
    pub anchors: Option<usize>,
    /// Bits of a channel of a local basis, 8 or 16
    #[arg(long)]
    pub bits: Option<u32>,
    /// Whether paths from the texels tell the transfer beforehand, where that is better [default: true]
    #[arg(long)]
    pub prior: Option<bool>,
    /// How basis and transfer are fitted
    #[arg(long)]
    pub method: Option<Method>,
    /// Whether colour channels share the vectors (multi) or have vectors of their own (mono)
    #[arg(long)]
    pub channels: Option<Channels>,
    /// Transfer between γth roots of light, such as 2.2, where contrast is high; two lights then do not add [default: 1, or 2.2
    /// where a trial on training conditions tells that it is better]
    #[arg(long)]
    pub gamma: Option<f32>,
    /// Ridge, relative to trace(DDᵀ)/P
    #[arg(long)]
    pub lambda: Option<f64>,
    /// Largest mean error on held-out lights, a fraction: the smallest model that reaches it is chosen, and status 1 tells where
    /// none does
    #[arg(long, value_name = "FRACTION")]
    pub max_error: Option<f64>,
    /// Most bytes that a run time loads for indirect light, such as 4MiB: the model of the least error that fits is chosen
    #[arg(long, value_name = "BYTES")]
    pub max_bytes: Option<Bytes>,
    /// All randomness comes from this number
    #[arg(long)]
    pub seed: Option<u64>,
    /// Reflection model of the surfaces
    #[arg(long)]
    pub materials: Option<MaterialPolicy>,
}

impl Overrides {
    /// Takes over what a rendered dataset decides: the numbers of conditions, as far as they are not given, and that its
    /// lightmaps are as their renderer left them, unless they are to be filtered.
    pub fn take(&self, scene: &mut SceneFile, rendered: &Rendered) {
        let (training, held_out) = rendered.counts();
        scene.bake.conditions = self.conditions.unwrap_or(Conditions::Count(training));
        scene.bake.held_out = self.held_out.unwrap_or(held_out);
        scene.bake.denoise = Some(self.denoise.unwrap_or(false));
    }

    /// Sizes that are given here are not chosen from a budget.
    pub fn held(&self) -> Held {
        Held { basis: self.basis.is_some(), anchors: self.anchors.is_some(), points: self.points.is_some() }
    }

    /// Applies the overrides to `scene` and checks the result; `place` names the scene in an error.
    pub fn apply(&self, scene: &mut SceneFile, place: &str) -> Result<(), Failure> {
        fn set<T: Clone>(to: &mut T, from: &Option<T>) {
            if let Some(value) = from {
                *to = value.clone();
            }
        }
        set(&mut scene.lightmap.size, &self.size);
        set(&mut scene.lightmap.uv, &self.uv);
        set(&mut scene.bake.conditions, &self.conditions);
        set(&mut scene.bake.held_out, &self.held_out);
        set(&mut scene.bake.paths, &self.paths);
        set(&mut scene.bake.integrator, &self.integrator);
        set(&mut scene.bake.max_bounces, &self.max_bounces);
        set(&mut scene.bake.seed, &self.seed);
        set(&mut scene.points.count, &self.points);
        scene.points.sub_points = self.sub_points.or(scene.points.sub_points);
        set(&mut scene.train.anchors, &self.anchors);
        set(&mut scene.train.bits, &self.bits);
        set(&mut scene.train.prior, &self.prior);
        set(&mut scene.train.method, &self.method);
        set(&mut scene.train.channels, &self.channels);
        set(&mut scene.asset.materials, &self.materials);
        if self.basis.is_some() {
            scene.train.basis = self.basis;
        }
        if self.denoise.is_some() {
            scene.bake.denoise = self.denoise;
        }
        if self.max_error.is_some() {
            scene.train.max_error = self.max_error;
        }
        if self.max_bytes.is_some() {
            scene.train.max_bytes = self.max_bytes;
        }
        if self.gamma.is_some() {
            scene.train.gamma = self.gamma;
        }
        if self.lambda.is_some() {
            scene.train.lambda = self.lambda;
        }
        Ok(scene.check(place)?)
    }
}
