//! What a host of any version may always do: stop the rig, darken it, and ask for its state.

use lobelia_protocol::{Fault, Happening, Refusal, SafeCommand, SafeState, ToHost};

use super::{Controller, Task};
use crate::board::Board;
use crate::motion::axis::AxisDrive;
use crate::pin::PinFailure;

impl<B: Board> Controller<B> {
    /// Obeys and tells how things stand. It renews no lease: whoever only asks must not keep the lamp alight.
    pub(super) fn make_safe(&mut self, now_us: u64, command: SafeCommand) {
        let exposing = self.shutter.is_open();
        let done = match command {
            SafeCommand::Stop => {
                self.refuse_waiting(now_us, Refusal::Stopped);
                self.stop()
            }
            SafeCommand::Darken => self.darken(now_us),
            SafeCommand::Ask | SafeCommand::Unknown(_) => Ok(()),
        };
        if done.is_err() {
            self.raise(now_us, Fault::Hardware, None);
        }
        if exposing && !self.shutter.is_open() {
            // Until now the host of the session had reason to be quiet.
            self.heard_us = now_us;
        }
        let state = SafeState {
            command,
            moving: self.axes.iter().any(AxisDrive::moving),
            busy: self.running.is_some(),
            lamp: self.lamp.is_on(),
            shutter: self.shutter.is_open(),
            emergency_stop: self.safety.pressed(),
            fault: !self.safety.faults().is_empty(),
            known: self.axes.iter().all(|axis| axis.known),
            configured: self.configuration.is_some(),
            uptime_s: (now_us / 1_000_000) as u32,
            positions: self.positions(),
        };
        self.link.send(&ToHost::Safe(state));
    }

    /// Puts the lamp out and closes the shutter, which ends an exposure.
    fn darken(&mut self, now_us: u64) -> Result<(), PinFailure> {
        let task = self.running.as_ref().map(|running| &running.task);
        let exposing = matches!(task, Some(Task::AwaitCamera { .. } | Task::Expose { .. }));
        let closed = if exposing { self.stop() } else { self.shutter.close() };
        let out = self.lamp.put_out(now_us);
        self.note(now_us, Happening::Lamp { on: false, level: 0 });
        out.and(closed)
    }
}
