//! Where the tags alone put the sample, and whether the motors can have put it there.
//!
//! A photograph of another pose has tags as good as any; only their place tells. The tags' orientation of the
//! carrier, found without the motors' help, is held against the motors' angles: what lies between the two
//! must be within the repeatability of pan, tilt and roll and the uncertainty of the tags. Distance and
//! displacement are left free, so that a rig whose lengths are a little off is not refused.

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::camera;
use super::homography::{Correspondence, Homography};
use super::pose::CORNER_SIGMA_PX;
use crate::rig::config::RigConfig;
use crate::rig::geometry::{MotorAngles, SamplePose, camera_position, sample_pose};
use lobelia_base::linalg::Normal;

/// Each head axis may be off by so many times its repeatability, all three at once: the home switches scatter
/// and the gears have play besides.
const LEEWAY: f64 = 1.25;

/// Standard deviations of the tags' orientation that are allowed besides.
const DEVIATIONS: f64 = 3.0;

/// The carrier's orientation as the tags show it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeenPose {
    /// The sample on the bench.
    pub pose: SamplePose,
    /// Covariance of the orientation as a rotation vector on the bench, rad².
    covariance: DMat3,
}

/// What lies between the orientation that tags show and the one that motors have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    /// The angle of the turn from one to the other, rad.
    pub angle: f64,
    /// By how much each of pan, tilt and roll would have to be off, rad; the most probable share of each.
    pub axes: [f64; 3],
    /// Whether that is within what the rig's repeatability and the tags' uncertainty allow.
    pub allowed: bool,
}

impl SeenPose {
    /// The sample's pose by the tags' corners and no other word: least squares on reprojection, from the
    /// motors' angles and from the homography. `None` when neither ends in front of the camera.
    pub fn find(
        config: &RigConfig,
        angles: &MotorAngles,
        homography: &Homography,
        corners: &[Correspondence],
    ) -> Option<Self> {
        let motors = sample_pose(config, angles, DVec3::ZERO);
        let starts = [Some(motors), decomposed(config, homography)];
        let found = starts.into_iter().flatten().filter_map(|start| refined(config, start, corners));
        // Seen nearly face to face, a plane that leans either way looks alike: of two that explain the
        // corners, the motors' own.
        found
            .reduce(|near, other| if near.1 > 1.2 * other.1 + 0.01 { other } else { near })
            .map(|found| found.0)
    }

    /// What lies between this and the motors' `angles`.
    pub fn difference(&self, config: &RigConfig, angles: &MotorAngles) -> Difference {
        let motors = sample_pose(config, angles, DVec3::ZERO).rotation;
        let turn = DQuat::from_mat3(&(self.pose.rotation * motors.transpose())).normalize();
        let turn = (if turn.w < 0.0 { -turn } else { turn }).to_scaled_axis();
        let axis = |k: usize| config.axes.in_order()[k].repeatability_deg.to_radians() * LEEWAY;
        let pan = DMat3::from_rotation_y(angles.pan);
        // A turn on the bench for each axis turned by what it may be off.
        let turns = DMat3::from_cols(
            DVec3::Y * axis(0),
            pan * DVec3::X * axis(1),
            pan * DMat3::from_rotation_x(angles.tilt) * DVec3::Z * axis(2),
        );
        let allowed = turns * turns.transpose() + self.covariance * (DEVIATIONS * DEVIATIONS);
        let weighted = allowed.inverse() * turn;
        let off = turns.transpose() * weighted;
        Difference {
            angle: turn.length(),
            axes: std::array::from_fn(|k| off[k] * axis(k)),
            // Three axes, each off by as much as it may be.
            allowed: turn.dot(weighted) <= 3.0,
        }
    }
}

