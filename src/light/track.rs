//! One value of a light over time, by keyframes.

use glam::Vec3;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Number, Value};

use super::motion::turned;

/// How a value goes from one keyframe to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Interpolation {
    /// Without a jump in speed and without going beyond the keyframes: monotone cubics (Fritsch and Butland, *A Method for
    /// Constructing Local Monotone Piecewise Cubic Interpolants*, 1984). A value that ends as it began goes on smoothly when
    /// the path begins anew.
    #[default]
    Smooth,
    /// At an even speed; directions turn at one.
    Linear,
    /// It stays until the next keyframe.
    Step,
}

/// What the numbers of a value mean to an interpolation.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Meaning {
    Numbers,
    /// A unit vector.
    Direction,
    /// Radians: whole turns are no difference.
    Angle,
}

/// A value's keyframes, in the order of time.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    meaning: Meaning,
    /// One number, not a list of one.
    single: bool,
    keys: Vec<(f32, Vec<f32>)>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Key {
    time: Value,
    value: Value,
}

/// Turns whose ends are this close to opposite (their cosine) leave open which way they go.
const OPPOSITE: f32 = -0.9999;

impl Track {
    /// A value called `name` that is this at this time.
    pub fn new(name: &str, seconds: f32, value: &Value) -> Option<Self> {
        let numbers = numbers(value)?;
        let meaning = match name {
            "direction" | "up" => Meaning::Direction,
            "rotation" | "sun_azimuth" => Meaning::Angle,
            _ => Meaning::Numbers,
        };
        let mut track = Self { meaning, single: value.is_number(), keys: Vec::new() };
        track.keys.push((seconds, track.normalised(numbers)?));
        Some(track)
    }

    /// Reads the keyframes of a value called `name`: a list of `{ time, value }`.
    ///
    /// # Errors
    /// One line that says which keyframe is wrong.
    pub fn read(name: &str, keys: &[Value]) -> Result<Self, String> {
        let mut track: Option<Self> = None;
        for (key, number) in keys.iter().zip(1..) {
            let wrong = |why: String| format!("{name}: keyframe {number}: {why}");
            let Key { time, value } = Key::deserialize(key).map_err(|e| wrong(e.to_string()))?;
            let seconds = time.as_f64().map(|t| t as f32).filter(|t| t.is_finite() && *t >= 0.0);
            let seconds = seconds.ok_or_else(|| wrong(format!("time {} must be finite, 0 or more", shown(&time))))?;
            let what = "a finite number, or a list of some, and for directions one with a length";
            let read = Track::new(name, seconds, &value)
                .ok_or_else(|| wrong(format!("value {} is not {what}", shown(&value))))?;
            let Some(track) = &mut track else {
                track = Some(read);
                continue;
            };
            let (before, first) = track.keys.last().expect("each track has a key");
            if read.single != track.single || read.keys[0].1.len() != first.len() {
                return Err(wrong("has more or fewer numbers than the one before".into()));
            }
            if seconds <= *before {
                return Err(wrong(format!("its time, {seconds} s, is not after {before} s, of the one before")));
            }
            track.keys.extend(read.keys);
        }
        track.ok_or_else(|| format!("{name}: no keyframes"))
    }

    /// As it is read.
    pub fn written(&self) -> Value {
        let key = |(seconds, value): &(f32, Vec<f32>)| {
            let fields = [("time", number(*seconds)), ("value", self.value(value))];
            Value::Object(Map::from_iter(fields.map(|(name, value)| (name.to_owned(), value))))
        };
        self.keys.iter().map(key).collect()
    }

