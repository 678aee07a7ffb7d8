//! Which poses to photograph, in which order and with which exposures (section 3.3.2).

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::rig::config::{AXIS_NAMES, RigConfig};
use crate::rig::geometry::MotorAngles;
use lobelia_base::error::{Error, Result};
use lobelia_base::{files, toml_file};

pub mod choose;
pub mod density;
pub mod exposure;
pub mod lamp;
pub mod order;

/// A plan: what `plan.toml` holds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Version of the format, 1.
    pub format: u32,
    /// Whether direction pairs that differ by a turn about the normal or a mirror count as one.
    pub isotropic: bool,
    /// Bi-angular distance that no two poses undercut.
    pub spacing_deg: f64,
    /// The poses in the order in which they are visited.
    #[serde(rename = "pose")]
    pub poses: Vec<PlannedPose>,
}

/// One setting of all axes and the exposures to take there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedPose {
    /// Pan.
    pub pan_deg: f64,
    /// Tilt.
    pub tilt_deg: f64,
    /// Roll.
    pub roll_deg: f64,
    /// Light.
    pub light_deg: f64,
    /// Shutter times, shortest first.
    pub exposures_s: Vec<f64>,
}

impl PlannedPose {
    /// The angles in the protocol's order: pan, tilt, roll, light.
    pub fn degrees(&self) -> [f64; 4] {
        [self.pan_deg, self.tilt_deg, self.roll_deg, self.light_deg]
    }
}

/// How many poses to choose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Extent {
    /// As many as fit with this bi-angular distance between them, degrees.
    Density(f64),
    /// As dense as the sharpest lobe cosⁿ asks for, by (3.5) or (3.6).
    SharpestExponent(f64),
    /// This many, as far apart as can be.
    Budget(usize),
}

/// Makes a plan for the rig.
///
/// # Errors
/// When the extent asks for nothing or the rig reaches no pose.
pub fn make(config: &RigConfig, extent: Extent, isotropic: bool, seed: u64) -> Result<Plan> {
    config.validate()?;
    let chosen = choose::poses(config, extent, isotropic, seed)?;
    let ordered = order::shorten(config, &chosen.angles);
    let poses = ordered
        .into_iter()
        .map(|angles| {
            let [pan_deg, tilt_deg, roll_deg, light_deg] = angles.to_degrees().map(tidy);
            let exposures_s = exposure::predict(config, &angles);
            PlannedPose { pan_deg, tilt_deg, roll_deg, light_deg, exposures_s }
        })
        .collect();
    Ok(Plan { format: 1, isotropic, spacing_deg: tidy(chosen.spacing_deg), poses })
}

/// Rounds to a ten-thousandth of a degree, finer than any motor step, for files that people read.
fn tidy(degrees: f64) -> f64 {
    (degrees * 1e4).round() / 1e4
}

impl Plan {
    /// Reads and checks a plan against the rig that shall run it.
    ///
    /// # Errors
    /// Input errors naming file and pose.
    pub fn read(path: &Path, config: &RigConfig) -> Result<Self> {
        let plan: Self = toml_file::read_as(path, toml_file::Kind::Plan)?;
        plan.validate(config).map_err(|error| error.at(path.display()))?;
        Ok(plan)
    }

    /// Writes `plan.toml`.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn write(&self, path: &Path) -> Result<()> {
        files::write_bytes(path, self.to_toml()?.as_bytes())
    }

    /// The plan as TOML text.
    ///
    /// # Errors
    /// When a number cannot be written, which a valid plan rules out.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self)
            .map_err(|error| Error::failure(format!("the plan cannot be written: {error}")).caused_by(error))
    }

    /// Checks format, limits and exposures.
    ///
    /// # Errors
    /// Input errors naming the pose.
    pub fn validate(&self, config: &RigConfig) -> Result<()> {
        if self.format != 1 {
            return Err(Error::input(format!("plan format {} is not known, only 1 is", self.format)));
        }
        if self.poses.is_empty() {
            return Err(Error::input("the plan has no pose"));
        }
        for (index, pose) in self.poses.iter().enumerate() {
            let refuse = |why: String| Err(Error::input(format!("pose {index}: {why}")));
            for ((name, axis), deg) in AXIS_NAMES.iter().zip(config.axes.in_order()).zip(pose.degrees()) {
                if !(axis.min_deg..=axis.max_deg).contains(&deg) {
                    let (min, max) = (axis.min_deg, axis.max_deg);
                    return refuse(format!("{name} at {deg}° is outside the rig's limits {min}° to {max}°"));
                }
            }
            if let Some(axes) = config.kept_out(pose.degrees()) {
                return refuse(format!(
                    "{axes} would be where they must not be together, see [[keep_out]] in the rig's file"
                ));
            }
            if !(1..=3).contains(&pose.exposures_s.len()) {
                return refuse(format!("{} exposures, must be 1 to 3", pose.exposures_s.len()));
            }
            let range = config.camera.min_exposure_s * 0.999..=config.camera.max_exposure_s * 1.001;
            if let Some(bad) = pose.exposures_s.iter().find(|&seconds| !range.contains(seconds)) {
                return refuse(format!("an exposure of {bad} s is outside the camera's range"));
            }
        }
        Ok(())
    }

    /// Motor angles of pose `index`.
    pub fn angles(&self, index: usize) -> MotorAngles {
        MotorAngles::from_degrees(self.poses[index].degrees())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_survives_its_file_and_bad_poses_are_named() {
        let config = RigConfig::default();
        let plan = make(&config, Extent::Budget(12), true, 1).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plan.toml");
        plan.write(&path).unwrap();
        assert_eq!(Plan::read(&path, &config).unwrap(), plan);

        let mut apart = config.clone();
        apart.axes.pan.home_order = 1;
        apart.keep_out = vec![crate::rig::config::KeepOut {
            first: crate::rig::config::AxisName::Pan,
            first_deg: [plan.poses[5].pan_deg - 1.0, plan.poses[5].pan_deg + 1.0],
            second: crate::rig::config::AxisName::Light,
            second_deg: [plan.poses[5].light_deg - 1.0, plan.poses[5].light_deg + 1.0],
        }];
        let message = plan.validate(&apart).unwrap_err().to_string();
        assert!(message.contains("pose 5") && message.contains("pan and light"), "{message}");
        // A plan made for it keeps out of there.
        make(&apart, Extent::Budget(12), true, 1).unwrap().validate(&apart).unwrap();

        let mut far = plan;
        far.poses[3].tilt_deg = 120.0;
        far.write(&path).unwrap();
        let text = Plan::read(&path, &config).unwrap_err().to_string();
        assert!(text.contains("plan.toml") && text.contains("pose 3") && text.contains("tilt"), "{text}");
    }
}
