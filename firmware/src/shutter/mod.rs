//! The shutter: opens it for a given time and means the lamp's photodiode over just that time.

use embedded_hal::digital::OutputPin;
use lobelia_protocol::Exposure;

use crate::board::{AnalogInput, PinFailure, set};

/// Photodiode readings are this far apart, or closer in short exposures, µs.
const READING_EVERY_US: u32 = 1000;
/// An exposure that was open longer than asked for by more than this is refused, µs.
const MAX_LATE_US: u64 = 10;
/// Fewest readings of an exposure.
const LEAST_READINGS: u32 = 16;

/// It stays closed for this long before each exposure, µs, so that a camera can tell it from the one before.
pub(crate) const REST_US: u64 = 1000;

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
    sum_of_squares: u64,
}

/// What came of an exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Closed {
    /// It was open for the time asked for.
    InTime(Exposure),
    /// It was open for so much longer, µs.
    Late(u32),
}

impl Open {
    /// Readings are at the midpoints of equal parts.
    fn next_reading_us(&self) -> u64 {
        let half_parts = u64::from(2 * self.readings + 1);
        self.start_us + u64::from(self.duration_us) * half_parts / u64::from(2 * self.planned)
    }

    fn read(&mut self, photodiode: &mut impl AnalogInput) -> Result<(), PinFailure> {
        let reading = u64::from(photodiode.read().ok_or(PinFailure)?);
        self.sum += reading;
        self.sum_of_squares += reading * reading;
        self.readings += 1;
        Ok(())
    }

    /// Standard deviation over mean, in millionths: √(nΣx² − (Σx)²)/Σx.
    fn flicker_ppm(&self) -> u32 {
        let sum = u128::from(self.sum);
        let spread = u128::from(self.readings) * u128::from(self.sum_of_squares) - sum * sum;
        (spread * 1_000_000_000_000).isqrt().checked_div(sum).unwrap_or(0).min(u32::MAX.into()) as u32
    }

    fn end_us(&self) -> u64 {
        self.start_us + u64::from(self.duration_us)
    }
}

impl<P: OutputPin> Shutter<P> {
    pub(crate) fn new(pin: P) -> Self {
        Self { pin, exposure: None }
    }

    /// Whether it is open.
    pub(crate) fn is_open(&self) -> bool {
        self.exposure.is_some()
    }

    /// Opens it for `duration_us`.
    pub(crate) fn open(&mut self, now_us: u64, duration_us: u32) -> Result<(), PinFailure> {
        let planned = duration_us.div_ceil(READING_EVERY_US).max(LEAST_READINGS);
        set(&mut self.pin, true)?;
        self.exposure =
            Some(Open { start_us: now_us, duration_us, readings: 0, planned, sum: 0, sum_of_squares: 0 });
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
    ) -> Result<Option<Closed>, PinFailure> {
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
                flicker_ppm: open.flicker_ppm(),
            };
            let late_us = now_us - open.end_us();
            self.exposure = None;
            let in_time = late_us <= MAX_LATE_US;
            return Ok(Some(if in_time { Closed::InTime(exposure) } else { Closed::Late(late_us as u32) }));
        }
        if open.readings < open.planned && now_us >= open.next_reading_us() {
            open.read(photodiode)?;
        }
        Ok(None)
    }
}
