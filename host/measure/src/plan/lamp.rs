//! How long the lamp burns for a plan, against the time after which the controller puts it out.

use super::{PlannedPose, order};
use crate::rig::config::RigConfig;
use crate::rig::geometry::MotorAngles;
use lobelia_base::progress::duration;

/// Time that the lamp burns for some poses, s: warm-up, moves, settling, exposures. Repeated photographs, the
/// camera's own time and the looks for lost steps come on top.
pub fn burning_s(config: &RigConfig, poses: &[PlannedPose]) -> f64 {
    let angles: Vec<_> = poses.iter().map(|pose| MotorAngles::from_degrees(pose.degrees())).collect();
    let settle_s = config.axes.in_order().iter().fold(0.0, |longest: f64, axis| longest.max(axis.settle_s));
    let exposures_s: f64 = poses.iter().flat_map(|pose| &pose.exposures_s).sum();
    config.lamp.warm_up_s
        + order::tour_s(config, &angles)
        + settle_s * poses.len().saturating_sub(1) as f64
        + exposures_s
}

/// What is wrong with poses that take longer than the lamp may burn; nothing where they don't.
pub fn too_long(config: &RigConfig, poses: &[PlannedPose]) -> Option<String> {
    let (needed, longest) = (burning_s(config, poses), config.lamp.longest_s);
    (needed > longest).then(|| {
        format!(
            "the lamp has to burn for at least {} (warm-up, moves and exposures of {} poses), but the \
             controller puts it out after {} (lamp.longest_s)",
            duration(needed),
            poses.len(),
            duration(longest)
        )
    })
}

/// What to do about it before a run.
pub const PLAN_LESS: &str = "raise lamp.longest_s in the rig's file, or plan fewer poses";

/// What to do about it in a run that has begun, whose rig may not be changed.
pub const GO_ON: &str =
    "when it is out, go on with `lobelia rig clear` and acquire --resume, which warms it up again";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lamp_burns_for_warm_up_moves_settling_and_exposures() {
        let config = RigConfig::default();
        let pose = |pan_deg| PlannedPose {
            pan_deg,
            tilt_deg: 0.0,
            roll_deg: 0.0,
            light_deg: 90.0,
            exposures_s: vec![0.25, 1.0],
        };
        // 60° at 60°/s and 120°/s²: 1.5 s. The light settles longest, 0.3 s.
        let poses = [pose(0.0), pose(60.0), pose(0.0)];
        let expected = 900.0 + 2.0 * 1.5 + 2.0 * 0.3 + 3.0 * 1.25;
        assert!((burning_s(&config, &poses) - expected).abs() < 1e-9);

        assert_eq!(too_long(&config, &poses), None);
        let mut brief = config;
        brief.lamp.longest_s = expected - 0.1;
        let told = too_long(&brief, &poses).unwrap();
        assert!(told.contains("at least 15 min") && told.contains("lamp.longest_s"), "{told}");
        brief.lamp.longest_s = expected + 0.1;
        assert_eq!(too_long(&brief, &poses), None);
    }

    #[test]
    fn durations_have_the_unit_that_suits_them() {
        assert_eq!([90.0, 600.0, 172_800.0].map(duration), ["90 s", "10 min", "48.0 h"]);
    }
}
