//! Reading environment images.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::Vec3;
use image::{ImageReader, Limits};

use super::EnvironmentImage;
use crate::light::environment::downsampled;
use crate::light::{EnvironmentMap, Light};
use crate::math::Rgb;

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EnvironmentError {
    #[error("{}: cannot be read as an environment: {why}; a .hdr or .exr image in latitude and longitude is expected", path.display())]
    Read { path: PathBuf, why: String },
    #[error("{}: {width} x {height} pixels; an environment in latitude and longitude is twice as wide as high", path.display())]
    Shape { path: PathBuf, width: usize, height: usize },
    #[error("{}: the pixel at column {x}, row {y} is not finite; repair the image", path.display())]
    NotFinite { path: PathBuf, x: usize, y: usize },
    #[error("{}: all pixels are black", path.display())]
    Black { path: PathBuf },
}

/// Pixels along an axis, at most.
const MOST_SIDE: usize = 1 << 14;

/// Reads environment images, each file once.
#[derive(Default)]
pub struct EnvironmentImages {
    maps: HashMap<PathBuf, Arc<EnvironmentMap>>,
}

impl EnvironmentImages {
    /// Reads the image of `light`, if it has one that is not read yet; relative paths start from `folder`, and are joined to
    /// it.
    ///
    /// # Errors
    /// [`EnvironmentError`], in one line that names the file.
    pub fn ready(&mut self, light: &mut Light, folder: &Path) -> Result<(), EnvironmentError> {
        match light {
            Light::Environment { image, .. } if image.map.is_none() => {
                *image = self.read(&folder.join(&image.path))?;
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Reads an image.
    ///
    /// # Errors
    /// As [`Self::ready`].
    pub fn read(&mut self, path: &Path) -> Result<EnvironmentImage, EnvironmentError> {
        let map = match self.maps.get(path) {
            Some(map) => map.clone(),
            None => {
                let map = Arc::new(read(path)?);
                self.maps.insert(path.to_owned(), map.clone());
                map
            }
        };
        Ok(EnvironmentImage { path: path.to_owned(), map: Some(map) })
    }
}

fn read(path: &Path) -> Result<EnvironmentMap, EnvironmentError> {
    let failed = |why: String| EnvironmentError::Read { path: path.to_owned(), why: one_line(&why) };
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    let (width, height, mut pixels) = match extension.as_deref() {
        Some("exr") => read_exr(path).map_err(failed)?,
        Some("hdr") => read_hdr(path).map_err(failed)?,
        _ => return Err(failed("its name ends in neither .hdr nor .exr".into())),
    };
    if let Some(i) = pixels.iter().position(|p| !p.is_finite()) {
        return Err(EnvironmentError::NotFinite { path: path.to_owned(), x: i % width, y: i / width });
    }
    if width != 2 * height || height == 0 {
        return Err(EnvironmentError::Shape { path: path.to_owned(), width, height });
    }
    // Filters that ring leave values below zero; light has none.
    pixels.iter_mut().for_each(|p| *p = p.max(Vec3::ZERO));
    if pixels.iter().all(|p| *p == Vec3::ZERO) {
        return Err(EnvironmentError::Black { path: path.to_owned() });
    }
    Ok(downsampled(width, height, pixels))
}

type Pixels = (usize, usize, Vec<Rgb>);

fn read_hdr(path: &Path) -> Result<Pixels, String> {
    let mut reader = ImageReader::open(path).map_err(|e| e.to_string())?;
    reader.set_format(image::ImageFormat::Hdr);
    let mut limits = Limits::default();
    limits.max_image_width = Some(MOST_SIDE as u32);
    limits.max_image_height = Some(MOST_SIDE as u32);
    limits.max_alloc = Some(4 << 30);
    reader.limits(limits);
    let image = reader.decode().map_err(|e| e.to_string())?.into_rgb32f();
    let (width, height) = image.dimensions();
    Ok((width as usize, height as usize, image.pixels().map(|p| Vec3::from_array(p.0)).collect()))
}

fn read_exr(path: &Path) -> Result<Pixels, String> {
    use exr::prelude::*;
    // The header alone tells the size, before anything is reserved for it.
    let meta = MetaData::read_from_file(path, false).map_err(|e| e.to_string())?;
    let size = meta.headers.first().map_or(Vec2(0, 0), |h| h.layer_size);
    if size.0 > MOST_SIDE || size.1 > MOST_SIDE {
        return Err(format!("{} x {} pixels are more than {MOST_SIDE} along a side", size.0, size.1));
    }
    let image = read_first_rgba_layer_from_file(
        path,
        |size, _| (size.width(), vec![Rgb::ZERO; size.width() * size.height()]),
        |(width, pixels), at, (r, g, b, _): (f32, f32, f32, f32)| {
            pixels[at.y() * *width + at.x()] = glam::Vec3::new(r, g, b);
        },
    )
    .map_err(|e| e.to_string())?;
    let (width, pixels) = image.layer_data.channel_data.pixels;
    Ok((width, pixels.len() / width.max(1), pixels))
}

fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn exr(path: &Path, size: (usize, usize), colour: impl Fn(usize, usize) -> (f32, f32, f32) + Sync) {
        exr::prelude::write_rgb_file(path, size.0, size.1, colour).unwrap();
    }

    #[test]
    fn a_file_is_read_once_and_shared() {
        let folder = tempfile::tempdir().unwrap();
        exr(&folder.path().join("map.exr"), (8, 4), |x, y| (x as f32, y as f32, -1.0));
        let mut images = EnvironmentImages::default();
        let text = r#"{ "type": "environment", "image": "map.exr", "rotation": 1.5 }"#;
        let mut lights: [Light; 2] = std::array::from_fn(|_| serde_json::from_str(text).unwrap());
        lights.iter_mut().for_each(|light| images.ready(light, folder.path()).unwrap());
        let [Light::Environment { image: a, .. }, Light::Environment { image: b, .. }] = &lights else { panic!() };
        assert!(Arc::ptr_eq(a.map(), b.map()));
        let texels: Vec<Rgb> = a.map().radiances().collect();
        // Values below zero count as none.
        assert_eq!(
            (texels.len(), texels[3], texels[8 * 3 + 7]),
            (32, Vec3::new(3.0, 0.0, 0.0), Vec3::new(7.0, 3.0, 0.0))
        );
        // What is written is the path.
        let written = serde_json::to_value(&lights[0]).unwrap();
        assert_eq!(written["image"], folder.path().join("map.exr").to_str().unwrap());
        let back: Light = serde_json::from_value(written).unwrap();
        assert_eq!(back, lights[0]);
    }

    #[test]
    fn a_large_image_is_averaged_and_keeps_its_light() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        let colour = |x: usize, y: usize| ((x % 7) as f32, if (x, y) == (700, 300) { 1e5 } else { 0.1 }, 1.0);
        exr(&path, (1500, 750), colour);
        let map = EnvironmentImages::default().read(&path).unwrap();
        assert_eq!((map.map().width(), map.map().height()), (1024, 512));
        let pixels = (0..1500 * 750).map(|i| colour(i % 1500, i / 1500).into()).collect();
        let fine = EnvironmentMap::new(1500, 750, pixels);
        assert!((map.map().mean() - fine.mean()).abs().max_element() < 1e-4 * fine.mean().max_element());
    }

    #[test]
    fn what_is_wrong_is_said_in_one_line_that_names_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        exr(&at("square.exr"), (4, 4), |_, _| (1.0, 1.0, 1.0));
        exr(&at("nan.exr"), (8, 4), |x, y| (if (x, y) == (5, 2) { f32::NAN } else { 1.0 }, 1.0, 1.0));
        exr(&at("black.exr"), (8, 4), |_, _| (0.0, 0.0, 0.0));
        exr(&at("good.exr"), (64, 32), |x, y| ((x * y) as f32, 1.0, 1.0));
        let whole = std::fs::read(at("good.exr")).unwrap();
        std::fs::write(at("cut.exr"), &whole[..whole.len() / 2]).unwrap();
        std::fs::write(at("text.hdr"), "not an image").unwrap();
        std::fs::write(at("empty.hdr"), "").unwrap();
        std::fs::write(at("map.png"), "").unwrap();
        for (name, part) in [
            ("square.exr", "4 x 4"),
            ("nan.exr", "column 5, row 2"),
            ("black.exr", "black"),
            ("cut.exr", "cannot be read"),
            ("text.hdr", "cannot be read"),
            ("empty.hdr", "cannot be read"),
            ("map.png", ".hdr nor .exr"),
            ("absent.exr", "cannot be read"),
        ] {
            let error = EnvironmentImages::default().read(&at(name)).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains(part) && !error.contains('\n'), "{error}");
        }
        assert!(EnvironmentImages::default().read(&at("good.exr")).is_ok());
    }
}
