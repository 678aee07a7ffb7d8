//! The processor's supply, by its internal reference: an injected conversion of ADC 1, which interrupts those of the photodiode for 23 µs
//! and leaves their settings alone.

use stm32f4xx_hal::pac;

/// Reading of the reference at 3.3 V, from the factory.
const CALIBRATION: *const u16 = 0x1FFF_7A2A as *const u16;
const CALIBRATED_MV: u32 = 3300;
/// The reference's input.
const REFERENCE: u8 = 17;

/// Sets the conversion up, once the converter is on.
pub(crate) fn start() {
    // SAFETY: these bits are used here alone.
    let (adc, common) = unsafe { (&*pac::ADC1::ptr(), &*pac::ADC_COMMON::ptr()) };
    common.ccr().modify(|_, w| w.tsvrefe().set_bit());
    // It wants 10 µs: 480 cycles at 21 MHz.
    adc.smpr1().modify(|_, w| w.smp17().cycles480());
    // SAFETY: one conversion, of an input that there is.
    adc.jsqr().write(|w| unsafe { w.jl().bits(0).jsq4().bits(REFERENCE) });
}

/// The supply by the conversion that was begun when this was last asked, mV; begins another.
pub(crate) fn millivolts() -> Option<u16> {
    // SAFETY: the injected conversion is used here alone.
    let adc = unsafe { &*pac::ADC1::ptr() };
    let done = adc.sr().read().jeoc().bit_is_set();
    let reading = u32::from(adc.jdr1().read().jdata().bits());
    adc.sr().modify(|_, w| w.jeoc().clear_bit());
    adc.cr2().modify(|_, w| w.jswstart().set_bit());
    // SAFETY: the address is of memory that is there to be read.
    let calibration = u32::from(unsafe { CALIBRATION.read_volatile() });
    let millivolts = (calibration * CALIBRATED_MV).checked_div(reading)?;
    done.then_some(u16::try_from(millivolts).ok()?)
}