    /// The times of its keyframes.
    pub fn times(&self) -> impl Iterator<Item = f32> + '_ {
        self.keys.iter().map(|(seconds, _)| *seconds)
    }

    /// The number of the first keyframe, from 1, from which the way to the next is not told: directions that are opposite.
    pub fn unclear_turn(&self) -> Option<usize> {
        let opposite =
            |pair: &[(f32, Vec<f32>)]| Vec3::from_slice(&pair[0].1).dot(Vec3::from_slice(&pair[1].1)) < OPPOSITE;
        let first = || self.keys.windows(2).position(opposite);
        if self.meaning == Meaning::Direction { first().map(|i| i + 1) } else { None }
    }

    /// Adds a keyframe, or replaces the one at that time. Whether the value fits: it has as many numbers as the others.
    pub fn set(&mut self, seconds: f32, value: &Value) -> bool {
        let fits = |v: &Vec<f32>| v.len() == self.keys[0].1.len() && value.is_number() == self.single;
        let Some(value) = numbers(value).filter(fits).and_then(|v| self.normalised(v)) else { return false };
        let at = self.keys.partition_point(|(time, _)| *time < seconds);
        match self.keys.get_mut(at) {
            Some(key) if key.0 == seconds => key.1 = value,
            _ => self.keys.insert(at, (seconds, value)),
        }
        true
    }

    /// The value at a time: before the first keyframe the first one's, after the last the last one's. The path begins anew
    /// after `duration` seconds.
    pub fn at(&self, seconds: f32, interpolation: Interpolation, duration: f32) -> Value {
        self.value(&self.numbers_at(seconds, interpolation, duration))
    }

    fn numbers_at(&self, seconds: f32, interpolation: Interpolation, duration: f32) -> Vec<f32> {
        let next = self.keys.partition_point(|(time, _)| *time <= seconds);
        if next == 0 || next == self.keys.len() {
            return self.keys[next.saturating_sub(1)].1.clone();
        }
        let ((from_time, from), (to_time, to)) = (&self.keys[next - 1], &self.keys[next]);
        let length = to_time - from_time;
        let share = (seconds - from_time) / length;
        match interpolation {
            Interpolation::Step => from.clone(),
            Interpolation::Linear if self.meaning == Meaning::Direction => {
                turned(Vec3::from_slice(from), Vec3::from_slice(to), share).to_array().into()
            }
            Interpolation::Linear => from.iter().zip(to).map(|(a, b)| a + (b - a) * share).collect(),
            Interpolation::Smooth => {
                let closed = self.is_closed(duration);
                // Hermite's cubics.
                let (s, r) = (share, 1.0 - share);
                let cubic = |i: usize| {
                    let (start, end) = (self.slope(next - 1, i, closed), self.slope(next, i, closed));
                    let ends = from[i] * r * r * (1.0 + 2.0 * s) + to[i] * s * s * (1.0 + 2.0 * r);
                    ends + length * s * r * (start * r - end * s)
                };
                let value = (0..from.len()).map(cubic).collect();
                self.normalised(value).unwrap_or_else(|| from.clone())
            }
        }
    }

    /// Whether it ends where it began, at the end of the path.
    fn is_closed(&self, duration: f32) -> bool {
        let ((first_time, first), (last_time, last)) = (&self.keys[0], &self.keys[self.keys.len() - 1]);
        let apart = |a: f32, b: f32| match self.meaning {
            Meaning::Angle => {
                let turns = (a - b) / std::f32::consts::TAU;
                (turns - turns.round()).abs() > 1e-4
            }
            _ => (a - b).abs() > 1e-5 * (a.abs() + b.abs()),
        };
        *first_time == 0.0 && *last_time >= duration && !first.iter().zip(last).any(|(&a, &b)| apart(a, b))
    }

    /// Length and slope of the way from keyframe `k` to the next.
    fn secant(&self, k: usize, component: usize) -> (f32, f32) {
        let length = self.keys[k + 1].0 - self.keys[k].0;
        (length, (self.keys[k + 1].1[component] - self.keys[k].1[component]) / length)
    }

    /// Slope at keyframe `k`.
    fn slope(&self, k: usize, component: usize, closed: bool) -> f32 {
        let last = self.keys.len() - 1;
        let before = if closed && k == 0 { Some(last - 1) } else { k.checked_sub(1) };
        let after = if closed && k == last { Some(0) } else { Some(k).filter(|&k| k < last) };
        let secant = |k: usize| self.secant(k, component);
        match (before.map(secant), after.map(secant)) {
            (Some((_, d0)), Some((_, d1))) if d0 * d1 <= 0.0 => 0.0,
            (Some((h0, d0)), Some((h1, d1))) => {
                let (w0, w1) = (2.0 * h1 + h0, h1 + 2.0 * h0);
                (w0 + w1) / (w0 / d0 + w1 / d1)
            }
            // At the ends as it goes on, no more.
            (None, Some((_, d))) | (Some((_, d)), None) => d,
            (None, None) => 0.0,
        }
    }

    fn normalised(&self, value: Vec<f32>) -> Option<Vec<f32>> {
        if self.meaning != Meaning::Direction {
            return Some(value);
        }
        let unit = (value.len() == 3).then(|| Vec3::from_slice(&value).try_normalize()).flatten()?;
        Some(unit.to_array().into())
    }

    fn value(&self, numbers: &[f32]) -> Value {
        if self.single { number(numbers[0]) } else { numbers.iter().map(|&v| number(v)).collect() }
    }
}

