//! ꟻLIP: how different two pictures look when one is flipped to the other (Andersson, Nilsson, Akenine-Möller, Oskarsson,
//! Åström, Fairchild, *ꟻLIP: A Difference Evaluator for Alternating Images*, 2020; for high dynamic range Andersson,
//! Nilsson, Shirley, Akenine-Möller, *Visualizing Errors in Rendered High Dynamic Range Images*, 2021).
//!
//! Constants are the papers'. Pictures are seen from 0.7 m on a screen of 3,840 pixels in 0.7 m.

use glam::{Mat3, Vec3};
use rayon::prelude::*;

use crate::math::Rgb;
use crate::math::colour::luminance;
use crate::model::Picture;

/// Pixels in a degree of the visual field.
const PIXELS_PER_DEGREE: f32 = 0.7 * 3840.0 / 0.7 * std::f32::consts::PI / 180.0;

/// Contrast sensitivity of the achromatic, red-green and blue-yellow channels, as sums of Gaussians: (a, b) of each.
const SENSITIVITY: [&[(f32, f32)]; 3] = [&[(1.0, 0.0047)], &[(1.0, 0.0053)], &[(34.1, 0.04), (13.5, 0.025)]];
/// The widest of their b.
const WIDEST: f32 = 0.04;

/// Exponent of colour differences, and how they are spread over [0, 1].
const COLOUR_EXPONENT: f32 = 0.7;
const KNEE: (f32, f32) = (0.4, 0.95);

/// Width of the detectors of edges and points, degrees, and the exponent of what they see.
const FEATURE_WIDTH: f32 = 0.082;
const FEATURE_EXPONENT: f32 = 0.5;

/// Per pixel, from 0, equal, to 1: of pictures with display-linear values in [0, 1].
pub fn ldr(reference: &Picture, test: &Picture) -> Vec<f32> {
    assert_eq!((reference.width, reference.height), (test.width, test.height), "pictures of different sizes");
    let seen = [reference, test].map(Seen::new);
    let largest = hyab(hunt(lab(Vec3::Y)), hunt(lab(Vec3::Z))).powf(COLOUR_EXPONENT);
    let pixel = |i: usize| {
        let difference = hyab(seen[0].colours[i], seen[1].colours[i]).powf(COLOUR_EXPONENT);
        let knee = KNEE.0 * largest;
        let colour = if difference < knee {
            KNEE.1 / knee * difference
        } else {
            KNEE.1 + (difference - knee) / (largest - knee) * (1.0 - KNEE.1)
        };
        let of = |features: fn(&Seen) -> &Vec<f32>| (features(&seen[0])[i] - features(&seen[1])[i]).abs();
        let feature = of(|s| &s.edges).max(of(|s| &s.points)) * std::f32::consts::FRAC_1_SQRT_2;
        colour.powf(1.0 - feature.powf(FEATURE_EXPONENT)).clamp(0.0, 1.0)
    };
    (0..reference.pixels.len()).into_par_iter().map(pixel).collect()
}

/// Per pixel the largest difference over the exposures at which something of the reference is seen: of scene-linear pictures.
pub fn hdr(reference: &Picture, test: &Picture) -> Vec<f32> {
    let (start, stop) = exposures(reference);
    let count = ((stop - start).ceil() as usize).max(2);
    let mut worst = vec![0f32; reference.pixels.len()];
    for i in 0..count {
        let gain = (start + i as f32 * (stop - start) / (count - 1) as f32).exp2();
        let shown = |picture: &Picture| {
            let pixels = picture.pixels.iter().map(|&c| (c * gain).map(aces)).collect();
            Picture { width: picture.width, height: picture.height, pixels }
        };
        let differences = ldr(&shown(reference), &shown(test));
        worst.iter_mut().zip(differences).for_each(|(worst, d)| *worst = worst.max(d));
    }
    worst
}

/// Mean over the pixels, the papers' single number.
pub fn mean(differences: &[f32]) -> f64 {
    differences.iter().map(|&d| d as f64).sum::<f64>() / differences.len().max(1) as f64
}

