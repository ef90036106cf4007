//! What is saved.

use super::app::App;
use crate::files::write_whole;
use crate::light::{Light, LightingCondition};
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
}
