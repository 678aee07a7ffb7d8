//! Checks on the way that the axes have lost no steps: every so many poses, and after the last. Where they
//! have, the poses since the last check are suspect, and are taken again.

use lobelia_protocol::Axis;

use super::Steps;
use crate::rig::config::RigConfig;
use crate::run::journal::Record;
use lobelia_base::error::{Error, Result};
use lobelia_base::progress;

/// Suspect poses are taken again so often before the run ends: what makes an axis slip for good needs
/// somebody to look.
const MOST_AGAIN: usize = 1;

/// How many poses the last check has found good.
pub(super) fn checked(records: &[Record]) -> usize {
    let good = |record: &Record| match record {
        Record::Checked { poses, .. } => Some(*poses),
        _ => None,
    };
    records.iter().rev().find_map(good).unwrap_or(0)
}

/// Which of the poses before `first_left` no check has found good, of a rig whose controller has lost its
/// positions: homing anew hides what was lost till then. Nothing where all were checked, or none ever is.
pub(super) fn unchecked(rig: &RigConfig, records: &[Record], first_left: usize) -> Option<String> {
    let from = checked(records);
    if rig.motion.check_every_poses == 0 || from >= first_left {
        return None;
    }
    let last = first_left - 1;
    let (poses, range) =
        if from == last { ("pose", last.to_string()) } else { ("poses", format!("{from}-{last}")) };
    Some(format!(
        "the controller had lost its positions and was homed anew, so {poses} {range} can't be checked for \
         lost steps any more; where a motor may have slipped, leave them out by develop --skip-pose {range}"
    ))
}

impl Steps<'_> {
    /// Whether a check is due once so many poses are done.
    pub(super) fn check_is_due(&self, done: usize) -> bool {
        let every = self.run.rig.motion.check_every_poses;
        every > 0 && done > 0 && (done == self.run.plan.poses.len() || done.is_multiple_of(every))
    }

    /// Looks for the home switches, and goes back to the last of so many poses; gives the next pose to take.
    /// Where steps were lost, the rig is homed and the poses since the last good check are taken again; twice
    /// in a row, and the run ends.
    pub(super) fn check(&mut self, done: usize) -> Result<usize> {
        let lost_steps = self.station.client.check_index()?;
        let axes = self.run.rig.configuration()?.axes;
        let lost: Vec<_> = Axis::ALL
            .into_iter()
            .map(|axis| (axis, lost_steps[axis.index()]))
            .filter(|(axis, lost)| lost.unsigned_abs() > axes[axis.index()].index_tolerance.into())
            .map(|(axis, lost)| {
                let by = if lost.abs() == 1 { "step" } else { "steps" };
                format!("{} by {lost} {by}", axis.name())
            })
            .collect();
        if lost.is_empty() {
            self.go_to_pose(done - 1)?;
            let controller_us = self.station.clock_us()?;
            self.journal.append(&Record::Checked { poses: done, lost_steps, controller_us })?;
            (self.checked, self.again) = (done, 0);
            return Ok(done);
        }
        let controller_us = self.station.clock_us()?;
        self.journal.append(&Record::Suspect { from: self.checked, lost_steps, controller_us })?;
        let found = format!(
            "a check found {} off, so some of the poses {} to {} were photographed elsewhere",
            lost.join(", "),
            self.checked,
            done - 1
        );
        if self.again == MOST_AGAIN {
            return Err(Error::failure(format!(
                "{found}, after they were taken again; find what blocks or slips, then `lobelia rig clear`, \
                 and acquire --resume takes these poses again"
            )));
        }
        progress::note(&format!("{found}; the rig is homed and they are taken again"));
        self.again += 1;
        self.samples.retain(|(pose, _)| *pose < self.checked);
        self.station.client.clear_faults()?;
        self.station.client.home()?;
        Ok(self.checked)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::first_left;

    #[test]
    fn poses_since_the_last_good_check_are_left_after_a_bad_one() {
        let pose = |index| Record::Pose { index, exposures: Vec::new(), controller_us: 0 };
        let good = |poses| Record::Checked { poses, lost_steps: [0; 4], controller_us: 0 };
        let bad = |from| Record::Suspect { from, lost_steps: [9, 0, 0, 0], controller_us: 0 };
        let mut records = vec![pose(0), pose(1)];
        assert_eq!((first_left(&records), checked(&records)), (2, 0));
        records.extend([good(2), pose(2), pose(3), bad(2)]);
        assert_eq!((first_left(&records), checked(&records)), (2, 2));
        records.extend([pose(2)]);
        assert_eq!((first_left(&records), checked(&records)), (3, 2));
    }

    #[test]
    fn poses_that_no_check_has_found_good_are_named_when_positions_were_lost() {
        let mut rig = RigConfig::default();
        let good = |poses| Record::Checked { poses, lost_steps: [0; 4], controller_us: 0 };
        let told = unchecked(&rig, &[good(2)], 5).unwrap();
        assert!(told.contains("poses 2-4") && told.ends_with("--skip-pose 2-4"), "{told}");
        assert!(unchecked(&rig, &[], 1).unwrap().ends_with("--skip-pose 0"));
        assert_eq!(unchecked(&rig, &[good(5)], 5), None);
        assert_eq!(unchecked(&rig, &[], 0), None);
        rig.motion.check_every_poses = 0;
        assert_eq!(unchecked(&rig, &[], 5), None);
    }
}
