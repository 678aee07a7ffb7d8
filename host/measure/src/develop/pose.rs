//! The sample's pose from its fiducials, wherever they know it better than the motors do.
//!
//! The most probable pan, tilt and roll, and displacement of the carrier, given the corners seen and the
//! motors' stated repeatability: Gauss–Newton on reprojection errors and on the motors' deviations, each
//! divided by its standard deviation.

use glam::{DVec2, DVec3};

use super::camera;
use super::homography::Correspondence;
use crate::rig::config::RigConfig;
use crate::rig::geometry::{MotorAngles, SamplePose, camera_position, sample_pose};
use lobelia_base::linalg::Normal;

/// Standard deviation of a refined tag corner, pixels.
pub(super) const CORNER_SIGMA_PX: f64 = 0.15;

/// Repeatability is a largest error; of a uniform error that large this is the standard deviation.
const UNIFORM_SIGMA: f64 = 0.577_350_269_189_625_8;

/// Unknowns: pan, tilt, roll in units of their standard deviation, then the displacement in units of its own.
type Unknowns = [f64; 6];

/// The most probable pose for the commanded `angles`; `None` when the equations break down (wildly wrong
/// corners).
pub fn estimate(config: &RigConfig, angles: &MotorAngles, corners: &[Correspondence]) -> Option<SamplePose> {
    let mut unknowns: Unknowns = [0.0; 6];
    for _ in 0..10 {
        let step = step(config, angles, corners, &unknowns)?;
        for (unknown, change) in unknowns.iter_mut().zip(step) {
            *unknown += change;
        }
        if step.iter().all(|change| change.abs() < 1e-8) {
            break;
        }
    }
    unknowns.iter().all(|u| u.is_finite()).then(|| pose(config, angles, &unknowns))
}

/// The pose that unknowns stand for.
fn pose(config: &RigConfig, angles: &MotorAngles, unknowns: &Unknowns) -> SamplePose {
    let sigma = |k: usize| config.axes.in_order()[k].repeatability_deg.to_radians() * UNIFORM_SIGMA;
    let moved = MotorAngles {
        pan: angles.pan + unknowns[0] * sigma(0),
        tilt: angles.tilt + unknowns[1] * sigma(1),
        roll: angles.roll + unknowns[2] * sigma(2),
        light: angles.light,
    };
    let slack = config.geometry.carrier_slack_mm;
    sample_pose(config, &moved, DVec3::new(unknowns[3], unknowns[4], unknowns[5]) * slack)
}

/// Where a corner of the plane appears in normalised coordinates under a pose.
fn appearance(config: &RigConfig, pose: &SamplePose, plane_mm: DVec2) -> DVec2 {
    camera::project(camera_position(config), pose.into_bench(plane_mm.extend(0.0)))
}

/// One Gauss–Newton step with central differences, which are exact enough for so smooth a map.
fn step(
    config: &RigConfig,
    angles: &MotorAngles,
    corners: &[Correspondence],
    unknowns: &Unknowns,
) -> Option<Unknowns> {
    const DIFFERENCE: f64 = 1e-3;
    let here = pose(config, angles, unknowns);
    let shifted = |k: usize, by: f64| {
        let mut other = *unknowns;
        other[k] += by;
        pose(config, angles, &other)
    };
    let around: Vec<(SamplePose, SamplePose)> =
        (0..6).map(|k| (shifted(k, -DIFFERENCE), shifted(k, DIFFERENCE))).collect();
    let weight = DVec2::from(config.camera.focal_px) / CORNER_SIGMA_PX;
    let mut equations = Normal::<6>::new();
    for corner in corners {
        let residual = (corner.image - appearance(config, &here, corner.plane_mm)) * weight;
        let derivatives: [DVec2; 6] = std::array::from_fn(|k| {
            let (before, after) = &around[k];
            let change =
                appearance(config, after, corner.plane_mm) - appearance(config, before, corner.plane_mm);
            change * weight / (2.0 * DIFFERENCE)
        });
        equations.add(&derivatives.map(|d| d.x), residual.x, 1.0);
        equations.add(&derivatives.map(|d| d.y), residual.y, 1.0);
    }
    // The motors' own word: every unknown is 0, give or take one.
    for (k, unknown) in unknowns.iter().enumerate() {
        let row = std::array::from_fn(|j| if j == k { 1.0 } else { 0.0 });
        equations.add(&row, -unknown, 1.0);
    }
    equations.solve(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corners(config: &RigConfig, truth: &SamplePose, noise_px: f64) -> Vec<Correspondence> {
        let half = config.carrier.tag_size_mm / 2.0;
        let tags = config.carrier.tags.iter();
        let places = tags.flat_map(|tag| {
            [(-half, half), (half, half), (half, -half), (-half, -half)]
                .map(|(dx, dy)| DVec2::new(tag.x_mm + dx, tag.y_mm + dy))
        });
        let jitter = |k: usize| f64::from(((k * 7919) % 1000) as u32) / 500.0 - 1.0;
        places
            .enumerate()
            .map(|(k, plane_mm)| {
                let error =
                    DVec2::new(jitter(2 * k), jitter(2 * k + 1)) * noise_px / config.camera.focal_px[0];
                Correspondence { plane_mm, image: appearance(config, truth, plane_mm) + error }
            })
            .collect()
    }

    #[test]
    fn exact_corners_correct_the_motors_to_a_thousandth_of_a_degree() {
        let config = RigConfig::default();
        let commanded = MotorAngles::from_degrees([30.0, -20.0, 75.0, 60.0]);
        let real = MotorAngles::from_degrees([30.4, -20.5, 74.6, 60.0]);
        let truth = sample_pose(&config, &real, DVec3::new(0.2, -0.1, 0.0));
        let found = estimate(&config, &commanded, &corners(&config, &truth, 0.0)).unwrap();
        let angle = (found.rotation.z_axis).angle_between(truth.rotation.z_axis).to_degrees();
        assert!(angle < 0.01, "{angle}°");
        assert!((found.translation - truth.translation).length() < 0.3);
    }

    #[test]
    fn without_corners_the_motors_are_believed() {
        let config = RigConfig::default();
        let commanded = MotorAngles::from_degrees([30.0, -20.0, 75.0, 60.0]);
        let found = estimate(&config, &commanded, &[]).unwrap();
        assert_eq!(found, sample_pose(&config, &commanded, DVec3::ZERO));
    }
}
