//! A sample bent over a cylinder: a sheet whose two side edges rest on the carrier and whose middle stands
//! above it. The cylinder's axis runs along the sample's y.

use glam::DVec3;

/// The bent sheet, in the sample's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BentSheet {
    radius: f64,
    /// z of the axis, below the carrier unless the sheet goes half way round.
    axis_z: f64,
    half_height: f64,
}

/// Where a ray meets the sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Struck {
    /// The point.
    pub(super) point: DVec3,
    /// Outward normal.
    pub(super) normal: DVec3,
    /// Place on the sheet from its middle, mm: along the arc and along the axis.
    pub(super) sheet_mm: [f64; 2],
    /// Whether the ray comes from outside; the inside is black.
    pub(super) outside: bool,
}

impl BentSheet {
    /// A sheet of a size bent to a radius, mm.
    pub(super) fn new(width_mm: f64, height_mm: f64, radius: f64) -> Self {
        let axis_z = -radius * (0.5 * width_mm / radius).cos();
        Self { radius, axis_z, half_height: 0.5 * height_mm }
    }

    /// The first point at which a ray meets the sheet.
    pub(super) fn strike(&self, from: DVec3, direction: DVec3) -> Option<Struck> {
        // |(x, z − axis)|² = radius² along the ray: a t² + 2 b t + c = 0.
        let up = from.z - self.axis_z;
        let a = direction.x * direction.x + direction.z * direction.z;
        let b = from.x * direction.x + up * direction.z;
        let c = from.x * from.x + up * up - self.radius * self.radius;
        let discriminant = b * b - a * c;
        if discriminant <= 0.0 {
            return None;
        }
        let root = discriminant.sqrt();
        // A ray that starts on the sheet does not meet it there.
        let times = [(-b - root) / a, (-b + root) / a].into_iter().filter(|&t| t > 1e-9);
        times.map(|t| from + direction * t).find(|p| p.z >= 0.0 && p.y.abs() <= self.half_height).map(
            |point| {
                let normal = DVec3::new(point.x, 0.0, point.z - self.axis_z) / self.radius;
                let sheet_mm = [self.radius * normal.x.atan2(normal.z), point.y];
                Struck { point, normal, sheet_mm, outside: normal.dot(direction) < 0.0 }
            },
        )
    }
}

impl Struck {
    /// A direction in the sheet's own frame: along the arc, along the axis, outward.
    pub(super) fn local(&self, direction: DVec3) -> DVec3 {
        let along = DVec3::new(self.normal.z, 0.0, -self.normal.x);
        DVec3::new(direction.dot(along), direction.y, direction.dot(self.normal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_half_cylinder_is_struck_where_its_closed_form_says_and_a_wide_one_is_nearly_flat() {
        let half = BentSheet::new(std::f64::consts::PI * 10.0, 40.0, 10.0);
        let struck = half.strike(DVec3::new(6.0, 3.0, 100.0), DVec3::NEG_Z).unwrap();
        assert!((struck.point - DVec3::new(6.0, 3.0, 8.0)).length() < 1e-9 && struck.outside);
        assert!((struck.sheet_mm[0] - 10.0 * 0.6f64.asin()).abs() < 1e-9 && struck.sheet_mm[1] == 3.0);
        assert!((struck.local(DVec3::Z) - DVec3::new(-0.6, 0.0, 0.8)).length() < 1e-9);
        assert!(half.strike(DVec3::new(6.0, 21.0, 100.0), DVec3::NEG_Z).is_none());
        // Through the open end and under the sheet.
        let below = half.strike(DVec3::new(0.0, 30.0, 1.0), DVec3::new(0.0, -1.0, 0.3).normalize()).unwrap();
        assert!(!below.outside);
        let flat = BentSheet::new(64.0, 64.0, 1e6);
        let struck = flat.strike(DVec3::new(20.0, 5.0, 1000.0), DVec3::NEG_Z).unwrap();
        assert!((struck.sheet_mm[0] - 20.0).abs() < 1e-6 && struck.normal.z > 0.999_999);
    }
}
