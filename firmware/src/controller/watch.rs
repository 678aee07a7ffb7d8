//! What a host that watches is told: telemetry at a period, and log lines.

use lobelia_protocol::{Field, Happening, Health, LogLine, Refusal, Telemetry};

use super::{Controller, Task, Trouble};
use crate::board::{AnalogInput, Board};
use crate::motion::pulses::PulsesCell;

/// Shortest period of telemetry, ms.
const SHORTEST_MS: u16 = 20;

/// What the host wants to be told.
#[derive(Debug, Default)]
pub(super) struct Watch {
    /// Period of telemetry, µs, and when the next one is due.
    telemetry: Option<(u64, u64)>,
    log: bool,
    /// Damaged frames told so far.
    bad_frames: u32,
}

impl Watch {
    /// When there is something to tell next, in µs.
    pub(super) fn next_us(&self) -> u64 {
        self.telemetry.map_or(u64::MAX, |(_, due_us)| due_us)
    }
}

impl<B: Board> Controller<B> {
    pub(super) fn set_watch(&mut self, now_us: u64, telemetry_ms: u16, log: bool) -> Result<(), Trouble> {
        if (1..SHORTEST_MS).contains(&telemetry_ms) {
            return Err(Refusal::BadParameter { axis: None, field: Field::TelemetryPeriod }.into());
        }
        let telemetry = (telemetry_ms > 0).then_some((u64::from(telemetry_ms) * 1000, now_us));
        self.link.events.end_watch();
        self.watch = Watch { telemetry, log, bad_frames: self.link.bad_frames };
        Ok(())
    }

    /// Tells the log what happened, if someone reads it.
    pub(super) fn note(&mut self, now_us: u64, what: Happening) {
        if self.watch.log {
            self.link.events.log(LogLine { at_us: now_us, what });
        }
    }

    /// Tells what is due.
    pub(super) fn tell(&mut self, now_us: u64) {
        if let Some((period_us, due_us)) = self.watch.telemetry
            && now_us >= due_us
        {
            self.watch.telemetry = Some((period_us, now_us + period_us));
            let telemetry = self.telemetry(now_us);
            self.link.events.telemetry(telemetry);
        }
        let count = self.link.bad_frames;
        if self.watch.log && count != self.watch.bad_frames {
            self.watch.bad_frames = count;
            self.note(now_us, Happening::BadFrames { count });
        }
    }

    fn telemetry(&mut self, now_us: u64) -> Telemetry {
        // The shutter's own readings are not to be disturbed.
        let exposing =
            self.running.as_ref().is_some_and(|running| matches!(running.task, Task::Expose { .. }));
        Telemetry {
            at_us: now_us,
            positions: self.positions(),
            photodiode: if exposing { None } else { self.photodiode.read() },
            frames: self.link.frames,
            bad_frames: self.link.bad_frames,
            dropped: self.link.events.dropped(),
            health: self.health(),
        }
    }

    /// How well the controller keeps up.
    pub(super) fn health(&mut self) -> Health {
        let worst_late_us = self.pulses.with(|pulses| pulses.trains.worst_late_us());
        let mut health = Health { worst_late_us, longest_poll_us: self.longest_poll_us, ..Health::default() };
        if let Some(vitals) = &mut self.options.vitals {
            health.stack = vitals.stack();
            health.overruns = vitals.overruns();
            health.supply_mv = vitals.supply_mv();
        }
        health
    }
}
