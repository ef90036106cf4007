//! The scene file (TOML): the asset, its lightmap, the lights it will meet, and how to bake and train. Every field has a
//! default; `scenes/cornell/scene.toml` shows them all.

use std::path::{Path, PathBuf};

use serde::de::{self, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::dataset::Bytes;
use crate::files::toml_error_line;
use crate::light::Scenario;
use crate::model::Channels;
use crate::scene::{Asset, Camera, SceneError, UvPolicy, generate, load};
use crate::transfer::{Budget, Lambda, Method, Precision};
use crate::transport::Integrator;

#[derive(Debug, thiserror::Error)]
pub enum SceneFileError {
    #[error("{}: cannot be read: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{}: {message}", path.display())]
    Parse { path: PathBuf, message: String },
    #[error("{place}: {message}")]
    Setting { place: String, message: String },
    #[error("{place}: generator \"{name}\" is not known; there are {}", generate::NAMES.join(", "))]
    UnknownGenerator { place: String, name: String },
    #[error("{place}: [asset] needs either `path` or `generator`")]
    NoAsset { place: String },
    #[error(transparent)]
    Asset(#[from] SceneError),
}

/// Everything that a training run depends on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SceneFile {
    pub asset: AssetSettings,
    pub lightmap: LightmapSettings,
    pub scenario: Scenario,
    pub points: PointSettings,
    pub bake: BakeSettings,
    pub train: TrainSettings,
    /// For pictures; the asset's own first camera, or one that sees all of it, where absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<Camera>,
}

/// Where the asset comes from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AssetSettings {
    /// A .gltf, .glb or .obj file; relative to the scene file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub path: Option<PathBuf>,
    /// A built-in asset: cornell, interior or statue.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub generator: Option<String>,
    pub materials: MaterialPolicy,
}

/// Which reflection model is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum MaterialPolicy {
    /// As the file says: metallic-roughness for glTF.
    #[default]
    File,
    /// Every surface reflects diffusely with its base colour.
    Lambert,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LightmapSettings {
    /// Side of the square lightmap, texels.
    pub size: u32,
    /// Which UV set becomes the lightmap's charts.
    pub uv: UvPolicy,
}

impl Default for LightmapSettings {
    fn default() -> Self {
        Self { size: 128, uv: UvPolicy::Auto }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PointSettings {
    /// P, measurement points.
    pub count: usize,
    /// Sub-points that each point averages (paper 5.1); absent: as [`PointSettings::sub_points_at`] says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sub_points: Option<usize>,
}

impl Default for PointSettings {
    fn default() -> Self {
        Self { count: 512, sub_points: None }
    }
}

/// Sub-points of all points together. Few points need them all the more: of light that falls between sub-points nothing is known.
const SUB_POINTS_IN_ALL: usize = 4096;

impl PointSettings {
    /// Sub-points that each point averages.
    pub fn sub_points(&self) -> usize {
        self.sub_points_at(self.count)
    }

    /// Those that each of `count` points averages: what is set, or so many that there are 4,096 in all, from 8 to 64.
    pub fn sub_points_at(&self, count: usize) -> usize {
        self.sub_points.unwrap_or_else(|| (SUB_POINTS_IN_ALL / count.max(1)).clamp(8, 64))
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BakeSettings {
    /// N, lighting conditions to train on; "auto": as many as it takes until twice as many lower the error by less than 5 %.
    pub conditions: Conditions,
    /// Conditions that training never sees, to test on.
    pub held_out: usize,
    /// Paths per texel, shared by all conditions.
    pub paths: u32,
    /// Reflections after which a path ends whatever it carries.
    pub max_bounces: u32,
    /// Whether path traced lightmaps are filtered along equal normals; absent: with up to [`NOISY_PATHS`] paths.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub denoise: Option<bool>,
    /// All randomness comes from this number.
    pub seed: u64,
    /// How light is carried; `auto`: `gather` where every material is diffuse, else `path`.
    pub integrator: Integrator,
}

/// Most conditions that can be asked for.
pub const MOST_CONDITIONS: usize = 65536;

/// Conditions that `auto` begins with.
const FIRST_CONDITIONS: usize = 64;

/// How many conditions to train on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Conditions {
    Count(usize),
    /// As many as it takes.
    Auto,
}

impl Conditions {
    /// Their number, or what `auto` begins with.
    pub fn first(self) -> usize {
        match self {
            Conditions::Count(count) => count,
            Conditions::Auto => FIRST_CONDITIONS,
        }
    }
}

impl std::str::FromStr for Conditions {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse() {
            Ok(count) => Ok(Conditions::Count(count)),
            Err(_) if text == "auto" => Ok(Conditions::Auto),
            Err(_) => Err("expected a number or \"auto\"".to_owned()),
        }
    }
}

impl Serialize for Conditions {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Conditions::Count(count) => count.serialize(serializer),
            Conditions::Auto => "auto".serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Conditions {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NumberOrWord;
        impl Visitor<'_> for NumberOrWord {
            type Value = Conditions;

            fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
                f.write_str("a number or \"auto\"")
            }

            fn visit_i64<E: de::Error>(self, count: i64) -> Result<Conditions, E> {
                let wrong = |_| E::invalid_value(de::Unexpected::Signed(count), &self);
                usize::try_from(count).map(Conditions::Count).map_err(wrong)
            }

            fn visit_u64<E: de::Error>(self, count: u64) -> Result<Conditions, E> {
                let wrong = |_| E::invalid_value(de::Unexpected::Unsigned(count), &self);
                usize::try_from(count).map(Conditions::Count).map_err(wrong)
            }

            fn visit_str<E: de::Error>(self, word: &str) -> Result<Conditions, E> {
                let wrong = |_| E::invalid_value(de::Unexpected::Str(word), &self);
                word.parse().map_err(wrong)
            }
        }
        deserializer.deserialize_any(NumberOrWord)
    }
}

