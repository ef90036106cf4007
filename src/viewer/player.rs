//! The light path that the window plays: read from a file, made of keyframes set in the window, or the selected light going
//! around.

use eframe::egui::{DragValue, Slider, Ui};
use glam::Vec3;

use super::app::App;
use crate::files::write_whole;
use crate::light::{Light, LightPath};

/// Seconds of a path that begins in the window.
const DURATION: f32 = 8.0;

/// Keyframes to which there are buttons.
const MOST_BUTTONS: usize = 24;

#[derive(Default)]
pub struct Player {
    path: Option<LightPath>,
    /// The path was made to let a light go around: it is made anew from where lights are.
    turning: bool,
    pub playing: bool,
    /// Since the path began.
    pub seconds: f32,
}

impl Player {
    /// Plays a path from its beginning.
    pub fn open(&mut self, path: LightPath) {
        *self = Self { path: Some(path), turning: false, playing: true, seconds: 0.0 };
    }

    /// The path that somebody made, not that of a light which merely goes around.
    pub fn made(&self) -> Option<&LightPath> {
        self.path.as_ref().filter(|_| !self.turning)
    }

    /// Plays or pauses; where nobody made a path, the selected light goes around the vertical axis through `centre`.
    pub fn toggle(&mut self, lights: &[Light], selected: Option<usize>, centre: Vec3) {
        self.playing = !self.playing;
        if self.playing && self.made().is_none_or(|path| !path.moves()) {
            let goes = selected.filter(|&i| i < lights.len());
            *self = Self {
                path: goes.map(|i| LightPath::around(lights, i, centre, DURATION)),
                turning: true,
                playing: goes.is_some(),
                seconds: 0.0,
            };
        }
    }

    /// The lights some seconds on, where it plays.
    pub fn advance(&mut self, by: f32) -> Option<Vec<Light>> {
        let duration = self.path.as_ref().filter(|_| self.playing)?.duration();
        self.seek((self.seconds + by) % duration)
    }

    /// The lights at this time.
    pub fn seek(&mut self, seconds: f32) -> Option<Vec<Light>> {
        self.seconds = seconds;
        // Values that do not go together between keyframes leave the lights as they were.
        self.path.as_ref()?.at(seconds).ok()
    }

    /// Somebody moved a light: the path waits.
    pub fn edited(&mut self) {
        self.playing = false;
        if self.turning {
            *self = Self::default();
        }
    }

    /// Gives what changed a keyframe at the present time. Returns what there is to say.
    pub fn key(&mut self, lights: &[Light]) -> String {
        self.playing = false;
        if self.turning {
            *self = Self::default();
        }
        let Some(path) = &mut self.path else {
            self.path = Some(LightPath::still(lights, DURATION));
            self.seconds = 0.0;
            return "the path begins so; go to another time, move lights, and press K again".into();
        };
        let before = path.times().len();
        path.set_key(self.seconds, lights);
        match path.times().len() {
            0 if before > 0 => "lights were added or removed: the path begins anew".into(),
            0 => "the path begins so; go to another time, move lights, and press K again".into(),
            count => format!("keyframe at {:.2} s; {count} in all", self.seconds),
        }
    }

    pub fn set_duration(&mut self, seconds: f32) {
        if let Some(path) = &mut self.path {
            path.set_duration(seconds);
            self.seconds = self.seconds.min(path.duration());
        }
    }

    /// Forgets the path.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// The path as a file's text, also that of a light which goes around.
    fn to_toml(&self) -> Result<String, String> {
        let path = self.path.as_ref().filter(|path| path.moves());
        path.ok_or("nothing moves yet: press Space, or set keyframes with K")?.to_toml()
    }
}

