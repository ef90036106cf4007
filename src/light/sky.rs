//! A clear sky and its sun (Preetham, Shirley, Smits, *A Practical Analytic Model for Daylight*, 1999).
//!
//! Luminance and chromaticity are Perez functions of the angles to the zenith and to the sun (their equation 3 and appendix
//! A.2). The sun's light is attenuated along the relative optical mass of the air as in their appendix A.1, at one
//! wavelength a channel instead of an integral over the spectrum.

use std::f32::consts::{FRAC_1_PI, FRAC_PI_2, PI};

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::EnvironmentMap;
use crate::math::Rgb;

/// What a clear sky looks like.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sky {
    /// Radians of the sun above the horizon, 0 to π/2.
    pub sun_elevation: f32,
    /// Radians of the sun from −z towards +x: clockwise as seen from above, as on a compass.
    #[serde(default)]
    pub sun_azimuth: f32,
    /// Haze: 2 is very clear, 6 hazy; the model holds from 1.7 to 10.
    #[serde(default = "Sky::default_turbidity")]
    pub turbidity: f32,
    /// What the ground below the horizon reflects.
    #[serde(default = "Sky::default_ground")]
    pub ground_albedo: f32,
    /// What the sun's own light is multiplied with; 0: the sky alone.
    #[serde(default = "super::condition::one")]
    pub sun: f32,
    #[serde(default = "super::condition::white")]
    pub color: Rgb,
    /// What the model's nits, and the sun's lux, are multiplied with.
    #[serde(default = "super::condition::one")]
    pub intensity: f32,
}

/// Columns and rows of the tabulated sky: texels of 5.6°, each of them the mean over itself.
const SIZE: [usize; 2] = [64, 32];

/// Illuminance of the sun outside the atmosphere, lux (IES, *Lighting Handbook*).
const SUN_ILLUMINANCE: f32 = 127_500.0;

impl Sky {
    /// A sky as the model has it, at this elevation of the sun.
    pub fn at(sun_elevation: f32) -> Self {
        Self {
            sun_elevation,
            sun_azimuth: 0.0,
            turbidity: Self::default_turbidity(),
            ground_albedo: Self::default_ground(),
            sun: 1.0,
            color: Vec3::ONE,
            intensity: 1.0,
        }
    }

    fn default_turbidity() -> f32 {
        3.0
    }

    fn default_ground() -> f32 {
        0.2
    }

    /// What is wrong with the sky, if anything, as one line.
    pub fn check(&self) -> Result<(), String> {
        let within = |name: &str, value: f32, low: f32, high: f32| {
            // Written so that NaN fails.
            if low <= value && value <= high {
                Ok(())
            } else {
                Err(format!("{name} {value} must be in {low} to {high}"))
            }
        };
        within("sun_elevation", self.sun_elevation, 0.0, FRAC_PI_2 + 1e-6)?;
        within("turbidity", self.turbidity, 1.7, 10.0)?;
        within("ground_albedo", self.ground_albedo, 0.0, 1.0)?;
        within("sun", self.sun, 0.0, f32::MAX)?;
        if self.sun_azimuth.is_finite() {
            Ok(())
        } else {
            Err(format!("sun_azimuth {} is not finite", self.sun_azimuth))
        }
    }

    /// Unit vector towards the sun.
    pub fn towards_sun(&self) -> Vec3 {
        let ((sin_e, cos_e), (sin_a, cos_a)) = (self.sun_elevation.sin_cos(), self.sun_azimuth.sin_cos());
        Vec3::new(cos_e * sin_a, sin_e, -cos_e * cos_a)
    }

    /// Angle by which [`Sky::tabulate`]'s map is turned about +y.
    pub fn rotation(&self) -> f32 {
        -self.sun_azimuth
    }

    /// Lux of the sun on a surface that faces it.
    pub fn sun_illuminance(&self) -> Rgb {
        let zenith_degrees = 90.0 - self.sun_elevation.to_degrees();
        // Relative optical mass (Kasten; Preetham et al., A.1).
        let mass = 1.0 / (self.sun_elevation.sin() + 0.15 * (93.885 - zenith_degrees).powf(-1.253));
        // Ångström's turbidity for particles of 1.3.
        let beta = 0.04608 * self.turbidity - 0.04586;
        // Micrometres near the peaks of the primaries, and the absorption of 0.35 cm of ozone there.
        let transmitted = |wavelength: f32, ozone: f32| {
            let rayleigh = 0.008735 * wavelength.powf(-4.08);
            let aerosol = beta * wavelength.powf(-1.3);
            (-(rayleigh + aerosol + 0.35 * ozone) * mass).exp()
        };
        let colour = Vec3::new(transmitted(0.61, 0.12), transmitted(0.55, 0.085), transmitted(0.465, 0.012));
        self.sun * SUN_ILLUMINANCE * colour
    }

    /// Nit that the sky above the horizon sends from the unit vector `towards`.
    pub fn radiance(&self, towards: Vec3) -> Rgb {
        Perez::new(self).radiance(towards, self.towards_sun())
    }

    /// Lux of sky and sun together on level ground, at unit intensity and colour.
    pub fn illuminance(&self) -> Rgb {
        let above = self.tabulate();
        above.irradiance(Vec3::Y) + self.sun_illuminance() * self.sun_elevation.sin()
    }

