//! The samples of a pose as its photographs come in, looked up where the motors have the sample: soon enough
//! to change the exposures.

use glam::DVec3;

use super::predicted::{pixel, places};
use crate::develop::frame::RawFrame;
use crate::develop::radiance::{read_variance, saturation};
use crate::rig::config::RigConfig;
use crate::rig::geometry::{MotorAngles, pose_geometry, sample_pose};
use lobelia_reflectance::warning::samples::PoseSamples;

/// Places along an edge of the sample.
const PLACES: usize = 24;

/// The samples of a pose that was photographed with the motors at `angles`. A frame that is not of the
/// camera's size counts as none.
pub fn samples(rig: &RigConfig, angles: &MotorAngles, frames: &[RawFrame]) -> PoseSamples {
    let camera = &rig.camera;
    let frames: Vec<&RawFrame> =
        frames.iter().filter(|frame| (frame.width, frame.height) == (camera.width, camera.height)).collect();
    let pose = sample_pose(rig, angles, DVec3::ZERO);
    let light = pose_geometry(rig, &pose, angles.light).light_mm;
    let limit = saturation(camera);
    let mut samples = PoseSamples::default();
    for place in places(rig, PLACES) {
        samples.all += 1;
        let Some(pixel) = pixel(rig, &pose, place).filter(|_| light.z > 0.0) else {
            samples.missing += 1;
            continue;
        };
        let (x, y) = (pixel.x as usize / 2 * 2, pixel.y as usize / 2 * 2);
        let corners = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)];
        let (mut used, mut signal) = (0.0, 0.0);
        for frame in &frames {
            let values = corners.map(|(x, y)| frame.values[y * camera.width + x]);
            if values.iter().all(|&value| value < limit) {
                used += 4.0;
                signal += values.iter().map(|&value| f64::from(value) - camera.black_level).sum::<f64>();
            }
        }
        // Variance of the sum: that of the light's electrons, and of reading each value and its dark signal.
        let variance = signal.max(0.0) / camera.electrons_per_value + 2.0 * used * read_variance(camera);
        if used == 0.0 {
            samples.clipped += 1;
        } else if signal < variance.sqrt() {
            samples.starved += 1;
        }
    }
    samples
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use lobelia_sim::size::Size;
    use lobelia_sim::{sample, simulated};

    const STAND: [f64; 4] = [20.0, -15.0, 40.0, 50.0];

    /// What the simulator's camera sees in exposures of some times.
    fn seen(times: &[f64]) -> PoseSamples {
        let simulated = Size::Small.rig(1);
        let layout = sample::recipe().layout(Path::new("."), &simulated.carrier).unwrap();
        let bench = simulated::bench(&simulated, layout);
        let rig: RigConfig = toml::from_str(&toml::to_string(&simulated).unwrap()).unwrap();
        let radiance = bench.radiance(STAND.map(f64::to_radians));
        let frame = |(key, &exposure_s): (usize, &f64)| RawFrame {
            width: rig.camera.width,
            height: rig.camera.height,
            values: bench.record(&radiance, 1.0, exposure_s, key as u64),
            exposure_s,
        };
        let frames: Vec<RawFrame> = times.iter().enumerate().map(frame).collect();
        samples(&rig, &MotorAngles::from_degrees(STAND), &frames)
    }

    #[test]
    fn right_exposures_have_no_bad_samples_and_wrong_ones_are_told_by_their_fault() {
        let right = seen(&[0.02, 0.2]);
        assert_eq!((right.all, right.clipped, right.starved, right.missing), (576, 0, 0, 0));
        let long = seen(&[20.0]);
        assert!(long.clipped > 500 && long.starved == 0, "{long:?}");
        let short = seen(&[1e-6]);
        assert!(short.starved > 400 && short.clipped == 0, "{short:?}");
        assert_eq!(seen(&[0.02, 20.0]).clipped, 0, "the short exposure shows what the long one clips");
    }
}
