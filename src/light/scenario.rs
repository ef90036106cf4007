//! Scenarios: the distribution that lighting conditions are drawn from. This file holds the settings; [`super::draw`]
//! draws from them.

use std::path::PathBuf;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::EnvironmentError;

/// A distribution of lighting conditions, as a scene file's `[scenario]` describes it. Ranges are `[low, high]`; a value is
/// uniform between them unless said otherwise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scenario {
    /// Lights that shine together in a condition: a whole number within this range. Default `[1, 1]`.
    pub lights_per_condition: [u32; 2],
    /// How often each kind of light is drawn, relative to the others. Default: spot lights alone.
    pub kinds: KindWeights,
    /// Where all lights but distant ones stand. Default `"near"`.
    pub position: Position,
    /// What spot lights, rectangles and disks shine at. Default `"surface"`.
    pub aim: Aim,
    /// Where directional lights come from. Default `"above"`.
    pub sky: Sky,
    /// Radians from a spot light's axis beyond which there is no light. Default `[0.35, 0.7]`, that is 20° to 40°.
    pub outer_cone_angle: [f32; 2],
    /// A spot light's inner cone angle as a fraction of its outer one. Default `[0.5, 0.9]`.
    pub inner_cone: [f32; 2],
    /// Intensity of lights that stand somewhere, candela, uniform in its logarithm: that along the axis for rectangles and
    /// disks. Default: about one lux × π at half the asset's extent, within a factor of two.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub intensity: Option<[f32; 2]>,
    /// Illuminance of distant lights, lux, uniform in its logarithm: of directional ones on a surface that faces them, of
    /// skies with their sun on level ground, of environments their mean radiance times π. Default `[1.5, 6.0]`: about π
    /// within a factor of two.
    pub illuminance: [f32; 2],
    /// Colours of the lights. Default `"white"`.
    pub color: Color,
    /// Metres between a light's middle and the nearest surface, at least. Default: one twentieth of the asset's extent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clearance: Option<f32>,
    /// Width and height of rectangles and diameter of disks and spheres, metres, uniform in the logarithm. Default: from one
    /// twentieth to one fifth of the asset's extent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size: Option<[f32; 2]>,
    /// Environments, one of which each environment light shows, turned at random: .hdr or .exr files, relative to the scene
    /// file.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub environments: Vec<PathBuf>,
    /// Radians of the sun of skies above the horizon; it stands in any direction. Default `[0.1, 1.4]`.
    pub sun_elevation: [f32; 2],
    /// Turbidity of skies: 2 is very clear, 6 hazy. Default `[2.0, 6.0]`.
    pub turbidity: [f32; 2],
    /// What the ground under skies reflects. Default `[0.1, 0.3]`.
    pub ground_albedo: [f32; 2],
    /// What the emission of the asset's own surfaces is multiplied with, uniform in its logarithm. Default `[0.5, 2.0]`.
    pub emission: [f32; 2],
}

/// Weights of the kinds of light; those not named are not drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KindWeights {
    pub point: f32,
    pub spot: f32,
    pub directional: f32,
    pub rect: f32,
    pub disk: f32,
    pub sphere: f32,
    /// One of the scenario's environments.
    pub environment: f32,
    /// A clear sky with its sun.
    pub sky: f32,
    /// The asset's own emissive surfaces.
    pub emissive: f32,
}

/// The kinds of light that are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Directional,
    Point,
    Spot,
    Rect,
    Disk,
    Sphere,
    Environment,
    Sky,
    Emissive,
}

impl Kind {
    /// Its name in scene files.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Directional => "directional",
            Kind::Point => "point",
            Kind::Spot => "spot",
            Kind::Rect => "rect",
            Kind::Disk => "disk",
            Kind::Sphere => "sphere",
            Kind::Environment => "environment",
            Kind::Sky => "sky",
            Kind::Emissive => "emissive",
        }
    }
}

impl KindWeights {
    /// One kind alone.
    pub fn only(kind: Kind) -> Self {
        let mut weights = Self::default();
        let weight = match kind {
            Kind::Directional => &mut weights.directional,
            Kind::Point => &mut weights.point,
            Kind::Spot => &mut weights.spot,
            Kind::Rect => &mut weights.rect,
            Kind::Disk => &mut weights.disk,
            Kind::Sphere => &mut weights.sphere,
            Kind::Environment => &mut weights.environment,
            Kind::Sky => &mut weights.sky,
            Kind::Emissive => &mut weights.emissive,
        };
        *weight = 1.0;
        weights
    }

    /// Every kind and its weight.
    pub fn all(&self) -> [(Kind, f32); 9] {
        [
            (Kind::Directional, self.directional),
            (Kind::Point, self.point),
            (Kind::Spot, self.spot),
            (Kind::Rect, self.rect),
            (Kind::Disk, self.disk),
            (Kind::Sphere, self.sphere),
            (Kind::Environment, self.environment),
            (Kind::Sky, self.sky),
            (Kind::Emissive, self.emissive),
        ]
    }
}

