//! A motor that slips in the middle of a run: the check finds it, the poses since the last good one are named
//! and photographed anew.

#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::io::{self, Read, Write};
use std::path::Path;
use std::time::Duration;

use lobelia::acquire::journal::{self, Record};
use lobelia::acquire::station::Station;
use lobelia::acquire::{self, RunFolder, simulated};
use lobelia::rig::Port;
use lobelia::rig::config::RigConfig;
use lobelia_hil_sim::{SimulatedLink, SimulatedRig};
use lobelia_protocol::{Axis, Command, FrameDecoder, ToController};
use lobelia_tests::small;

const POSES: usize = 9;

/// The link to a rig whose tilt slips when certain exposures are asked for, counted from 1.
struct Slipping {
    link: SimulatedLink,
    rig: SimulatedRig,
    decoder: FrameDecoder,
    exposures: usize,
    slips_at: Vec<usize>,
}

impl Read for Slipping {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.link.read(into)
    }
}

impl Write for Slipping {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        for &byte in bytes {
            let Some(Ok(payload)) = self.decoder.push(byte) else { continue };
            if let Ok(ToController::Request(request)) = ToController::decode(payload)
                && let Command::Expose { warm_lamp: true, .. } = request.command
            {
                self.exposures += 1;
                if self.slips_at.contains(&self.exposures) {
                    self.rig.slip(Axis::Tilt, 60);
                }
            }
        }
        self.link.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.link.flush()
    }
}

impl Port for Slipping {
    fn set_read_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        self.link.set_timeout(timeout);
        Ok(())
    }

    fn is_real_time(&self) -> bool {
        false
    }
}

/// A rig without scatter, one frame a pose, that looks for its switches every three poses.
fn rig() -> RigConfig {
    let mut rig = small::rig(24);
    rig.motion.check_every_poses = 3;
    rig.exposure.count = 1;
    rig.simulator.repeatability = false;
    rig
}

fn station(rig: &RigConfig, slips_at: &[usize]) -> Station {
    let simulated = SimulatedRig::new(&simulated::mechanics(rig));
    let slipping = Slipping {
        link: simulated.link(),
        rig: simulated.clone(),
        decoder: FrameDecoder::new(),
        exposures: 0,
        slips_at: slips_at.to_vec(),
    };
    simulated::station_of(&simulated, Box::new(slipping), rig, small::layout(rig)).unwrap()
}

/// The poses in the order in which they were photographed, `None` where they became suspect from one on.
fn course(run: &Path) -> Vec<Result<usize, usize>> {
    let records = journal::read(run).unwrap();
    let of = |record: &Record| match record {
        Record::Pose { index, .. } => Some(Ok(*index)),
        Record::Suspect { from, lost_steps, .. } => {
            assert!(lost_steps[1].unsigned_abs() >= 50, "tilt is named: {lost_steps:?}");
            assert!(
                [0, 2, 3].iter().all(|&axis: &usize| lost_steps[axis].unsigned_abs() <= 4),
                "{lost_steps:?}"
            );
            Some(Err(*from))
        }
        _ => None,
    };
    records.iter().filter_map(of).collect()
}

#[test]
fn poses_photographed_after_a_motor_slipped_are_taken_again_and_where_the_plan_has_them() {
    let rig = rig();
    let plan = small::plan(&rig, POSES);
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let (opened, mut journal) = RunFolder::create(&run, &plan, &rig).unwrap();
    // At the exposure of pose 4, between the checks after 3 and after 6.
    acquire::run(&opened, &mut journal, &mut station(&rig, &[5])).unwrap();
    let expected = [0, 1, 2, 3, 4, 5].map(Ok).into_iter().chain([Err(3)]).chain((3..POSES).map(Ok));
    assert_eq!(course(&run), expected.collect::<Vec<_>>());
    assert!(RunFolder::open(&run).unwrap().finished());
    let records = journal::read(&run).unwrap();
    assert!(records.iter().any(|record| matches!(record, Record::Health { .. })));
    // The truth: what counts was photographed in the plan's poses, within a step and the play.
    let truth = simulated::read_truth(&run, POSES).unwrap();
    for (index, (pose, truth)) in plan.poses.iter().zip(truth).enumerate() {
        let off = (truth[1].to_degrees() - pose.degrees()[1]).abs();
        assert!(off < 0.15, "pose {index}: tilt off by {off}°");
    }
}

#[test]
fn motor_that_slips_again_ends_the_run_which_names_the_poses_and_resumes_with_them() {
    let rig = rig();
    let plan = small::plan(&rig, POSES);
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let (opened, mut journal) = RunFolder::create(&run, &plan, &rig).unwrap();
    let error = acquire::run(&opened, &mut journal, &mut station(&rig, &[5, 8])).unwrap_err().to_string();
    assert!(error.contains("tilt") && error.contains("poses 3 to 5"), "{error}");
    drop(journal);
    small::resume(&run, small::layout);
    let twice = [0, 1, 2, 3, 4, 5].map(Ok).into_iter().chain([Err(3), Ok(3), Ok(4), Ok(5), Err(3)]);
    assert_eq!(course(&run), twice.chain((3..POSES).map(Ok)).collect::<Vec<_>>());
}
