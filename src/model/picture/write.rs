//! A picture's files.

use std::io::{self, Cursor};
use std::path::{Path, PathBuf};

use exr::prelude::{SpecificChannels, WritableImage};
use image::ImageEncoder;

use super::Picture;
use crate::files::write_whole;

/// A picture could not be written.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    #[error("{}: the picture cannot be written: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
    #[error("{}: the picture cannot be encoded as OpenEXR: {source}", path.display())]
    Exr { path: PathBuf, source: exr::error::Error },
}

impl Picture {
    /// Tone-mapped 8-bit PNG, as bytes.
    pub fn to_png(&self, exposure: f32) -> Vec<u8> {
        let texels = self.srgb8(exposure);
        let mut bytes = Vec::new();
        image::codecs::png::PngEncoder::new(&mut bytes)
            .write_image(texels.as_flattened(), self.width, self.height, image::ExtendedColorType::Rgb8)
            .expect("encoding to memory, with as many pixels as the size says");
        bytes
    }

    /// Writes a tone-mapped 8-bit PNG; a file of that name is replaced only once the new one is whole.
    pub fn write_png(&self, path: &Path, exposure: f32) -> Result<(), PictureError> {
        let io = |source| PictureError::Io { path: path.to_owned(), source };
        write_whole(path, &self.to_png(exposure)).map_err(io)
    }

    /// Scene-linear f32 radiance as OpenEXR, as bytes.
    ///
    /// # Errors
    /// What the encoder refuses.
    pub fn to_exr(&self) -> exr::error::Result<Vec<u8>> {
        let channels = SpecificChannels::rgb(|at: exr::math::Vec2<usize>| {
            let radiance = self.pixel(at.x() as u32, at.y() as u32);
            (radiance.x, radiance.y, radiance.z)
        });
        let image = exr::image::Image::from_channels((self.width as usize, self.height as usize), channels);
        let mut bytes = Cursor::new(Vec::new());
        image.write().to_buffered(&mut bytes)?;
        Ok(bytes.into_inner())
    }

    /// Writes scene-linear f32 radiance as OpenEXR; a file of that name is replaced only once the new one is whole.
    pub fn write_exr(&self, path: &Path) -> Result<(), PictureError> {
        let bytes = self.to_exr().map_err(|source| PictureError::Exr { path: path.to_owned(), source })?;
        write_whole(path, &bytes).map_err(|source| PictureError::Io { path: path.to_owned(), source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rgb;

    fn ramp() -> Picture {
        let pixels = (0..12).map(|i| Rgb::new(i as f32 * 0.05, 0.3, 2.0 / (1.0 + i as f32))).collect();
        Picture { width: 4, height: 3, pixels }
    }

    #[test]
    fn png_holds_the_tone_mapped_codes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ramp.png");
        ramp().write_png(&path, 0.5).unwrap();
        let read = image::open(&path).unwrap().into_rgb8();
        assert_eq!((read.width(), read.height()), (4, 3));
        assert_eq!(read.as_raw().as_slice(), ramp().srgb8(0.5).as_flattened());
    }

    #[test]
    fn exr_holds_the_radiance_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ramp.exr");
        ramp().write_exr(&path).unwrap();
        let read = exr::prelude::read_first_rgba_layer_from_file(
            &path,
            |size, _| (size.width(), vec![Rgb::ZERO; size.area()]),
            |(width, pixels), at, (r, g, b, _): (f32, f32, f32, f32)| {
                pixels[at.y() * *width + at.x()] = Rgb::new(r, g, b)
            },
        )
        .unwrap();
        assert_eq!(read.layer_data.channel_data.pixels.1, ramp().pixels);
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "not a folder").unwrap();
        let path = file.join("all.png");
        let error = ramp().write_png(&path, 1.0).unwrap_err();
        assert!(error.to_string().starts_with(&path.display().to_string()), "{error}");
    }
}