/// The finite numbers of a value that is one or a list of some.
fn numbers(value: &Value) -> Option<Vec<f32>> {
    let finite = |v: &Value| v.as_f64().map(|v| v as f32).filter(|v| v.is_finite());
    match value {
        Value::Array(list) if !list.is_empty() => list.iter().map(finite).collect(),
        single => Some(vec![finite(single)?]),
    }
}

/// With the fewest digits that give this number, as people write them.
pub fn number(value: f32) -> Value {
    value.to_string().parse().ok().and_then(Number::from_f64).map_or(Value::Null, Value::Number)
}

/// JSON has no word for what is not finite.
fn shown(value: &Value) -> String {
    value.to_string().replace("null", "NaN")
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn track(name: &str, keys: &[(f32, Value)]) -> Track {
        let keys: Vec<Value> = keys.iter().map(|(time, value)| json!({ "time": time, "value": value })).collect();
        Track::read(name, &keys).unwrap()
    }

    fn single(track: &Track, seconds: f32, how: Interpolation) -> f32 {
        track.at(seconds, how, 1e9).as_f64().unwrap() as f32
    }

    #[test]
    fn each_way_meets_the_keyframes_and_stays_between_them() {
        let keys = [(1.0, json!(2)), (2.0, json!(5)), (4.0, json!(5.5)), (4.5, json!(0)), (6.0, json!(1))];
        let track = track("intensity", &keys);
        for how in [Interpolation::Smooth, Interpolation::Linear, Interpolation::Step] {
            for (time, value) in &keys {
                assert!((single(&track, *time, how) as f64 - value.as_f64().unwrap()).abs() < 1e-6, "{how:?} {time}");
            }
            assert_eq!((single(&track, 0.0, how), single(&track, 99.0, how)), (2.0, 1.0));
            for pair in keys.windows(2) {
                let [a, b] = [0, 1].map(|i| pair[i].1.as_f64().unwrap() as f32);
                for i in 0..=20 {
                    let seconds = pair[0].0 + (pair[1].0 - pair[0].0) * i as f32 / 20.0;
                    let value = single(&track, seconds, how);
                    // Rounding of a few units.
                    assert!((a.min(b) - 1e-5..=a.max(b) + 1e-5).contains(&value), "{how:?} {seconds}: {value}");
                }
            }
        }
        assert_eq!(single(&track, 1.5, Interpolation::Linear), 3.5);
        assert_eq!(single(&track, 1.999, Interpolation::Step), 2.0);
        // A monotone cubic is a straight line where the keyframes are on one.
        let line = self::track("intensity", &[(0.0, json!(0)), (1.0, json!(2)), (3.0, json!(6))]);
        assert!((single(&line, 1.7, Interpolation::Smooth) - 3.4).abs() < 1e-5);
    }

    /// Four keyframes of a circle: the speed is the same before and after each of them, over the end too.
    #[test]
    fn a_smooth_path_has_no_jump_in_speed() {
        let at = |x: i32, y: i32, z: i32| json!([x, y, z]);
        let keys =
            [(0.0, at(1, 2, 0)), (1.0, at(0, 2, 1)), (2.0, at(-1, 2, 0)), (3.0, at(0, 2, -1)), (4.0, at(1, 2, 0))];
        let track = track("position", &keys);
        let place = |t: f32| Vec3::from_slice(&track.numbers_at(t.rem_euclid(4.0), Interpolation::Smooth, 4.0));
        let (mut steepest, step) = (0f32, 1e-2);
        for key in 0..4 {
            let t = key as f32;
            let jump = (place(t + step) - place(t)) - (place(t) - place(t - step));
            steepest = steepest.max(jump.length() / step);
        }
        // Half way from slope 0 to slope −1: 1/2 + 1/8.
        assert!((place(0.5) - Vec3::new(0.625, 2.0, 0.625)).length() < 1e-6, "{}", place(0.5));
        // Second differences fall with the step where the first derivative has no jump: its bound is the largest curvature,
        // 6 · 1 m in (1 s)², times the step.
        assert!(steepest < 6.0 * step * 1.5, "{steepest}");
        let linear = |t: f32| Vec3::from_slice(&track.numbers_at(t, Interpolation::Linear, 4.0));
        let jump = (linear(1.0 + step) - linear(1.0)) - (linear(1.0) - linear(1.0 - step));
        assert!(jump.length() / step > 1.0, "a path of lines has one");
    }

    #[test]
    fn directions_stay_unit_and_angles_close_after_a_turn() {
        let turning = track("direction", &[(0.0, json!([2, 0, 0])), (1.0, json!([0, 0, 3])), (2.0, json!([0, 1, 0]))]);
        for how in [Interpolation::Smooth, Interpolation::Linear] {
            for i in 0..=20 {
                let v = Vec3::from_slice(&turning.numbers_at(i as f32 * 0.1, how, 2.0));
                assert!((v.length() - 1.0).abs() < 1e-6, "{how:?}: {v}");
            }
        }
        let tau = std::f64::consts::TAU;
        let turn = track("rotation", &[(0.0, json!(0.5)), (1.0, json!(1.0)), (2.0, json!(0.5 + tau))]);
        assert!(turn.is_closed(2.0) && !turn.is_closed(3.0));
        let dimmed = track("intensity", &[(0.0, json!(0.5)), (2.0, json!(0.5 + tau))]);
        assert!(!dimmed.is_closed(2.0));
        assert_eq!(track("direction", &[(0.0, json!([1, 0, 0])), (1.0, json!([-1, 0, 0]))]).unclear_turn(), Some(1));
        assert_eq!(turning.unclear_turn(), None);
    }

    #[test]
    fn a_keyframe_is_added_or_replaced_and_written_as_it_is_read() {
        let mut track = track("color", &[(0.0, json!([1, 0.1, 0])), (2.0, json!([0, 0, 1]))]);
        assert!(track.set(1.0, &json!([0.3, 0.3, 0.3])) && track.set(2.0, &json!([0, 1, 0])));
        assert!(!track.set(1.5, &json!(0.3)) && !track.set(1.5, &json!([0.3, 0.2])) && !track.set(1.5, &json!("red")));
        assert_eq!(track.times().collect::<Vec<_>>(), [0.0, 1.0, 2.0]);
        let written = track.written();
        assert_eq!(written.to_string().matches("0.3").count(), 3, "few digits: {written}");
        assert_eq!(Track::read("color", written.as_array().unwrap()).unwrap(), track);
    }

    #[test]
    fn what_is_wrong_with_a_keyframe_is_said() {
        for (keys, part) in [
            (
                json!([{ "time": 0, "value": 1 }, { "time": 0, "value": 2 }]),
                "keyframe 2: its time, 0 s, is not after 0 s",
            ),
            (
                json!([{ "time": 3, "value": 1 }, { "time": 2, "value": 2 }]),
                "keyframe 2: its time, 2 s, is not after 3 s",
            ),
            (json!([{ "time": -1, "value": 1 }]), "keyframe 1: time -1 must be finite"),
            (json!([{ "time": null, "value": 1 }]), "keyframe 1: time NaN must be finite"),
            (json!([{ "time": 0, "value": null }]), "keyframe 1: value NaN is not a finite number"),
            (json!([{ "time": 0, "value": [1, null, 2] }]), "keyframe 1: value [1,NaN,2] is not"),
            (json!([{ "time": 0, "value": "bright" }]), "value \"bright\" is not"),
            (json!([{ "time": 0, "value": [] }]), "value [] is not"),
            (
                json!([{ "time": 0, "value": 1 }, { "time": 1, "value": [1, 2] }]),
                "keyframe 2: has more or fewer numbers",
            ),
            (json!([{ "time": 0, "value": 1, "ease": "in" }]), "unknown field `ease`"),
            (json!([{ "time": 0 }]), "missing field `value`"),
            (json!([{ "time": 0, "value": 1e300 }]), "keyframe 1: value 1e+300 is not"),
        ] {
            let error = Track::read("intensity", keys.as_array().unwrap()).unwrap_err();
            assert!(error.contains(part) && !error.contains('\n'), "{keys}: {error}");
        }
        let keys = [json!({ "time": 0, "value": [0, 0, 0] })];
        assert!(Track::read("direction", &keys).unwrap_err().contains("with a length"));
    }
}
