//! Orthonormal frames around a normal.

use glam::Vec3;

/// A right-handed orthonormal frame whose z axis is the normal.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    pub tangent: Vec3,
    pub bitangent: Vec3,
    pub normal: Vec3,
}

impl Frame {
    /// Builds a frame around a unit `normal` without branches (Duff et al., *Building an Orthonormal Basis, Revisited*, 2017).
    pub fn from_normal(normal: Vec3) -> Self {
        let sign = 1f32.copysign(normal.z);
        let a = -1.0 / (sign + normal.z);
        let b = normal.x * normal.y * a;
        Self {
            tangent: Vec3::new(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
            bitangent: Vec3::new(b, sign + normal.y * normal.y * a, -normal.y),
            normal,
        }
    }

    pub fn world_from_local(&self, v: Vec3) -> Vec3 {
        self.tangent * v.x + self.bitangent * v.y + self.normal * v.z
    }

    pub fn local_from_world(&self, v: Vec3) -> Vec3 {
        Vec3::new(v.dot(self.tangent), v.dot(self.bitangent), v.dot(self.normal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn frame_is_orthonormal_and_right_handed(x in -1f32..1.0, y in -1f32..1.0, z in -1f32..1.0) {
            let v = Vec3::new(x, y, z);
            prop_assume!(v.length() > 1e-3);
            let frame = Frame::from_normal(v.normalize());
            // Rounding of a handful of f32 operations on values of at most 2.
            prop_assert!((frame.tangent.cross(frame.bitangent) - frame.normal).length() < 1e-5);
            prop_assert!(frame.tangent.dot(frame.bitangent).abs() < 1e-5);
            let w = Vec3::new(0.3, -0.2, 0.9);
            prop_assert!((frame.local_from_world(frame.world_from_local(w)) - w).length() < 1e-5);
        }
    }
}
