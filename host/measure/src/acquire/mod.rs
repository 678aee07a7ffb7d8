//! Runs a plan: moves the rig, fires the camera, and keeps a journal by which a killed run is continued.
//!
//! What the journal records is on the disk; what it does not record is done again, so a pose is the unit of
//! loss.

use std::time::Duration;

use lobelia_protocol::Health;

use crate::develop::frame::{self, RawFrame};
use crate::rig::PLUG_IN;
use crate::warning::frames;
use lobelia_base::error::{Error, Result};
use lobelia_base::interrupt::interrupted;
use lobelia_base::progress;
use lobelia_reflectance::warning::samples::PoseSamples;

pub mod camera;
mod check;
mod judge;
pub mod station;
mod watch;

pub use crate::run::{PLAN_FILE, RIG_FILE, RunFolder, journal};

pub use watch::WatchedFolder;

use camera::Shot;
use journal::{ExposureRecord, Journal, Record};
use station::Station;

/// What a run cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Acquired {
    /// Poses photographed now, not counting those of an earlier part of the run.
    pub poses: usize,
    /// The controller's time from power-up to the end, s.
    pub controller_s: f64,
    /// How the samples of the poses photographed now fared, looked up where the motors have the sample.
    pub samples: Vec<(usize, PoseSamples)>,
}

/// Fails once the user has asked to stop.
fn check_interrupt() -> Result<()> {
    if interrupted() {
        return Err(Error::failure("interrupted; the run can be continued with --resume"));
    }
    Ok(())
}

/// Runs what the journal does not record yet. On a real rig a resumed run homes only if the controller lost
/// its positions; it always drives to the last recorded pose first and goes on from there.
///
/// # Errors
/// Failures of the link, the rig, the camera or the disk. The journal holds what was done; `--resume`
/// continues.
pub fn run(run: &RunFolder, journal: &mut Journal, station: &mut Station) -> Result<Acquired> {
    let checked = check::checked(&run.records);
    let mut steps = Steps { run, journal, station, samples: Vec::new(), checked, again: 0 };
    if run.finished() {
        let controller_s = steps.last_us() as f64 / 1e6;
        return Ok(Acquired { poses: 0, controller_s, samples: Vec::new() });
    }
    if let Err(error) = steps.all() {
        return Err(match steps.station.rest() {
            Ok(()) => error,
            Err(rest) => not_at_rest(error, &rest),
        });
    }
    let controller_s = steps.station.clock_us()? as f64 / 1e6;
    Ok(Acquired { poses: steps.samples.len(), controller_s, samples: steps.samples })
}

/// The error that ended a run, and that the rig went on. What to do about a lost link is said once.
fn not_at_rest(error: Error, rest: &Error) -> Error {
    let told = error.to_string().contains(PLUG_IN);
    let rest = if told { rest.to_string().replace(PLUG_IN, "") } else { rest.to_string() };
    error.hint(format!("and the rig could not be brought to rest, look whether its lamp burns: {rest}"))
}

/// The steps of one run and what they share.
struct Steps<'a> {
    run: &'a RunFolder,
    journal: &'a mut Journal,
    station: &'a mut Station,
    /// How the samples of each pose photographed now fared.
    samples: Vec<(usize, PoseSamples)>,
    /// Poses that the last check found good.
    checked: usize,
    /// How often suspect poses were taken again since then.
    again: usize,
}

