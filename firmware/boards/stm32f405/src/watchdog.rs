//! The independent watchdog, which runs on an oscillator of its own and resets the chip.

use lobelia_board_support::crash::{CrashCause, CrashRecord};
use stm32f4xx_hal::pac;
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::watchdog::IndependentWatchdog;

/// Longer than the erasing of a sector, 0.8 s at most, at the oscillator's fastest, 47 kHz instead of 32.
const PERIOD_MS: u32 = 2000;

/// The watchdog, which starts at its first feeding.
#[derive(Debug)]
pub(crate) struct Watchdog {
    timer: IndependentWatchdog,
    started: bool,
}

impl Watchdog {
    pub(crate) fn new(timer: pac::IWDG) -> Self {
        Self { timer: IndependentWatchdog::new(timer), started: false }
    }
}

impl lobelia_firmware::Watchdog for Watchdog {
    fn feed(&mut self) {
        if !self.started {
            self.started = true;
            self.timer.start(PERIOD_MS.millis());
        }
        self.timer.feed();
    }
}

/// What to report if the watchdog caused the last reset. Where the program hung is not known.
pub(crate) fn take_reset(rcc: &pac::RCC) -> Option<CrashRecord> {
    let was = rcc.csr().read().wdgrstf().bit_is_set();
    rcc.csr().modify(|_, w| w.rmvf().set_bit());
    was.then_some(CrashRecord { cause: CrashCause::Watchdog, place: 0 })
}
