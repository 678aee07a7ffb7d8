//! Motor angles to light, camera and sample frames and back (chapter 3's four axes).
//!
//! Bench frame: origin where pan and tilt meet, camera on +z, the light's arc in the x–z plane. A point p of
//! the sample lies at Ry(pan) Rx(tilt) (Rz(roll) p + (0, 0, offset)).

use glam::{DMat3, DVec3};

use super::config::RigConfig;
use lobelia_reflectance::sampled::PoseGeometry;

/// Motor angles of one pose, radians.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotorAngles {
    /// About the bench's y axis.
    pub pan: f64,
    /// About the panned x axis.
    pub tilt: f64,
    /// About the sample's normal.
    pub roll: f64,
    /// From the camera's direction along the light's arc.
    pub light: f64,
}

impl MotorAngles {
    /// From degrees in the protocol's order: pan, tilt, roll, light.
    pub fn from_degrees(degrees: [f64; 4]) -> Self {
        let [pan, tilt, roll, light] = degrees.map(f64::to_radians);
        Self { pan, tilt, roll, light }
    }

    /// Degrees in the protocol's order.
    pub fn to_degrees(self) -> [f64; 4] {
        [self.pan, self.tilt, self.roll, self.light].map(f64::to_degrees)
    }
}

/// Where the sample is on the bench: p_bench = rotation · p_sample + translation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SamplePose {
    /// From the sample's frame to the bench's.
    pub rotation: DMat3,
    /// The sample's centre on the bench, mm.
    pub translation: DVec3,
}

impl SamplePose {
    /// A bench point in the sample's frame.
    pub fn into_sample(&self, bench: DVec3) -> DVec3 {
        self.rotation.transpose() * (bench - self.translation)
    }

    /// A sample point on the bench.
    pub fn into_bench(&self, sample: DVec3) -> DVec3 {
        self.rotation * sample + self.translation
    }
}

/// The sample's pose for motor angles, and a displacement (mm) of the carrier in its own frame.
pub fn sample_pose(config: &RigConfig, angles: &MotorAngles, displacement: DVec3) -> SamplePose {
    let head = DMat3::from_rotation_y(angles.pan) * DMat3::from_rotation_x(angles.tilt);
    let rotation = head * DMat3::from_rotation_z(angles.roll);
    let translation =
        head * DVec3::new(0.0, 0.0, config.geometry.carrier_offset_mm) + rotation * displacement;
    SamplePose { rotation, translation }
}

/// The camera's centre of projection on the bench, mm.
pub fn camera_position(config: &RigConfig) -> DVec3 {
    DVec3::new(0.0, 0.0, config.geometry.camera_distance_mm)
}

/// The light's aperture on the bench for a light angle in radians, mm.
pub fn light_position(config: &RigConfig, light: f64) -> DVec3 {
    DVec3::new(light.sin(), 0.0, light.cos()) * config.geometry.light_radius_mm
}

/// Light and camera in the sample's frame.
pub fn pose_geometry(config: &RigConfig, pose: &SamplePose, light: f64) -> PoseGeometry {
    PoseGeometry {
        light_mm: pose.into_sample(light_position(config, light)),
        camera_mm: pose.into_sample(camera_position(config)),
        weight: 1.0,
    }
}

/// Unit directions toward light and camera at the sample's centre, in its frame.
pub fn directions(config: &RigConfig, angles: &MotorAngles) -> (DVec3, DVec3) {
    let geometry = pose_geometry(config, &sample_pose(config, angles, DVec3::ZERO), angles.light);
    (geometry.light_mm.normalize(), geometry.camera_mm.normalize())
}

/// Motor angles that bring light and camera to the unit directions `wi` and `wo` at the sample's centre, or
/// `None` when the pair is out of the axes' limits (the light too near to the camera, say).
pub fn motor_angles(config: &RigConfig, wi: DVec3, wo: DVec3) -> Option<MotorAngles> {
    // The sample's centre is not on the axes, so the distant solution is a start; a few corrections make it
    // exact.
    let (mut want_i, mut want_o) = (wi, wo);
    let mut angles = distant_motor_angles(want_i, want_o)?;
    for _ in 0..8 {
        let (has_i, has_o) = directions(config, &angles);
        want_i = (want_i + wi - has_i).normalize();
        want_o = (want_o + wo - has_o).normalize();
        angles = distant_motor_angles(want_i, want_o)?;
    }
    let (has_i, has_o) = directions(config, &angles);
    let exact = has_i.angle_between(wi).max(has_o.angle_between(wo)) < 1e-6;
    let axes = config.axes.in_order();
    let within =
        angles.to_degrees().iter().zip(axes).all(|(&deg, axis)| (axis.min_deg..=axis.max_deg).contains(&deg));
    let apart = config.kept_out(angles.to_degrees()).is_none();
    (exact && within && apart).then_some(angles)
}

/// Motor angles for light and camera infinitely far away.
fn distant_motor_angles(wi: DVec3, wo: DVec3) -> Option<MotorAngles> {
    let across = wi - wo * wi.dot(wo);
    let sine = across.length();
    if sine < 1e-6 {
        return None;
    }
    let x = across / sine;
    // Rows are the bench's axes in the sample's frame.
    let rotation = DMat3::from_cols(x, wo.cross(x), wo).transpose();
    let normal = rotation.z_axis;
    let tilt = -normal.y.clamp(-1.0, 1.0).asin();
    let pan = normal.x.atan2(normal.z);
    let turned = (DMat3::from_rotation_y(pan) * DMat3::from_rotation_x(tilt)).transpose() * rotation;
    let roll = turned.x_axis.y.atan2(turned.x_axis.x);
    Some(MotorAngles { pan, tilt, roll, light: sine.atan2(wi.dot(wo)) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn direction(theta_deg: f64, phi_deg: f64) -> DVec3 {
        let (theta, phi) = (theta_deg.to_radians(), phi_deg.to_radians());
        DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
    }

    #[test]
    fn at_rest_the_sample_faces_the_camera_with_x_to_the_right_and_y_up() {
        let config = RigConfig::default();
        let pose = sample_pose(&config, &MotorAngles::default(), DVec3::ZERO);
        assert_eq!(pose.into_bench(DVec3::X), DVec3::new(1.0, 0.0, 25.4));
        assert!((light_position(&config, 90f64.to_radians()) - DVec3::X * 1000.0).length() < 1e-9);
    }

    proptest! {
        #[test]
        fn motor_angles_reach_the_directions_asked_for(
            ti in 0f64..75.0, pi in -180f64..180.0, to in 0f64..65.0, po in -180f64..180.0,
        ) {
            let config = RigConfig::default();
            let (wi, wo) = (direction(ti, pi), direction(to, po));
            let apart = wi.angle_between(wo).to_degrees();
            match motor_angles(&config, wi, wo) {
                Some(angles) => {
                    let (has_i, has_o) = directions(&config, &angles);
                    prop_assert!(has_i.angle_between(wi) < 1e-6 && has_o.angle_between(wo) < 1e-6);
                }
                // Near the arc's end the sample's height above the axes moves the limit by about a degree.
                None => prop_assert!(apart < 12.0, "{apart} degrees apart was refused"),
            }
        }
    }
}
