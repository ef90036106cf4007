//! Lights whose values change over time: what `relight render --path` renders and the window plays.

use std::collections::BTreeMap;
use std::f32::consts::TAU;
use std::path::Path;

use glam::{Quat, Vec3};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::track::{Interpolation, Track, number};
use super::{EnvironmentImage, EnvironmentImages, Light};
use crate::files::read_words;

/// What is wrong with a path, in one line.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LightPathError {
    #[error("no light is given")]
    Empty,
    #[error("duration {0} must be finite and positive")]
    Duration(f32),
    #[error("a keyframe at {key} s lies after the end, {duration} s")]
    AfterEnd { key: f32, duration: f32 },
    #[error("light {light}: {why}")]
    Light { light: usize, why: String },
    #[error("light {light} at {seconds} s: {why}")]
    Moment { light: usize, seconds: f32, why: String },
}

/// Some lights over time. It begins anew after its duration.
#[derive(Clone, Debug, PartialEq)]
pub struct LightPath {
    interpolation: Interpolation,
    /// Seconds.
    duration: f32,
    lights: Vec<Moving>,
}

/// A light, with keyframes for some of its values.
#[derive(Clone, Debug, PartialEq)]
struct Moving {
    /// In the words of [`Light`]; for values that have keyframes, the first one.
    words: Map<String, Value>,
    tracks: BTreeMap<String, Track>,
    /// Of an environment, once it is read.
    image: Option<EnvironmentImage>,
}

/// As in a file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Words {
    #[serde(default)]
    interpolation: Interpolation,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    duration: Option<f32>,
    lights: Vec<Map<String, Value>>,
}

impl LightPath {
    /// Reads a TOML or JSON file: `lights` in the words of [`Light`], in which a value may be a list of keyframes,
    /// `{ time, value }`; and optionally `duration` in seconds and `interpolation`. Images are read, too.
    ///
    /// # Errors
    /// One line that names the file, the light and the value.
    pub fn read(file: &Path, images: &mut EnvironmentImages) -> Result<Self, String> {
        let words: Words = read_words(file)?;
        let mut path = Self::new(words).map_err(|why| format!("{}: {why}", file.display()))?;
        for moving in &mut path.lights {
            // Paths in a file are relative to it.
            let mut light = moving.at(0.0, path.interpolation, path.duration).unwrap_or(Light::Emissive { scale: 0.0 });
            images.ready(&mut light, file.parent().unwrap_or(Path::new(""))).map_err(|e| e.to_string())?;
            moving.keep_image(&light);
        }
        Ok(path)
    }

    fn new(words: Words) -> Result<Self, LightPathError> {
        let Words { interpolation, duration, lights } = words;
        if lights.is_empty() {
            return Err(LightPathError::Empty);
        }
        let mut moving = Vec::new();
        for (words, light) in lights.into_iter().zip(1..) {
            let read = Moving::read(words).map_err(|why| LightPathError::Light { light, why })?;
            for (name, track) in &read.tracks {
                if interpolation != Interpolation::Step
                    && let Some(key) = track.unclear_turn()
                {
                    let next = key + 1;
                    let why = format!(
                        "{name}: keyframes {key} and {next} are opposite; one between them must say which way it turns"
                    );
                    return Err(LightPathError::Light { light, why });
                }
            }
            moving.push(read);
        }
        let mut path = Self { interpolation, duration: 0.0, lights: moving };
        let times = path.times();
        let last = times.last().copied().unwrap_or(0.0);
        // Where nothing moves, any duration will do.
        path.duration = duration.unwrap_or(if last > 0.0 { last } else { 1.0 });
        if !(path.duration.is_finite() && path.duration > 0.0) {
            return Err(LightPathError::Duration(path.duration));
        }
        if last > path.duration {
            return Err(LightPathError::AfterEnd { key: last, duration: path.duration });
        }
        // What is wrong with a light at all times is said first, and without one.
        for (moving, light) in path.lights.iter().zip(1..) {
            moving.at(0.0, interpolation, path.duration).map_err(|why| LightPathError::Light { light, why })?;
        }
        times.into_iter().try_for_each(|seconds| path.at(seconds).map(|_| ()))?;
        Ok(path)
    }