impl Steps<'_> {
    fn all(&mut self) -> Result<()> {
        self.prepare()?;
        self.dark_frames()?;
        self.warm_up()?;
        self.poses()?;
        self.station.rest()?;
        let controller_us = self.station.clock_us()?;
        let Health { worst_late_us, longest_poll_us, stack, overruns, supply_mv } =
            self.station.client.health()?;
        let health =
            Record::Health { worst_late_us, longest_poll_us, stack, overruns, supply_mv, controller_us };
        self.journal.append(&health)?;
        self.journal.append(&Record::Finished { controller_us })
    }

    /// The last recorded controller time, µs.
    fn last_us(&self) -> u64 {
        self.run.records.iter().rev().find_map(Record::controller_us).unwrap_or(0)
    }

    fn recorded(&self, wanted: impl Fn(&Record) -> bool) -> Option<&Record> {
        self.run.records.iter().find(|record| wanted(record))
    }

    /// Lets a simulated rig's clock run to where the recorded step left it.
    fn catch_up(&mut self, record: Option<u64>) {
        if let Some(time_us) = record {
            self.station.idle_until_us(time_us);
        }
    }

    /// Parameters and homing.
    fn prepare(&mut self) -> Result<()> {
        if self.station.client.forgive_lease()? {
            progress::note(
                "the controller had heard nothing for longer than its lease, stopped and dimmed the lamp; \
                 that fault is cleared",
            );
        }
        self.station.client.configure(&self.run.rig.configuration()?)?;
        if !self.station.homed()? {
            self.station.client.home()?;
            if let Some(why) = check::unchecked(&self.run.rig, &self.run.records, self.run.first_left())
                && !self.station.is_simulated()
            {
                progress::note(&why);
            }
        }
        match self.recorded(|record| matches!(record, Record::Homed { .. })) {
            Some(record) => {
                let time = record.controller_us();
                self.catch_up(time);
                Ok(())
            }
            None => {
                let controller_us = self.station.clock_us()?;
                self.journal.append(&Record::Homed { controller_us })
            }
        }
    }

    /// Frames without light, at the shortest and the longest exposure, before the lamp is switched on. An
    /// earlier program may have left it burning.
    fn dark_frames(&mut self) -> Result<()> {
        let camera = &self.run.rig.camera;
        let each = self.run.rig.exposure.dark_frames.max(1);
        let times =
            [camera.min_exposure_s, camera.max_exposure_s].map(|seconds| vec![seconds; each]).concat();
        let recorded = |record: &&Record| matches!(record, Record::Dark { .. });
        let all = self.run.records.iter().filter(recorded).count() >= times.len();
        if !all {
            self.station.client.lamp(false, 0.0)?;
        }
        let mut darks = Vec::new();
        for (index, seconds) in times.into_iter().enumerate() {
            let is_this = |record: &Record| matches!(record, Record::Dark { index: i, .. } if *i == index);
            if let Some(record) = self.recorded(is_this) {
                if let (Record::Dark { exposure, .. }, false) = (record, all) {
                    darks.push(self.raw_frame(exposure)?);
                }
                let time = record.controller_us();
                self.catch_up(time);
                continue;
            }
            let file = format!("frames/dark-{index:02}.tiff");
            let key = [0, index as u64, 0];
            let shot = Shot { open_s: seconds, warm_lamp: false, angles: None, darks: &darks, key };
            let exposure = self.dark_frame(index, &file, &shot)?;
            darks.push(self.raw_frame(&exposure)?);
            let controller_us = self.station.clock_us()?;
            self.journal.append(&Record::Dark { index, exposure, controller_us })?;
        }
        Ok(())
    }

    /// One frame without light. A lamp that glows on after it was switched off gets some time.
    fn dark_frame(&mut self, index: usize, file: &str, shot: &Shot<'_>) -> Result<ExposureRecord> {
        const AFTERGLOW: Duration = Duration::from_secs(60);
        const LOOK_AGAIN: Duration = Duration::from_secs(5);
        let mut waited = Duration::ZERO;
        loop {
            let exposure = self.photograph(file, shot)?;
            let Some(light) = self.run.rig.lamp.lit(exposure.lamp_reading) else { return Ok(exposure) };
            if waited >= AFTERGLOW {
                let message = format!(
                    "dark frame {index}: the lamp is switched off, but its photodiode reads {light:.3} of \
                     the warm lamp's light; look at the lamp and its switch, and keep other light from the \
                     photodiode"
                );
                return Err(Error::failure(message));
            }
            self.station.client.pause(LOOK_AGAIN)?;
            check_interrupt()?;
            waited += LOOK_AGAIN;
        }
    }

    fn warm_up(&mut self) -> Result<()> {
        self.station.client.lamp(true, 1.0)?;
        match self.recorded(|record| matches!(record, Record::LampOn { .. })) {
            Some(record) => {
                let time = record.controller_us();
                self.catch_up(time);
            }
            None => {
                let controller_us = self.station.clock_us()?;
                self.journal.append(&Record::LampOn { controller_us })?;
            }
        }
        let seconds = self.run.rig.lamp.warm_up_s.ceil() as u64;
        let bar = progress::bar("warming up", seconds, "s");
        let mut told = 0;
        self.station.client.wait_until_warm(|left| {
            let warm = seconds.saturating_sub(u64::from(left));
            bar.advance(warm.saturating_sub(told));
            told = told.max(warm);
        })
    }

    fn poses(&mut self) -> Result<()> {
        let first = self.run.first_left();
        if first > 0 {
            // From the last pose on, everything happens as if the run had never been broken off.
            self.go_to_pose(first - 1)?;
            let time = self.last_us();
            self.catch_up(Some(time));
        }
        let count = self.run.plan.poses.len();
        let bar = progress::bar("acquiring", (count - first) as u64, "poses");
        let mut next = first;
        // Broken off before its check.
        if self.check_is_due(first) && self.checked < first {
            next = self.check(first)?;
        }
        while next < count {
            check_interrupt()?;
            self.pose(next).map_err(|error| error.at(format!("pose {next}")))?;
            bar.advance(1);
            next += 1;
            if self.check_is_due(next) {
                next = self.check(next)?;
            }
        }
        Ok(())
    }

    fn go_to_pose(&mut self, index: usize) -> Result<()> {
        let steps = self.run.rig.steps(self.run.plan.poses[index].degrees());
        self.station.client.go_to(&self.run.rig.configuration()?, steps).map(|_| ())
    }

    fn pose(&mut self, index: usize) -> Result<()> {
        self.go_to_pose(index)?;
        let pose = &self.run.plan.poses[index];
        let mut exposures = Vec::with_capacity(pose.exposures_s.len());
        for (number, &open_s) in pose.exposures_s.iter().enumerate() {
            let file = format!("frames/pose-{index:05}-{number}.tiff");
            let angles = Some(self.run.plan.angles(index));
            let key = [1, index as u64, number as u64];
            let shot = Shot { open_s, warm_lamp: true, angles, darks: &[], key };
            exposures.push(self.photograph(&file, &shot)?);
        }
        let frames =
            exposures.iter().map(|exposure| self.raw_frame(exposure)).collect::<Result<Vec<RawFrame>>>()?;
        let controller_us = self.station.clock_us()?;
        self.journal.append(&Record::Pose { index, exposures, controller_us })?;
        self.count(index, &frames);
        Ok(())
    }

    /// A frame as `develop` takes it: its exposure is the controller's, whatever the EXIF block says or
    /// leaves out.
    fn raw_frame(&self, exposure: &ExposureRecord) -> Result<RawFrame> {
        let photograph = frame::read_photograph(&self.run.path.join(&exposure.file))?;
        let (width, height) = (photograph.width, photograph.height);
        Ok(RawFrame { width, height, values: photograph.values, exposure_s: exposure.open_s })
    }

    /// Counts the samples of a pose; says so when for the first time most of them are clipped, since a run
    /// takes hours.
    fn count(&mut self, index: usize, frames: &[RawFrame]) {
        const MOST: f64 = 0.5;
        let counts = frames::samples(&self.run.rig, &self.run.plan.angles(index), frames);
        let before = self.samples.iter().any(|(_, counts)| counts.clipped_share() > MOST);
        if counts.clipped_share() > MOST && !before {
            progress::note(&format!(
                "pose {index}: {:.0} % of the sample is saturated in every exposure",
                100.0 * counts.clipped_share()
            ));
        }
        self.samples.push((index, counts));
    }

    fn photograph(&mut self, file: &str, shot: &Shot<'_>) -> Result<ExposureRecord> {
        let exposure = self.station.photograph(&self.run.rig, &self.run.path.join(file), shot)?;
        Ok(ExposureRecord {
            file: file.into(),
            open_s: f64::from(exposure.open_us) / 1e6,
            lamp_reading: f64::from(exposure.reference_q8) / 256.0,
            flicker: Some(f64::from(exposure.flicker_ppm) / 1e6),
        })
    }
}
