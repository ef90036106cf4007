//! A rendered picture and its files.

use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use exr::prelude::{SpecificChannels, WritableImage};
use image::ImageEncoder;

use crate::math::Rgb;
use crate::math::colour::{srgb8_from_linear, tone_map};

/// Scene-linear radiance, W·m⁻²·sr⁻¹, Rec. 709.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    pub width: u32,
    pub height: u32,
    /// `[y][x]`, row 0 on top.
    pub pixels: Vec<Rgb>,
}

/// A picture could not be written.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    #[error("{}: the picture cannot be written: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
    #[error("{}: the picture cannot be encoded as PNG: {source}", path.display())]
    Png { path: PathBuf, source: image::ImageError },
    #[error("{}: the picture cannot be encoded as OpenEXR: {source}", path.display())]
    Exr { path: PathBuf, source: exr::error::Error },
}

impl Picture {
    pub fn pixel(&self, x: u32, y: u32) -> Rgb {
        self.pixels[(y * self.width + x) as usize]
    }

    /// 8-bit sRGB, `[y][x]`, after exposure and tone mapping.
    pub fn srgb8(&self, exposure: f32) -> Vec<[u8; 3]> {
        self.pixels.iter().map(|&radiance| srgb8_from_linear(tone_map(radiance * exposure))).collect()
    }

    /// Writes a tone-mapped 8-bit PNG; a file of that name is replaced only once the new one is whole.
    pub fn write_png(&self, path: &Path, exposure: f32) -> Result<(), PictureError> {
        let texels = self.srgb8(exposure);
        replace_file(path, |file| {
            image::codecs::png::PngEncoder::new(file)
                .write_image(texels.as_flattened(), self.width, self.height, image::ExtendedColorType::Rgb8)
                .map_err(|source| PictureError::Png { path: path.to_owned(), source })
        })
    }

    /// Writes scene-linear f32 radiance as OpenEXR; a file of that name is replaced only once the new one is whole.
    pub fn write_exr(&self, path: &Path) -> Result<(), PictureError> {
        let channels = SpecificChannels::rgb(|at: exr::math::Vec2<usize>| {
            let radiance = self.pixel(at.x() as u32, at.y() as u32);
            (radiance.x, radiance.y, radiance.z)
        });
        let image = exr::image::Image::from_channels((self.width as usize, self.height as usize), channels);
        replace_file(path, |file| {
            image.write().to_buffered(file).map_err(|source| PictureError::Exr { path: path.to_owned(), source })
        })
    }
}

/// Lets `write` fill a file beside `path`, then renames it, so that no reader meets half a picture.
fn replace_file(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<&mut std::fs::File>) -> Result<(), PictureError>,
) -> Result<(), PictureError> {
    let io = |source| PictureError::Io { path: path.to_owned(), source };
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Temporary files are private by default; a picture gets what the umask leaves.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let mut file = builder.tempfile_in(folder).map_err(io)?;
    let mut buffered = BufWriter::new(file.as_file_mut());
    write(&mut buffered)?;
    buffered.flush().map_err(io)?;
    drop(buffered);
    file.persist(path).map_err(|e| io(e.error))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn a_folder_that_is_not_there_is_named() {
        let error = ramp().write_png(Path::new("/nowhere/at/all.png"), 1.0).unwrap_err();
        assert!(error.to_string().starts_with("/nowhere/at/all.png: "), "{error}");
    }
}
