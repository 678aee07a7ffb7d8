//! The lamp: switch, level, whether it has burnt long enough to be steady, and how long it has burnt
//! altogether; and its fan.

use embedded_hal::digital::OutputPin;
use embedded_hal::pwm::SetDutyCycle;
use lobelia_protocol::LampStatus;

use crate::pin::{Line, PinFailure, set};

const US_PER_S: u64 = 1_000_000;

/// A lamp's pins and since when it burns.
#[derive(Debug)]
pub(crate) struct Lamp<P, D> {
    switch: P,
    dimmer: D,
    /// Since when it is switched on, and since when it gives light at its present level or a higher one.
    on_since_us: Option<u64>,
    lit_since_us: Option<u64>,
    /// When it went out last.
    out_us: Option<u64>,
    level: u16,
}

impl<P: OutputPin, D: SetDutyCycle> Lamp<Line<P>, D> {
    /// Tells it how its relay is wired.
    pub(crate) fn wire(&mut self, inverted: bool) {
        self.switch.wire(inverted);
    }
}

impl<P: OutputPin, D: SetDutyCycle> Lamp<P, D> {
    pub(crate) fn new(switch: P, dimmer: D) -> Self {
        Self { switch, dimmer, on_since_us: None, lit_since_us: None, out_us: None, level: 0 }
    }

    /// Switches it. The time of warming up runs from when it was last off or burnt at a lower level; at level
    /// 0 it does not warm up.
    pub(crate) fn switch(&mut self, now_us: u64, on: bool, level: u16) -> Result<(), PinFailure> {
        if !on {
            return self.put_out(now_us);
        }
        let duty = u32::from(self.dimmer.max_duty_cycle()) * u32::from(level) / u32::from(u16::MAX);
        self.dimmer.set_duty_cycle(duty as u16).map_err(|_| PinFailure)?;
        set(&mut self.switch, true)?;
        let raised = level > self.level;
        self.level = level;
        self.lit_since_us = (level > 0).then(|| self.lit_since_us.filter(|_| !raised).unwrap_or(now_us));
        self.on_since_us.get_or_insert(now_us);
        Ok(())
    }

    /// Puts it out: the relay first, whatever the dimmer does.
    pub(crate) fn put_out(&mut self, now_us: u64) -> Result<(), PinFailure> {
        let opened = set(&mut self.switch, false);
        let dimmed = self.dimmer.set_duty_cycle(0).map_err(|_| PinFailure);
        if self.on_since_us.take().is_some() {
            self.out_us = Some(now_us);
        }
        self.lit_since_us = None;
        self.level = 0;
        opened.and(dimmed)
    }

    /// Whether it burns.
    pub(crate) fn is_on(&self) -> bool {
        self.on_since_us.is_some()
    }

    /// When it has burnt for so long, in µs; never while it is off.
    pub(crate) fn burnt_us(&self, longest_s: u32) -> u64 {
        self.on_since_us.map_or(u64::MAX, |since| since + u64::from(longest_s) * US_PER_S)
    }

    /// Until when its fan has to run, in µs, if it runs on for so long; for ever while it burns.
    pub(crate) fn fan_until_us(&self, run_on_s: u16) -> u64 {
        match (self.on_since_us, self.out_us) {
            (Some(_), _) => u64::MAX,
            (None, Some(out_us)) => out_us + u64::from(run_on_s) * US_PER_S,
            (None, None) => 0,
        }
    }

    /// Its state, given how long it has to burn until it is warm.
    pub(crate) fn status(&self, now_us: u64, warm_up_s: u16) -> LampStatus {
        if self.on_since_us.is_none() {
            return LampStatus { level: self.level, ..LampStatus::default() };
        }
        let lit_us = self.lit_since_us.map_or(0, |since| now_us - since);
        let remaining = (u64::from(warm_up_s) * US_PER_S).saturating_sub(lit_us);
        LampStatus {
            on: true,
            level: self.level,
            warm: self.lit_since_us.is_some() && remaining == 0,
            remaining_s: remaining.div_ceil(US_PER_S) as u16,
        }
    }
}
