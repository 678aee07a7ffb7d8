//! Events that wait until the line is free: a bounded number of each kind, and a count of those left out.

use heapless::Deque;
use lobelia_protocol::{Event, Happening, LogLine, Telemetry};

/// Faults and crashes waiting; each fault is told once until it is cleared, so they hardly ever fill it.
const ALARMS: usize = 8;
/// Log lines waiting.
const LINES: usize = 8;

/// Events waiting to be sent.
#[derive(Debug, Default)]
pub(crate) struct Events {
    alarms: Deque<Event, ALARMS>,
    log: Deque<LogLine, LINES>,
    telemetry: Option<Telemetry>,
    dropped: u32,
    /// Log lines dropped since the last one that was kept.
    gap: u32,
}

impl Events {
    /// Keeps a fault or a crash. When too many wait the newest is left out: a fault is in each status too.
    pub(crate) fn alarm(&mut self, event: Event) {
        if self.alarms.push_back(event).is_err() {
            self.dropped = self.dropped.wrapping_add(1);
        }
    }

    /// Keeps a log line, if there is room; the next one that is kept is preceded by the number of those that
    /// were not.
    pub(crate) fn log(&mut self, line: LogLine) {
        let room = LINES - self.log.len();
        if room < 1 + usize::from(self.gap > 0) {
            self.gap = self.gap.saturating_add(1);
            self.dropped = self.dropped.wrapping_add(1);
            return;
        }
        let count = core::mem::take(&mut self.gap);
        if count > 0 {
            let _ = self.log.push_back(LogLine { at_us: line.at_us, what: Happening::Dropped { count } });
        }
        let _ = self.log.push_back(line);
    }

    /// Keeps how things go; the one before it is left out if it still waits.
    pub(crate) fn telemetry(&mut self, telemetry: Telemetry) {
        if self.telemetry.replace(telemetry).is_some() {
            self.dropped = self.dropped.wrapping_add(1);
        }
    }

    /// Events left out so far.
    pub(crate) fn dropped(&self) -> u32 {
        self.dropped
    }

    /// The event to send next: faults before all else.
    pub(crate) fn next(&mut self) -> Option<Event> {
        let line = |events: &mut Self| events.log.pop_front().map(Event::Log);
        self.alarms.pop_front().or_else(|| line(self)).or_else(|| self.telemetry.take().map(Event::Telemetry))
    }

    /// Forgets what the host of a session that is over watched; its faults are told to the next one.
    pub(crate) fn end_watch(&mut self) {
        self.log.clear();
        self.telemetry = None;
        self.gap = 0;
    }
}