/// Distribution of positions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Position {
    /// `"near"`: uniform in the asset's bounding box, grown by half its extent to the sides and upwards. Positions behind
    /// one-sided surfaces are never taken, so that lights stay in a room and stand around a thing.
    Near,
    /// `"inside"`: uniform in the asset's bounding box.
    Inside,
    /// `{ around = { radius = [1.2, 2.0], above = true } }`: uniform by volume in a shell about the centre of the
    /// asset's bounds. `radius` is in units of the bounds' half diagonal; `above` keeps to the upper half (default).
    Around {
        radius: [f32; 2],
        #[serde(default = "yes")]
        above: bool,
    },
    /// `{ box = { min = [x, y, z], max = [x, y, z] } }`: uniform in a box, metres.
    Box { min: Vec3, max: Vec3 },
}

fn yes() -> bool {
    true
}

/// Distribution of spot directions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Aim {
    /// `"surface"`: at a point of the asset, uniform by area.
    Surface,
    /// `"bounds"`: at a point of the asset's bounding box.
    Bounds,
    /// `"any"`: every direction alike.
    Any,
    /// `{ box = { min = [x, y, z], max = [x, y, z] } }`: at a point of a box, metres.
    Box { min: Vec3, max: Vec3 },
}

/// Distribution of the directions that directional lights come from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sky {
    /// `"above"`: uniform over the upper hemisphere.
    Above,
    /// `"everywhere"`: uniform over the sphere.
    Everywhere,
}

/// Distribution of colours, linear Rec. 709, the greatest channel 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Color {
    /// `"white"`
    White,
    /// `{ random = { hue = [0, 1], saturation = [0.2, 0.8] } }`: hue in turns from red over green.
    Random {
        #[serde(default = "unit_range")]
        hue: [f32; 2],
        #[serde(default = "unit_range")]
        saturation: [f32; 2],
    },
}

fn unit_range() -> [f32; 2] {
    [0.0, 1.0]
}

impl Default for Scenario {
    fn default() -> Self {
        Self {
            lights_per_condition: [1, 1],
            kinds: KindWeights { spot: 1.0, ..Default::default() },
            position: Position::Near,
            aim: Aim::Surface,
            sky: Sky::Above,
            outer_cone_angle: [0.35, 0.7],
            inner_cone: [0.5, 0.9],
            intensity: None,
            illuminance: [1.5, 6.0],
            color: Color::White,
            clearance: None,
            size: None,
            environments: Vec::new(),
            sun_elevation: [0.1, 1.4],
            turbidity: [2.0, 6.0],
            ground_albedo: [0.1, 0.3],
            emission: [0.5, 2.0],
        }
    }
}

/// Why a scenario cannot be drawn from.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ScenarioError {
    #[error("scenario: {0}")]
    Environment(#[from] EnvironmentError),
    #[error("scenario: `kinds.emissive` is positive, but nothing of the asset emits")]
    NothingEmits,
    #[error("scenario: `{setting}` is {found}; expected {expected}")]
    Setting { setting: &'static str, found: String, expected: &'static str },
    #[error(
        "scenario: no room for a light: of {tries} positions drawn from `position` ({position}), {too_near} were within \
         `clearance` = {clearance} m of a surface and {inside_solid} inside a solid or behind the surface; lower \
         `clearance` or move `position`"
    )]
    NoRoom { tries: u32, position: String, too_near: u32, inside_solid: u32, clearance: f32 },
    #[error("scenario: the asset has no surface that lights could shine on")]
    NoSurface,
}

impl Scenario {
    /// Checks every setting by itself.
    ///
    /// # Errors
    /// [`ScenarioError::Setting`] names the first that is out of range.
    pub fn validate(&self) -> Result<(), ScenarioError> {
        let [fewest, most] = self.lights_per_condition;
        if fewest == 0 || most < fewest || most > MOST_LIGHTS {
            return wrong(
                "lights_per_condition",
                self.lights_per_condition,
                "[low, high] with 1 <= low <= high <= 1024",
            );
        }
        let weights = self.kinds.all().map(|(_, weight)| weight);
        if !weights.iter().all(|w| w.is_finite() && *w >= 0.0) || weights.iter().sum::<f32>() <= 0.0 {
            return wrong("kinds", self.kinds, "weights >= 0, one of them positive");
        }
        if self.kinds.environment > 0.0 && self.environments.is_empty() {
            return wrong("environments", &self.environments, "a list of .hdr or .exr files for `kinds.environment`");
        }
        if let Some(path) = self.environments.iter().find(|path| path.to_str().is_none()) {
            return wrong("environments", path, "names in UTF-8; rename the file");
        }
        range(
            "outer_cone_angle",
            self.outer_cone_angle,
            1e-3,
            std::f32::consts::FRAC_PI_2,
            "radians in 0.001 to pi/2",
        )?;
        range("inner_cone", self.inner_cone, 0.0, 1.0, "fractions in 0 to 1")?;
        range("illuminance", self.illuminance, f32::MIN_POSITIVE, f32::MAX, "positive lux")?;
        range("sun_elevation", self.sun_elevation, 0.0, std::f32::consts::FRAC_PI_2, "radians in 0 to pi/2")?;
        range("turbidity", self.turbidity, 1.7, 10.0, "turbidities in 1.7 to 10")?;
        range("ground_albedo", self.ground_albedo, 0.0, 1.0, "fractions in 0 to 1")?;
        range("emission", self.emission, f32::MIN_POSITIVE, f32::MAX, "positive factors")?;
        if let Some(size) = self.size {
            range("size", size, f32::MIN_POSITIVE, f32::MAX, "positive metres")?;
        }
        if let Some(intensity) = self.intensity {
            range("intensity", intensity, f32::MIN_POSITIVE, f32::MAX, "positive candela")?;
        }
        if let Color::Random { hue, saturation } = self.color {
            range("color.hue", hue, 0.0, 1.0, "turns in 0 to 1")?;
            range("color.saturation", saturation, 0.0, 1.0, "fractions in 0 to 1")?;
        }
        if let Some(clearance) = self.clearance.filter(|c| !(c.is_finite() && *c >= 0.0)) {
            return wrong("clearance", clearance, "metres >= 0");
        }
        match self.position {
            Position::Near | Position::Inside => {}
            Position::Around { radius, .. } => range("position.around.radius", radius, 0.0, 1e6, "multiples >= 0")?,
            Position::Box { min, max } => corners("position.box", min, max)?,
        }
        match self.aim {
            Aim::Box { min, max } => corners("aim.box", min, max),
            _ => Ok(()),
        }
    }
}

