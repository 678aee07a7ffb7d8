//! The brown-out level, in the option bytes: as delivered the chip runs on down to 1.8 V, where flash and
//! pins do what they like.

use lobelia_board_support::brown_out::{is_highest, with_highest};
use lobelia_firmware::BrownOut;
use stm32f4xx_hal::pac;

/// What unlocks the option bytes.
const KEYS: [u32; 2] = [0x0819_2A3B, 0x4C5D_6E7F];

/// Resets the chip below 2.7 V, its highest level.
#[derive(Debug)]
pub(crate) struct Level3;

fn flash() -> &'static pac::flash::RegisterBlock {
    // SAFETY: what is written here are the option bytes' registers, which nothing else touches.
    unsafe { &*pac::FLASH::ptr() }
}

impl BrownOut for Level3 {
    fn is_set(&mut self) -> bool {
        is_highest(flash().optcr().read().bits())
    }

    fn set(&mut self) {
        let flash = flash();
        for key in KEYS {
            // SAFETY: the keys in their order unlock, anything else locks until the next reset.
            flash.optkeyr().write(|w| unsafe { w.bits(key) });
        }
        while flash.sr().read().bsy().bit_is_set() {}
        // SAFETY: all other option bytes stay as they were loaded.
        flash.optcr().modify(|r, w| unsafe { w.bits(with_highest(r.bits())) });
        flash.optcr().modify(|_, w| w.optstrt().set_bit());
        while flash.sr().read().bsy().bit_is_set() {}
        flash.optcr().modify(|_, w| w.optlock().set_bit());
    }
}
