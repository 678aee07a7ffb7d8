//! The shutter on TIM5's second comparator, PA1: opened and closed by the very counter that is the
//! controller's clock, to the tick of 1 µs.

use cortex_m::interrupt::free;
use lobelia_firmware::TimedShutter;
use stm32f4xx_hal::pac;

/// From the call until it opens, µs: time to set the comparator.
const LEAD_US: u32 = 4;
/// The comparator's match did not come.
const PATIENCE_US: u32 = 50;

/// Channel 2's part of `CCMR1`, and what it does at a match.
const MODE: u32 = 0b111 << 12;
const ACTIVE_AT_MATCH: u32 = 0b001 << 12;
const INACTIVE_AT_MATCH: u32 = 0b010 << 12;
const INACTIVE: u32 = 0b100 << 12;
/// In `CCER`: the channel's output, and that it is inverted.
const ENABLE: u32 = 1 << 4;
const INVERTED: u32 = 1 << 5;
/// In `SR`.
const MATCHED: u32 = 1 << 2;

/// The shutter's timer.
#[derive(Debug)]
pub(crate) struct ShutterTimer;

fn timer() -> &'static pac::tim5::RegisterBlock {
    // SAFETY: the second channel's registers and bits are touched here only, others are left as they are.
    unsafe { &*pac::TIM5::ptr() }
}

fn set_mode(mode: u32) {
    // SAFETY: only the second channel's mode changes.
    timer().ccmr1_output().modify(|r, w| unsafe { w.bits(r.bits() & !MODE | mode) });
}

fn compare(at_us: u32) {
    let timer = timer();
    // SAFETY: any comparison is allowed; a flag is cleared by 0, and 1 leaves it.
    unsafe {
        timer.ccr2().write(|w| w.bits(at_us));
        timer.sr().write(|w| w.bits(!MATCHED));
    }
}

fn has_matched() -> bool {
    timer().sr().read().bits() & MATCHED != 0
}

/// Closed, by a wiring that may be inverted; the pin follows once it is the timer's.
pub(crate) fn set_up(inverted: bool) {
    set_mode(INACTIVE);
    let output = ENABLE | if inverted { INVERTED } else { 0 };
    // SAFETY: only the second channel's output changes.
    timer().ccer().modify(|r, w| unsafe { w.bits(r.bits() & !(ENABLE | INVERTED) | output) });
}

impl TimedShutter for ShutterTimer {
    fn open(&mut self, duration_us: u32) -> Option<u32> {
        // For some µs nothing may come between: the shutter is closed by the second comparison, which has to
        // be set in time. No axis moves.
        free(|_| {
            let now = || timer().cnt().read().bits();
            let at_us = now().wrapping_add(LEAD_US);
            compare(at_us);
            set_mode(ACTIVE_AT_MATCH);
            while !has_matched() {
                if now().wrapping_sub(at_us) as i32 > PATIENCE_US as i32 {
                    set_mode(INACTIVE);
                    return None;
                }
            }
            compare(at_us.wrapping_add(duration_us));
            set_mode(INACTIVE_AT_MATCH);
            Some(at_us)
        })
    }

    fn close(&mut self) -> bool {
        set_mode(INACTIVE);
        true
    }

    fn is_open(&mut self) -> bool {
        timer().ccmr1_output().read().bits() & MODE == INACTIVE_AT_MATCH && !has_matched()
    }
}
