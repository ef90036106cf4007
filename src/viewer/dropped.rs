//! What is dropped into the window.

use std::path::Path;

use eframe::egui;
use glam::Vec3;

use super::app::App;
use crate::light::{EnvironmentImage, EnvironmentImages, Light, LightPath};

/// What a dropped file is.
#[derive(Debug, PartialEq)]
enum Dropped {
    /// All lights from now on, and the selected one.
    Lights(Vec<Light>, Option<usize>),
    Path(LightPath),
}

impl Dropped {
    /// Opens a file that is dropped on a window with these lights.
    fn open(
        file: &Path,
        images: &mut EnvironmentImages,
        lights: &[Light],
        selected: Option<usize>,
    ) -> Result<Self, String> {
        let extension = file.extension().map(|e| e.to_string_lossy().to_lowercase());
        match extension.as_deref() {
            Some("hdr" | "exr") => {
                let read = images.read(file).map_err(|e| e.to_string())?;
                let mut lights = lights.to_vec();
                // In the place of the environment that is selected, turned and tinted as that was; otherwise one more.
                let index = selected.filter(|&i| matches!(lights.get(i), Some(Light::Environment { .. })));
                let index = index.unwrap_or(lights.len());
                if index == lights.len() {
                    let image = EnvironmentImage::from(file.to_owned());
                    lights.push(Light::Environment { image, rotation: 0.0, color: Vec3::ONE, intensity: 1.0 });
                }
                if let Light::Environment { image, .. } = &mut lights[index] {
                    *image = read;
                }
                Ok(Self::Lights(lights, Some(index)))
            }
            Some("toml" | "json") => {
                let path = LightPath::read(file, images)?;
                if path.moves() {
                    return Ok(Self::Path(path));
                }
                let lights = path.at(0.0).map_err(|e| format!("{}: {e}", file.display()))?;
                let selected = lights.len().checked_sub(1);
                Ok(Self::Lights(lights, selected))
            }
            _ => Err(format!("{}: neither an environment (.hdr, .exr) nor lights (.toml, .json)", file.display())),
        }
    }
}

impl App<'_> {
    /// Opens what is dropped into the window.
    pub(super) fn dropped(&mut self, ui: &egui::Ui) {
        let files = ui.input(|i| i.raw.dropped_files.clone());
        for file in files.iter().map(|file| file.path()) {
            let opened =
                Dropped::open(file, &mut self.images, &self.lights, self.selected).map(|dropped| match dropped {
                    Dropped::Lights(lights, selected) => {
                        (self.lights, self.selected) = (lights, selected);
                        self.edited();
                        format!("opened {}", file.display())
                    }
                    Dropped::Path(path) => {
                        let said = format!("plays {}, {} s", file.display(), path.duration());
                        self.player.open(path);
                        self.selected = None;
                        said
                    }
                });
            self.say(opened);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point() -> Light {
        Light::Point { position: Vec3::Y, color: Vec3::ONE, intensity: 1.0, range: None }
    }

    fn environment(lights: &[Light], index: usize) -> (&Path, f32, Vec3) {
        match &lights[index] {
            Light::Environment { image, rotation, .. } => (image.path(), *rotation, image.map().mean()),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn images_become_environments_one_by_one_or_in_the_place_of_the_selected_one() {
        let folder = tempfile::tempdir().unwrap();
        let [exr, hdr] = ["dawn.exr", "Dusk.HDR"].map(|name| folder.path().join(name));
        exr::prelude::write_rgb_file(&exr, 8, 4, |_, _| (1.0f32, 0.5f32, 0.25f32)).unwrap();
        let texels = vec![image::Rgb([0.25f32, 0.5, 2.0]); 8 * 4];
        image::codecs::hdr::HdrEncoder::new(std::fs::File::create(&hdr).unwrap()).encode(&texels, 8, 4).unwrap();
        let mut images = EnvironmentImages::default();
        let mut drop =
            |file: &Path, lights: &[Light], selected| match Dropped::open(file, &mut images, lights, selected) {
                Ok(Dropped::Lights(lights, selected)) => (lights, selected),
                other => panic!("{other:?}"),
            };
        let (one, selected) = drop(&exr, &[point()], Some(0));
        assert_eq!((one.len(), selected, &one[0]), (2, Some(1), &point()));
        // A constant image is what its mean is, to half floats and the exponents that .hdr shares.
        assert!((environment(&one, 1).2 - Vec3::new(1.0, 0.5, 0.25)).length() < 1e-3);
        let (two, selected) = drop(&hdr, &one, None);
        assert_eq!((two.len(), selected), (3, Some(2)), "several shine at once");
        assert!((environment(&two, 2).2 - Vec3::new(0.25, 0.5, 2.0)).length() < 0.02, "{:?}", environment(&two, 2));

        let mut turned = two.clone();
        if let Light::Environment { rotation, .. } = &mut turned[1] {
            *rotation = 1.5;
        }
        let (other, selected) = drop(&hdr, &turned, Some(1));
        assert_eq!((other.len(), selected), (3, Some(1)));
        assert_eq!(
            (environment(&other, 1).0, environment(&other, 1).1),
            (hdr.as_path(), 1.5),
            "turned as the one before"
        );
    }

    #[test]
    fn lights_and_paths_are_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        let mut images = EnvironmentImages::default();
        let mut drop = |name: &str, text: &str| {
            let file = folder.path().join(name);
            std::fs::write(&file, text).unwrap();
            Dropped::open(&file, &mut images, &[point(), point()], Some(0))
        };
        let lamp = "[[lights]]\ntype = \"point\"\nposition = [0, 1, 0]\nintensity = ";
        assert_eq!(drop("a.toml", &format!("{lamp}1")), Ok(Dropped::Lights(vec![point()], Some(0))));
        let json = r#"{"lights": [{"type": "point", "position": [0, 1, 0], "intensity": 1}]}"#;
        assert_eq!(drop("a.json", json), Ok(Dropped::Lights(vec![point()], Some(0))));
        let moving = format!("{lamp}[{{ time = 0, value = 1 }}, {{ time = 3, value = 2 }}]");
        assert!(matches!(drop("b.toml", &moving), Ok(Dropped::Path(path)) if path.duration() == 3.0));
        for (name, text, part) in [
            ("c.toml", "lights = 3", "c.toml: "),
            ("d.exr", "noise", "d.exr: cannot be read as an environment"),
            ("e.png", "", "e.png: neither an environment"),
        ] {
            let error = drop(name, text).unwrap_err();
            assert!(error.contains(part) && !error.contains('\n'), "{error}");
        }
    }
}
