//! The photodiode's amplifier on ADC1's input 0, PA0: read once, or by DMA again and again while the shutter
//! is open.
//!
//! A conversion takes 84 + 12 cycles of 21 MHz: 7 of them in 32 µs, 10.94 in a period of the lamp's dimmer,
//! which they so meet at all its phases.

use lobelia_board_support::meter::Meter;
use lobelia_firmware::{AnalogInput, Readings};
use stm32f4xx_hal::adc::Adc;
use stm32f4xx_hal::adc::config::SampleTime;
use stm32f4xx_hal::gpio::{Analog, PA0};
use stm32f4xx_hal::pac;

use crate::interrupt::{TICKS_PER_US, now_us};

/// Readings in the ring, 9 ms of them.
const SIZE: usize = 2048;
/// The DMA's stream and channel that ADC1 has.
const STREAM: usize = 0;
/// The first stream's flags.
const FLAGS: u32 = 0x3D;
/// From when the converter is on until it is steady, µs.
const STEADY_US: u32 = 3;
/// In `SR`: a reading was lost, and the converter has stopped.
const OVERRUN: u32 = 1 << 5;

/// The ring that the DMA writes into.
pub(crate) type Ring = [u16; SIZE];

/// The photodiode.
pub struct Photodiode {
    adc: Adc<pac::ADC1>,
    pin: PA0<Analog>,
    ring: *mut u16,
    meter: Meter<{ SIZE as u32 }, 7, 32>,
    /// Since when it reads by itself.
    since_us: Option<u64>,
}

// SAFETY: the ring is this one's alone, and the DMA's.
unsafe impl Send for Photodiode {}

fn adc() -> &'static pac::adc1::RegisterBlock {
    // SAFETY: whoever has the `Photodiode` has the converter.
    unsafe { &*pac::ADC1::ptr() }
}

fn dma() -> &'static pac::dma2::RegisterBlock {
    // SAFETY: nothing else has a DMA.
    unsafe { &*pac::DMA2::ptr() }
}

impl Photodiode {
    /// With its converter, and a ring that nobody else touches. The DMA's clock is running.
    pub(crate) fn new(adc: Adc<pac::ADC1>, pin: PA0<Analog>, ring: &'static mut Ring) -> Self {
        Self { adc, pin, ring: ring.as_mut_ptr(), meter: Meter::default(), since_us: None }
    }

    fn stop(&mut self) {
        self.since_us = None;
        // SAFETY: converter and stream off.
        unsafe {
            adc().cr2().write(|w| w.bits(0));
            dma().st(STREAM).cr().write(|w| w.bits(0));
        }
        while dma().st(STREAM).cr().read().en().bit_is_set() {}
        // On again, for single conversions.
        adc().cr2().write(|w| w.adon().set_bit());
        cortex_m::asm::delay(STEADY_US * TICKS_PER_US);
    }
}

impl AnalogInput for Photodiode {
    fn read(&mut self) -> Option<u16> {
        if self.since_us.is_some() {
            self.stop();
        }
        // 28 + 12 cycles at 21 MHz: 2 µs.
        Some(self.adc.convert(&self.pin, SampleTime::Cycles_28))
    }

    fn begin(&mut self, duration_us: u32) -> bool {
        self.stop();
        self.meter = Meter::begin(duration_us);
        let stream = dma().st(STREAM);
        // SAFETY: halfwords from the converter's register into the ring, round and round; the ring lives for
        // ever.
        unsafe {
            dma().lifcr().write(|w| w.bits(FLAGS));
            stream.par().write(|w| w.bits(adc().dr().as_ptr() as u32));
            stream.m0ar().write(|w| w.bits(self.ring as u32));
            stream.ndtr().write(|w| w.bits(SIZE as u32));
            stream.cr().write(|w| w.msize().bits16().psize().bits16().minc().incremented().circ().enabled());
            stream.cr().modify(|_, w| w.en().enabled());
            // Input 0 alone, 84 cycles.
            adc().cr1().write(|w| w.bits(0));
            adc().smpr2().write(|w| w.bits(0b100));
            adc().sqr1().write(|w| w.bits(0));
            adc().sqr3().write(|w| w.bits(0));
            adc().sr().write(|w| w.bits(0));
        }
        // Again and again, each to the DMA for as long as it asks.
        adc().cr2().write(|w| w.adon().set_bit().cont().set_bit().dma().set_bit().dds().set_bit());
        adc().cr2().modify(|_, w| w.swstart().set_bit());
        self.since_us = Some(now_us());
        true
    }

    fn gather(&mut self) -> Option<Readings> {
        let mut readings = Readings::default();
        let Some(since_us) = self.since_us else { return Some(readings) };
        if adc().sr().read().bits() & OVERRUN != 0 {
            self.stop();
            return None;
        }
        let place = (SIZE as u32 - dma().st(STREAM).ndtr().read().bits()) % SIZE as u32;
        for number in self.meter.take(now_us() - since_us, place) {
            // SAFETY: within the ring; the DMA writes whole readings.
            readings.add(unsafe { self.ring.add(number as usize % SIZE).read_volatile() });
        }
        if self.meter.is_over() {
            self.stop();
        }
        Some(readings)
    }
}