    /// These lights as they are.
    pub fn still(lights: &[Light], duration: f32) -> Self {
        Self { interpolation: Interpolation::default(), duration, lights: lights.iter().map(Moving::still).collect() }
    }

    /// These lights, one of which goes once around the vertical axis through `centre`, and shines there as seen from it.
    pub fn around(lights: &[Light], goes: usize, centre: Vec3, duration: f32) -> Self {
        const STEPS: usize = 16;
        let mut path = Self::still(lights, duration);
        let mut turned = lights.to_vec();
        for step in 1..=STEPS {
            let share = step as f32 / STEPS as f32;
            // The same to the last bit at the end.
            let turn = Quat::from_rotation_y((share % 1.0) * TAU);
            let mut light = lights[goes].clone();
            match &mut light {
                Light::Environment { rotation, .. } => *rotation += share * TAU,
                Light::Sky(sky) => sky.sun_azimuth -= share * TAU,
                light => {
                    if let Some(position) = light.position_mut() {
                        *position = centre + turn * (*position - centre);
                    }
                    if let Some(direction) = light.direction_mut() {
                        *direction = turn * *direction;
                    }
                }
            }
            turned[goes] = light;
            path.set_key(share * duration, &turned);
        }
        path
    }

    /// Seconds.
    pub fn duration(&self) -> f32 {
        self.duration
    }

    /// Makes it this long, but not shorter than its last keyframe's time.
    pub fn set_duration(&mut self, seconds: f32) {
        self.duration = seconds.max(self.times().last().copied().unwrap_or(0.0)).max(1e-3);
    }

    /// Whether any value has two keyframes.
    pub fn moves(&self) -> bool {
        self.lights.iter().flat_map(|light| light.tracks.values()).any(|track| track.times().count() > 1)
    }

    /// The times of all keyframes, in order, each once.
    pub fn times(&self) -> Vec<f32> {
        let mut times: Vec<f32> =
            self.lights.iter().flat_map(|light| light.tracks.values()).flat_map(Track::times).collect();
        times.sort_by(f32::total_cmp);
        times.dedup();
        times
    }

    /// The lights at a time.
    ///
    /// # Errors
    /// Where values do not go together half way between keyframes, such as the two angles of a spot.
    pub fn at(&self, seconds: f32) -> Result<Vec<Light>, LightPathError> {
        let lights = self.lights.iter().zip(1..).map(|(moving, light)| {
            let moment = |why| LightPathError::Moment { light, seconds, why };
            moving.at(seconds, self.interpolation, self.duration).map_err(moment)
        });
        lights.collect()
    }

    /// Gives all values in which `lights` differ from the path at that time a keyframe there; a value that had none keeps what
    /// it had as a keyframe at 0 s. Lights of another number or of other kinds begin a path of their own.
    pub fn set_key(&mut self, seconds: f32, lights: &[Light]) {
        let seconds = seconds.clamp(0.0, self.duration);
        let targets: Vec<Moving> = lights.iter().map(Moving::still).collect();
        let alike = |(a, b): (&Moving, &Moving)| a.words.get("type") == b.words.get("type");
        if targets.len() != self.lights.len() || !self.lights.iter().zip(&targets).all(alike) {
            self.lights = targets;
            return;
        }
        for (moving, target) in self.lights.iter_mut().zip(targets) {
            // Such as a range that was taken away.
            moving.words.retain(|name, _| target.words.contains_key(name));
            moving.tracks.retain(|name, _| target.words.contains_key(name));
            for (name, value) in target.words {
                let now = moving.value_at(&name, seconds, self.interpolation, self.duration);
                if now.as_ref() == Some(&value) {
                    continue;
                }
                let known = moving.tracks.get_mut(&name);
                let first = || now.as_ref().and_then(|now| Track::new(&name, 0.0, now));
                let set = match known {
                    Some(track) => track.set(seconds, &value),
                    None if seconds > 0.0 => first().is_some_and(|mut track| {
                        let fits = track.set(seconds, &value);
                        moving.tracks.insert(name.clone(), track);
                        fits
                    }),
                    None => false,
                };
                if !set {
                    moving.tracks.remove(&name);
                    moving.words.insert(name, value);
                }
            }
            moving.image = target.image;
        }
    }

