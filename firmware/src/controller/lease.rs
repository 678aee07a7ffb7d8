//! The lease: a host that has gone silent must not leave the rig moving or the lamp burning at full level.

use lobelia_protocol::{Configuration, Event, Fault, FaultReport, Refusal};

use super::{Controller, Task};
use crate::board::Board;

impl<B: Board> Controller<B> {
    /// Renews the lease as a request would: for a simulated host that does not follow the controller's clock.
    pub fn keep_alive(&mut self, now_us: u64) {
        self.heard_us = now_us;
    }

    /// When the lease ends unless something is heard before, in µs; never while nothing moves and the lamp is off, or once
    /// it has ended.
    pub(super) fn lease_end_us(&self) -> u64 {
        let Some(Configuration { settings, .. }) = &self.configuration else { return u64::MAX };
        if self.safety.faults().contains(Fault::LeaseExpired) {
            return u64::MAX;
        }
        let running = self.running.as_ref().is_some_and(|running| !matches!(running.task, Task::Stop));
        let end = |holds: bool, ms: u32| {
            if holds && ms > 0 { self.heard_us.saturating_add(u64::from(ms) * 1000) } else { u64::MAX }
        };
        end(running, settings.lease_ms).min(end(self.lamp.is_on(), settings.lamp_lease_ms))
    }

    /// Stops by the ramps, so positions stay known; dims the lamp; remembers why.
    pub(super) fn expire(&mut self, now_us: u64) {
        self.safety.latch(Fault::LeaseExpired);
        let report = FaultReport { fault: Fault::LeaseExpired, axis: None, at_us: now_us };
        self.link.events.alarm(Event::Fault(report));
        self.refuse_waiting(now_us, Refusal::Faulted(self.safety.faults()));
        let level = self.configuration.map_or(0, |configuration| configuration.settings.lamp_safe_level);
        let dimmed = !self.lamp.is_on() || self.lamp.switch(now_us, level > 0, level).is_ok();
        if self.stop(now_us).is_err() || !dimmed {
            self.raise(now_us, Fault::Hardware, None);
        }
    }
}
