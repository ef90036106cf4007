//! What the window shows of pictures.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use relight::gpu::Gpu;
use relight::math::Rgb;
use relight::math::colour::{false_colour, luminance, srgb8_from_linear, tone_map};
use relight::model::Picture;
use relight::viewer::display::{Display, Frame, Look, What};
use wgpu::util::DeviceExt;

const SIZE: [u32; 2] = [61, 43];

/// Radiance up to four, with highlights.
fn random_picture(seed: u64, [width, height]: [u32; 2]) -> Picture {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut pixel = || {
        let bright = 4.0 * rng.random::<f32>().powi(3);
        Rgb::new(rng.random(), rng.random(), rng.random()) * bright
    };
    Picture { width, height, pixels: (0..width * height).map(|_| pixel()).collect() }
}

fn texture(gpu: &Gpu, picture: &Picture) -> wgpu::Texture {
    let texels: Vec<[f32; 4]> = picture.pixels.iter().map(|p| p.extend(1.0).to_array()).collect();
    let descriptor = wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d { width: picture.width, height: picture.height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba32Float,
        usage: wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    };
    let order = wgpu::util::TextureDataOrder::LayerMajor;
    gpu.device.create_texture_with_data(&gpu.queue, &descriptor, order, bytemuck::cast_slice(&texels))
}

/// A picture at a place of the window, both from 0 to 1: between pixels bilinear, beyond the outer ones as they are.
fn at(picture: &Picture, x: f32, y: f32) -> Rgb {
    let pixel = |x: f32, y: f32| {
        let clamped = |v: f32, side: u32| (v.max(0.0) as u32).min(side - 1);
        picture.pixel(clamped(x, picture.width), clamped(y, picture.height))
    };
    let (x, y) = (x * picture.width as f32 - 0.5, y * picture.height as f32 - 0.5);
    // Rounding does not take a pixel for a place between two.
    let (left, top) = ((x + 1e-3).floor(), (y + 1e-3).floor());
    let (fx, fy) = ((x - left).clamp(0.0, 1.0), (y - top).clamp(0.0, 1.0));
    let row = |y: f32| pixel(left, y).lerp(pixel(left + 1.0, y), fx);
    row(top).lerp(row(top + 1.0), fy)
}

/// The window's pixels by the functions of the CPU.
fn shown(pictures: &[Picture; 2], reference: &Picture, what: [What; 2], split: u32, look: &Look) -> Vec<[u8; 3]> {
    let [width, height] = SIZE;
    let pixel = |i: u32| {
        let side = (i % width >= split) as usize;
        let (x, y) = (((i % width) as f32 + 0.5) / width as f32, ((i / width) as f32 + 0.5) / height as f32);
        let (picture, reference) = (at(&pictures[side], x, y), at(reference, x, y));
        let exposed = |radiance: Rgb| {
            let exposed = radiance * look.exposure;
            srgb8_from_linear(if look.tone_curve { tone_map(exposed) } else { exposed })
        };
        match what[side] {
            What::Picture => exposed(picture),
            What::Reference => exposed(reference),
            What::Difference => false_colour(luminance((picture - reference).abs()) / look.difference),
        }
    };
    (0..width * height).map(pixel).collect()
}

/// Codes that differ by more than one, and those that differ at all. Powers and bilinear sums are a few roundings apart, which
/// decides a code only near its border.
fn differences(gpu: &[[u8; 4]], cpu: &[[u8; 3]]) -> [usize; 2] {
    let codes = gpu.iter().zip(cpu).flat_map(|(g, c)| (0..3).map(|i| g[i].abs_diff(c[i])));
    codes.fold([0, 0], |[far, any], d| [far + (d > 1) as usize, any + (d > 0) as usize])
}

pub fn display() {
    let gpu = Gpu::new().unwrap();
    let display = Display::new(&gpu.device);
    let output = Display::output(&gpu.device, SIZE);
    // One of the window's own size, which is shown as it is, and coarser ones.
    let pictures = [random_picture(1, SIZE), random_picture(2, [33, 20])];
    let reference = random_picture(3, [31, 22]);
    let read = || {
        let row = (4 * SIZE[0]).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let readback = gpu.readback((row * SIZE[1]) as u64);
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row), rows_per_image: None };
        let to = wgpu::TexelCopyBufferInfo { buffer: &readback, layout };
        encoder.copy_texture_to_buffer(output.as_image_copy(), to, output.size());
        gpu.queue.submit([encoder.finish()]);
        let texels: Vec<[u8; 4]> = gpu.read(&readback).unwrap();
        let rows = texels.chunks_exact(row as usize / 4).flat_map(|row| &row[..SIZE[0] as usize]);
        rows.copied().collect::<Vec<_>>()
    };
    for what in [
        [What::Picture, What::Picture],
        [What::Reference, What::Picture],
        [What::Picture, What::Reference],
        [What::Difference, What::Reference],
        [What::Picture, What::Difference],
    ] {
        for (tone_curve, split) in [(true, 20), (false, 33), (true, SIZE[0])] {
            let look = Look { exposure: 0.7, tone_curve, difference: 1.5, split: 0.5 };
            let [left, right] = [0, 1].map(|i| texture(&gpu, &pictures[i]));
            let frame = Frame { what, pictures: [left, right], reference: texture(&gpu, &reference), split };
            display.show(&gpu.device, &gpu.queue, &frame, &look, &output);
            let gpu = read();
            let case = format!("{what:?}, split at {split}, tone curve {tone_curve}");
            assert!(gpu.iter().all(|texel| texel[3] == 255), "{case}: see-through");
            let cpu = |look: &Look, split: u32| shown(&pictures, &reference, what, split, look);
            let [far, any] = differences(&gpu, &cpu(&look, split));
            let codes = 3 * gpu.len();
            assert!(far == 0 && any < codes / 50, "{case}: {far} of {codes} codes are far off, {any} differ");
            // Controls: a fiftieth brighter, a difference scaled otherwise, a column shown on the other side.
            let brighter = Look { exposure: look.exposure * 1.02, difference: look.difference * 1.02, ..look };
            assert!(differences(&gpu, &cpu(&brighter, split))[1] > codes / 10, "{case}: 2 % go unnoticed");
            if split < SIZE[0] {
                assert!(
                    differences(&gpu, &cpu(&look, split + 1))[0] > SIZE[1] as usize,
                    "{case}: the split goes unnoticed"
                );
            }
        }
    }
}