/// The pose whose projection the homography is.
fn decomposed(config: &RigConfig, homography: &Homography) -> Option<SamplePose> {
    // Image coordinates run right and down, and depth away from the camera.
    let to_bench = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let columns = to_bench * homography.matrix();
    let scale = 2.0 / (columns.x_axis.length() + columns.y_axis.length());
    // The carrier lies before the camera, on −z of it.
    let scale = if columns.z_axis.z > 0.0 { -scale } else { scale };
    let (x, y) = (columns.x_axis * scale, columns.y_axis * scale);
    let normal = x.cross(y).try_normalize()?;
    // The orthogonal pair nearest to two that are nearly so.
    let middle = (x.normalize() + y.normalize()).try_normalize()?;
    let across = middle.cross(normal);
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let rotation = DMat3::from_cols((middle + across) * half, (middle - across) * half, normal);
    let translation = camera_position(config) + columns.z_axis * scale;
    rotation.is_finite().then_some(SamplePose { rotation, translation })
}

/// Gauss–Newton on the reprojection; the pose and its RMS error in pixels.
fn refined(config: &RigConfig, start: SamplePose, corners: &[Correspondence]) -> Option<(SeenPose, f64)> {
    const STEPS: usize = 20;
    let mut pose = start;
    for _ in 0..STEPS {
        let (equations, _) = equations(config, &pose, corners)?;
        let step = equations.solve(0.0)?;
        pose = moved(&pose, &step);
        if step.iter().all(|change| change.abs() < 1e-9) {
            break;
        }
    }
    let (equations, rms_px) = equations(config, &pose, corners)?;
    let inverse = equations.inverse()?;
    // Where lens and carrier are known worse than corners are seen, the residuals say so.
    let variance = (rms_px / CORNER_SIGMA_PX).powi(2).max(1.0);
    let rows: [DVec3; 3] = std::array::from_fn(|i| DVec3::new(inverse[i][0], inverse[i][1], inverse[i][2]));
    let covariance = DMat3::from_cols(rows[0], rows[1], rows[2]) * variance;
    Some((SeenPose { pose, covariance }, rms_px))
}

/// A pose turned on the bench by the first three unknowns, rad, and shifted by the others, mm.
fn moved(pose: &SamplePose, step: &[f64; 6]) -> SamplePose {
    let turn = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::from_slice(&step[..3])));
    SamplePose {
        rotation: turn * pose.rotation,
        translation: pose.translation + DVec3::from_slice(&step[3..]),
    }
}

