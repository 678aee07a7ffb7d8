//! The time in µs since the start, from a counter that counts down, wraps and interrupts, or from one that
//! counts µs up and wraps at 32 bits.

use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// Time kept by a counter that runs down from `TICKS_PER_US * PERIOD_US - 1` to 0 and starts again.
#[derive(Debug)]
pub struct Clock<const TICKS_PER_US: u32, const PERIOD_US: u32> {
    /// Whole periods, lower and upper half. Only the counter's interrupt writes them.
    periods: AtomicU32,
    periods_high: AtomicU32,
}

impl<const TICKS_PER_US: u32, const PERIOD_US: u32> Clock<TICKS_PER_US, PERIOD_US> {
    /// What the counter starts from.
    pub const RELOAD: u32 = TICKS_PER_US * PERIOD_US - 1;

    /// Time 0.
    pub const fn new() -> Self {
        Self { periods: AtomicU32::new(0), periods_high: AtomicU32::new(0) }
    }

    /// From the counter's interrupt: a period is over.
    pub fn period_over(&self) {
        let periods = self.periods.load(Relaxed).wrapping_add(1);
        if periods == 0 {
            self.periods_high.store(self.periods_high.load(Relaxed).wrapping_add(1), Relaxed);
        }
        self.periods.store(periods, Relaxed);
    }

    /// The lower half of [`Self::now_us`], for less work.
    #[inline(always)]
    pub fn wrapping_us(&self, mut counter: impl FnMut() -> (u32, bool)) -> u32 {
        loop {
            let periods = self.periods.load(Relaxed);
            let (value, waiting) = counter();
            if self.periods.load(Relaxed) == periods {
                let over = u32::from(waiting && value > Self::RELOAD / 2);
                let in_period = (Self::RELOAD - value) / TICKS_PER_US;
                return periods.wrapping_add(over).wrapping_mul(PERIOD_US).wrapping_add(in_period);
            }
        }
    }

    /// The time in µs. `counter` gives the counter's value and then whether its interrupt is waiting to run,
    /// read in this order; the interrupt may come at any moment.
    pub fn now_us(&self, mut counter: impl FnMut() -> (u32, bool)) -> u64 {
        loop {
            let high = self.periods_high.load(Relaxed);
            let low = self.periods.load(Relaxed);
            let (value, waiting) = counter();
            if self.periods.load(Relaxed) != low || self.periods_high.load(Relaxed) != high {
                continue;
            }
            // The wait may have begun before or after the value was read: a high value is one of the new
            // period.
            let over = waiting && value > Self::RELOAD / 2;
            let periods = (u64::from(high) << 32 | u64::from(low)) + u64::from(over);
            return periods * u64::from(PERIOD_US) + u64::from((Self::RELOAD - value) / TICKS_PER_US);
        }
    }
}

impl<const TICKS_PER_US: u32, const PERIOD_US: u32> Default for Clock<TICKS_PER_US, PERIOD_US> {
    fn default() -> Self {
        Self::new()
    }
}

/// A counter of µs that wraps at 32 bits, extended to 64. Nothing has to happen when it wraps: it is enough
/// to ask for the time once a turn, 71 minutes.
#[derive(Debug, Default)]
pub struct Extended {
    /// Turns of the counter, and what it last read.
    turns: AtomicU32,
    last: AtomicU32,
}

impl Extended {
    /// A counter that has not yet turned.
    pub const fn new() -> Self {
        Self { turns: AtomicU32::new(0), last: AtomicU32::new(0) }
    }

    /// The time in µs, from the counter's reading. Only the main loop may ask, so that readings come in
    /// order.
    pub fn now_us(&self, count: u32) -> u64 {
        let mut turns = self.turns.load(Relaxed);
        if count < self.last.load(Relaxed) {
            turns = turns.wrapping_add(1);
            self.turns.store(turns, Relaxed);
        }
        self.last.store(count, Relaxed);
        u64::from(turns) << 32 | u64::from(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counter_of_32_bits_goes_on_past_each_wrap() {
        let clock = Extended::new();
        let mut at = 0;
        // A little less than a turn at a time.
        for _ in 0..10 {
            assert_eq!(clock.now_us(at as u32), at);
            at += 0xFFFF_0000u64;
        }
        assert!(at >> 32 > 8);
    }

    type TestClock = Clock<50, 1000>;

    #[test]
    fn time_counts_periods_and_what_the_counter_has_run_down() {
        let clock = TestClock::new();
        assert_eq!(clock.now_us(|| (TestClock::RELOAD, false)), 0);
        assert_eq!(clock.now_us(|| (0, false)), 999);
        clock.period_over();
        assert_eq!(clock.now_us(|| (TestClock::RELOAD - 50, false)), 1001);
    }

    #[test]
    fn period_whose_interrupt_waits_counts_once_the_counter_has_wrapped() {
        let clock = TestClock::new();
        assert_eq!(clock.now_us(|| (TestClock::RELOAD, true)), 1000);
        // Read just before the wrap, which then came.
        assert_eq!(clock.now_us(|| (0, true)), 999);
        assert_eq!(clock.wrapping_us(|| (TestClock::RELOAD, true)), 1000);
        assert_eq!(clock.wrapping_us(|| (0, true)), 999);
    }

    #[test]
    fn reading_that_an_interrupt_broke_into_is_repeated() {
        let clock = TestClock::new();
        let mut readings = 0;
        let time = clock.now_us(|| {
            readings += 1;
            if readings == 1 {
                clock.period_over();
                (0, false)
            } else {
                (TestClock::RELOAD, false)
            }
        });
        assert_eq!((time, readings), (1000, 2));
    }

    #[test]
    fn periods_run_past_32_bits() {
        let clock = TestClock::new();
        clock.periods.store(u32::MAX, Relaxed);
        clock.period_over();
        assert_eq!(clock.now_us(|| (TestClock::RELOAD, false)), (1 << 32) * 1000);
        assert_eq!(clock.wrapping_us(|| (TestClock::RELOAD - 50, false)), 1);
    }
}
