//! The watchdog: its first period that ends unfed interrupts and is reported with the place where the program
//! hangs, the second one resets the chip even if no interrupt can run.

use lobelia_board_support::crash::{CrashCause, CrashRecord};

use crate::crash::{crash, interrupted_at};
use crate::interrupt::TICKS_PER_US;
use crate::register::{system, watchdog};

/// A period, µs.
const PERIOD_US: u32 = 500_000;

/// The chip's watchdog, which starts at its first feeding.
#[derive(Debug)]
pub(crate) struct Watchdog;

impl lobelia_firmware::Watchdog for Watchdog {
    fn feed(&mut self) {
        watchdog::LOAD.write(PERIOD_US * TICKS_PER_US);
        // Interrupt first, then reset. Once set, the former stays.
        watchdog::CTL.write(0b11);
    }
}

/// What to report if the last reset was the watchdog's own, and no handler could write a record.
pub(crate) fn take_reset() -> Option<CrashRecord> {
    let was = system::RESC.read() & system::RESET_BY_WATCHDOG != 0;
    system::RESC.write(0);
    was.then_some(CrashRecord { cause: CrashCause::Watchdog, place: 0 })
}

/// The watchdog's handler.
// SAFETY: the vector table asks for this name, and nothing else bears it.
#[unsafe(no_mangle)]
#[unsafe(naked)]
unsafe extern "C" fn WATCHDOG() {
    core::arch::naked_asm!("mrs r0, MSP", "b {bark}", bark = sym bark)
}

extern "C" fn bark(stack: *const u32) -> ! {
    crash(CrashCause::Watchdog, interrupted_at(stack))
}