    /// As TOML that [`Self::read`] reads from anywhere: places of images are absolute.
    pub fn to_toml(&self) -> Result<String, String> {
        let lights = self.lights.iter().map(Moving::written).collect();
        let words = Words { interpolation: self.interpolation, duration: Some(self.duration), lights };
        toml::to_string(&words).map_err(|e| e.to_string())
    }
}

impl Moving {
    fn read(mut words: Map<String, Value>) -> Result<Self, String> {
        let mut tracks = BTreeMap::new();
        for (name, value) in &mut words {
            if let Value::Array(keys) = value
                && keys.first().is_some_and(Value::is_object)
            {
                let track = Track::read(name, keys)?;
                *value = track.at(0.0, Interpolation::Step, f32::INFINITY);
                tracks.insert(name.clone(), track);
            } else if has_null(value) {
                // What TOML calls nan or inf.
                return Err(format!("{name} is not finite"));
            }
        }
        Ok(Self { words, tracks, image: None })
    }

    fn still(light: &Light) -> Self {
        let words = match serde_json::to_value(light) {
            Ok(Value::Object(words)) => words.into_iter().map(|(name, value)| (name, short(value))).collect(),
            _ => Map::new(),
        };
        let mut moving = Self { words, tracks: BTreeMap::new(), image: None };
        moving.keep_image(light);
        moving
    }

    fn keep_image(&mut self, light: &Light) {
        if let Light::Environment { image, .. } = light {
            self.image = Some(image.clone());
        }
    }

    fn value_at(&self, name: &str, seconds: f32, how: Interpolation, duration: f32) -> Option<Value> {
        let of_track = self.tracks.get(name).map(|track| track.at(seconds, how, duration));
        of_track.or_else(|| self.words.get(name).cloned())
    }

    fn at(&self, seconds: f32, how: Interpolation, duration: f32) -> Result<Light, String> {
        let mut words = self.words.clone();
        for (name, track) in &self.tracks {
            words.insert(name.clone(), track.at(seconds, how, duration));
        }
        let mut light: Light = serde_json::from_value(Value::Object(words)).map_err(|e| e.to_string())?;
        if let (Light::Environment { image, .. }, Some(read)) = (&mut light, &self.image) {
            *image = read.clone();
        }
        light.validated()
    }

    fn written(&self) -> Map<String, Value> {
        let mut words = self.words.clone();
        for (name, track) in &self.tracks {
            words.insert(name.clone(), track.written());
        }
        if let Some(Ok(place)) = self.image.as_ref().map(|image| std::path::absolute(image.path())) {
            words.insert("image".into(), Value::String(place.to_string_lossy().into_owned()));
        }
        words
    }
}

fn has_null(value: &Value) -> bool {
    match value {
        Value::Null => true,
        Value::Array(list) => list.iter().any(has_null),
        _ => false,
    }
}

