//! The sample's surface under a pixel: the carrier's plane, or a cylinder that the sample is bent over, its
//! axis along the sample's y and its two side edges on the carrier (rig.toml: `carrier.cylinder_radius_mm`).

use glam::{DVec2, DVec3};

use crate::rig::config::Carrier;

/// A point of the sample that the camera sees, in the sample's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SurfacePoint {
    /// The point, mm.
    pub(super) position_mm: DVec3,
    /// Its place on the sample laid flat, mm.
    pub(super) flat_mm: DVec2,
    /// Tangent across the sample; the other tangent is y.
    across: DVec3,
    /// Outward normal.
    pub(super) normal: DVec3,
}

impl SurfacePoint {
    /// The point with a place on the sample laid flat.
    pub(super) fn at(carrier: &Carrier, flat_mm: DVec2) -> Self {
        let Some(radius) = carrier.cylinder_radius_mm else {
            return Self { position_mm: flat_mm.extend(0.0), flat_mm, across: DVec3::X, normal: DVec3::Z };
        };
        let (sin, cos) = (flat_mm.x / radius).sin_cos();
        let rim = (0.5 * carrier.sample_width_mm / radius).cos();
        Self {
            position_mm: DVec3::new(radius * sin, flat_mm.y, radius * (cos - rim)),
            flat_mm,
            across: DVec3::new(cos, 0.0, -sin),
            normal: DVec3::new(sin, 0.0, cos),
        }
    }

    /// The point that a camera sees where its ray meets the carrier's plane in `plane_mm`; `None` beside the
    /// sample.
    pub(super) fn seen(carrier: &Carrier, camera_mm: DVec3, plane_mm: DVec2) -> Option<Self> {
        let half = DVec2::new(carrier.sample_width_mm, carrier.sample_height_mm) / 2.0;
        let flat_mm = match carrier.cylinder_radius_mm {
            None => plane_mm,
            Some(radius) => {
                // Across the axis, the ray is nearest to it in `foot`, and enters the circle half a chord
                // earlier.
                let axis = DVec2::new(0.0, -radius * (half.x / radius).cos());
                let (from, to) = (DVec2::new(camera_mm.x, camera_mm.z), DVec2::new(plane_mm.x, 0.0));
                let along = (to - from).normalize();
                let foot = from + along * (axis - from).dot(along);
                let chord = radius * radius - (foot - axis).length_squared();
                let entry = foot - along * (chord > 0.0).then(|| chord.sqrt())?;
                let travelled = (entry - from).length() / (to - from).length();
                let y = camera_mm.y + (plane_mm.y - camera_mm.y) * travelled;
                DVec2::new(radius * (entry.x - axis.x).atan2(entry.y - axis.y), y)
            }
        };
        flat_mm.abs().cmple(half).all().then(|| Self::at(carrier, flat_mm))
    }

    /// A direction in the frame of the reflectance: across, along y, outward.
    pub(super) fn local(&self, direction: DVec3) -> DVec3 {
        DVec3::new(direction.dot(self.across), direction.y, direction.dot(self.normal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_of_the_surface_is_seen_along_the_ray_through_it() {
        let camera = DVec3::new(300.0, -200.0, 900.0);
        for radius in [None, Some(22.0), Some(60.0)] {
            let carrier = Carrier { cylinder_radius_mm: radius, ..Carrier::default() };
            for flat in [DVec2::ZERO, DVec2::new(20.0, 31.0), DVec2::new(-8.0, -12.0)] {
                let point = SurfacePoint::at(&carrier, flat);
                assert!((point.local(point.across.cross(DVec3::Y)) - DVec3::Z).length() < 1e-12);
                let ray = point.position_mm - camera;
                if ray.dot(point.normal) >= 0.0 {
                    continue;
                }
                let plane = camera - ray * (camera.z / ray.z);
                let seen = SurfacePoint::seen(&carrier, camera, plane.truncate()).unwrap();
                assert!((seen.flat_mm - flat).length() < 1e-9, "{radius:?} {flat}: {seen:?}");
                assert!((seen.position_mm - point.position_mm).length() < 1e-9);
            }
            assert!(SurfacePoint::seen(&carrier, camera, DVec2::new(50.0, 0.0)).is_none());
        }
    }
}
