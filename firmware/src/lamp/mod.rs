//! The lamp: switch, level, and whether it has burnt long enough to be steady.

use embedded_hal::digital::OutputPin;
use embedded_hal::pwm::SetDutyCycle;
use lobelia_protocol::LampStatus;

use crate::board::{PinFailure, set};

const US_PER_S: u64 = 1_000_000;

/// A lamp's pins and since when it burns.
#[derive(Debug)]
pub(crate) struct Lamp<P, D> {
    switch: P,
    dimmer: D,
    on_since_us: Option<u64>,
    level: u16,
}

impl<P: OutputPin, D: SetDutyCycle> Lamp<P, D> {
    pub(crate) fn new(switch: P, dimmer: D) -> Self {
        Self { switch, dimmer, on_since_us: None, level: 0 }
    }

    /// Switches it. The time of warming up runs from when it was last off or burnt at a lower level.
    pub(crate) fn switch(&mut self, now_us: u64, on: bool, level: u16) -> Result<(), PinFailure> {
        let duty = u32::from(self.dimmer.max_duty_cycle()) * u32::from(level) / u32::from(u16::MAX);
        self.dimmer.set_duty_cycle(if on { duty as u16 } else { 0 }).map_err(|_| PinFailure)?;
        set(&mut self.switch, on)?;
        let raised = level > self.level;
        self.level = level;
        self.on_since_us = on.then(|| self.on_since_us.filter(|_| !raised).unwrap_or(now_us));
        Ok(())
    }

    /// Whether it burns.
    pub(crate) fn is_on(&self) -> bool {
        self.on_since_us.is_some()
    }

    /// Its state, given how long it has to burn until it is warm.
    pub(crate) fn status(&self, now_us: u64, warm_up_s: u16) -> LampStatus {
        let Some(since) = self.on_since_us else {
            return LampStatus { level: self.level, ..LampStatus::default() };
        };
        let remaining = (u64::from(warm_up_s) * US_PER_S).saturating_sub(now_us - since);
        LampStatus {
            on: true,
            level: self.level,
            warm: remaining == 0,
            remaining_s: remaining.div_ceil(US_PER_S) as u16,
        }
    }
}