/// Numerator and denominator of the tone curve (Narkowicz 2015, fitted to ACES), the papers' with exposure 0.6.
const ACES: [[f32; 3]; 2] = [[0.6 * 0.6 * 2.51, 0.6 * 0.03, 0.0], [0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14]];

fn aces(x: f32) -> f32 {
    let [[a, b, c], [d, e, f]] = ACES;
    ((a * x * x + b * x + c) / (d * x * x + e * x + f)).clamp(0.0, 1.0)
}

/// Exposures, in stops, that show the brightest and the median luminance at 85 % of white.
fn exposures(reference: &Picture) -> (f32, f32) {
    const SHOWN: f32 = 0.85;
    let [top, bottom] = ACES;
    let [a, b, c] = [0, 1, 2].map(|k| top[k] - SHOWN * bottom[k]);
    let x = (-b + (b * b - 4.0 * a * c).max(0.0).sqrt()) / (2.0 * a);
    let mut levels: Vec<f32> = reference.pixels.iter().map(|&p| luminance(p)).collect();
    levels.sort_by(f32::total_cmp);
    let n = levels.len();
    let median = (levels[(n - 1) / 2] + levels[n / 2]) / 2.0;
    // A dark half has no exposure of its own.
    let stops = |level: f32| (x / level.max(levels[n - 1] * 1e-6).max(f32::MIN_POSITIVE)).log2();
    (stops(levels[n - 1]), stops(median))
}

/// What the eye makes of a picture.
struct Seen {
    /// L*a*b* after contrast sensitivity, a* and b* weighted by lightness.
    colours: Vec<Vec3>,
    /// Strength of edges and of points and lines in the lightness.
    edges: Vec<f32>,
    points: Vec<f32>,
}

impl Seen {
    fn new(picture: &Picture) -> Self {
        let size = (picture.width as usize, picture.height as usize);
        let opponent: Vec<Vec3> = picture.pixels.par_iter().map(|&c| opponent(c)).collect();
        let channel = |k: usize| opponent.iter().map(|c| c[k]).collect::<Vec<f32>>();
        let filtered: [Vec<f32>; 3] = [0, 1, 2].map(|k| sensed(&channel(k), size, SENSITIVITY[k]));
        let colours = (0..opponent.len())
            .into_par_iter()
            .map(|i| {
                let linear = rgb_from_opponent(Vec3::from_array([0, 1, 2].map(|k: usize| filtered[k][i])));
                hunt(lab(linear.clamp(Vec3::ZERO, Vec3::ONE)))
            })
            .collect();
        let lightness: Vec<f32> = opponent.iter().map(|c| (c.x + 16.0) / 116.0).collect();
        let [edges, points] = features(&lightness, size);
        Self { colours, edges, points }
    }
}

/// A channel through a contrast sensitivity function. Gaussians are separable, their sum is one channel after the other.
fn sensed(channel: &[f32], size: (usize, usize), gaussians: &[(f32, f32)]) -> Vec<f32> {
    use std::f32::consts::PI;
    let radius = (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * PIXELS_PER_DEGREE).ceil() as i32;
    let mut sum = vec![0f32; channel.len()];
    let mut total = 0.0;
    for &(a, b) in gaussians {
        let kernel: Vec<f32> =
            (-radius..=radius).map(|x| (-(PI * x as f32 / PIXELS_PER_DEGREE).powi(2) / b).exp()).collect();
        let weight = a * (PI / b).sqrt();
        total += weight * kernel.iter().sum::<f32>().powi(2);
        let filtered = vertically(&horizontally(channel, size, &kernel), size, &kernel);
        sum.iter_mut().zip(filtered).for_each(|(sum, f)| *sum += weight * f);
    }
    sum.iter_mut().for_each(|s| *s /= total);
    sum
}

