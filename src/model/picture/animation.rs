//! Pictures that follow each other, in one animated PNG.

use std::io;

use super::Picture;

/// An animated PNG (APNG, PNG's third edition) as it grows. What does not show animations shows the first frame.
pub struct Animation<W: io::Write> {
    writer: png::Writer<W>,
    width: u32,
    /// The frame before, 8-bit sRGB.
    before: Vec<[u8; 3]>,
}

impl<W: io::Write> Animation<W> {
    /// Of `frames` pictures of this size, so many of them a second, again and again.
    ///
    /// # Errors
    /// What the encoder refuses, such as no frames, and what cannot be written to `to`.
    pub fn new(to: W, [width, height]: [u32; 2], frames: u32, frames_per_second: f32) -> io::Result<Self> {
        let mut encoder = png::Encoder::new(to, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::High);
        encoder.set_filter(png::Filter::Adaptive);
        encoder.set_animated(frames, 0)?;
        let (seconds, of) = delay(frames_per_second);
        encoder.set_frame_delay(seconds, of)?;
        Ok(Self { writer: encoder.write_header()?, width, before: Vec::new() })
    }

    /// Adds a tone-mapped picture.
    ///
    /// # Errors
    /// What the encoder refuses, such as a picture too many, and what cannot be written.
    ///
    /// # Panics
    /// For a picture of another size.
    pub fn add(&mut self, picture: &Picture, exposure: f32) -> io::Result<()> {
        let now = picture.srgb8(exposure);
        let width = self.width as usize;
        // Of all frames but the first, what differs from the one before.
        let [x0, y0, x1, y1] = if self.before.is_empty() {
            [0, 0, width, now.len() / width]
        } else {
            assert_eq!(now.len(), self.before.len(), "frames of one size");
            changed(&self.before, &now, width)
        };
        if !self.before.is_empty() {
            self.writer.reset_frame_position()?;
            self.writer.set_frame_dimension((x1 - x0) as u32, (y1 - y0) as u32)?;
            self.writer.set_frame_position(x0 as u32, y0 as u32)?;
        }
        let rows: Vec<u8> =
            (y0..y1).flat_map(|y| now[y * width + x0..y * width + x1].as_flattened()).copied().collect();
        self.writer.write_image_data(&rows)?;
        self.before = now;
        Ok(())
    }

    /// Ends the file.
    ///
    /// # Errors
    /// Where there are fewer pictures than was said, and what cannot be written.
    pub fn finish(self) -> io::Result<()> {
        Ok(self.writer.finish()?)
    }
}

/// Left, top, right and bottom of what differs, the latter two not part of it; one pixel where nothing does.
fn changed(before: &[[u8; 3]], now: &[[u8; 3]], width: usize) -> [usize; 4] {
    let mut bounds = [width, usize::MAX, 0, 0];
    for (i, _) in before.iter().zip(now).enumerate().filter(|(_, (a, b))| a != b) {
        let (x, y) = (i % width, i / width);
        bounds = [bounds[0].min(x), bounds[1].min(y), bounds[2].max(x + 1), bounds[3].max(y + 1)];
    }
    if bounds[2] == 0 { [0, 0, 1, 1] } else { bounds }
}

/// Seconds that a frame is shown, as the fraction of two 16-bit numbers that the format has.
fn delay(frames_per_second: f32) -> (u16, u16) {
    let most = u16::MAX as f32;
    let fraction = |value: f32| {
        let scale = [1000.0, 100.0, 10.0, 1.0].into_iter().find(|scale| value * scale <= most).unwrap_or(1.0);
        ((value * scale).round().clamp(1.0, most) as u16, scale as u16)
    };
    if frames_per_second >= 1.0 {
        let (frames, seconds) = fraction(frames_per_second);
        (seconds, frames)
    } else {
        fraction(1.0 / frames_per_second)
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    /// Black with a white square of two pixels, whose left upper corner is here.
    fn square(x: u32, y: u32) -> Picture {
        let inside =
            |at: u32| Vec3::splat(((at % 9).wrapping_sub(x) < 2 && (at / 9).wrapping_sub(y) < 2) as u32 as f32);
        Picture { width: 9, height: 7, pixels: (0..63).map(inside).collect() }
    }

    #[test]
    fn the_file_shows_every_frame_whole() {
        let frames = [square(0, 0), square(1, 0), square(1, 0), square(6, 4)];
        let mut bytes = Vec::new();
        let mut animation = Animation::new(&mut bytes, [9, 7], 4, 12.5).unwrap();
        frames.iter().for_each(|frame| animation.add(frame, 1.0).unwrap());
        animation.finish().unwrap();
        let mut reader = png::Decoder::new(io::Cursor::new(&bytes)).read_info().unwrap();
        let control = reader.info().animation_control().copied().unwrap();
        assert_eq!((control.num_frames, control.num_plays), (4, 0));
        let mut canvas = vec![[0u8; 3]; 63];
        let mut sizes = Vec::new();
        for frame in &frames {
            let mut part = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut part).unwrap();
            let shown = *reader.info().frame_control().unwrap();
            assert_eq!(shown.delay_num as f32 / shown.delay_den as f32, 0.08);
            let (width, height) = (shown.width as usize, shown.height as usize);
            for (i, pixel) in part.as_chunks::<3>().0[..width * height].iter().enumerate() {
                canvas[(shown.y_offset as usize + i / width) * 9 + shown.x_offset as usize + i % width] = *pixel;
            }
            sizes.push((width, height));
            assert_eq!(canvas, frame.srgb8(1.0));
        }
        assert_eq!(sizes, [(9, 7), (3, 2), (1, 1), (7, 6)], "no more than what changes");
    }

    #[test]
    fn delays_are_as_near_as_the_format_can() {
        for (rate, expected) in
            [(30.0, (1000, 30_000)), (12.5, (1000, 12_500)), (144.0, (100, 14_400)), (0.5, (2000, 1000))]
        {
            assert_eq!(delay(rate), expected);
        }
        for rate in [1e-9f32, 1e-3, 23.976, 999.0, 1e6] {
            let (seconds, of) = delay(rate);
            let shown = of as f32 / seconds as f32;
            assert!(
                seconds > 0 && of > 0 && ((shown / rate - 1.0).abs() < 1e-3 || !(1e-4..6e4).contains(&rate)),
                "{rate}"
            );
        }
    }
}