impl App<'_> {
    /// Plays on.
    pub(super) fn play(&mut self, ui: &Ui) {
        let by = ui.input(|i| i.stable_dt.min(0.1));
        if let Some(lights) = self.player.advance(by) {
            self.show_moment(lights);
            ui.ctx().request_repaint();
        }
    }

    pub(super) fn toggle_playing(&mut self) {
        let centre = self.centre();
        self.player.toggle(&self.lights, self.selected, centre);
    }

    pub(super) fn set_key(&mut self) {
        let said = self.player.key(&self.lights);
        self.say(Ok(said));
    }

    /// Saves the path, for `relight render --path` and for this window.
    pub(super) fn save_path(&mut self) {
        let said = self.player.to_toml().and_then(|text| {
            let file = self.next_file("path.toml");
            write_whole(&file, text.as_bytes()).map_err(|e| format!("{}: {e}", file.display()))?;
            Ok(format!("wrote {}", file.display()))
        });
        self.say(said);
    }

    fn show_moment(&mut self, lights: Vec<Light>) {
        self.lights = lights;
        self.selected = self.selected.filter(|&i| i < self.lights.len());
        self.relight();
    }

    pub(super) fn path_panel(&mut self, ui: &mut Ui) {
        ui.heading("Light path");
        let mut moment = None;
        ui.horizontal(|ui| {
            let (does, why) = if self.player.playing { ("pause", "Space") } else { ("play", "Space") };
            let hint = "Space; without a path the selected light goes around";
            if ui.button(format!("{does} ({why})")).on_hover_text(hint).clicked() {
                self.toggle_playing();
            }
            if ui.button("key (K)").on_hover_text("keep the lights as they are at this time").clicked() {
                self.set_key();
            }
        });
        if let Some((mut duration, times)) = self.player.made().map(|path| (path.duration(), path.times())) {
            let mut seconds = self.player.seconds;
            if ui.add(Slider::new(&mut seconds, 0.0..=duration).suffix(" s").max_decimals(2)).changed() {
                moment = Some(seconds);
            }
            ui.horizontal_wrapped(|ui| {
                for &time in times.iter().take(MOST_BUTTONS) {
                    if ui.small_button(format!("{time:.4}").trim_end_matches('0').trim_end_matches('.')).clicked() {
                        moment = Some(time);
                    }
                }
                if times.len() > MOST_BUTTONS {
                    ui.label(format!("and {} more", times.len() - MOST_BUTTONS));
                }
            });
            ui.horizontal(|ui| {
                let value = DragValue::new(&mut duration).speed(0.05).range(0.1..=3600.0).suffix(" s long");
                if ui.add(value).changed() {
                    self.player.set_duration(duration);
                }
                if ui.button("clear").clicked() {
                    self.player.clear();
                }
            });
        }
        if ui.button("save path (Ctrl+P)").clicked() {
            self.save_path();
        }
        if let Some(seconds) = moment {
            self.player.playing = false;
            let lights = self.player.seek(seconds);
            lights.into_iter().for_each(|lights| self.show_moment(lights));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: f32) -> Light {
        Light::Point { position: Vec3::new(x, 1.0, 0.0), color: Vec3::ONE, intensity: 1.0, range: None }
    }

    #[test]
    fn a_light_goes_around_until_somebody_moves_it() {
        let mut player = Player::default();
        let lights = [point(1.0), point(3.0)];
        assert!(player.advance(1.0).is_none());
        player.toggle(&lights, None, Vec3::ZERO);
        assert!(!player.playing, "nothing is selected");
        player.toggle(&lights, Some(1), Vec3::ZERO);
        let later = player.advance(DURATION / 4.0).unwrap();
        assert_eq!(later[0], lights[0]);
        assert!((later[1].position().unwrap() - Vec3::new(0.0, 1.0, -3.0)).length() < 1e-4);
        assert!(player.made().is_none());
        player.edited();
        assert!(!player.playing && player.advance(1.0).is_none());
        player.toggle(&[point(5.0)], Some(0), Vec3::ZERO);
        assert_eq!(player.advance(DURATION).unwrap(), [point(5.0)], "from where it is now, and back there");
    }

    #[test]
    fn keyframes_make_a_path_that_is_saved_and_plays() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.path.toml");
        let mut player = Player::default();
        assert!(player.to_toml().unwrap_err().contains("nothing moves"));
        player.key(&[point(0.0)]);
        assert!(player.seek(4.0).unwrap() == [point(0.0)] && player.key(&[point(2.0)]).contains("2 in all"));
        std::fs::write(&file, player.to_toml().unwrap()).unwrap();
        let mut read = Player::default();
        read.open(LightPath::read(&file, &mut Default::default()).unwrap());
        assert_eq!(read.advance(2.0).unwrap(), [point(1.0)]);
        read.edited();
        assert!(!read.playing && read.made().is_some(), "a path that was made stays");
        read.toggle(&[point(7.0)], Some(0), Vec3::ZERO);
        assert_eq!(read.advance(2.0).unwrap(), [point(2.0)], "and goes on where it waited");
        assert!(read.key(&[point(1.0), point(2.0)]).contains("anew"));
    }
}