/// Magnitudes of the first and of the second Gaussian derivatives.
fn features(lightness: &[f32], size: (usize, usize)) -> [Vec<f32>; 2] {
    let deviation = 0.5 * FEATURE_WIDTH * PIXELS_PER_DEGREE;
    let radius = (3.0 * deviation).ceil() as i32;
    let gaussian = |x: i32| (-(x * x) as f32 / (2.0 * deviation * deviation)).exp();
    let smooth: Vec<f32> = (-radius..=radius).map(gaussian).collect();
    let total: f32 = smooth.iter().sum();
    let smooth: Vec<f32> = smooth.iter().map(|g| g / total).collect();
    let first = |x: i32| -x as f32 * gaussian(x);
    let second = |x: i32| ((x * x) as f32 / (deviation * deviation) - 1.0) * gaussian(x);
    let magnitude = |derivative: &dyn Fn(i32) -> f32| -> Vec<f32> {
        // Weights of either sign sum to one.
        let raw: Vec<f32> = (-radius..=radius).map(derivative).collect();
        let positive: f32 = raw.iter().filter(|w| **w > 0.0).sum();
        let negative: f32 = -raw.iter().filter(|w| **w < 0.0).sum::<f32>();
        let kernel: Vec<f32> = raw.iter().map(|&w| if w > 0.0 { w / positive } else { w / negative }).collect();
        let along_x = vertically(&horizontally(lightness, size, &kernel), size, &smooth);
        let along_y = vertically(&horizontally(lightness, size, &smooth), size, &kernel);
        along_x.iter().zip(&along_y).map(|(x, y)| x.hypot(*y)).collect()
    };
    [magnitude(&first), magnitude(&second)]
}

/// Correlation with `kernel` along rows; the border goes on for ever.
fn horizontally(values: &[f32], (width, _): (usize, usize), kernel: &[f32]) -> Vec<f32> {
    let radius = kernel.len() / 2;
    let mut out = vec![0f32; values.len()];
    out.par_chunks_mut(width).zip(values.par_chunks(width)).for_each(|(out, row)| {
        for (x, out) in out.iter_mut().enumerate() {
            let at = |k: usize| row[(x + k).saturating_sub(radius).min(width - 1)];
            *out = kernel.iter().enumerate().map(|(k, w)| w * at(k)).sum();
        }
    });
    out
}

/// The same along columns.
fn vertically(values: &[f32], (width, height): (usize, usize), kernel: &[f32]) -> Vec<f32> {
    let radius = kernel.len() / 2;
    let mut out = vec![0f32; values.len()];
    out.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for (k, w) in kernel.iter().enumerate() {
            let row = (y + k).saturating_sub(radius).min(height - 1);
            out.iter_mut().zip(&values[row * width..]).for_each(|(out, v)| *out += w * v);
        }
    });
    out
}

/// Linear Rec. 709 to CIE XYZ.
const XYZ_FROM_RGB: Mat3 = Mat3::from_cols(
    Vec3::new(0.412_390_8, 0.212_639, 0.019_330_8),
    Vec3::new(0.357_584_3, 0.715_168_7, 0.119_194_8),
    Vec3::new(0.180_480_8, 0.072_192_3, 0.950_532_2),
);

/// XYZ relative to white.
fn relative_xyz(linear: Rgb) -> Vec3 {
    XYZ_FROM_RGB * linear / (XYZ_FROM_RGB * Vec3::ONE)
}

/// Linear colour in the opponent space Y Cx Cz, in which contrast sensitivity is known.
fn opponent(linear: Rgb) -> Vec3 {
    let Vec3 { x, y, z } = relative_xyz(linear);
    Vec3::new(116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z))
}

fn rgb_from_opponent(c: Vec3) -> Rgb {
    let y = (c.x + 16.0) / 116.0;
    XYZ_FROM_RGB.inverse() * (Vec3::new(y + c.y / 500.0, y, y - c.z / 200.0) * (XYZ_FROM_RGB * Vec3::ONE))
}

