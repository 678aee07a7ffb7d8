//! Pins as the controller sees them, their safe state, and what the emergency stop does to them. The README has the map.

use core::convert::Infallible;
use core::sync::atomic::{AtomicBool, Ordering::Relaxed};

use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use lobelia_firmware::StepPins;
use lobelia_firmware::safety::EmergencyStop;
use stm32f4xx_hal::gpio::{AnyPin, Input, Output, PushPull};
use stm32f4xx_hal::pac;

/// Pins of port C that step: two bits each in its mode register, and 01 is an output.
const STEP_MODES: u32 = 0xFF;
const STEPS_OUT: u32 = 0x55;
/// The emergency stop's line.
const STOP: u32 = 1 << 9;

/// The emergency stop, between its interrupt and the controller.
pub(crate) static EMERGENCY_STOP: EmergencyStop = EmergencyStop::new();
/// Whether the step pins are let go, so that what is written to them reaches no driver.
static HELD: AtomicBool = AtomicBool::new(false);

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

/// The step pins, PC0 to PC3, written at once.
#[derive(Debug)]
pub struct StepPort(());

impl StepPort {
    /// Takes the pins, set up as outputs.
    pub(crate) fn new(_: [AnyPin<Output<PushPull>>; 4]) -> Self {
        Self(())
    }
}

impl StepPins for StepPort {
    fn write(&mut self, raise: u8, lower: u8) -> bool {
        // SAFETY: `BSRR` is written whole and only changes the pins named, which belong to this port alone.
        unsafe { (*pac::GPIOC::ptr()).bsrr().write(|w| w.bits(u32::from(raise) | u32::from(lower) << 16)) };
        true
    }
}

/// An input: with a pull-up and a contact to ground that opens when the switch is met, so that a broken wire reads the same; or with
/// a pull-down, for what may be left out.
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
        // is the purpose.
        unsafe { (*port).bsrr().write(|w| w.bits(bits)) };
    }
    // SAFETY: as above. Shutter, lamp and its level; the last is made a plain output instead of the timer's.
    unsafe {
        let port = &*pac::GPIOA::ptr();
        port.bsrr().write(|w| w.bits(0b111 << (4 + LOW)));
        port.moder().modify(|r, w| w.bits(r.bits() & !(0b11 << 12) | 0b01 << 12));
    }
}

fn set_step_modes(modes: u32) {
    // SAFETY: only the step pins' modes change, and these here alone once the board is set up.
    unsafe { (*pac::GPIOC::ptr()).moder().modify(|r, w| w.bits(r.bits() & !STEP_MODES | modes)) };
}

/// The emergency stop's interrupt: everything off at once, whatever the controller is about to write to the step pins.
pub(crate) fn stop() {
    // SAFETY: writing a line's bit forgets its interrupt and does nothing else.
    unsafe { (*pac::EXTI::ptr()).pr().write(|w| w.bits(STOP)) };
    safe_state();
    set_step_modes(0);
    HELD.store(true, Relaxed);
    EMERGENCY_STOP.trip();
}

/// Takes the step pins and the lamp's level back once the controller has seen the stop; it steps no axis then, and its lamp is off.
pub fn after_poll() {
    if HELD.load(Relaxed) {
        cortex_m::interrupt::free(|_| {
            if !EMERGENCY_STOP.is_tripped() {
                HELD.store(false, Relaxed);
                // What was written to the step pins meanwhile must not become an edge.
                safe_state();
                set_step_modes(STEPS_OUT);
                // SAFETY: only the mode of the lamp level's pin changes, back to its timer's.
                unsafe {
                    (*pac::GPIOA::ptr()).moder().modify(|r, w| w.bits(r.bits() & !(0b11 << 12) | 0b10 << 12));
                }
            }
        });
    }
}
