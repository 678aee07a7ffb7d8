//! The lease: a host that has gone silent must not leave the rig moving or the lamp burning at full level.
//! And whatever the host says, the lamp burns no longer than it may.

use lobelia_protocol::{Configuration, Event, Fault, FaultReport, Refusal};

use super::{Controller, Task};
use crate::board::Board;
use crate::pin::set;

impl<B: Board> Controller<B> {
    /// Renews the lease as a request would: for a simulated host that does not follow the controller's clock.
    pub fn keep_alive(&mut self, now_us: u64) {
        self.heard_us = now_us;
    }

    /// When the lease ends unless something is heard before, in µs; never while nothing moves and the lamp is
    /// off, or once it has ended.
    pub(super) fn lease_end_us(&self) -> u64 {
        let Some(Configuration { settings, .. }) = &self.configuration else { return u64::MAX };
        if self.safety.faults().contains(Fault::LeaseExpired) {
            return u64::MAX;
        }
        let running = self.running.as_ref().is_some_and(|running| !matches!(running.task, Task::Stop));
        // While the shutter is open the host is quiet, so that nothing disturbs it.
        let heard_us = self.shutter.end_us().map_or(self.heard_us, |end_us| end_us.max(self.heard_us));
        let end = |holds: bool, ms: u32| {
            if holds && ms > 0 { heard_us.saturating_add(u64::from(ms) * 1000) } else { u64::MAX }
        };
        end(running, settings.lease_ms).min(end(self.lamp.is_on(), settings.lamp_lease_ms))
    }

    /// When the lamp has burnt for as long as it may, in µs.
    pub(super) fn lamp_end_us(&self) -> u64 {
        self.lamp.burnt_us(
            self.configuration.as_ref().map_or(0, |configuration| configuration.settings.lamp_longest_s),
        )
    }

    /// Ends the lease, or the time of the lamp, when it is over.
    pub(super) fn mind_times(&mut self, now_us: u64) {
        if now_us >= self.lease_end_us() {
            let level =
                self.configuration.as_ref().map_or(0, |configuration| configuration.settings.lamp_safe_level);
            self.expire(now_us, Fault::LeaseExpired, level);
        }
        if now_us >= self.lamp_end_us() {
            self.expire(now_us, Fault::LampTimeout, 0);
        }
    }

    /// Runs the fan while the lamp burns and for a time after that.
    pub(super) fn mind_fan(&mut self, now_us: u64) {
        let until_us = self.fan_until_us();
        let Some(fan) = &mut self.lines.fan else { return };
        let runs = now_us < until_us;
        if runs != self.fan_runs {
            self.fan_runs = runs;
            if set(fan, runs).is_err() {
                self.raise(now_us, Fault::Hardware, None);
            }
        }
    }

    fn fan_until_us(&self) -> u64 {
        self.lamp.fan_until_us(
            self.configuration.as_ref().map_or(0, |configuration| configuration.settings.fan_run_on_s),
        )
    }

    /// When something is due for lamp or fan, in µs.
    pub(super) fn lamp_us(&self) -> u64 {
        let fan_us = if self.fan_runs { self.fan_until_us() } else { u64::MAX };
        self.lamp_end_us().min(fan_us)
    }

    /// Stops by the ramps, so positions stay known; dims the lamp; remembers why.
    fn expire(&mut self, now_us: u64, fault: Fault, level: u16) {
        self.safety.latch(fault);
        self.link.events.alarm(Event::Fault(FaultReport { fault, axis: None, at_us: now_us }));
        self.refuse_waiting(now_us, Refusal::Faulted(self.safety.faults()));
        let dimmed = !self.lamp.is_on() || self.lamp.switch(now_us, level > 0, level).is_ok();
        if self.stop().is_err() || !dimmed {
            self.raise(now_us, Fault::Hardware, None);
        }
    }
}