/// CIE L*a*b*.
fn lab(linear: Rgb) -> Vec3 {
    const DELTA: f32 = 6.0 / 29.0;
    let f = |t: f32| if t > DELTA * DELTA * DELTA { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 };
    let Vec3 { x, y, z } = relative_xyz(linear).map(f);
    Vec3::new(116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z))
}

/// Colours look stronger in the light (Hunt 1952).
fn hunt(lab: Vec3) -> Vec3 {
    Vec3::new(lab.x, 0.01 * lab.x * lab.y, 0.01 * lab.x * lab.z)
}

/// Distance of large colour differences (Abasi et al. 2020).
fn hyab(a: Vec3, b: Vec3) -> f32 {
    let d = a - b;
    d.x.abs() + d.y.hypot(d.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (u32, u32) = (96, 64);

    fn picture(pixel: impl Fn(f32, f32) -> Vec3) -> Picture {
        let (width, height) = SIZE;
        let pixels = (0..width * height).map(|i| pixel((i % width) as f32, (i / width) as f32)).collect();
        Picture { width, height, pixels }
    }

    /// Waves, a ramp and a chequerboard.
    fn pattern(x: f32, y: f32) -> Vec3 {
        let (w, h) = (SIZE.0 as f32, SIZE.1 as f32);
        let squares = ((x / 8.0).floor() + (y / 8.0).floor()) % 2.0;
        Vec3::new(0.5 + 0.5 * (x * 0.21).sin() * (y * 0.13).cos(), (x + y) / (w + h), squares)
    }

    fn close(found: f64, expected: f64) {
        // f32 throughout, here and there, over sums of some hundred terms; a constant in the wrong place moves the third digit.
        assert!((found - expected).abs() < 2e-4, "{found}, expected {expected}");
    }

    /// Against `flip_evaluator` 1.x, the authors' own (PyPI), on the same two pictures.
    #[test]
    fn it_is_the_authors_measure() {
        let reference = picture(pattern);
        let test = picture(|x, y| {
            let p = pattern(x, y);
            let before = pattern(if x == 0.0 { SIZE.0 as f32 - 1.0 } else { x - 1.0 }, y);
            Vec3::new(p.x * 0.9 + 0.02, p.y + 0.05 * (y * 0.9).sin(), before.z).clamp(Vec3::ZERO, Vec3::ONE)
        });
        let map = ldr(&reference, &test);
        close(mean(&map), 0.231_626_87);
        for ((x, y), expected) in [((10, 10), 0.202_165_44), ((48, 32), 0.158_293_41), ((95, 63), 0.144_152_13)] {
            close(map[y * SIZE.0 as usize + x] as f64, expected);
        }

        let bright = picture(|x, y| {
            let glow = 1.0 + 20.0 * (-((x - 30.0).powi(2) + (y - 20.0).powi(2)) / 50.0).exp();
            pattern(x, y) * pattern(x, y) * 4.0 * glow + 0.01
        });
        let tinted = picture(|x, y| bright.pixels[(y * SIZE.0 as f32 + x) as usize] * Vec3::new(0.9, 1.0, 1.1));
        let (start, stop) = exposures(&bright);
        close(start as f64, -3.098_897_9);
        close(stop as f64, 0.721_041_1);
        let map = hdr(&bright, &tinted);
        close(mean(&map), 0.111_389_496);
        for ((x, y), expected) in [((10, 10), 0.144_719_53), ((48, 32), 0.121_324_13), ((30, 20), 0.063_991_75)] {
            close(map[y * SIZE.0 as usize + x] as f64, expected);
        }
    }

    #[test]
    fn equal_pictures_do_not_differ_and_black_ones_are_pictures() {
        let reference = picture(pattern);
        assert!(ldr(&reference, &reference).iter().all(|&d| d == 0.0));
        let black = picture(|_, _| Vec3::ZERO);
        assert!(hdr(&black, &black).iter().all(|&d| d == 0.0));
        assert!(hdr(&black, &reference).iter().all(|d| (0.0..=1.0).contains(d)));
    }
}
