//! Pictures for the report: renders, errors in false colour, lightmaps, measurement points.

use glam::{Vec2, Vec3};
use image::ImageEncoder;
use rayon::prelude::*;

use super::page::Image;
use crate::math::Rgb;
use crate::math::colour::{false_colour, luminance};
use crate::measure::{MeasurementPoint, MeasurementPoints};
use crate::model::render::first_visible;
use crate::model::{Basis, Picture, View, ViewError};
use crate::scene::{Lightmap, Tracer};

/// Encodes 8-bit RGB pixels as PNG.
pub fn png(pixels: &[[u8; 3]], width: u32, height: u32) -> Vec<u8> {
    let mut out = Vec::new();
    image::codecs::png::PngEncoder::new(&mut out)
        .write_image(pixels.as_flattened(), width, height, image::ExtendedColorType::Rgb8)
        .expect("encoding to memory, with as many pixels as the size says");
    out
}

/// Tone-mapped picture.
pub fn render(picture: &Picture, exposure: f32, caption: impl Into<String>) -> Image {
    Image { caption: caption.into(), png: png(&picture.srgb8(exposure), picture.width, picture.height) }
}

/// The exposure that puts a picture's bright parts just under white.
pub fn exposure_for(picture: &Picture) -> f32 {
    let mut values: Vec<f32> = picture.pixels.iter().map(|&p| luminance(p)).filter(|&l| l > 0.0).collect();
    if values.is_empty() {
        return 1.0;
    }
    let at = (values.len() - 1) * 95 / 100;
    let (_, &mut bright, _) = values.select_nth_unstable_by(at, f32::total_cmp);
    0.75 / bright
}

/// Difference of `picture` from `truth`, relative to the mean luminance of `whole`; brightest at `full`.
pub fn error(picture: &Picture, truth: &Picture, whole: &Picture, full: f32, caption: impl Into<String>) -> Image {
    let lit: Vec<f32> = whole.pixels.iter().map(|&p| luminance(p)).filter(|&l| l > 0.0).collect();
    let mean = (lit.iter().sum::<f32>() / lit.len().max(1) as f32).max(f32::MIN_POSITIVE);
    let differences = picture.pixels.iter().zip(&truth.pixels).map(|(&a, &b)| luminance((a - b).abs()));
    let pixels: Vec<[u8; 3]> = differences.map(|d| false_colour(d / mean / full)).collect();
    Image { caption: caption.into(), png: png(&pixels, picture.width, picture.height) }
}

/// Sum of two pictures of the same size.
pub fn sum(a: &Picture, b: &Picture) -> Picture {
    Picture { pixels: a.pixels.iter().zip(&b.pixels).map(|(&a, &b)| a + b).collect(), ..*a }
}

/// One value per covered texel as a lightmap in blue (negative), white (zero) and red (positive); the gutter is grey.
pub fn signed_lightmap(lightmap: &Lightmap, values: &[f32], caption: impl Into<String>) -> Image {
    let peak = values.iter().fold(f32::MIN_POSITIVE, |m, v| m.max(v.abs()));
    let size = lightmap.size;
    let mut pixels = vec![[224, 224, 224]; size * size];
    for (texel, &value) in lightmap.texels.iter().zip(values) {
        pixels[texel.index as usize] = diverging(value / peak);
    }
    Image { caption: caption.into(), png: png(&pixels, size as u32, size as u32) }
}

/// Blue for −1, white for 0, red for 1 (the ends of ColorBrewer's RdBu, safe for colour-blind readers).
fn diverging(value: f32) -> [u8; 3] {
    let (end, t) =
        if value < 0.0 { (Vec3::new(33.0, 102.0, 172.0), -value) } else { (Vec3::new(178.0, 24.0, 43.0), value) };
    // Square root, so that small values are seen.
    Vec3::splat(255.0).lerp(end, t.clamp(0.0, 1.0).sqrt()).to_array().map(|c| c as u8)
}

/// An element (of a coloured basis its green part) over the whole page, row by row.
pub fn element_pixels(basis: &Basis, element: usize) -> Vec<[u8; 3]> {
    let plane = basis.size * basis.size;
    let first = (element * basis.components + basis.components / 2) * plane;
    let value = |texel: usize| {
        let scale = basis.anchors.as_ref().map_or(1.0, |anchors| anchors.scale(texel));
        basis.values.get(first + texel) * scale
    };
    let peak = (0..plane).fold(f32::MIN_POSITIVE, |m, t| m.max(value(t).abs()));
    (0..plane).map(|t| diverging(value(t) / peak)).collect()
}

