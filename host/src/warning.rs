//! What finds the [warnings](Warning) of a measurement and of a fit.
//!
//! [`samples`] counts, pose by pose, what is clipped, starved or missing: [`predicted`] before a run,
//! [`frames`] during it, the developed samples and those of a store after it. [`directions`] looks at where
//! light and camera stood, [`residual`] at the poses and [`texels`] at the texels that a fit leaves much of.

use crate::plan::Plan;
use crate::rig::config::RigConfig;

pub use lobelia_base::warning::{Kind, Warning};
pub use lobelia_fit::warning::{directions, residual, texels};
pub use lobelia_measure::warning::{frames, predicted};
pub use lobelia_reflectance::warning::samples;

/// Warns of a plan with too few poses for the lobes that a fit takes by itself, or with poses that leave the
/// shape of a lobe open.
pub fn of_plan(rig: &RigConfig, plan: &Plan) -> Vec<Warning> {
    let options = directions::by_default(plan.isotropic);
    let pair = |pose| crate::rig::geometry::directions(rig, &plan.angles(pose));
    let planned: Vec<_> = (0..plan.poses.len()).map(pair).collect();
    directions::too_few(planned.len(), &options)
        .into_iter()
        .chain(directions::shape(&planned, plan.isotropic))
        .collect()
}
