//! What is saved and what is dropped into the window.

use std::path::Path;

use eframe::egui;

use super::app::App;
use crate::files::write_whole;
use crate::light::{EnvironmentImage, Light, LightingCondition};
use crate::model::{Picture, View};

impl App<'_> {
    /// Saves the left side's picture as it is shown: .png as displayed, .exr as radiance.
    pub(super) fn save_picture(&mut self) {
        let said = self.finest_picture().and_then(|picture| {
            let png = self.next_file("png");
            picture.write_png(&png, self.look.exposure).map_err(|e| e.to_string())?;
            let exr = png.with_extension("exr");
            picture.write_exr(&exr).map_err(|e| e.to_string())?;
            Ok(format!("wrote {} and {}", png.display(), exr.display()))
        });
        self.say(said);
    }

    /// The relit picture at the window's size, two samples along each side of a pixel.
    fn finest_picture(&mut self) -> Result<Picture, String> {
        let side = self.sides[0].ok_or("nothing is shown")?;
        let view = self.view.as_ref().ok_or("nothing is shown")?;
        let view = View::new(self.camera.clone(), view.width, view.height);
        self.screen.draw(0, side, &view, self.part).map_err(|e| e.to_string())?;
        let picture = self.screen.picture(&view).map_err(|e| e.to_string())?;
        self.redraw();
        picture.ok_or_else(|| "nothing is shown".into())
    }

    /// Saves the lights, for `--light FILE` of any command.
    pub(super) fn save_lights(&mut self) {
        let mut condition = LightingCondition { lights: self.lights.clone() };
        for light in &mut condition.lights {
            // Paths in a file are relative to it, and it may stand elsewhere.
            if let Light::Environment { image, .. } = light
                && let Ok(absolute) = std::path::absolute(image.path())
            {
                *image = absolute.into();
            }
        }
        let said = toml::to_string(&condition).map_err(|e| e.to_string()).and_then(|text| {
            let path = self.next_file("toml");
            write_whole(&path, text.as_bytes()).map_err(|e| format!("{}: {e}", path.display()))?;
            Ok(format!("wrote {}", path.display()))
        });
        self.say(said);
    }

    pub(super) fn say(&mut self, said: Result<String, String>) {
        self.message = said.unwrap_or_else(|error| format!("error: {error}"));
    }

    /// Environment maps and light setups that are dropped into the window.
    pub(super) fn dropped(&mut self, ui: &egui::Ui) {
        let files = ui.input(|i| i.raw.dropped_files.clone());
        for path in files.iter().map(|file| file.path()) {
            let said = self.open(path);
            self.say(said);
        }
    }

    fn open(&mut self, path: &Path) -> Result<String, String> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        match extension.as_deref() {
            Some("hdr" | "exr") => {
                let image = EnvironmentImage::from(path.to_owned());
                let mut light = Light::Environment { image, rotation: 0.0, color: glam::Vec3::ONE, intensity: 1.0 };
                self.images.ready(&mut light, Path::new("")).map_err(|e| e.to_string())?;
                // One environment at a time: a second one takes the first one's place.
                self.lights.retain(|light| !matches!(light, Light::Environment { .. }));
                self.lights.push(light);
            }
            Some("toml") => {
                let text = std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
                let condition: LightingCondition = toml::from_str(&text)
                    .map_err(|e| format!("{}: {}", path.display(), crate::scene_file::one_line(&text, &e)))?;
                let mut lights = Vec::new();
                for mut light in condition.lights {
                    let folder = path.parent().unwrap_or(Path::new(""));
                    self.images.ready(&mut light, folder).map_err(|e| e.to_string())?;
                    lights.push(light.validated().map_err(|why| format!("{}: {why}", path.display()))?);
                }
                self.lights = lights;
            }
            _ => return Err(format!("{}: neither an environment (.hdr, .exr) nor lights (.toml)", path.display())),
        }
        self.selected = self.lights.len().checked_sub(1);
        self.relight();
        Ok(format!("opened {}", path.display()))
    }
}
