//! Pins as the controller sees them, and their safe state. The README has the map.

use core::convert::Infallible;

use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use stm32f4xx_hal::gpio::{AnyPin, Input, Output, PushPull};
use stm32f4xx_hal::pac;

/// An output; drivers' enable inputs are inverted.
#[derive(Debug)]
pub struct OutputLine {
    pin: AnyPin<Output<PushPull>>,
    inverted: bool,
}

impl OutputLine {
    pub(crate) fn new(pin: AnyPin<Output<PushPull>>) -> Self {
        Self { pin, inverted: false }
    }

    pub(crate) fn inverted(pin: AnyPin<Output<PushPull>>) -> Self {
        Self { pin, inverted: true }
    }

    fn set(&mut self, high: bool) {
        if high != self.inverted {
            self.pin.set_high();
        } else {
            self.pin.set_low();
        }
    }
}

impl ErrorType for OutputLine {
    type Error = Infallible;
}

impl OutputPin for OutputLine {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.set(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.set(true);
        Ok(())
    }
}

/// An input with its pull-up: a contact to ground that opens when the switch is met, so that a broken wire reads the same.
#[derive(Debug)]
pub struct InputLine(pub(crate) AnyPin<Input>);

impl ErrorType for InputLine {
    type Error = Infallible;
}

impl InputPin for InputLine {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.is_high())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.is_low())
    }
}

/// Puts every output where nothing moves, burns or exposes, whoever owns the pins.
pub(crate) fn safe_state() {
    /// In `BSRR`, the upper half makes pins low.
    const LOW: u32 = 16;
    let writes = [
        // Steps and directions low.
        (pac::GPIOC::ptr(), 0x00FF << LOW),
        // Drivers off: their enable inputs high.
        (pac::GPIOB::ptr().cast(), 0xF000),
    ];
    for (port, bits) in writes {
        // SAFETY: `BSRR` is written whole and only changes the pins named; that this breaks into what their owners do
        // is the purpose, and they never run again.
        unsafe { (*port).bsrr().write(|w| w.bits(bits)) };
    }
    // SAFETY: as above. Shutter, lamp and its level; the last is made a plain output instead of the timer's.
    unsafe {
        let port = &*pac::GPIOA::ptr();
        port.bsrr().write(|w| w.bits(0b111 << (4 + LOW)));
        port.moder().modify(|r, w| w.bits(r.bits() & !(0b11 << 12) | 0b01 << 12));
    }
}
