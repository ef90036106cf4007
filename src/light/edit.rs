//! The parts of a light that are moved, aimed, coloured and dimmed, whatever its kind.

use glam::Vec3;

use super::condition::Strength;
use super::{Kind, Light};
use crate::math::Rgb;

impl Light {
    pub fn kind(&self) -> Kind {
        match self {
            Light::Point { .. } => Kind::Point,
            Light::Spot { .. } => Kind::Spot,
            Light::Directional { .. } => Kind::Directional,
            Light::Rect { .. } => Kind::Rect,
            Light::Disk { .. } => Kind::Disk,
            Light::Sphere { .. } => Kind::Sphere,
            Light::Environment { .. } => Kind::Environment,
            Light::Sky(_) => Kind::Sky,
            Light::Emissive { .. } => Kind::Emissive,
        }
    }

    /// Where it stands, metres; none for lights that stand nowhere.
    pub fn position_mut(&mut self) -> Option<&mut Vec3> {
        match self {
            Light::Point { position, .. }
            | Light::Spot { position, .. }
            | Light::Rect { position, .. }
            | Light::Disk { position, .. }
            | Light::Sphere { position, .. } => Some(position),
            Light::Directional { .. } | Light::Environment { .. } | Light::Sky(_) | Light::Emissive { .. } => None,
        }
    }

    /// Unit vector along which it shines. A sky's is that of its sun: see [`Self::aim`].
    pub fn direction_mut(&mut self) -> Option<&mut Vec3> {
        match self {
            Light::Spot { direction, .. }
            | Light::Directional { direction, .. }
            | Light::Rect { direction, .. }
            | Light::Disk { direction, .. } => Some(direction),
            _ => None,
        }
    }

    pub fn color_mut(&mut self) -> Option<&mut Rgb> {
        self.strength_mut().color
    }

    /// What its colour is multiplied with, and the unit.
    pub fn amount_mut(&mut self) -> (&mut f32, &'static str) {
        let Strength { amount, unit, .. } = self.strength_mut();
        (amount, unit)
    }

    /// Where it stands, metres; none for lights that stand nowhere.
    pub fn position(&self) -> Option<Vec3> {
        self.clone().position_mut().copied()
    }

    /// Unit vector along which it, or its sun, shines.
    pub fn direction(&self) -> Option<Vec3> {
        match self {
            Light::Sky(sky) => Some(-sky.towards_sun()),
            _ => self.clone().direction_mut().copied(),
        }
    }

    /// Makes it, or its sun, shine along `direction`, which need not be unit; a sun does not set.
    pub fn aim(&mut self, direction: Vec3) {
        let Some(direction) = direction.try_normalize() else { return };
        if let Light::Sky(sky) = self {
            let towards = -direction;
            sky.sun_elevation = towards.y.clamp(-1.0, 1.0).asin().clamp(0.0, std::f32::consts::FRAC_PI_2);
            if towards.x != 0.0 || towards.z != 0.0 {
                sky.sun_azimuth = towards.x.atan2(-towards.z).rem_euclid(std::f32::consts::TAU);
            }
        } else if let Some(to) = self.direction_mut() {
            *to = direction;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::Sky;

    #[test]
    fn a_sky_is_aimed_at_its_sun() {
        let mut light = Light::Sky(Sky::at(0.3));
        for towards in [Vec3::new(0.3, 0.5, -0.8), Vec3::new(-0.9, 0.1, 0.2), Vec3::Y] {
            light.aim(-towards * 3.0);
            assert!((light.direction().unwrap() + towards.normalize()).length() < 1e-5, "{light:?}");
            assert_eq!(light.clone().validated().unwrap(), light);
        }
        // Below the horizon it stays on it.
        light.aim(Vec3::new(1.0, 1.0, 0.0));
        assert!((light.direction().unwrap() - Vec3::X).length() < 1e-5);
    }
}
