//! The processor's supply, by its internal reference: an injected conversion of ADC 1, which leaves the
//! photodiode's settings alone. It would interrupt its conversions for 23 µs, so there is none while they run
//! by themselves.

use core::sync::atomic::{AtomicU16, Ordering::Relaxed};

use stm32f4xx_hal::pac;

use crate::interrupt::TICKS_PER_US;

/// Reading of the reference at 3.3 V, from the factory.
const CALIBRATION: *const u16 = 0x1FFF_7A2A as *const u16;
const CALIBRATED_MV: u32 = 3300;
/// The reference's input.
const REFERENCE: u8 = 17;

/// What was measured last, mV; 0 before that.
static LATEST: AtomicU16 = AtomicU16::new(0);

/// Sets the conversion up, once the converter is on, and begins the first.
pub(crate) fn start() {
    // SAFETY: these bits are used here alone.
    let (adc, common) = unsafe { (&*pac::ADC1::ptr(), &*pac::ADC_COMMON::ptr()) };
    common.ccr().modify(|_, w| w.tsvrefe().set_bit());
    // It wants 10 µs: 480 cycles at 21 MHz.
    adc.smpr1().modify(|_, w| w.smp17().cycles480());
    // SAFETY: one conversion, of an input that there is.
    adc.jsqr().write(|w| unsafe { w.jl().bits(0).jsq4().bits(REFERENCE) });
    // The reference, too, needs 10 µs to start.
    cortex_m::asm::delay(10 * TICKS_PER_US);
    adc.cr2().modify(|_, w| w.jswstart().set_bit());
}

/// The supply by the latest conversion, mV; begins another, unless the photodiode reads by itself.
pub(crate) fn millivolts() -> Option<u16> {
    // SAFETY: the injected conversion is used here alone.
    let adc = unsafe { &*pac::ADC1::ptr() };
    if adc.cr2().read().cont().bit_is_clear() {
        if adc.sr().read().jeoc().bit_is_set() {
            LATEST.store(measured(adc.jdr1().read().jdata().bits()).unwrap_or(0), Relaxed);
        }
        adc.sr().modify(|_, w| w.jeoc().clear_bit());
        adc.cr2().modify(|_, w| w.jswstart().set_bit());
    }
    Some(LATEST.load(Relaxed)).filter(|&millivolts| millivolts > 0)
}

/// The supply by a reading of the reference, mV.
fn measured(reading: u16) -> Option<u16> {
    // SAFETY: the address is of memory that is there to be read.
    let calibration = u32::from(unsafe { CALIBRATION.read_volatile() });
    u16::try_from((calibration * CALIBRATED_MV).checked_div(reading.into())?).ok()
}
