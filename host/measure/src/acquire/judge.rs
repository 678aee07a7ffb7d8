//! Judges a photograph when it arrives, so that a wrong one is taken again at once and not found the next
//! morning.

use super::camera::Shot;
use crate::develop::frame::{Photograph, RawFrame};
use crate::develop::{dark, registration};
use crate::rig::config::RigConfig;

/// Share of pixels that are 0 below a black level above 0, over which part of a file counts as not written.
const MOST_UNWRITTEN: f64 = 0.01;

/// Share of pixels that must be brighter than darkness, or darker than saturation.
const LEAST_SHOWN: f64 = 0.001;

/// What is wrong with a photograph.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Fault {
    /// It may be of this shot and not all there yet.
    Unfinished(String),
    /// It cannot be of this shot, or shows nothing.
    Wrong(String),
}

/// Judges a photograph of a shot whose shutter was open for `open_s`.
pub(super) fn judge(
    config: &RigConfig,
    shot: &Shot<'_>,
    open_s: f64,
    photograph: &Photograph,
) -> std::result::Result<(), Fault> {
    let camera = &config.camera;
    let (width, height) = (photograph.width, photograph.height);
    if (width, height) != (camera.width, camera.height) {
        let (w, h) = (camera.width, camera.height);
        return Err(Fault::Wrong(format!("it has {width} × {height} pixels, rig.toml says {w} × {h}")));
    }
    let share = |wanted: &dyn Fn(f64) -> bool| {
        let count = photograph.values.iter().filter(|&&value| wanted(f64::from(value))).count();
        count as f64 / photograph.values.len().max(1) as f64
    };
    // A camera's 0 is far below its black level: it is what a file holds that is not filled yet.
    let deviation = camera.read_noise_e / camera.electrons_per_value + 1.0;
    let unwritten = share(&|value| value == 0.0);
    if camera.black_level > 8.0 * deviation && unwritten > MOST_UNWRITTEN {
        let percent = 100.0 * unwritten;
        return Err(Fault::Unfinished(format!(
            "{percent:.0} % of its values are 0, so not all of it was written"
        )));
    }
    let agrees = camera.exif.agrees(photograph.notes.exposure_s, open_s);
    agrees.map_err(Fault::Wrong)?;
    let limit = camera.black_level + 0.97 * camera.range();
    if share(&|value| value < limit) < LEAST_SHOWN {
        return Err(Fault::Wrong("it is saturated throughout".into()));
    }
    let frame = RawFrame { width, height, values: photograph.values.clone(), exposure_s: open_s };
    let Some(angles) = &shot.angles else {
        return judge_dark(config, &frame, shot.darks).map_err(Fault::Wrong);
    };
    if share(&|value| value > camera.black_level + 6.0 * deviation) < LEAST_SHOWN {
        return Err(Fault::Wrong("it is black throughout".into()));
    }
    match registration::register_frame(config, &frame, angles) {
        // Too few tags in one exposure of a bracket are no fault: another may show them.
        Err(unregistered) if unregistered.elsewhere.is_some() => Err(Fault::Wrong(unregistered.why)),
        _ => Ok(()),
    }
}