/// Numbers of f32 as people write them.
fn short(value: Value) -> Value {
    match value {
        Value::Number(n) => number(n.as_f64().unwrap_or(0.0) as f32),
        Value::Array(list) => list.into_iter().map(short).collect(),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::Sky;

    fn read(text: &str) -> Result<LightPath, String> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("path.toml");
        std::fs::write(&file, text).unwrap();
        let read = LightPath::read(&file, &mut EnvironmentImages::default());
        read.map_err(|e| e.replace(&format!("{}: ", file.display()), ""))
    }

    const LAMPS: &str = r#"
        interpolation = "linear"
        duration = 5
        [[lights]]
        type = "spot"
        position = [{ time = 0, value = [0, 2, 0] }, { time = 4, value = [2, 2, 0] }]
        direction = [0, -1, 0]
        color = [{ time = 1, value = [1, 0, 0] }, { time = 2, value = [0, 0, 1] }]
        intensity = 10
        outer_cone_angle = [{ time = 0, value = 0.4 }, { time = 5, value = 0.9 }]
        [[lights]]
        type = "sky"
        sun_elevation = [{ time = 0, value = 0.1 }, { time = 5, value = 1.1 }]
    "#;

    #[test]
    fn what_has_keyframes_moves_and_the_rest_stays() {
        let path = read(LAMPS).unwrap();
        assert_eq!((path.duration(), path.moves(), path.times()), (5.0, true, vec![0.0, 1.0, 2.0, 4.0, 5.0]));
        let [Light::Spot { position, direction, color, intensity, outer_cone_angle, .. }, Light::Sky(sky)] =
            path.at(1.5).unwrap()[..]
        else {
            panic!("a spot and a sky")
        };
        assert_eq!((position, direction, intensity), (Vec3::new(0.75, 2.0, 0.0), Vec3::NEG_Y, 10.0));
        assert_eq!(color, Vec3::new(0.5, 0.0, 0.5));
        assert!((outer_cone_angle - 0.55).abs() < 1e-6 && (sky.sun_elevation - 0.4).abs() < 1e-6);
        assert_eq!(Sky { sun_elevation: sky.sun_elevation, ..Sky::at(0.0) }, sky);
        // What is written is what is read, from a file in either language.
        let written = path.to_toml().unwrap();
        assert_eq!(read(&written).unwrap(), path, "{written}");
        let folder = tempfile::tempdir().unwrap();
        let json: Value = toml::from_str(LAMPS).unwrap();
        std::fs::write(folder.path().join("path.json"), json.to_string()).unwrap();
        let of_json = LightPath::read(&folder.path().join("path.json"), &mut EnvironmentImages::default());
        assert_eq!(of_json.unwrap(), path);
    }

    #[test]
    fn an_image_is_read_once_and_turns() {
        let folder = tempfile::tempdir().unwrap();
        exr::prelude::write_rgb_file(folder.path().join("map.exr"), 8, 4, |_, _| (1.0f32, 1.0f32, 1.0f32)).unwrap();
        let text = "[[lights]]\ntype = \"environment\"\nimage = \"map.exr\"\n\
                    rotation = [{ time = 0, value = 0 }, { time = 2, value = 6.2831855 }]\n";
        let file = folder.path().join("path.toml");
        std::fs::write(&file, text).unwrap();
        let path = LightPath::read(&file, &mut EnvironmentImages::default()).unwrap();
        let [Light::Environment { image, rotation, .. }] = &path.at(1.0).unwrap()[..] else { panic!() };
        assert_eq!((image.map().width(), *rotation), (8, std::f32::consts::PI));
        // Written, it is found from anywhere.
        let elsewhere = read(&path.to_toml().unwrap()).unwrap();
        assert_eq!(elsewhere.at(0.5), path.at(0.5));
    }

    #[test]
    fn what_is_wrong_with_a_path_is_said() {
        let lamp = |words: &str| format!("[[lights]]\ntype = \"point\"\n{words}\n");
        let still = "position = [0, 1, 0]";
        for (text, part) in [
            ("lights = []".to_owned(), "no light is given"),
            ("light = []".into(), "unknown field `light`"),
            ("speed = 2\nlights = []".into(), "unknown field `speed`"),
            ("interpolation = \"curly\"\nlights = []".into(), "unknown variant `curly`"),
            (lamp(still), "light 1: missing field `intensity`"),
            (lamp("position = [0, 1, 0]\nintensity = nan"), "light 1: intensity is not finite"),
            (lamp("position = [0, nan, 0]\nintensity = 1"), "light 1: position is not finite"),
            (lamp("position = [0, 1]\nintensity = 1"), "light 1: invalid length 2"),
            (lamp("position = [0, 1, 0]\nbrightness = [{ time = 0, value = 1 }]"), "unknown field `brightness`"),
            (
                lamp("position = [0, 1, 0]\nintensity = [{ time = 0, value = 1 }, { time = 1, value = -2 }]"),
                "at 1 s: intensity -2",
            ),
            (
                lamp("position = [{ time = 1, value = [0, 1, 0] }, { time = 1, value = [0, 1, 0] }]\nintensity = 1"),
                "not after",
            ),
            (
                format!("duration = 2\n{}", lamp("intensity = 1\nposition = [{ time = 3, value = [0, 1, 0] }]")),
                "3 s lies after the end, 2 s",
            ),
            (format!("duration = nan\n{}", lamp("position = [0, 1, 0]\nintensity = 1")), "duration NaN must be"),
            (format!("duration = 0\n{}", lamp("position = [0, 1, 0]\nintensity = 1")), "duration 0 must be"),
            (
                "[[lights]]\ntype = \"directional\"\nintensity = 1\n\
                 direction = [{ time = 0, value = [0, 1, 0] }, { time = 1, value = [0, -1, 0] }]"
                    .into(),
                "direction: keyframes 1 and 2 are opposite",
            ),
            ("[[lights]]\ntype = [{ time = 0, value = \"spot\" }]".into(), "light 1: type: keyframe 1: value \"spot\""),
            ("[[lights]]\nposition = [0, 0".into(), "line 2: "),
            ("[[lights]]\ntype = \"environment\"\nimage = \"gone.hdr\"".into(), "gone.hdr: cannot be read"),
        ] {
            let error = read(&text).unwrap_err();
            assert!(error.contains(part) && !error.contains('\n'), "{text}\n  says {error}\n  expected {part}");
        }
        assert!(
            LightPath::read(Path::new("gone.toml"), &mut EnvironmentImages::default())
                .unwrap_err()
                .contains("gone.toml: cannot be read")
        );
        assert!(!read(&lamp("position = [0, 1, 0]\nintensity = 1")).unwrap().moves());
    }

    /// On the circle at each step, near it between (a chord of a sixteenth of a turn is off by r (1 − cos π/16) at most), and back.
    #[test]
    fn a_light_goes_around_and_comes_back() {
        let (centre, r) = (Vec3::new(1.0, 2.0, -1.0), 3.0);
        let spot = Light::Spot {
            position: centre + Vec3::new(r, 1.0, 0.0),
            direction: Vec3::NEG_X,
            color: Vec3::ONE,
            intensity: 5.0,
            range: None,
            inner_cone_angle: 0.1,
            outer_cone_angle: 0.5,
        };
        let lights = [Light::Emissive { scale: 1.0 }, spot, Light::Sky(Sky::at(0.4))];
        let path = LightPath::around(&lights, 1, centre, 8.0);
        for i in 0..=100 {
            let now = path.at(0.08 * i as f32).unwrap();
            assert_eq!((&now[0], &now[2]), (&lights[0], &lights[2]));
            let (position, direction) = (now[1].position().unwrap() - centre, now[1].direction().unwrap());
            let flat = Vec3::new(position.x, 0.0, position.z);
            assert!((flat.length() - r).abs() < 0.02 * r && (position.y - 1.0).abs() < 1e-5, "{position}");
            assert!(direction.dot(-flat.normalize()) > 0.999, "it faces the centre");
        }
        assert_eq!(path.at(8.0).unwrap()[1], lights[1]);
        assert!((path.at(2.0).unwrap()[1].position().unwrap() - centre - Vec3::new(0.0, 1.0, -r)).length() < 1e-5);
        let sky = LightPath::around(&lights, 2, centre, 8.0).at(2.0).unwrap();
        let Light::Sky(Sky { sun_azimuth, .. }) = sky[2] else { panic!() };
        // A quarter turn to the left, as seen from above, from north: west.
        assert!((sun_azimuth + TAU / 4.0).abs() < 1e-5);
    }

    #[test]
    fn a_keyframe_is_set_for_what_changed() {
        let point =
            |x: f32, intensity: f32| Light::Point { position: Vec3::X * x, color: Vec3::ONE, intensity, range: None };
        let mut path = LightPath::still(&[point(0.0, 1.0)], 4.0);
        assert!(!path.moves());
        path.set_key(0.0, &[point(1.0, 1.0)]);
        assert_eq!(
            (path.moves(), path.at(3.0).unwrap()),
            (false, vec![point(1.0, 1.0)]),
            "at its beginning it starts elsewhere"
        );
        path.set_key(2.0, &[point(3.0, 1.0)]);
        assert_eq!(path.times(), [0.0, 2.0]);
        assert_eq!(path.at(1.0).unwrap(), [point(2.0, 1.0)]);
        path.set_key(2.0, &[point(5.0, 1.0)]);
        assert_eq!(path.at(1.0).unwrap(), [point(3.0, 1.0)], "replaced");
        path.set_key(4.0, &[point(5.0, 9.0)]);
        assert_eq!(path.at(4.0).unwrap(), [point(5.0, 9.0)]);
        path.set_duration(1.0);
        assert_eq!(path.duration(), 4.0, "not shorter than its keyframes");
        path.set_key(1.0, &[point(5.0, 9.0), Light::Emissive { scale: 1.0 }]);
        assert!(!path.moves(), "another number of lights");
    }
}