/// The first eight elements of a basis as lightmaps; of a coloured basis the green part.
pub fn basis_images(lightmap: &Lightmap, basis: &Basis) -> Vec<Image> {
    let plane = basis.size * basis.size;
    let image = |j: usize| {
        let first = (j * basis.components + basis.components / 2) * plane;
        let values: Vec<f32> = lightmap.texels.iter().map(|t| basis.values.get(first + t.index as usize)).collect();
        signed_lightmap(lightmap, &values, format!("element {}", j + 1))
    };
    (0..basis.elements.min(8)).map(image).collect()
}

/// Both pictures of Figure 4: the points, and their sub-points, seen by the asset's first camera.
pub fn point_images(tracer: &Tracer, points: &MeasurementPoints) -> Result<Vec<Image>, ViewError> {
    let view = View::new(tracer.asset().cameras[0].clone(), 560, 440);
    let sub_points = format!("{} sub-points in the colours of their points", points.sub_points.len());
    Ok(vec![
        self::points(tracer, &view, points, false, format!("{} measurement points", points.points.len()))?,
        self::points(tracer, &view, points, true, sub_points)?,
    ])
}

/// The measurement points (paper, Figure 4): the points on the asset, or its sub-points in the colours of the points that
/// average them.
pub fn points(
    tracer: &Tracer,
    view: &View,
    points: &MeasurementPoints,
    show_sub_points: bool,
    caption: impl Into<String>,
) -> Result<Image, ViewError> {
    let pinhole = view.pinhole()?;
    let shown = if show_sub_points { &points.sub_points } else { &points.points };
    let owners = if show_sub_points { owners(points) } else { (0..points.points.len() as u32).map(Some).collect() };
    // A disk covers a fifth of a point's share of the bounding box's faces: large enough to see, too small to touch.
    let radius = tracer.extent / (shown.len() as f32).sqrt() * 0.22;
    let (width, grid) = (view.width as usize, view.samples_per_axis);
    let mut pixels = vec![[255u8; 3]; width * view.height as usize];
    pixels.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.iter_mut().enumerate() {
            let mut sum = Vec3::ZERO;
            for sample in 0..grid * grid {
                let at = Vec2::new(x as f32, y as f32)
                    + (Vec2::new((sample % grid) as f32, (sample / grid) as f32) + 0.5) / grid as f32;
                let to_scene = pinhole.through(at);
                sum += match first_visible(tracer, pinhole.eye, to_scene) {
                    None => Vec3::ONE,
                    Some(hit) => {
                        let surface = tracer.surface(&hit, to_scene);
                        let clay = Vec3::splat(0.35 + 0.55 * surface.normal.dot(-to_scene).max(0.0));
                        let nearest = nearest_disk(shown, surface.position, surface.normal, radius);
                        nearest.map_or(clay, |i| owners[i].map_or(Vec3::splat(0.5), palette))
                    }
                };
            }
            *pixel = (sum / (grid * grid) as f32).to_array().map(|c| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8);
        }
    });
    Ok(Image { caption: caption.into(), png: png(&pixels, view.width, view.height) })
}

fn nearest_disk(points: &[MeasurementPoint], position: Vec3, normal: Vec3, radius: f32) -> Option<usize> {
    let facing = points.iter().enumerate().filter(|(_, p)| p.normal.dot(normal) > 0.5);
    let near = facing.map(|(i, p)| (p.position.distance_squared(position), i)).min_by(|a, b| a.0.total_cmp(&b.0))?;
    (near.0 < radius * radius).then_some(near.1)
}

/// For each sub-point, the nearest of the points that average it.
fn owners(points: &MeasurementPoints) -> Vec<Option<u32>> {
    let mut owners: Vec<Option<(f32, u32)>> = vec![None; points.sub_points.len()];
    let count = points.neighbours_per_point().max(1);
    for (p, neighbours) in points.neighbours.chunks(count).enumerate() {
        for &s in neighbours {
            let d = points.points[p].position.distance_squared(points.sub_points[s as usize].position);
            let owner = &mut owners[s as usize];
            if owner.is_none_or(|(best, _)| d < best) {
                *owner = Some((d, p as u32));
            }
        }
    }
    owners.into_iter().map(|o| o.map(|(_, p)| p)).collect()
}

/// A colour of its own for each index: hues by the golden ratio.
fn palette(index: u32) -> Rgb {
    let hue = (index as f32 * 0.618_034).fract() * 6.0;
    let ramp = |offset: f32| (((hue + offset) % 6.0 - 3.0).abs() - 1.0).clamp(0.0, 1.0);
    let strength = if index.is_multiple_of(2) { 0.95 } else { 0.7 };
    Vec3::new(ramp(0.0), ramp(4.0), ramp(2.0)) * strength * 0.85 + 0.05
}