/// Paths a texel up to which the filter was measured to lower the error in every built-in scene.
const NOISY_PATHS: u32 = 256;

impl BakeSettings {
    pub fn with_conditions(&self, count: usize) -> Self {
        Self { conditions: Conditions::Count(count), ..self.clone() }
    }

    /// Whether path traced lightmaps are filtered.
    pub fn denoises(&self) -> bool {
        self.denoise.unwrap_or(self.paths <= NOISY_PATHS)
    }
}

impl Default for BakeSettings {
    fn default() -> Self {
        Self {
            conditions: Conditions::Count(256),
            held_out: 128,
            paths: 256,
            max_bounces: 32,
            denoise: None,
            seed: 1,
            integrator: Integrator::Auto,
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainSettings {
    pub method: Method,
    /// n, basis elements, of which the mean counts as one for `belcour`; channels a texel for `local`. Absent: 4 for `local`,
    /// else 16.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub basis: Option<usize>,
    pub channels: Channels,
    /// λ relative to trace(DDᵀ)/P; absent: the published value for `belcour`, else leave-one-out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lambda: Option<f64>,
    /// Anchors of `local`, between which coefficients are interpolated.
    pub anchors: usize,
    /// Bits of a channel of `local`: 8 or 16.
    pub bits: u32,
    /// γ: D and I are raised to 1/γ before the fit, what is relit to γ (paper 5.3); absent: 1, or 2.2 where a trial tells that
    /// it is better; for `belcour` always 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gamma: Option<f32>,
    /// Whether paths from the texels tell the transfer of `linear` and `local` beforehand, where that lowers the
    /// leave-one-out error.
    pub prior: bool,
    /// A mean held-out error, as a fraction: n, K and P are chosen, the smallest that reach it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_error: Option<f64>,
    /// Bytes that a run time loads: n, K and P are chosen, those of the least error that fit, or the smallest that reach `max_error`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_bytes: Option<Bytes>,
}

impl Default for TrainSettings {
    fn default() -> Self {
        Self {
            method: Method::Local,
            basis: None,
            channels: Channels::Mono,
            lambda: None,
            anchors: 128,
            bits: 8,
            gamma: None,
            prior: true,
            max_error: None,
            max_bytes: None,
        }
    }
}

/// Most channels a texel of `local`: beyond, a global basis is as good.
const MOST_CHANNELS: usize = 16;

impl TrainSettings {
    /// n.
    pub fn elements(&self) -> usize {
        self.basis.unwrap_or(if self.method == Method::Local { 4 } else { 16 })
    }

    /// γ; 1 where none is given.
    pub fn gamma(&self) -> f32 {
        self.gamma.unwrap_or(1.0)
    }

    pub fn budget(&self) -> Budget {
        Budget { max_error: self.max_error, max_bytes: self.max_bytes.map(|b| b.0) }
    }

    /// The same with other sizes.
    pub fn with_sizes(&self, basis: usize, anchors: usize) -> Self {
        Self { basis: Some(basis), anchors, ..self.clone() }
    }

    pub fn precision(&self) -> Precision {
        if self.bits == 8 { Precision::Byte } else { Precision::Half }
    }

    /// The λ that the settings mean for `method`.
    pub fn lambda_for(&self, method: Method) -> Lambda {
        match (self.lambda, method) {
            (Some(value), _) => Lambda::Relative(value),
            (None, Method::Linear | Method::Local) => Lambda::LeaveOneOut,
            (None, Method::Belcour) => crate::transfer::PUBLISHED_LAMBDA,
        }
    }
}

/// The Cornell box that a run without arguments trains on.
const CORNELL: &str = include_str!("../scenes/cornell/scene.toml");

impl SceneFile {
    /// The built-in Cornell box.
    pub fn cornell() -> Self {
        toml::from_str(CORNELL).expect("scenes/cornell/scene.toml is held valid by a test")
    }

    /// Reads `path`: a scene file, or an asset for which everything else is defaulted (spot lights around its bounds).
    ///
    /// # Errors
    /// One line that names the file, the setting and what was expected.
    pub fn read(path: &Path) -> Result<Self, SceneFileError> {
        if path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("toml")) {
            return Ok(Self {
                asset: AssetSettings { path: Some(path.to_owned()), ..Default::default() },
                ..Self::default()
            });
        }
        let text =
            std::fs::read_to_string(path).map_err(|source| SceneFileError::Read { path: path.to_owned(), source })?;
        let mut scene: Self = toml::from_str(&text)
            .map_err(|e| SceneFileError::Parse { path: path.to_owned(), message: toml_error_line(&text, &e) })?;
        // Paths in the file are relative to it.
        if let Some(folder) = path.parent() {
            for place in scene.asset.path.iter_mut().chain(&mut scene.scenario.environments) {
                *place = folder.join(&place);
            }
        }
        Ok(scene)
    }

    /// What is wrong with the settings, if anything, as one line. `place` names where they come from.
    pub fn check(&self, place: &str) -> Result<(), SceneFileError> {
        let limits = [
            ("lightmap.size", self.lightmap.size as u64, 8, 8192),
            ("points.count", self.points.count as u64, 1, 65536),
            ("points.sub_points", self.points.sub_points() as u64, 1, 256),
            ("bake.conditions", self.bake.conditions.first() as u64, 1, MOST_CONDITIONS as u64),
            ("bake.held_out", self.bake.held_out as u64, 1, 65536),
            ("bake.paths", self.bake.paths as u64, 1, 1 << 20),
            ("bake.max_bounces", self.bake.max_bounces as u64, 1, 1024),
            ("train.basis", self.train.elements() as u64, 1, 1024),
            ("train.anchors", self.train.anchors as u64, 1, 256),
        ];
        let error = |message: String| SceneFileError::Setting { place: place.to_owned(), message };
        for (name, value, least, most) in limits {
            if !(least..=most).contains(&value) {
                return Err(error(format!("{name} = {value} must be from {least} to {most}")));
            }
        }
        if self.train.method == Method::Local && self.train.elements() > MOST_CHANNELS {
            let channels = self.train.elements();
            return Err(error(format!("train.basis = {channels} channels a texel; `local` has 1 to {MOST_CHANNELS}")));
        }
        if ![8, 16].contains(&self.train.bits) {
            return Err(error(format!("train.bits = {} must be 8 or 16", self.train.bits)));
        }
        if let Some(lambda) = self.train.lambda
            && !(lambda.is_finite() && lambda >= 0.0)
        {
            return Err(error(format!("train.lambda = {lambda} must be finite and not negative")));
        }
        if let Some(most) = self.train.max_error
            && !(most > 0.0 && most < 1.0)
        {
            return Err(error(format!(
                "train.max_error = {most} must be above 0 and below 1: it is a fraction, 0.05 is 5 %"
            )));
        }
        if let Some(gamma) = self.train.gamma
            && !(0.2..=5.0).contains(&gamma)
        {
            return Err(error(format!(
                "train.gamma = {gamma} must be from 0.2 to 5; 1 is linear light, the paper has 2.2"
            )));
        }
        if self.train.budget().is_given() && self.train.gamma.is_some_and(|gamma| gamma != 1.0) {
            return Err(error(
                "train.max_error and train.max_bytes choose sizes in linear light: leave train.gamma out, or give --basis \
                 and --points"
                    .to_owned(),
            ));
        }
        if self.train.budget().is_given() && self.train.method == Method::Belcour {
            return Err(error(
                "train.max_error and train.max_bytes choose sizes of `local` and `linear`; `belcour` is kept as published: \
                 give --basis and --points"
                    .to_owned(),
            ));
        }
        if let Some(camera) = &self.camera {
            camera.check().map_err(|why| error(format!("camera: {why}")))?;
        }
        // The model carries its settings as TOML, which is UTF-8.
        if let Some(path) = self.asset.path.as_deref().filter(|path| path.to_str().is_none()) {
            return Err(error(format!("the asset's path {} is not UTF-8; rename the file", path.display())));
        }
        Ok(())
    }

    /// Loads or generates the asset, with the scene's material policy and camera applied. `place` names the settings in an
    /// error.
    pub fn load_asset(&self, place: &str) -> Result<Asset, SceneFileError> {
        let mut asset = match (&self.asset.path, &self.asset.generator) {
            (Some(path), None) => load(path)?,
            (None, Some(name)) => generate::generate(name)
                .ok_or_else(|| SceneFileError::UnknownGenerator { place: place.to_owned(), name: name.clone() })?,
            _ => return Err(SceneFileError::NoAsset { place: place.to_owned() }),
        };
        if self.asset.materials == MaterialPolicy::Lambert {
            asset.make_lambert();
        }
        if let Some(camera) = &self.camera {
            asset.cameras.insert(0, camera.clone());
        }
        if asset.cameras.is_empty() {
            asset.cameras.push(Camera::that_sees(&asset.mesh.bounds()));
        }
        Ok(asset)
    }
}
