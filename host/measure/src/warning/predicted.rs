//! What a plan's exposures will make of its samples, before anything is photographed.
//!
//! Reflectances are taken to be spread evenly, by their logarithm, between `exposure.darkest_reflectance` of
//! rig.toml and the brightest that is expected at the pose, which rises to `exposure.brightest_reflectance`
//! near the mirror direction.

use glam::{DVec2, DVec3};

use crate::develop::radiance::{read_variance, saturation};
use crate::develop::{camera, reflectance};
use crate::plan::{Plan, exposure};
use crate::rig::config::RigConfig;
use crate::rig::geometry::{SamplePose, camera_position, pose_geometry, sample_pose};
use lobelia_reflectance::warning::samples::PoseSamples;

/// Places along an edge of the sample, and reflectances at each.
const PLACES: usize = 5;
const REFLECTANCES: usize = 20;

/// Points of the sample, evenly spread, mm.
pub(super) fn places(rig: &RigConfig, along_an_edge: usize) -> impl Iterator<Item = DVec2> {
    let size = DVec2::new(rig.carrier.sample_width_mm, rig.carrier.sample_height_mm);
    let share = move |k: usize| (k as f64 + 0.5) / along_an_edge as f64 - 0.5;
    (0..along_an_edge * along_an_edge)
        .map(move |k| DVec2::new(share(k % along_an_edge), share(k / along_an_edge)) * size)
}

/// The pixel of a point of the sample's plane, mm, as the motors have it; none outside the photograph.
pub(super) fn pixel(rig: &RigConfig, pose: &SamplePose, place: DVec2) -> Option<DVec2> {
    let normalised = camera::project(camera_position(rig), pose.into_bench(place.extend(0.0)));
    let pixel = camera::to_pixel(&rig.camera, normalised);
    let size = DVec2::new(rig.camera.width as f64, rig.camera.height as f64);
    // Two pixels of each colour are needed beside the nearest.
    let inside = pixel.cmpge(DVec2::splat(4.0)).all() && pixel.cmplt(size - 5.0).all();
    inside.then_some(pixel)
}

/// The samples of every pose of a plan, as they are to be expected.
pub fn samples(rig: &RigConfig, plan: &Plan) -> Vec<(usize, PoseSamples)> {
    (0..plan.poses.len()).map(|index| (index, of_pose(rig, plan, index))).collect()
}

fn of_pose(rig: &RigConfig, plan: &Plan, index: usize) -> PoseSamples {
    let angles = plan.angles(index);
    let pose = sample_pose(rig, &angles, DVec3::ZERO);
    let geometry = pose_geometry(rig, &pose, angles.light);
    let times = &plan.poses[index].exposures_s;
    let shortest = times.iter().copied().fold(f64::INFINITY, f64::min);
    let longest = times.iter().copied().fold(0.0, f64::max);
    let darkest = rig.exposure.darkest_reflectance;
    let brightest = exposure::brightest_expected(rig, &angles).max(darkest);
    let camera = &rig.camera;
    let range = f64::from(saturation(camera)) - camera.black_level;
    let mut samples = PoseSamples::default();
    for place in places(rig, PLACES) {
        samples.all += REFLECTANCES as u64;
        let factor = reflectance::irradiance_factor(rig, &geometry, place.extend(0.0));
        if factor <= 0.0 || pixel(rig, &pose, place).is_none() {
            samples.missing += REFLECTANCES as u64;
            continue;
        }
        // Value above black a unit of reflectance and second.
        let rates: [f64; 3] = std::array::from_fn(|c| rig.lamp.radiance[c] * factor * camera.responsivity[c]);
        for k in 0..REFLECTANCES {
            let share = k as f64 / (REFLECTANCES - 1) as f64;
            let f = darkest * (brightest / darkest).powf(share);
            let values = |time: f64| rates.map(|rate| f * rate * time);
            if values(shortest).iter().any(|&value| value >= range) {
                samples.clipped += 1;
            } else if is_starved(rig, values(longest).map(|value| value.min(range))) {
                samples.starved += 1;
            }
        }
    }
    samples
}

/// Whether values above black in the three channels are together below their noise, that of a dark frame
/// included.
fn is_starved(rig: &RigConfig, values: [f64; 3]) -> bool {
    let camera = &rig.camera;
    let noise = values.map(|value| (value / camera.electrons_per_value + 2.0 * read_variance(camera)).sqrt());
    values.iter().sum::<f64>() < noise.iter().sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::{self, Extent};
    use lobelia_base::warning::Kind;
    use lobelia_reflectance::warning::samples::{Step, warnings};

    fn kinds(rig: &RigConfig, plan: &Plan) -> Vec<Kind> {
        warnings(Step::Plan, &samples(rig, plan)).into_iter().map(|warning| warning.kind).collect()
    }

    #[test]
    fn plans_of_the_default_rig_expect_no_trouble_at_any_number_of_exposures() {
        let mut rig = RigConfig::default();
        for count in 1..=3 {
            rig.exposure.count = count;
            let plan = plan::make(&rig, Extent::Budget(60), true, 1).unwrap();
            assert_eq!(kinds(&rig, &plan), []);
        }
    }

    #[test]
    fn a_lamp_too_bright_or_too_dark_for_the_camera_s_exposures_is_told_before_the_run() {
        let mut rig = RigConfig::default();
        rig.lamp.radiance = [1e7; 3];
        let plan = plan::make(&rig, Extent::Budget(30), true, 1).unwrap();
        assert_eq!(kinds(&rig, &plan), [Kind::Clipped]);
        rig.lamp.radiance = [0.01; 3];
        let plan = plan::make(&rig, Extent::Budget(30), true, 1).unwrap();
        assert_eq!(kinds(&rig, &plan), [Kind::Starved]);
    }

    #[test]
    fn a_sample_that_does_not_fit_into_the_photograph_is_told() {
        let mut rig = RigConfig::default();
        let plan = plan::make(&rig, Extent::Budget(30), true, 1).unwrap();
        rig.carrier.sample_width_mm = 300.0;
        assert_eq!(kinds(&rig, &plan), [Kind::Missing]);
    }

    #[test]
    fn places_lie_within_the_sample() {
        let rig = RigConfig::default();
        let half = rig.carrier.sample_width_mm / 2.0;
        assert!(places(&rig, 4).all(|place| place.abs().max_element() < half));
        assert_eq!(places(&rig, 4).sum::<DVec2>(), DVec2::ZERO);
    }
}
