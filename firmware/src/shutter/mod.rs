//! The shutter: opens it for a given time and means the lamp's photodiode over just that time.

use embedded_hal::digital::OutputPin;
use lobelia_protocol::Exposure;

use crate::board::{AnalogInput, PinFailure, set};

/// Shortest and longest open time, µs.
pub(crate) const OPEN_US: core::ops::RangeInclusive<u32> = 100..=60_000_000;
/// Photodiode readings are this far apart, or closer in short exposures, µs.
const READING_EVERY_US: u32 = 1000;
/// Fewest readings of an exposure.
const LEAST_READINGS: u32 = 16;

/// The shutter's pin and the exposure under way.
#[derive(Debug)]
pub(crate) struct Shutter<P> {
    pin: P,
    exposure: Option<Open>,
}

#[derive(Debug)]
struct Open {
    start_us: u64,
    duration_us: u32,
    readings: u32,
    planned: u32,
    sum: u64,
}

impl Open {
    /// Readings are at the midpoints of equal parts.
    fn next_reading_us(&self) -> u64 {
        let half_parts = u64::from(2 * self.readings + 1);
        self.start_us + u64::from(self.duration_us) * half_parts / u64::from(2 * self.planned)
    }

    fn end_us(&self) -> u64 {
        self.start_us + u64::from(self.duration_us)
    }
}

impl<P: OutputPin> Shutter<P> {
    pub(crate) fn new(pin: P) -> Self {
        Self { pin, exposure: None }
    }

    /// Opens it for `duration_us`.
    pub(crate) fn open(&mut self, now_us: u64, duration_us: u32) -> Result<(), PinFailure> {
        let planned = duration_us.div_ceil(READING_EVERY_US).max(LEAST_READINGS);
        set(&mut self.pin, true)?;
        self.exposure = Some(Open { start_us: now_us, duration_us, readings: 0, planned, sum: 0 });
        Ok(())
    }

    /// Closes it, whatever it was doing.
    pub(crate) fn close(&mut self) -> Result<(), PinFailure> {
        self.exposure = None;
        set(&mut self.pin, false)
    }

    /// When it next has to be polled, in µs.
    pub(crate) fn next_us(&self) -> u64 {
        match &self.exposure {
            Some(open) if open.readings < open.planned => open.next_reading_us().min(open.end_us()),
            Some(open) => open.end_us(),
            None => u64::MAX,
        }
    }

    /// Reads the photodiode and closes when it's time; gives the exposure when it has ended.
    pub(crate) fn poll(
        &mut self,
        now_us: u64,
        photodiode: &mut impl AnalogInput,
    ) -> Result<Option<Exposure>, PinFailure> {
        let Some(open) = &mut self.exposure else {
            return Ok(None);
        };
        if now_us >= open.end_us() {
            set(&mut self.pin, false)?;
            let mean_q8 = (open.sum << 8).checked_div(u64::from(open.readings)).unwrap_or(0);
            let exposure = Exposure {
                start_us: open.start_us,
                open_us: (now_us - open.start_us) as u32,
                reference_q8: mean_q8 as u32,
                readings: open.readings,
            };
            self.exposure = None;
            return Ok(Some(exposure));
        }
        if open.readings < open.planned && now_us >= open.next_reading_us() {
            open.sum += u64::from(photodiode.read().ok_or(PinFailure)?);
            open.readings += 1;
        }
        Ok(None)
    }
}