/// Judges a dark frame by itself and by those before it.
fn judge_dark(config: &RigConfig, frame: &RawFrame, before: &[RawFrame]) -> std::result::Result<(), String> {
    if let Some(why) = dark::shows_tags(config, frame) {
        return Err(why);
    }
    let camera = &config.camera;
    if let Some(earlier) = before.iter().position(|earlier| dark::outshines(camera, frame, earlier)) {
        return Err(format!("it shows more light than dark frame {earlier}"));
    }
    // No further try mends that one.
    if let Some(earlier) = before.iter().position(|earlier| dark::outshines(camera, earlier, frame)) {
        return Err(format!(
            "dark frame {earlier}, taken before it, shows more light than it; keep the camera in the dark \
             and begin the run anew"
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::develop::frame::ExifNotes;
    use crate::rig::geometry::MotorAngles;
    use lobelia_sim::{sample, simulated};

    const STAND: [f64; 4] = [20.0, -15.0, 40.0, 50.0];

    fn shot(stand: [f64; 4]) -> Shot<'static> {
        let angles = Some(MotorAngles::from_degrees(stand));
        Shot { open_s: 0.2, warm_lamp: true, angles, darks: &[], key: [1, 0, 0] }
    }

    /// What the simulator's camera sees at [`STAND`].
    fn photograph(config: &RigConfig) -> Photograph {
        let layout = sample::recipe().layout(Path::new("."), &Default::default()).unwrap();
        let bench = simulated::bench(&Default::default(), layout);
        let values = bench.record(&bench.radiance(STAND.map(f64::to_radians)), 1.0, 0.2, 1);
        let notes = ExifNotes { exposure_s: Some(0.2), taken_s: None };
        Photograph { width: config.camera.width, height: config.camera.height, values, notes }
    }

    #[test]
    fn a_photograph_of_the_shot_is_right_and_each_kind_of_other_is_told_by_its_fault() {
        let config = RigConfig::default();
        let right = photograph(&config);
        let judged = |photograph: &Photograph| judge(&config, &shot(STAND), 0.2, photograph);
        assert_eq!(judged(&right), Ok(()));

        let with = |change: &dyn Fn(&mut Photograph)| {
            let mut other = right.clone();
            change(&mut other);
            judged(&other).unwrap_err()
        };
        let wrong = |fault: Fault, part: &str| {
            assert!(matches!(&fault, Fault::Wrong(why) if why.contains(part)), "{part}: {fault:?}");
        };
        wrong(with(&|p| (p.width, p.height) = (p.height, p.width)), "600 × 800 pixels");
        wrong(with(&|p| p.notes.exposure_s = Some(0.5)), "EXIF exposure is 0.5 s");
        wrong(with(&|p| p.values.fill(16_383)), "saturated throughout");
        wrong(with(&|p| p.values.iter_mut().for_each(|v| *v = 505 + *v % 16)), "black throughout");
        wrong(
            judge(&config, &shot([-40.0, 10.0, 100.0, 50.0]), 0.2, &right).unwrap_err(),
            "the tags show the sample",
        );
        let seventh = right.values.len() / 7;
        let fault = with(&|p| p.values[6 * seventh..].fill(0));
        assert!(
            matches!(&fault, Fault::Unfinished(why) if why.contains("14 % of its values are 0")),
            "{fault:?}"
        );
    }

    #[test]
    fn dark_frames_may_be_dark_and_show_no_tags() {
        let config = RigConfig::default();
        let mut dark = photograph(&config);
        dark.values.fill(512);
        let first = Shot { angles: None, ..shot(STAND) };
        assert_eq!(judge(&config, &first, 0.2, &dark), Ok(()));
        let frame = |photograph: &Photograph| RawFrame {
            width: photograph.width,
            height: photograph.height,
            values: photograph.values.clone(),
            exposure_s: 0.2,
        };
        let before = [frame(&dark)];
        assert_eq!(judge(&config, &Shot { darks: &before, ..first }, 0.2, &dark), Ok(()));

        // A photograph that came a shot early, the same out of focus, and such a one believed before.
        let wrong = |shot: Shot<'_>, photograph: &Photograph, part: &str| {
            let fault = judge(&config, &shot, 0.2, photograph).unwrap_err();
            assert!(matches!(&fault, Fault::Wrong(why) if why.contains(part)), "{part}: {fault:?}");
        };
        wrong(first, &photograph(&config), "of the carrier's 16 tags");
        let mut dim = dark.clone();
        dim.values.fill(540);
        wrong(Shot { darks: &before, ..first }, &dim, "more light than dark frame 0");
        let before = [frame(&dark), frame(&dim)];
        wrong(Shot { darks: &before, ..first }, &dark, "dark frame 1, taken before it");
    }
}