/// More than these in one condition are a mistake.
const MOST_LIGHTS: u32 = 1024;

fn wrong<T>(setting: &'static str, found: impl std::fmt::Debug, expected: &'static str) -> Result<T, ScenarioError> {
    Err(ScenarioError::Setting { setting, found: format!("{found:?}"), expected })
}

fn range(
    setting: &'static str,
    [low, high]: [f32; 2],
    least: f32,
    most: f32,
    expected: &'static str,
) -> Result<(), ScenarioError> {
    // Written so that NaN fails.
    if least <= low && low <= high && high <= most { Ok(()) } else { wrong(setting, [low, high], expected) }
}

fn corners(setting: &'static str, min: Vec3, max: Vec3) -> Result<(), ScenarioError> {
    if min.is_finite() && max.is_finite() && min.cmple(max).all() {
        return Ok(());
    }
    wrong(setting, (min.to_array(), max.to_array()), "finite corners (min, max) with min <= max on each axis")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_file_names_each_distribution() {
        let scenario: Scenario = toml::from_str(
            r#"
            lights_per_condition = [1, 3]
            kinds = { spot = 3, directional = 1 }
            position = { around = { radius = [1.2, 2.0] } }
            aim = { box = { min = [0, 0, 0], max = [1, 1, 1] } }
            color = { random = { saturation = [0.2, 0.8] } }
            intensity = [10, 20]
            clearance = 0.3
            "#,
        )
        .unwrap();
        assert_eq!(scenario.kinds, KindWeights { spot: 3.0, directional: 1.0, ..Default::default() });
        assert_eq!(scenario.position, Position::Around { radius: [1.2, 2.0], above: true });
        assert_eq!(scenario.color, Color::Random { hue: [0.0, 1.0], saturation: [0.2, 0.8] });
        assert_eq!(scenario.sky, Sky::Above);
        scenario.validate().unwrap();
        assert_eq!(toml::from_str::<Scenario>("").unwrap(), Scenario::default());
        assert_eq!(toml::from_str::<Scenario>("position = \"near\"").unwrap(), Scenario::default());
    }

    #[test]
    fn a_mistyped_setting_is_named() {
        let error = toml::from_str::<Scenario>("clearence = 0.3").unwrap_err().to_string();
        assert!(error.contains("clearence") && error.contains("clearance"), "{error}");
    }

    #[test]
    fn settings_out_of_range_are_named() {
        for (text, setting) in [
            ("lights_per_condition = [0, 1]", "lights_per_condition"),
            ("kinds = { spot = 0 }", "kinds"),
            ("kinds = { spot = -1, point = 2 }", "kinds"),
            ("outer_cone_angle = [0.5, 2.0]", "outer_cone_angle"),
            ("inner_cone = [0.9, 0.5]", "inner_cone"),
            ("intensity = [0, 1]", "intensity"),
            ("illuminance = [nan, 1]", "illuminance"),
            ("clearance = -1", "clearance"),
            ("position = { box = { min = [1, 0, 0], max = [0, 1, 1] } }", "position.box"),
            ("color = { random = { hue = [0, 2] } }", "color.hue"),
            ("kinds = { environment = 1 }", "environments"),
            ("size = [0, 1]", "size"),
            ("sun_elevation = [0, 2]", "sun_elevation"),
            ("turbidity = [1, 4]", "turbidity"),
            ("ground_albedo = [0, 2]", "ground_albedo"),
            ("emission = [0, 1]", "emission"),
        ] {
            let error = toml::from_str::<Scenario>(text).unwrap().validate().unwrap_err();
            assert!(matches!(error, ScenarioError::Setting { setting: s, .. } if s == setting), "{text}: {error}");
        }
    }
}
