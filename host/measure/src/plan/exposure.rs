//! Exposures predicted from geometry: irradiance exactly, reflectance between the operator's darkest and
//! brightest by how far the half vector lies from the normal.

use crate::rig::config::RigConfig;
use crate::rig::geometry::{MotorAngles, directions, light_position, sample_pose};

/// Share of the sensor's range that the brightest expected texel fills in the shortest exposure.
const HIGH: f64 = 0.7;

/// Share of the range that the darkest expected texel fills in the longest exposure.
const LOW: f64 = 0.15;

/// Irradiance on the sample's centre for one channel (0, 1, 2), in units of the lamp's radiance times
/// steradian.
pub fn irradiance(config: &RigConfig, angles: &MotorAngles, channel: usize) -> f64 {
    let pose = sample_pose(config, angles, glam::DVec3::ZERO);
    let light = pose.into_sample(light_position(config, angles.light));
    let cosine = (light.z / light.length()).max(0.0);
    config.lamp.radiance[channel] * cosine * config.lamp.aperture_mm2() / light.length_squared()
}

/// The brightest reflectance that the pose may show, sr⁻¹: the operator's brightest near the mirror
/// direction, falling to ten times the darkest away from it, and raised toward grazing where lobes grow.
pub(crate) fn brightest_expected(config: &RigConfig, angles: &MotorAngles) -> f64 {
    let (wi, wo) = directions(config, angles);
    let off_mirror = (wi + wo).normalize().z.clamp(-1.0, 1.0).acos().to_degrees();
    let (dark, bright) = (config.exposure.darkest_reflectance, config.exposure.brightest_reflectance);
    let floor = (10.0 * dark).min(bright);
    let nearness = (-(off_mirror / config.exposure.highlight_deg).powi(2)).exp();
    floor * (bright / floor).powf(nearness)
}

/// Shutter times for a pose, s, shortest first, at most `exposure.count` and fewer where one does the same.
pub fn predict(config: &RigConfig, angles: &MotorAngles) -> Vec<f64> {
    let camera = &config.camera;
    // Value above black a unit of reflectance and second; the most and the least sensitive channel bound the
    // choice.
    let rates: Vec<f64> = (0..3).map(|c| irradiance(config, angles, c) * camera.responsivity[c]).collect();
    let fastest = rates.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let slowest = rates.iter().copied().fold(f64::MAX, f64::min).max(f64::MIN_POSITIVE);
    let clamp = |seconds: f64| seconds.clamp(camera.min_exposure_s, camera.max_exposure_s);
    let short = clamp(HIGH * camera.range() / (fastest * brightest_expected(config, angles)));
    let long = clamp(LOW * camera.range() / (slowest * config.exposure.darkest_reflectance)).max(short);
    let count = config.exposure.count;
    let step = |k: usize| short * (long / short).powf(k as f64 / (count - 1).max(1) as f64);
    let mut times: Vec<f64> = if count == 1 { vec![short] } else { (0..count).map(step).collect() };
    // The controller counts microseconds.
    times.iter_mut().for_each(|seconds| *seconds = (*seconds * 1e6).round() / 1e6);
    times.dedup();
    times
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::{Extent, choose};

    #[test]
    fn exposures_lie_in_the_cameras_range_shortest_first() {
        let mut config = RigConfig::default();
        for count in 1..=3 {
            config.exposure.count = count;
            for angles in choose::poses(&config, Extent::Budget(40), false, 2).unwrap().angles {
                let times = predict(&config, &angles);
                assert!(!times.is_empty() && times.len() <= count);
                assert!(times.windows(2).all(|pair| pair[0] < pair[1]));
                assert!(times[0] >= config.camera.min_exposure_s - 1e-6);
                assert!(times[times.len() - 1] <= config.camera.max_exposure_s + 1e-6);
            }
        }
    }

    #[test]
    fn mirror_poses_get_shorter_exposures_than_others_of_the_same_incidence() {
        let config = RigConfig::default();
        // Light at 40°; the sample's normal halfway to it, and on the camera.
        let mirror = MotorAngles::from_degrees([20.0, 0.0, 0.0, 40.0]);
        let away = MotorAngles::from_degrees([-10.0, 0.0, 0.0, 40.0]);
        assert!(3.0 * predict(&config, &mirror)[0] < predict(&config, &away)[0]);
    }
}