/// The normal equations of a step, residuals in standard deviations of a corner, and the residuals' RMS in
/// pixels along one coordinate; `None` where the plane is not before the camera.
fn equations(config: &RigConfig, pose: &SamplePose, corners: &[Correspondence]) -> Option<(Normal<6>, f64)> {
    let focal = DVec2::from(config.camera.focal_px);
    let weight = focal / CORNER_SIGMA_PX;
    let centre = camera_position(config);
    let mut equations = Normal::<6>::new();
    let mut squares = 0.0;
    for corner in corners {
        let arm = pose.rotation * corner.plane_mm.extend(0.0);
        let bench = arm + pose.translation;
        let depth = centre.z - bench.z;
        if depth.is_nan() || depth <= 0.0 {
            return None;
        }
        let seen = camera::project(centre, bench);
        let residual = (corner.image - seen) * weight;
        squares += (residual * CORNER_SIGMA_PX).length_squared();
        // How the image moves with the bench's x, y and z.
        let along = [
            DVec3::new(1.0, 0.0, seen.x) / depth * weight.x,
            DVec3::new(0.0, -1.0, seen.y) / depth * weight.y,
        ];
        for (by_place, residual) in along.into_iter().zip([residual.x, residual.y]) {
            let by_turn = arm.cross(by_place);
            equations.add(
                &[by_turn.to_array(), by_place.to_array()].concat().try_into().ok()?,
                residual,
                1.0,
            );
        }
    }
    Some((equations, (squares / (2 * corners.len()).max(1) as f64).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::develop::registration::tag_corners;

    /// The corners of the carrier's tags under a pose, each off by up to `noise_px`.
    fn corners(config: &RigConfig, truth: &SamplePose, tags: usize, noise_px: f64) -> Vec<Correspondence> {
        let jitter = |k: usize| f64::from(((k * 7919) % 1000) as u32) / 500.0 - 1.0;
        let places = config.carrier.tags.iter().step_by(16 / tags).flat_map(|tag| tag_corners(config, tag));
        places
            .enumerate()
            .map(|(k, plane_mm)| {
                let error =
                    DVec2::new(jitter(2 * k), jitter(2 * k + 1)) * noise_px / config.camera.focal_px[0];
                let image = camera::project(camera_position(config), truth.into_bench(plane_mm.extend(0.0)));
                Correspondence { plane_mm, image: image + error }
            })
            .collect()
    }

    fn difference(
        config: &RigConfig,
        stand: [f64; 4],
        truth: &SamplePose,
        tags: usize,
        noise: f64,
    ) -> Difference {
        let corners = corners(config, truth, tags, noise);
        let angles = MotorAngles::from_degrees(stand);
        let homography = Homography::fit(&corners).unwrap();
        SeenPose::find(config, &angles, &homography, &corners).unwrap().difference(config, &angles)
    }

    const STANDS: [[f64; 4]; 5] = [
        [0.0, 0.0, 0.0, 40.0],
        [30.0, -20.0, 75.0, 60.0],
        [-65.0, 10.0, -170.0, 90.0],
        [2.0, 66.0, 0.0, 30.0],
        [-1.0, 1.0, 178.0, 20.0],
    ];

    /// What is off is known: the truth is the motors' angles and a chosen error of every axis and of the
    /// carrier's seat.
    #[test]
    fn errors_within_the_repeatability_are_allowed_in_every_pose_and_larger_ones_of_any_axis_are_not() {
        let config = RigConfig::default();
        let most = config.axes.pan.repeatability_deg;
        for stand in STANDS {
            let at = |off: [f64; 3]| {
                let real = [stand[0] + off[0], stand[1] + off[1], stand[2] + off[2], stand[3]];
                sample_pose(&config, &MotorAngles::from_degrees(real), DVec3::new(0.4, -0.3, 5.0))
            };
            for signs in 0..8u32 {
                let off = [0, 1, 2].map(|k| if signs >> k & 1 == 1 { most } else { -most });
                let found = difference(&config, stand, &at(off), 16, 0.2);
                assert!(found.allowed, "{stand:?} {off:?}: {found:?}");
            }
            for axis in 0..3 {
                let mut off = [0.0; 3];
                off[axis] = 4.0 * most;
                let found = difference(&config, stand, &at(off), 16, 0.2);
                assert!(!found.allowed, "{stand:?} {off:?}: {found:?}");
                assert!((found.angle.to_degrees() - 4.0 * most).abs() < 0.4, "{stand:?} {off:?}: {found:?}");
                // Tilted far, pan and roll turn about nearly the same axis, and who turned is not told.
                let on_axis = found.axes[axis].to_degrees();
                let told = (on_axis - 4.0 * most).abs() < 0.8;
                assert!(told || stand[1] > 45.0, "{stand:?} {off:?}: {found:?}");
            }
        }
    }

    #[test]
    fn the_photograph_of_any_other_pose_is_refused_and_by_the_angle_between_them() {
        let config = RigConfig::default();
        for stand in STANDS {
            for other in STANDS.into_iter().filter(|other| *other != stand) {
                let angles = MotorAngles::from_degrees(other);
                let truth = sample_pose(&config, &angles, DVec3::ZERO);
                let motors = sample_pose(&config, &MotorAngles::from_degrees(stand), DVec3::ZERO);
                let between = DQuat::from_mat3(&(truth.rotation * motors.rotation.transpose()));
                let expected = between.angle_between(DQuat::IDENTITY).to_degrees();
                for tags in [4, 16] {
                    let found = difference(&config, stand, &truth, tags, 0.1);
                    let off = (found.angle.to_degrees() - expected).abs();
                    // A photograph turned upside down is among them: 178° about the normal.
                    assert!(!found.allowed && off < 2.0, "{stand:?} {other:?}: {found:?}, {expected}°");
                }
            }
        }
    }
}