    /// The sky as a map whose middle column holds the sun, the ground below it lit by sky and sun.
    pub fn tabulate(&self) -> EnvironmentMap {
        let ahead = Sky { sun_azimuth: 0.0, ..*self };
        let (perez, sun) = (Perez::new(&ahead), ahead.towards_sun());
        let [width, height] = SIZE;
        let mut texels = vec![Rgb::ZERO; width * height];
        let mut irradiance = self.sun_illuminance() * sun.y;
        let edge = |row: f32| (PI * row / height as f32).cos();
        for row in 0..height / 2 {
            for column in 0..width / 2 {
                // The mean of 3 × 3 points of equal solid angle.
                let mut sum = Rgb::ZERO;
                for i in 0..9 {
                    let (x, y) = ((i % 3) as f32 / 3.0 + 1.0 / 6.0, (i / 3) as f32 / 3.0 + 1.0 / 6.0);
                    let (top, bottom) = (edge(row as f32), edge(row as f32 + 1.0));
                    let cos = (top + (bottom - top) * y).max(0.0);
                    let sin = (1.0 - cos * cos).sqrt();
                    let phi = PI * (2.0 * (column as f32 + x) / width as f32 - 1.0);
                    sum += perez.radiance(Vec3::new(sin * phi.sin(), cos, -sin * phi.cos()), sun);
                }
                texels[row * width + column] = sum / 9.0;
                // The sky is as bright to the right of the sun as to its left.
                texels[row * width + width - 1 - column] = sum / 9.0;
                let (top, bottom) = (edge(row as f32), edge(row as f32 + 1.0));
                // ∫ cos θ over the two texels.
                irradiance += sum / 9.0 * (top * top - bottom * bottom) * (2.0 * PI / width as f32);
            }
        }
        texels[height / 2 * width..].fill(irradiance * self.ground_albedo * FRAC_1_PI);
        EnvironmentMap::new(width, height, texels)
    }
}

/// The Perez functions of one sky: luminance Y (nit) and chromaticities x and y.
struct Perez {
    coefficients: [[f32; 5]; 3],
    /// Value at the zenith over the function's own there.
    scale: [f32; 3],
}

impl Perez {
    fn new(sky: &Sky) -> Self {
        let t = sky.turbidity;
        let sun = FRAC_PI_2 - sky.sun_elevation;
        // Appendix A.2, coefficients A to E of Y, x and y.
        let coefficients = [
            [
                0.1787 * t - 1.4630,
                -0.3554 * t + 0.4275,
                -0.0227 * t + 5.3251,
                0.1206 * t - 2.5771,
                -0.0670 * t + 0.3703,
            ],
            [
                -0.0193 * t - 0.2592,
                -0.0665 * t + 0.0008,
                -0.0004 * t + 0.2125,
                -0.0641 * t - 0.8989,
                -0.0033 * t + 0.0452,
            ],
            [
                -0.0167 * t - 0.2608,
                -0.0950 * t + 0.0092,
                -0.0079 * t + 0.2102,
                -0.0441 * t - 1.6537,
                -0.0109 * t + 0.0529,
            ],
        ];
        let chi = (4.0 / 9.0 - t / 120.0) * (PI - 2.0 * sun);
        let luminance = 1000.0 * ((4.0453 * t - 4.9710) * chi.tan() - 0.2155 * t + 2.4192);
        let powers = |[a, b, c, d]: [f32; 4]| ((a * sun + b) * sun + c) * sun + d;
        let zenith_x = powers([0.00166, -0.00375, 0.00209, 0.0]) * t * t
            + powers([-0.02903, 0.06377, -0.03202, 0.00394]) * t
            + powers([0.11693, -0.21196, 0.06052, 0.25886]);
        let zenith_y = powers([0.00275, -0.00610, 0.00317, 0.0]) * t * t
            + powers([-0.04214, 0.08970, -0.04153, 0.00516]) * t
            + powers([0.15346, -0.26756, 0.06670, 0.26688]);
        let zenith = [luminance.max(0.0), zenith_x, zenith_y];
        let scale = std::array::from_fn(|i| zenith[i] / perez(&coefficients[i], 1.0, sun, sun.cos()));
        Self { coefficients, scale }
    }

    fn radiance(&self, towards: Vec3, sun: Vec3) -> Rgb {
        // At the horizon itself exp(B / cos θ) is 0.
        let cos_zenith = towards.y.max(1e-3);
        let cos_sun = towards.dot(sun).clamp(-1.0, 1.0);
        let angle = cos_sun.acos();
        let [luminance, x, y] =
            std::array::from_fn(|i| self.scale[i] * perez(&self.coefficients[i], cos_zenith, angle, cos_sun));
        let (big_x, big_z) = (luminance * x / y, luminance * (1.0 - x - y) / y);
        // Linear Rec. 709 from XYZ (IEC 61966-2-1). Colours outside its gamut end at its border.
        Vec3::new(
            3.2406 * big_x - 1.5372 * luminance - 0.4986 * big_z,
            -0.9689 * big_x + 1.8758 * luminance + 0.0415 * big_z,
            0.0557 * big_x - 0.2040 * luminance + 1.0570 * big_z,
        )
        .max(Vec3::ZERO)
    }
}

/// (1 + A e^{B / cos θ}) (1 + C e^{D γ} + E cos² γ), equation 3.
fn perez(&[a, b, c, d, e]: &[f32; 5], cos_zenith: f32, angle: f32, cos_angle: f32) -> f32 {
    (1.0 + a * (b / cos_zenith).exp()) * (1.0 + c * (d * angle).exp() + e * cos_angle * cos_angle)
}
