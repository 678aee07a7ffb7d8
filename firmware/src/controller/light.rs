//! The part of the controller that has to do with light: lamp, shutter, camera.

use lobelia_protocol::{Answer, EXPOSURE_US, Fault, Field, LampStatus, Outcome, Refusal};

use super::{Controller, Task, Trouble};
use crate::board::Board;
use crate::pin::{PinFailure, is_high};
use crate::shutter::{Closed, REST_US};

/// The camera is looked at this often while it isn't ready, µs.
const LOOK_EVERY_US: u64 = 1000;

impl<B: Board> Controller<B> {
    pub(super) fn begin_exposure(
        &mut self,
        now_us: u64,
        duration_us: u32,
        warm_lamp: bool,
    ) -> Result<Task, Trouble> {
        if !EXPOSURE_US.contains(&duration_us) {
            return Err(Refusal::BadParameter { axis: None, field: Field::Duration }.into());
        }
        self.check_positions()?;
        let lamp = self.lamp_status(now_us);
        if warm_lamp && !lamp.warm {
            return Err(Refusal::LampNotWarm { remaining_s: lamp.on.then_some(lamp.remaining_s) }.into());
        }
        let wait_ms =
            self.configuration.as_ref().map_or(0, |configuration| configuration.settings.camera_wait_ms);
        // A rest before each exposure, whatever was before it: times do not depend on the past.
        let look_us = now_us + REST_US;
        Ok(Task::AwaitCamera {
            look_us,
            until_us: look_us + u64::from(wait_ms) * 1000,
            duration_us,
            warm_lamp,
        })
    }

    /// Opens the shutter if the camera is ready, or waits for it; nothing when that has taken too long.
    pub(super) fn open_when_ready(
        &mut self,
        now_us: u64,
        (until_us, duration_us, warm_lamp): (u64, u32, bool),
    ) -> Result<Option<Task>, PinFailure> {
        let ready = self.lines.camera_ready.as_mut().map_or(Ok(true), is_high)?;
        if ready {
            self.shutter.open(now_us, duration_us, &mut self.photodiode)?;
            return Ok(Some(Task::Expose { lit: warm_lamp }));
        }
        let look_us = now_us + LOOK_EVERY_US;
        let wait = Task::AwaitCamera { look_us, until_us, duration_us, warm_lamp };
        Ok((look_us <= until_us).then_some(wait))
    }

    /// Reads the photodiode, closes the shutter when it's time, and looks at what came of it.
    pub(super) fn expose_on(&mut self, now_us: u64, lit: bool) -> Result<Option<Outcome>, Fault> {
        let closed = self.shutter.poll(now_us, &mut self.photodiode).map_err(|_| Fault::Hardware)?;
        if closed.is_some() {
            // Until now the host had reason to be quiet.
            self.heard_us = now_us;
        }
        Ok(match closed {
            None => None,
            Some(Closed::Late(late_us)) => Some(Outcome::Refused(Refusal::ShutterLate { late_us })),
            Some(Closed::InTime(exposure)) => {
                if lit && self.is_dark(now_us, exposure.reference_q8) {
                    return Err(Fault::LampFailure);
                }
                Some(Outcome::Done(Answer::Exposed(exposure)))
            }
        })
    }

    /// Whether the lamp should have been brighter than this.
    fn is_dark(&self, now_us: u64, reference_q8: u32) -> bool {
        let least =
            self.configuration.as_ref().map_or(0, |configuration| configuration.settings.lamp_least_reading);
        let level = self.lamp_status(now_us).level;
        let least_q8 = (u64::from(least) << 8) * u64::from(level) / u64::from(u16::MAX);
        u64::from(reference_q8) < least_q8
    }

    pub(super) fn lamp_status(&self, now_us: u64) -> LampStatus {
        self.lamp.status(
            now_us,
            self.configuration.as_ref().map_or(0, |configuration| configuration.settings.lamp_warm_up_s),
        )
    }

    /// Looks at the temperature input, where there is one. Before its wiring is known nothing can burn.
    pub(super) fn mind_temperature(&mut self, now_us: u64) {
        if self.wiring.is_none() {
            return;
        }
        match self.lines.over_temperature.as_mut().map(is_high) {
            Some(Ok(true)) if !self.safety.faults().contains(Fault::OverTemperature) => {
                self.raise(now_us, Fault::OverTemperature, None);
            }
            Some(Err(PinFailure)) => self.raise(now_us, Fault::Hardware, None),
            _ => {}
        }
    }
}
