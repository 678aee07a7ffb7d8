//! Whether a dark frame was taken in the dark: it shows no tags, and no more light than those of its exposure
//! or of a longer one.
//!
//! Light that is taken for the sensor's own signal is subtracted from every photograph. The photodiode tells
//! of a burning lamp, not of a photograph that got into a dark frame's place.

use super::frame::RawFrame;
use super::radiance::read_variance;
use super::registration;
use crate::rig::config::{Camera, RigConfig};

/// So many tags are no chance find in noise.
const TAGS: usize = 2;

/// A value is brighter than another one beyond so many standard deviations of their noise.
const DEVIATIONS: f64 = 6.0;

/// The dark current follows the sensor's temperature: by this share it may grow from frame to frame.
const DRIFT: f64 = 0.1;

/// The mean of a frame may drift besides by so many standard deviations of one value.
const MEAN_DRIFT: f64 = 2.0;

/// A frame is brighter than another when more than this share of its values are: some change by themselves,
/// from frame to frame.
const MOST_BRIGHTER: f64 = 0.01;

/// Why a frame that should be dark is not, by itself.
pub(crate) fn shows_tags(config: &RigConfig, frame: &RawFrame) -> Option<String> {
    let seen = registration::tags_seen(config, frame);
    (seen >= TAGS).then(|| {
        let tags = config.carrier.tags.len();
        format!("it shows {seen} of the carrier's {tags} tags, so it is a photograph and no dark frame")
    })
}

/// Whether the first of two dark frames has more than the second, which was exposed for as long or longer:
/// light fell on it.
pub(crate) fn outshines(camera: &Camera, frame: &RawFrame, other: &RawFrame) -> bool {
    if frame.exposure_s > other.exposure_s || frame.values.len() != other.values.len() {
        return false;
    }
    let read = read_variance(camera);
    let signal = |value: u16| (f64::from(value) - camera.black_level).max(0.0);
    let (mut brighter, mut sum, mut dark) = (0_usize, 0.0, 0.0);
    for (&value, &of_other) in frame.values.iter().zip(&other.values) {
        let more = f64::from(value) - f64::from(of_other);
        let noise = 2.0 * (read + signal(of_other) / camera.electrons_per_value);
        brighter += usize::from(more > DEVIATIONS * noise.sqrt() + DRIFT * signal(of_other));
        sum += more;
        dark += signal(of_other);
    }
    let count = frame.values.len().max(1) as f64;
    brighter as f64 > MOST_BRIGHTER * count || sum / count > MEAN_DRIFT * read.sqrt() + DRIFT * dark / count
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use lobelia_sim::{sample, simulated};

    const STAND: [f64; 4] = [20.0, -15.0, 40.0, 50.0];

    /// What the simulator's camera records of its carrier in a light of so many parts of the lamp's.
    fn shot(config: &RigConfig, exposure_s: f64, light: f64, key: u64) -> RawFrame {
        let layout = sample::recipe().layout(Path::new("."), &Default::default()).unwrap();
        // The simulator stands on this crate as others see it, whose types are others to the compiler.
        let theirs = toml::from_str(&toml::to_string(config).unwrap()).unwrap();
        let bench = simulated::bench(&theirs, layout);
        let values = bench.record(&bench.radiance(STAND.map(f64::to_radians)), light, exposure_s, key);
        RawFrame { width: config.camera.width, height: config.camera.height, values, exposure_s }
    }

    #[test]
    fn frames_without_light_are_dark_by_every_pair_and_warm_sensors_drift() {
        let mut config = RigConfig::default();
        for dark_e_s in [0.0, 3000.0] {
            config.simulator.dark_e_s = dark_e_s;
            let short = [1, 2].map(|key| shot(&config, 0.001, 0.0, key));
            let long = [3, 4].map(|key| shot(&config, 2.0, 0.0, key));
            let all: Vec<&RawFrame> = short.iter().chain(&long).collect();
            for (frame, other) in all.iter().flat_map(|a| all.iter().map(move |b| (a, b))) {
                assert!(!outshines(&config.camera, frame, other));
            }
            assert!(all.iter().all(|frame| shows_tags(&config, frame).is_none()));
            // By a twentieth of its dark current the sensor may have become warmer.
            let mut warmer = long[0].clone();
            let own = |value: u16| f64::from(value) - config.camera.black_level;
            warmer.values.iter_mut().for_each(|v| *v += (0.05 * own(*v).max(0.0)) as u16);
            assert!(!outshines(&config.camera, &warmer, &long[1]));
        }
    }

    /// A hundredth of the lamp's light, as an afterglow or a door that is ajar.
    #[test]
    fn light_is_told_by_tags_or_by_the_frames_of_the_same_or_of_a_longer_exposure() {
        let config = RigConfig::default();
        let dark = [0.05, 0.5].map(|exposure_s| shot(&config, exposure_s, 0.0, 1));
        for (exposure_s, light) in [(0.05, 1.0), (0.05, 0.01), (0.5, 1.0), (0.5, 0.01)] {
            let lit = shot(&config, exposure_s, light, 2);
            let place = usize::from(exposure_s > 0.1);
            assert!(outshines(&config.camera, &lit, &dark[place]), "{exposure_s} s in {light} of the light");
            assert!(!outshines(&config.camera, &dark[place], &lit));
            assert!(shows_tags(&config, &lit).is_some() || light < 1.0);
        }
        assert!(outshines(&config.camera, &shot(&config, 0.05, 1.0, 3), &dark[1]), "short, but brighter");
    }
}
