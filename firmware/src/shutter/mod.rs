//! The shutter: opens it for a given time and means the lamp's photodiode over just that time.
//!
//! A timer opens and closes it to the tick where the board has one for that; else the polls do. Likewise a
//! converter that reads by itself sees the lamp's dimmer, tens of kHz, at all its phases; one that is read at
//! each millisecond sees a dimmer of the same crystal at one.

use embedded_hal::digital::OutputPin;
use lobelia_protocol::Exposure;

use crate::board::{AnalogInput, Readings, TimedShutter};
use crate::pin::{Line, PinFailure, set};

/// Photodiode readings are this far apart, or closer in short exposures, µs; one that reads by itself is
/// asked as often.
const READING_EVERY_US: u32 = 1000;
/// An exposure that was open longer than asked for by more than this is refused, µs.
const MAX_LATE_US: u64 = 10;
/// The last of them is at least this long before the end, µs: the poll that makes it must not delay the one
/// that closes.
const BEFORE_END_US: u64 = 120;
/// Fewest readings of an exposure.
const LEAST_READINGS: u32 = 16;

/// It stays closed for this long before each exposure, µs, so that a camera can tell it from the one before.
pub(crate) const REST_US: u64 = 1000;

/// A board's timer for the shutter.
pub(crate) type Timer = Option<&'static mut (dyn TimedShutter + Send)>;

/// The shutter's pin, or the timer in its place, and the exposure under way.
pub(crate) struct Shutter<P> {
    pin: P,
    timer: Timer,
    exposure: Option<Open>,
}

#[derive(Debug)]
struct Open {
    start_us: u64,
    duration_us: u32,
    photodiode: Meter,
    readings: Readings,
}

/// How the photodiode is read.
#[derive(Debug)]
enum Meter {
    /// At so many midpoints of equal parts, or just before the end.
    Polled { planned: u32 },
    /// By itself; asked next at a time in µs.
    Itself { ask_us: u64 },
}

/// What came of an exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Closed {
    /// It was open for the time asked for.
    InTime(Exposure),
    /// It was open for so much longer, µs.
    Late(u32),
}

/// Standard deviation over mean, in millionths: √(nΣx² − (Σx)²)/Σx.
fn flicker_ppm(readings: &Readings) -> u32 {
    let sum = u128::from(readings.sum);
    let spread = u128::from(readings.count) * u128::from(readings.sum_of_squares) - sum * sum;
    (spread * 1_000_000_000_000).isqrt().checked_div(sum).unwrap_or(0).min(u32::MAX.into()) as u32
}

fn shut(pin: &mut impl OutputPin, timer: &mut Timer) -> Result<(), PinFailure> {
    match timer {
        Some(timer) => timer.close().then_some(()).ok_or(PinFailure),
        None => set(pin, false),
    }
}

impl Open {
    /// When the photodiode has to be looked at next, in µs.
    fn look_us(&self) -> u64 {
        match self.photodiode {
            Meter::Polled { planned } if self.readings.count < planned => {
                let half_parts = u64::from(2 * self.readings.count + 1);
                let middle = u64::from(self.duration_us) * half_parts / u64::from(2 * planned);
                (self.start_us + middle).min(self.end_us().saturating_sub(BEFORE_END_US))
            }
            Meter::Polled { .. } => u64::MAX,
            Meter::Itself { ask_us } => ask_us,
        }
    }

    fn look(&mut self, now_us: u64, photodiode: &mut impl AnalogInput) -> Result<(), PinFailure> {
        match &mut self.photodiode {
            Meter::Polled { .. } => self.readings.add(photodiode.read().ok_or(PinFailure)?),
            Meter::Itself { ask_us } => {
                *ask_us = now_us + u64::from(READING_EVERY_US);
                self.readings += photodiode.gather().ok_or(PinFailure)?;
            }
        }
        Ok(())
    }

    fn end_us(&self) -> u64 {
        self.start_us + u64::from(self.duration_us)
    }

    /// What it was, open for so long.
    fn exposure(&self, open_us: u32) -> Exposure {
        let Readings { count, sum, .. } = self.readings;
        Exposure {
            start_us: self.start_us,
            open_us,
            reference_q8: (sum << 8).checked_div(count.into()).unwrap_or(0) as u32,
            readings: count,
            flicker_ppm: flicker_ppm(&self.readings),
        }
    }
}

impl<P: OutputPin> Shutter<Line<P>> {
    /// Tells it how its pin is wired; of a timer's pin the board is told.
    pub(crate) fn wire(&mut self, inverted: bool) {
        self.pin.wire(inverted);
    }
}

impl<P: OutputPin> Shutter<P> {
    pub(crate) fn new(pin: P, timer: Timer) -> Self {
        Self { pin, timer, exposure: None }
    }

    /// Whether it is open.
    pub(crate) fn is_open(&self) -> bool {
        self.exposure.is_some()
    }

    /// Opens it for `duration_us`.
    pub(crate) fn open(
        &mut self,
        now_us: u64,
        duration_us: u32,
        photodiode: &mut impl AnalogInput,
    ) -> Result<(), PinFailure> {
        let start_us = match &mut self.timer {
            Some(timer) => {
                let at = timer.open(duration_us).ok_or(PinFailure)?;
                now_us.saturating_add_signed(i64::from(at.wrapping_sub(now_us as u32) as i32))
            }
            None => {
                set(&mut self.pin, true)?;
                now_us
            }
        };
        let photodiode = if photodiode.begin(duration_us) {
            Meter::Itself { ask_us: start_us + u64::from(READING_EVERY_US) }
        } else {
            Meter::Polled { planned: duration_us.div_ceil(READING_EVERY_US).max(LEAST_READINGS) }
        };
        self.exposure = Some(Open { start_us, duration_us, photodiode, readings: Readings::default() });
        Ok(())
    }

    /// Closes it, whatever it was doing.
    pub(crate) fn close(&mut self) -> Result<(), PinFailure> {
        self.exposure = None;
        shut(&mut self.pin, &mut self.timer)
    }

    /// When it next has to be polled, in µs.
    pub(crate) fn next_us(&self) -> u64 {
        self.exposure.as_ref().map_or(u64::MAX, |open| open.look_us().min(open.end_us()))
    }

    /// When the exposure under way ends, in µs.
    pub(crate) fn end_us(&self) -> Option<u64> {
        self.exposure.as_ref().map(Open::end_us)
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
        if now_us < open.end_us() {
            if now_us >= open.look_us() {
                open.look(now_us, photodiode)?;
            }
            return Ok(None);
        }
        // One that its timer has closed was open for just its time, however late it is looked at.
        let by_itself = self.timer.as_mut().is_some_and(|timer| !timer.is_open());
        if !by_itself {
            shut(&mut self.pin, &mut self.timer)?;
        }
        let late_us = if by_itself { 0 } else { now_us - open.end_us() };
        if matches!(open.photodiode, Meter::Itself { .. }) {
            open.look(now_us, photodiode)?;
        }
        let exposure = open.exposure((u64::from(open.duration_us) + late_us) as u32);
        self.exposure = None;
        let in_time = late_us <= MAX_LATE_US;
        Ok(Some(if in_time { Closed::InTime(exposure) } else { Closed::Late(late_us as u32) }))
    }
}
